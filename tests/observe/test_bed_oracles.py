"""Beds whose answer is known, from made-up runs: final velocity, Ergun's gradient, U_mf; and what is not averaged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bed_runs import facts, series
from compared_beds import run_data
from hypothesis import given, settings
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.core.files import write_json
from kncal.observe.averages import observe_bed
from kncal.observe.compare import Comparison, compare
from kncal.observe.estimate import Estimate, apart
from kncal.observe.fluidization_curve import PACKED, fluidization_curve
from kncal.observe.packed_bed import ergun_plateaus
from kncal.observe.row import Row, judge
from kncal.observe.settling import final_velocity
from kncal.physics.fluidization import (
    ergun_gradient,
    minimum_fluidization_velocity,
    settling_velocity,
    terminal_velocity,
)
from kncal.record.facts import BedFacts
from kncal.record.series import BedSeries
from kncal.scene.gas import Gas
from kncal.scene.metrics import COUPLED, KINDS_OF_BEDS, METRICS, offered, why_not

pytestmark = pytest.mark.slow

GAS = Gas(cells=(5, 1, 20), density=1.2, viscosity=1.8e-5)


# --- the table ------------------------------------------------------------------------------------------------------


def test_every_metric_belongs_to_a_kind_of_bed_and_says_what_it_is() -> None:
    for name in offered(COUPLED):
        unit, text = METRICS[name].unit, METRICS[name].text
        assert unit and text
        assert any(not why_not(name, kind, changes=False) for kind in KINDS_OF_BEDS), name


@pytest.mark.parametrize(
    ("name", "kind"), [("bubble_number", "single"), ("U_mf", "steady"), ("velocity", "frozen"), ("ergun_ratio", "ramp")]
)
def test_what_a_bed_has_not_is_said_why(name: str, kind: str) -> None:
    assert KINDS_OF_BEDS[kind] in why_not(name, kind, changes=False)


# --- a single particle ----------------------------------------------------------------------------------------------


def falling(U_0: float, end: float, **changes: Any) -> BedSeries:
    """DEM06's sphere by the equation of motion."""
    of = facts(**({"count": 1, "diameter": 1e-4, "density": 2000.0, "gravity": 9.80665} | changes))
    n = round(end / of.coupling)
    t = of.coupling * np.arange(1, n + 1)
    v = settling_velocity(t, of.diameter, of.density, 1.2, 1.8e-5, gravity=of.gravity, U_gas=U_0)
    return series(of, n, momentum_z=of.mass * v, U_0=np.full(n, U_0))


@pytest.mark.parametrize(("end", "reference"), [(0.1, -0.05263133), (0.35, -0.05739251)])
def test_final_velocity_and_its_uncertainty(end: float, reference: float) -> None:
    """The references are those stored with MFIX's verification case DEM06."""
    found = final_velocity(falling(0.4, end), GAS)
    assert found.velocity == pytest.approx(reference, abs=1e-8)
    assert found.velocity == pytest.approx(found.settling, rel=1e-9)
    terminal = float(terminal_velocity(1e-4, 2000.0, 1.2, 1.8e-5, 9.80665))
    assert found.slip == pytest.approx(0.4 - found.velocity)
    # what is missing to the end is less than the change over the last relaxation time, and not much less
    left = abs(found.slip - terminal)
    assert left < found.slip_uncertainty < 4.0 * left
    assert found.terminal == terminal


def test_a_particle_without_a_final_velocity_has_none() -> None:
    fall = falling(0.4, 0.2)
    landed = fall.floor.copy()
    landed[-1] = 1e-8
    for run, gas, message in (
        (replace(fall, floor=landed), GAS, "touches"),
        (falling(0.4, 0.02), GAS, "shorter than the relaxation time"),
        (fall, None, "no gas"),
        (series(facts(), 20), GAS, "single"),
    ):
        with pytest.raises(InputError, match=message):
            final_velocity(run, gas)


# --- a frozen bed ---------------------------------------------------------------------------------------------------


