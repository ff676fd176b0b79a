import math

import numpy as np
import pytest

from kncal import (
    InputError,
    Material,
    PairMatrix,
    ValidityError,
    calibrate,
    calibrate_matrix,
    matrix_block,
    pair,
    wall_pair,
)

GLASS = Material(young=70e9, poisson=0.22, density=2500.0)
STEEL = Material(young=210e9, poisson=0.3, density=7800.0)
MATRIX = calibrate_matrix(
    {"small": (GLASS, 1e-3), "large": (STEEL, 3e-3)}, {"floor": STEEL, "rigid": None}, v_0=0.5, e_n=0.9
)


def test_every_pair_has_its_own_numbers():
    assert MATRIX.names == ("small", "large", "floor", "rigid")
    assert set(MATRIX.calibrations) == {
        ("small", "small"),
        ("small", "large"),
        ("large", "large"),
        ("small", "floor"),
        ("small", "rigid"),
        ("large", "floor"),
        ("large", "rigid"),
    }
    k_n = MATRIX.matrix("k_n")
    assert np.array_equal(k_n, k_n.T)
    assert (k_n > 0).all()
    assert k_n[0, 1] == calibrate(pair(GLASS, 1e-3, STEEL, 3e-3), v_0=0.5, e_n=0.9).k_n
    assert k_n[0, 3] == calibrate(wall_pair(GLASS, 1e-3), v_0=0.5, e_n=0.9).k_n
    assert MATRIX["rigid", "small"] is MATRIX["small", "rigid"]


def test_gamman_gives_the_wanted_restitution_in_every_pair():
    # e = exp(-pi zeta/sqrt(1 - zeta²)) with zeta = gamman sqrt(m_eff/k_n)/2, as hooke/stiffness computes it
    for calibration in MATRIX.calibrations.values():
        zeta = calibration.gamma_n / 2 * math.sqrt(calibration.pair.m_eff / calibration.k_n)
        assert math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)) == pytest.approx(0.9, rel=1e-10)


def test_one_gamman_for_all_would_be_wrong_at_a_wall():
    # the known 0.8615: same k_n and gamman at a wall of twice the effective mass
    both = calibrate(pair(GLASS, 1e-3), v_0=0.5, e_n=0.9)
    zeta = both.gamma_n / 2 * math.sqrt(2 * both.pair.m_eff / both.k_n)
    assert math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)) == pytest.approx(0.8615, abs=5e-5)


def test_shortest_contact_time_and_values_per_pair():
    assert MATRIX.t_c == min(c.t_c for c in MATRIX.calibrations.values())
    own = calibrate_matrix({"a": (GLASS, 1e-3)}, {"w": None}, v_0={("w", "a"): 1.0, ("a", "a"): 0.1}, e_n=0.8)
    assert own["a", "w"].v_0 == 1.0
    assert own["a", "a"].v_0 == 0.1


def test_liggghts_block_holds_the_matrix_with_all_digits():
    block = matrix_block(MATRIX)
    line = next(x for x in block.splitlines() if " kn " in x and "property/global" in x)
    numbers = np.array([float(x) for x in line.split()[7:]]).reshape(4, 4)
    assert np.array_equal(numbers, MATRIX.matrix("k_n"))


def test_frame_and_warnings_name_their_pair():
    frame = MATRIX.to_frame()
    assert len(frame) == 7
    assert list(frame.columns[:2]) == ["type_1", "type_2"]
    assert any(w.startswith("small–large: size ratio") for w in MATRIX.warnings)


def test_bad_matrix():
    with pytest.raises(InputError, match="at least one"):
        calibrate_matrix({}, v_0=1.0, e_n=0.9)
    with pytest.raises(InputError, match="distinct"):
        calibrate_matrix({"a": (GLASS, 1e-3)}, {"a": None}, v_0=1.0, e_n=0.9)
    with pytest.raises(InputError, match="a–b"):
        calibrate_matrix({"a": (GLASS, 1e-3), "b": (GLASS, 1e-3)}, v_0={("a", "a"): 1.0}, e_n=0.9)
    with pytest.raises(InputError, match="no contact"):
        MATRIX["floor", "rigid"]


@pytest.mark.parametrize(
    "name", ["a\nrun 1", "a b", "", "x" * 65, "$a", "Stahlwände", "-a", "a;b", 'a"', "a\r", "a\n", 1, None, ("a",)]
)
def test_no_name_can_become_a_command(name):
    for particles, walls in (({name: (GLASS, 1e-3)}, None), ({"a": (GLASS, 1e-3)}, {name: None})):
        with pytest.raises(InputError, match="name"):
            calibrate_matrix(particles, walls, v_0=0.5, e_n=0.9)
    if isinstance(name, str):
        # nor by hand
        with pytest.raises(InputError, match="name"):
            PairMatrix((name,), (), {(name, name): MATRIX["small", "small"]})


COMMANDS = ("# ", "fix ", "pair_style gran model ", "pair_coeff * *", "timestep ", "hard_particles yes")


@pytest.mark.parametrize("style", ["hooke/stiffness", "hooke", "hertz"])
def test_liggghts_block_has_no_lines_but_those_of_contacts(style):
    names = ["a.b-c_D", "9", "x" * 64]
    matrix = calibrate_matrix({n: (GLASS, 1e-3) for n in names}, {"w": None}, v_0=0.5, e_n=0.9, method="strain_energy")
    for line in matrix_block(matrix, style).splitlines():
        assert line.startswith(COMMANDS)
        if line.startswith("fix "):
            _, name, _, where, same, *_ = line.split()
            assert (where, same) == ("property/global", name)


