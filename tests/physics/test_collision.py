import numpy as np
import pytest

from kncal import InputError, Material, calibrate, pair
from kncal.report.collision import collision_paths, plot_collision

PAIR = pair(Material(young=70e9, poisson=0.22, density=2500.0), 1e-3)


@pytest.mark.parametrize("law", ["tsuji", "kuwabara_kono", "hunt_crossley", "hertz", "walton_braun", "linear"])
@pytest.mark.parametrize("end", ["overlap", "force"])
def test_paths_obey_newton_and_end_as_calibrated(law, end):
    c = calibrate(PAIR, v_0=0.5, e_n=0.8, law=law, end=end)
    for kind, path in collision_paths(c, 4001).items():
        impulse = np.trapezoid(path.force, path.t)
        change = PAIR.m_eff * (path.delta_dot[0] - path.delta_dot[-1])
        assert impulse == pytest.approx(change, rel=1e-4)
        expected = c if kind == "linear" else c.reference
        assert path.t[-1] == pytest.approx(expected.t_c, rel=1e-9)
        assert path.delta.max() == pytest.approx(expected.delta_max, rel=1e-5)
        assert path.delta[-1] == pytest.approx(expected.delta_end, abs=1e-7 * expected.delta_max)


def test_loop_area_is_the_energy_lost():
    c = calibrate(PAIR, v_0=0.5, e_n=0.8)
    for path in collision_paths(c, 4001).values():
        area = np.trapezoid(path.force, path.delta)
        assert area == pytest.approx(0.5 * PAIR.m_eff * 0.25 * (1 - 0.8**2), rel=1e-4)


def test_picture(tmp_path):
    c = calibrate(PAIR, v_0=0.5, e_n=0.5)
    plot_collision(c, tmp_path / "one.png")
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match=r"\.png"):
        plot_collision(c, tmp_path / "one.jpg")
    with pytest.raises(InputError, match="does not exist"):
        plot_collision(c, tmp_path / "no" / "one.png")
    with pytest.raises(InputError, match="one impact"):
        collision_paths(calibrate(PAIR, v_0=[0.5, 1.0], e_n=0.5))