def packed(velocities: tuple[float, ...], eps: float = 0.42, *, tilt: float = 0.0, factor: float = 1.0) -> BedSeries:
    """An even bed of 30 cell layers, then freeboard; ``tilt``: transverse over axial velocity; 20 couplings each."""
    of = facts()
    nx, ny, nz = of.cells
    h, dense = of.size[2] / nz, 30
    n = 20 * len(velocities)
    shape = (n, nz, ny, nx)
    eps_g = np.where(np.arange(nz) < dense, eps, 1.0)[None, :, None, None] * np.ones(shape)
    U_0 = np.repeat(velocities, 20)
    U = np.zeros((*shape, 3))
    U[..., 2] = U_0[:, None, None, None] / eps_g
    U[..., 0] = tilt * U[..., 2]
    z = (np.arange(nz) + 0.5) * h
    viscous = float(ergun_gradient(1e-9, eps, of.diameter, 1.2, 1.8e-5)) / 1e-9
    inertial = 1.75 * 1.2 * (1.0 - eps) / (eps**3 * of.diameter) * np.hypot(1.0, tilt)
    gradient = factor * (viscous * U_0 + inertial * U_0**2)
    p = gradient[:, None] * np.maximum(dense * h - z, 0.0) + 1.2 * of.gravity * (of.size[2] - z)
    nothing = np.full(n, np.nan)
    fields = {"eps_g": eps_g, "U": U, "p": np.broadcast_to(p[:, :, None, None], shape)}
    return series(of, n, U_0=U_0, floor=nothing, walls=nothing, **fields)


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_ergun_ratio_of_an_even_bed_is_one_at_every_velocity(tilt: float) -> None:
    """The drag acts along the velocity: across the axis it makes the axial gradient larger than U_0 alone says."""
    found = ergun_plateaus(packed((0.1, 0.3, 0.6), tilt=tilt), GAS)
    assert [p.U_0 for p in found] == [0.1, 0.3, 0.6]
    for p in found:
        assert p.ratio == pytest.approx(1.0, abs=1e-5)  # single precision of the frames
        assert p.uncertainty < 1e-5
        assert p.eps_g == pytest.approx(0.42)
        if not tilt:
            assert p.gradient == pytest.approx(p.ergun_mean, rel=1e-5)
    assert [(p.begin, p.end) for p in found] == [pytest.approx((a, a + 0.02)) for a in (0.0, 0.02, 0.04)]


def test_the_worst_plateau_is_the_metric() -> None:
    good, bad = packed((0.1, 0.3)), packed((0.1, 0.3), factor=1.05)
    mixed = replace(good, p=np.concatenate([good.p[:20], bad.p[20:]]))
    assert [p.ratio for p in ergun_plateaus(mixed, GAS)] == pytest.approx([1.0, 1.05], abs=1e-5)
    seen = observe_bed(mixed, gas=GAS)
    assert (seen.kind, seen.begin, len(seen.plateaus)) == ("frozen", 0.0, 2)
    assert "different states" in seen.why_not("pressure_drop")


def test_what_has_no_gradient_is_refused() -> None:
    run = packed((0.1, 0.3))
    with pytest.raises(InputError, match="layers of gas cells"):
        ergun_plateaus(replace(run, eps_g=np.where(np.arange(48)[:, None, None] < 3, run.eps_g, 1.0)), GAS)
    with pytest.raises(InputError, match="was held"):
        ergun_plateaus(replace(run, U_0=np.linspace(0.1, 0.3, 40)), GAS)
    with pytest.raises(InputError, match="no gas"):
        ergun_plateaus(run, None)


# --- a ramp ---------------------------------------------------------------------------------------------------------

BED = facts(count=2000, size=(0.04, 0.04, 0.2), density=1500.0)


def height(of: BedFacts, eps: float) -> float:
    return of.mass / of.density / (of.floor_area * (1.0 - eps))


def up_and_down(
    rising: float, falling: float, *, top: float = 1.8, bottom: float = 0.2, plateau: float = 1.0, noise: float = 0.0
) -> BedSeries:
    """Ergun's pressure drop at a void fraction per branch, at most ``plateau`` of the weight: U_mf is Ergun's."""
    n = 1500
    U = np.concatenate([np.full(50, bottom), np.linspace(bottom, top, n), np.linspace(top, bottom, n)])
    carried = BED.weight * (1.0 - 1.2 / BED.density) / BED.floor_area
    drops, z = [], []
    for eps, part in ((rising, U[: 50 + n]), (falling, U[50 + n :])):
        H = height(BED, eps)
        drop = np.minimum(ergun_gradient(part, eps, BED.diameter, 1.2, 1.8e-5) * H, plateau * carried)
        drops.append(drop)
        z.append(0.5 * np.where(drop < 0.999 * plateau * carried, H, 1.1 * H))
    p = np.concatenate(drops) + 1.2 * BED.gravity * BED.size[2]
    p += noise * carried * np.random.default_rng(3).normal(size=len(p))
    return series(BED, len(U), U_0=U, p_in=p, z_mean=np.concatenate(z))