def test_the_block_has_the_tangential_stiffness_asked_for():
    def kt_over_kn(**options):
        lines = {words[1]: words[7:] for words in map(str.split, matrix_block(MATRIX, **options).splitlines())}
        return float(lines["kt"][0]) / float(lines["kn"][0])

    assert kt_over_kn() == pytest.approx(2.0 * (1.0 - 0.22) / (2.0 - 0.22), rel=1e-12)  # Mindlin, like materials
    assert kt_over_kn(k_t_ratio=2.0 / 7.0) == pytest.approx(2.0 / 7.0, rel=1e-12)


def test_a_matrix_made_by_hand_says_what_it_lacks_for_a_block():
    with pytest.raises(InputError, match="calibrate_matrix"):
        matrix_block(PairMatrix(("a",), (), {("a", "a"): MATRIX["small", "small"]}))
    with pytest.raises(InputError, match="style"):
        matrix_block(MATRIX, "hooke/hysteresis")


def test_liggghts_block_states_the_contact_end_it_needs():
    for end, word in (("overlap", "limitForce off"), ("force", "limitForce on")):
        matrix = calibrate_matrix({"a": (GLASS, 1e-3)}, {"w": None}, v_0=0.5, e_n=0.9, end=end)
        comments = [line for line in matrix_block(matrix).splitlines() if line.startswith("#")]
        assert any(word in line for line in comments)


SOFT = Material(young=1e3, poisson=0.3, density=2500.0)


@pytest.mark.parametrize(
    ("change", "words", "error"),
    [
        ({"v_0": {("a", "a"): 1.0, ("a", "w"): -1.0}}, "a–w: v_0", InputError),
        ({"particles": {"a": (GLASS, 1e-3), "b": (GLASS, 1e-30)}}, "a–b: .*radius_2", InputError),
        ({"particles": {"a": (GLASS, 1e-3), "b": (SOFT, 1e-3)}, "v_0": 5.0}, "a–b: .*overlap", ValidityError),
        ({"v_0": {("a", "a"): 1.0, ("a", "w"): 1.0, ("a", "x"): 1.0}}, "'x'", InputError),
        ({"v_0": {("a", "a"): 1.0, ("a", "w"): 1.0, ("w", "w"): 1.0}}, "'w', 'w'", InputError),
        ({"v_0": {("a", "a"): 1.0, ("a", "w"): 1.0, ("w", "a"): 2.0}}, "a–w: expected one", InputError),
        ({"e_n": {("a", "a"): 0.9, "aw": 0.9}}, "'aw'", InputError),
        ({"e_n": {("a", "a"): [0.9, 0.8], ("a", "w"): 0.9}}, "e_n of a–a .*single", InputError),
        ({"v_0": [0.5, 1.0]}, "v_0 .*single", InputError),
        ({"e_n": np.array([0.9])}, "e_n .*single", InputError),
        ({"particles": {"a": (GLASS, [1e-3, 2e-3])}}, "radius of a .*single", InputError),
        ({"method": "contact_time", "t_c": [1e-5, 2e-5]}, "a–a: .*single", InputError),
        (
            {"particles": {"a": (Material(young=[7e10, 8e10], poisson=0.2, density=2500.0), 1e-3)}},
            "a–a: .*single",
            InputError,
        ),
        ({"walls": {"w": "steel"}}, "a–w: wall_material", InputError),
        ({"walls": ["w"]}, "walls", InputError),
        ({"particles": 1.0}, "particles", InputError),
        ({"particles": {"a": GLASS}}, "particles.*'a'.*radius", InputError),
        ({"particles": {"a": ("glass", 1e-3)}}, "particles.*'a'.*Material", InputError),
    ],
)
def test_refusals_name_the_pair_or_the_argument(change, words, error):
    arguments = {"particles": {"a": (GLASS, 1e-3)}, "walls": {"w": None}, "v_0": 0.5, "e_n": 0.9} | change
    with pytest.raises(error, match=words):
        calibrate_matrix(**arguments)


def test_a_pair_named_twice_alike_is_no_contradiction():
    both = {("a", "a"): 1.0, ("a", "w"): 0.5, ("w", "a"): 0.5}
    assert calibrate_matrix({"a": (GLASS, 1e-3)}, {"w": None}, v_0=both, e_n=0.9)["w", "a"].v_0 == 0.5


@pytest.mark.parametrize("quantity", ["foo", "warnings", "pair", "__class__", None, 1])
def test_only_numbers_make_a_matrix(quantity):
    with pytest.raises(InputError, match="quantity"):
        MATRIX.matrix(quantity)


def test_every_number_makes_a_matrix():
    for quantity in ("k_n", "eta_n", "gamma_n", "zeta", "kappa", "t_c", "delta_max", "delta_mean", "v_0", "e_n"):
        assert MATRIX.matrix(quantity)[0, 2] == getattr(MATRIX["small", "floor"], quantity)


@pytest.mark.parametrize("key", ["small", ("small",), 3, ("small", "nobody"), (["small"], "floor"), "ab"])
def test_an_unknown_pair_is_refused(key):
    with pytest.raises(InputError, match="small–floor"):
        MATRIX[key]
