"""Signs of softness against closed forms: columns, chains of masses and springs, single impacts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from compared_beds import SCENE, run_data
from hypothesis import given
from hypothesis import strategies as st

from kncal.engines.registry import get_engine
from kncal.observe.softness import secant, signs, sound_speed
from kncal.physics.impact import dimensionless_impact
from kncal.runs.workflow import load, run_case
from kncal.scene.case_file import load_case
from kncal.scene.contact import ContactChoice
from kncal.scene.load import bottom_overlaps
from kncal.scene.model import PairContact
from kncal.scene.plan import plan

D, RHO, G = SCENE.diameter, 1000.0, SCENE.g
MASS = RHO * math.pi / 6.0 * D**3


def by_name(found):
    return {sign.name: sign for sign in found}


def contact(k: float, n: float = 1.0, **changes) -> PairContact:
    values = {
        "law": "linear" if n == 1.0 else "hertz", "k": k, "n": n, "c": 0.0, "p": 0.0, "end": "overlap", "e_n": 1.0,
        "v_0": None, "t_c": 1e-4, "delta_max": None, "m_eff": MASS / 2.0, "R_eff": D / 4.0, "E_eff": 1e6,
        "G_eff": 1e6, "friction": 0.0, "rolling_friction": 0.0, "k_t": 0.0,
    }  # fmt: skip
    return PairContact(**(values | changes))


@given(st.floats(1e-3, 1e9), st.sampled_from([1.0, 1.5]), st.floats(1e-9, 1e3))
def test_the_spring_carries_the_force_at_its_overlap(k, n, force):
    assert k * contact(k, n).overlap_under(force) ** n == pytest.approx(force, rel=1e-12)


def test_overlaps_of_a_column_of_particles_at_rest():
    """A column one particle wide, solved as a chain of springs: the overlap at the floor is N m g/k exactly."""
    number, k = 40, 50.0
    scene = replace(
        SCENE.with_box(size=(D, D, 0.2)).with_group(count=number),
        gas=replace(SCENE.gas, cells=(1, 1, 100)),
        contact=ContactChoice(e_n=0.9, v_0=0.5, k_n=k),
    )
    pair, floor = bottom_overlaps(plan(scene, ("linear",))["linear"]).values()
    # K u = m g: displacements u, from the lowest up; each joined to the one below (the lowest to the floor)
    stiffness = k * (2.0 * np.eye(number) - np.eye(number, k=1) - np.eye(number, k=-1))
    stiffness[-1, -1] = k
    down = np.linalg.solve(stiffness, np.full(number, MASS * G))
    assert floor == pytest.approx(down[0], rel=1e-9)
    # two particles at the bottom carry one weight less; the estimate does not tell them apart
    assert pair == pytest.approx((down[1] - down[0]) * number / (number - 1), rel=1e-9)


@pytest.mark.parametrize("number", [20, 200])
def test_sound_in_a_chain_of_masses_and_springs(number):
    """The lowest mode of a clamped chain is a half wave: omega L/pi -> c, short of it by the known dispersion."""
    k = 123.0
    matrix = k / MASS * (2.0 * np.eye(number) - np.eye(number, k=1) - np.eye(number, k=-1))
    omega = math.sqrt(np.linalg.eigvalsh(matrix)[0])
    measured = omega * (number + 1) * D / math.pi
    q = math.pi / (number + 1) / 2.0
    assert measured / sound_speed(contact(k), D, MASS) == pytest.approx(math.sin(q) / q, rel=1e-9)


def test_the_secant_of_a_hertz_contact_is_its_force_over_its_overlap():
    delta, k_h = 3e-6, 1e6
    assert secant(contact(k_h, 1.5, delta_max=delta)) == pytest.approx(k_h * delta**1.5 / delta)


CASE = """
gravity = [0.0, 0.0, -9.81]
[materials.glass]
young = 1e7
poisson = 0.25
density = 2500.0
[particles.bead]
material = "glass"
diameter = 0.002
position = [0.0, 0.0, 0.001000001]
velocity = [0.0, 0.0, -1.0]
[walls.floor]
axis = "z"
position = 0.0
material = "rigid"
[contact]
e_n = 0.9
k_n = {k_n}
[run]
steps_per_contact = 400
until_time = {end}
"""


def test_signs_of_one_impact(tmp_path):
    """Overlap, weight and speed of sound of a linear impact, all in closed form; softer is worse in each."""
    m = 2500.0 * math.pi / 6.0 * 0.002**3
    before = {"overlap_share": 0.0, "static_overlap": 0.0, "sound_speed": 0.0}
    runs = {}
    for k_n in (10_000.0, 300.0):
        path = tmp_path / f"{k_n:g}" / "case.toml"
        path.parent.mkdir()
        path.write_text(CASE.format(k_n=k_n, end=2.0 * math.pi * math.sqrt(m / k_n)), encoding="utf-8")
        run_case(load_case(path), get_engine("builtin"), path.parent / "run", ("linear",))
        data = runs[k_n] = load(path.parent / "run" / "linear")
        found = by_name(signs(data))
        omega = math.sqrt(k_n / m)
        M = float(dimensionless_impact("linear", 0.9, "overlap").x_max)
        # gravity adds less than g/(omega v) of the overlap; N = 400 misses the maximum by less than 1e-3
        assert found["overlap_share"].value == pytest.approx(M / omega / 0.001, rel=1e-3 + 9.81 / omega)
        assert found["static_overlap"].value == pytest.approx(m * 9.81 / k_n / 0.002, rel=1e-9)
        assert found["sound_speed"].value == pytest.approx(1.0 / (0.002 * math.sqrt(k_n / m)), rel=1e-4)
        assert found["leaking"].value == 0.0
        assert found["overlap_share"].changed == (M / omega / 0.001 > found["overlap_share"].limit)
        assert all(found[name].value > value for name, value in before.items())
        before = {name: found[name].value for name in before}
    against = by_name(signs(runs[300.0], runs[10_000.0]))["sound_speed"]
    assert f"{math.sqrt(10_000.0 / 300.0):.3g} times as fast" in against.text


def test_a_centre_in_a_wall_is_a_leak():
    data = run_data("linear", 1)
    assert by_name(signs(data))["leaking"].changed is False
    x = data.series.x.copy()
    x[3, 17] = (0.01, 0.003, -1e-4)
    x[5, 4] = (0.01, 0.0061, 0.01)
    through = replace(data, signals=replace(data.series, x=x))
    sign = by_name(signs(through))["leaking"]
    assert sign.changed
    assert sign.value == 2.0


def test_contacts_per_particle_against_the_reference():
    """A tenth is the limit; a difference is one only with its whole interval."""
    reference = run_data("hertz", 2, means={"contacts": 90.0})
    same, more = (run_data("linear", 3, means={"contacts": value}) for value in (90.0, 130.0))
    assert by_name(signs(same, reference))["contact_number"].changed is False
    sign = by_name(signs(more, reference))["contact_number"]
    assert sign.changed
    # means of AR(1) signals with a spread of 5 %: the averages are known to some per cent
    assert sign.value == pytest.approx(130.0 / 90.0 - 1.0, abs=0.05)
    assert "contact_number" not in by_name(signs(more))