def u_mf(eps: float) -> float:
    return float(minimum_fluidization_velocity(BED.diameter, BED.density, 1.2, 1.8e-5, eps))


@settings(max_examples=20, deadline=None)
@given(rising=st.floats(0.38, 0.45), falling=st.floats(0.38, 0.45))
def test_u_mf_of_ergun_beds_is_ergun_s(rising: float, falling: float) -> None:
    found = fluidization_curve(up_and_down(rising, falling), GAS)
    for branch, eps in ((found.rising, rising), (found.falling, falling)):
        assert branch.U_mf == pytest.approx(u_mf(eps), rel=1e-6)
        assert branch.uncertainty < 1e-6
        assert branch.eps_g == pytest.approx(eps, abs=1e-9)
        assert branch.ergun == pytest.approx(u_mf(eps), rel=1e-6)
        assert branch.plateau == pytest.approx(1.0, rel=1e-6)
        assert branch.U_mf_plateau == pytest.approx(branch.U_mf, rel=1e-6)
        assert branch.packed_drop(np.array([branch.U_mf]))[0] == pytest.approx(1.0)
    assert found.rising.largest == pytest.approx(1.0, rel=1e-6)


def test_u_mf_is_right_within_its_uncertainty_in_noise_and_with_a_low_plateau() -> None:
    found = fluidization_curve(up_and_down(0.40, 0.42, plateau=0.93, noise=0.03), GAS)
    for branch, eps in ((found.rising, 0.40), (found.falling, 0.42)):
        assert abs(branch.U_mf - u_mf(eps)) < branch.uncertainty < 0.05 * u_mf(eps)
        assert branch.plateau == pytest.approx(0.93, abs=branch.plateau_uncertainty + 0.005)
        # a lower plateau is met earlier: dU/U is between a half (inertial) and all (viscous) of 7 %
        assert 0.5 * 0.06 < 1.0 - branch.U_mf_plateau / branch.U_mf < 0.09


def test_a_bed_that_is_held_together_overshoots_on_the_way_up_only() -> None:
    run = up_and_down(0.40, 0.42)
    p = run.p_in.copy()
    carried = BED.weight * (1.0 - 1.2 / BED.density) / BED.floor_area
    late = slice(int(np.argmax(p >= p.max() * (1.0 - 1e-9))), None)
    p[late][:60] += 0.15 * carried
    found = fluidization_curve(replace(run, p_in=p), GAS)
    assert found.rising.largest == pytest.approx(1.15, abs=1e-3)
    assert found.falling.largest == pytest.approx(1.0, abs=1e-3)
    assert found.rising.U_mf == pytest.approx(u_mf(0.40), rel=1e-6)


@pytest.mark.parametrize(
    ("limits", "message"),
    [({"top": 0.6}, "fluidises the bed"), ({"bottom": 0.9}, "expected it to begin below|below .* m/s")],
)
def test_ramps_that_show_only_one_state_are_refused(limits: dict[str, float], message: str) -> None:
    assert PACKED * u_mf(0.4) > 0.6
    with pytest.raises(InputError, match=message):
        fluidization_curve(up_and_down(0.4, 0.4, **limits), GAS)


# --- in a comparison ------------------------------------------------------------------------------------------------


def test_averages_of_a_ramp_are_not_judged(tmp_path: Any) -> None:
    data = run_data("hertz", 3, bubble=False)
    U_0 = np.linspace(0.2, 0.8, len(data.series.t))
    ramp = replace(data, signals=replace(data.series, U_0=U_0))
    found = compare(ramp, ramp, {"z_mean": 0.05})
    row = found.row("z_mean")
    assert (row.verdict, row.run.value) == ("missing", None)
    assert "different states" in row.reason
    assert found.state == "outside"
    names = {r.metric for r in found.rows}
    assert "pressure_drop" not in names
    assert "eps_g" not in names
    assert "weight_closure" in names  # holds over any window, whatever the states
    write_json(tmp_path / "c.json", found.to_dict())
    assert json.loads((tmp_path / "c.json").read_text())["theory"]["hertz"]["curve"] is None


def both(run: BedSeries, tolerances: dict[str, float], gas: Gas = GAS) -> Comparison:
    """A linear and a Hertz run that do the very same."""
    made = []
    for kind in ("linear", "hertz"):
        data = run_data(kind, 3, bubble=False)
        scene = replace(data.model.scene, gas=gas, run=replace(data.model.scene.run, discard=None))
        made.append(replace(data, model=replace(data.model, scene=scene), signals=run))
    return compare(*made, tolerances)


def rises(factor: float) -> BedSeries:
    """Ergun's bed with a pressure drop of ``factor`` times Ergun's, up to the weight."""
    run = up_and_down(0.40, 0.42)
    column = 1.2 * BED.gravity * BED.size[2]
    carried = BED.weight * (1.0 - 1.2 / BED.density) / BED.floor_area
    drops = []
    for eps, part in ((0.40, slice(0, 1550)), (0.42, slice(1550, None))):
        drop = factor * ergun_gradient(run.U_0[part], eps, BED.diameter, 1.2, 1.8e-5) * height(BED, eps)
        drops.append(np.minimum(drop, carried))
    return replace(run, p_in=np.concatenate(drops) + column)


@pytest.mark.parametrize(
    ("metric", "right", "wrong"),
    [
        ("ergun_ratio", packed((0.1, 0.3)), packed((0.1, 0.3), factor=0.812)),
        ("ergun_ratio", packed((0.1,)), packed((0.1,), factor=1.06)),
        ("slip", falling(0.4, 0.35), falling(0.4, 0.35, density=2200.0)),
        ("U_mf", rises(1.0), rises(0.6)),
    ],
)
def test_models_that_agree_on_a_wrong_answer_are_not_within_tolerance(
    metric: str, right: BedSeries, wrong: BedSeries, tmp_path: Path
) -> None:
    """A frozen bed's gradient, a terminal velocity and U_mf have an answer; equal errors of both models cancel."""
    good = both(right, {metric: 0.01})
    assert (good.state, good.within) == ("within", True)
    assert {(k.metric, k.model, k.verdict) for k in good.known} == {
        (metric, kind, "ok") for kind in ("linear", "hertz")
    }
    if metric == "slip":  # the same fall in the gas of a lighter particle
        wrong = replace(wrong, facts=right.facts, momentum_z=wrong.momentum_z * right.facts.mass / wrong.facts.mass)
    bad = both(wrong, {metric: 0.01})
    assert bad.row(metric).verdict == "ok"
    assert (bad.state, bad.within) == ("outside", False)
    assert {k.verdict for k in bad.known} == {"outside"}
    assert not any("ithin tolerance" in text for text in bad.verdict.all)
    assert metric in bad.verdict.sentence
    assert both(wrong, {}).state == "outside"
    assert both(right, {}).state == "open"
    write_json(tmp_path / "c.json", bad.to_dict())
    assert json.loads((tmp_path / "c.json").read_text())["known"][0]["metric"] == metric


def test_another_drag_law_has_no_known_answer() -> None:
    wrong = both(packed((0.1,), factor=0.8), {"ergun_ratio": 0.01}, replace(GAS, drag="PlessisMasliyah"))
    assert (wrong.known, wrong.state) == ((), "within")


def test_own_values_that_are_too_uncertain_are_undecided_without_an_end_time() -> None:
    def judged(value: float, tolerance: float) -> Row:
        side = {x: Estimate(value=x, width=0.03, chance=True) for x in (value, 1.0)}
        found = apart(side[value], side[1.0], 1.0, ("linear", "hertz"))
        made = Row(
            metric="U_mf", unit="m/s", text="", run=side[value], reference=side[1.0], difference=found, scale=1.0
        )
        return judge(made, tolerance)

    undecided = judged(1.0, 0.02)
    assert (undecided.verdict, undecided.difference.needed_end) == ("undecided", None)
    assert judged(1.0, 0.05).verdict == "ok"
    assert judged(1.2, 0.05).verdict == "outside"
