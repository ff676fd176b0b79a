"""Trades of beds: the split of errors on made-up runs of known averages, parts of runs, and a small bed for real."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compared_beds import run_data

from kncal.engines.settle import to_settle
from kncal.observe.compare import compare
from kncal.observe.difference import rows_between
from kncal.record.steps import REACTION_LIMIT
from kncal.runs.workflow import load
from kncal.scene.case_file import dump_case, load_case
from kncal.scene.load import bottom_overlaps, fluidised
from kncal.scene.scene import Scene
from kncal.study import Variant, VariantRun
from kncal.study.trade import averaged
from kncal.study.trade import run as loop
from kncal.study.trade import runs as bed_runs
from kncal.study.trade.candidates import START_OVERLAP, STIFF, contacts, settling_spring, shared_case
from kncal.study.trade.errors import NAMES, average_splits
from kncal.study.trade.reference import reference_steps
from kncal.study.trade.run import trade_scene
from kncal.study.trade.runs import Runs, load_part
from kncal.study.trade.trade import Candidate, TradeOptions

pytestmark = pytest.mark.slow

Z = "z_mean"


def candidate(how: str, factor: float | None, steps: float, model: str = "linear") -> Candidate:
    name = f"{how}-{factor}-{steps:g}"
    return Candidate(
        name=name, how=how, factor=factor, steps_per_contact=steps, variant=Variant(name=name, model=model)
    )


def mean_height(kind: str, seed: int, share: float):
    """A run whose mean height is ``share`` above 10 mm, long enough to know it to about 1 %."""
    return run_data(kind, seed, length=10.0, means={"z_mean": 0.010 * (1.0 + share)})


@pytest.fixture(scope="module")
def chain():
    """Hertz; unsoftened linear 5 % above; softened another 10 %; at a coarse step another 20 % of the reference's."""
    return {
        "reference": mean_height("hertz", 1, 0.0),
        "unsoftened": mean_height("linear", 2, 0.05),
        "softened": mean_height("linear", 3, 0.15),
        "coarse": mean_height("linear", 4, 0.35),
    }


def errors_of(run, reference, tolerances):
    return {row.metric: row for row in rows_between(run, reference, tolerances, NAMES)}


def judged(name: str, chain, of: Candidate):
    return of, chain[name], errors_of(chain[name], chain["reference"], {})


def test_the_split_finds_each_part_and_leaves_nothing(chain):
    points = [
        judged("unsoftened", chain, candidate("mean_overlap", 1.0, 50.0)),
        judged("softened", chain, candidate("softened", 0.1, 50.0)),
        judged("coarse", chain, candidate("softened", 0.1, 10.0)),
    ]
    splits = average_splits(points, chain["reference"], 50.0)
    split = next(s for s in splits[points[2][0].name] if s.metric == Z)
    for part, known in ((split.discretisation, 0.20), (split.softness, 0.10), (split.model, 0.05)):
        # intervals of 95 %: twice the width is missed by one in ten thousand
        assert abs(part.value - known) <= 2.0 * part.width
        assert part.width < 0.05
    assert split.interaction == pytest.approx(0.0, abs=1e-12)
    assert split.missing == ()
    fine = next(s for s in splits[points[1][0].name] if s.metric == Z)
    assert fine.discretisation is None
    assert fine.total.value == pytest.approx(fine.softness.value + fine.model.value, abs=1e-12)


def test_a_part_within_its_interval_is_not_resolved(chain):
    run, of = mean_height("linear", 9, 0.0), candidate("mean_overlap", 1.0, 50.0)
    same = of, run, errors_of(run, chain["reference"], {})
    (split,) = (s for s in average_splits([same], chain["reference"], 50.0)[of.name] if s.metric == Z)
    assert not split.model.significant
    assert split.model.value == split.total.value


def test_parts_that_were_not_run_are_missing(chain):
    coarse = judged("coarse", chain, candidate("softened", 0.1, 10.0))
    (split,) = (s for s in average_splits([coarse], chain["reference"], 50.0)[coarse[0].name] if s.metric == Z)
    assert (split.discretisation, split.softness, split.model, split.interaction) == (None, None, None, None)
    assert len(split.missing) == 3


def test_errors_are_those_of_a_comparison_of_two_beds():
    """Against a comparison of the same two runs: same numbers, same verdicts; any run may be the reference."""
    linear, hertz = run_data("linear", 5, means={"z_mean": 0.0105}), run_data("hertz", 6)
    tolerances = {Z: 0.2, "eps_g": 0.1, "pressure_drop": 0.02, "overlap_mean": 0.001}
    rows = {row.metric: row for row in compare(linear, hertz, tolerances).rows}
    found = errors_of(linear, hertz, tolerances)
    assert set(found) == set(rows)
    for name in tolerances:
        assert found[name].verdict == rows[name].verdict
    assert found[Z].difference.value == rows[Z].difference.value
    two = errors_of(run_data("hertz", 7), hertz, {})
    assert "relative to reference" in two[Z].basis
    assert abs(two[Z].difference.value) <= 2.0 * two[Z].difference.width


@pytest.mark.parametrize(("rms", "noise"), [(0.05, 0.001), (0.02, 0.02), (0.11, 0.02)])
def test_the_interval_of_a_field_decides_as_its_row_does(rms, noise, monkeypatch):
    monkeypatch.setattr("kncal.observe.difference.voidage_difference", lambda *_: (rms, noise))
    linear, hertz = run_data("linear", 5), run_data("hertz", 6)
    for limit in (0.01, 0.045, 0.06, 0.1, 0.2):
        row = compare(linear, hertz, {"eps_g": limit}).row("eps_g")
        assert errors_of(linear, hertz, {"eps_g": limit})["eps_g"].verdict == row.verdict


# --- candidates and starts ----------------------------------------------------


def mini(end_time: float, count: int = 300, **contact) -> Scene:
    scene = load_case("bubbling_bed_mini")
    return replace(
        scene.with_group(count=count, place="lattice"),
        run=replace(scene.run, until_time=end_time, discard=0.0, frames_every=0.001, steps_per_contact=10.0),
        contact=replace(scene.contact, **contact),
    )


def written(scene: Scene, folder: Path) -> Path:
    path = folder / "bed" / "case.toml"
    path.parent.mkdir()
    path.write_text(dump_case(scene), encoding="utf-8")
    return path


def test_every_pair_is_softened_by_the_factor_and_keeps_its_restitution(tmp_path):
    from kncal.scene.plan import plan

    case = written(mini(0.1), tmp_path)
    options = TradeOptions(reference=("materials.soft.young=5e8",), factors=(1.0, 0.01))
    top, tried = contacts(case, options)

    def planned(contact, kind):
        return plan(load_case(case, overrides=contact.at(20.0).variant.overrides), (kind,))[kind]

    hard, soft = (planned(contact, "linear") for contact in tried[:2])
    for pair, contact in hard.contacts.items():
        assert soft.contacts[pair].k == pytest.approx(0.01 * contact.k, rel=1e-12)
        assert soft.contacts[pair].t_c == pytest.approx(10.0 * contact.t_c, rel=1e-12)
        assert soft.contacts[pair].e_n == contact.e_n
        # eta_n = 2 zeta sqrt(k m): softer by a hundred is damped by a tenth
        assert soft.contacts[pair].c == pytest.approx(0.1 * contact.c, rel=1e-12)
    real, reduced = planned(top, "hertz"), planned(tried[3], "hertz")
    for pair, contact in real.contacts.items():
        assert reduced.contacts[pair].k == pytest.approx(0.01 * contact.k, rel=1e-12)
    # the same number of steps per contact for every model
    for model in (hard, soft, real, reduced):
        assert min(c.t_c for c in model.contacts.values()) / model.dt == pytest.approx(20.0)


def test_the_reference_takes_the_smallest_step_that_changes_its_contacts_little_enough():
    scene = mini(0.1)
    loose, tight = (reference_steps(scene, (10.0, 20.0, 50.0, 400.0), t) for t in (0.3, 0.02))
    assert loose[0] < tight[0]
    assert loose[1] <= 0.03
    assert tight[1] <= 0.002
    assert reference_steps(replace(scene, run=replace(scene.run, steps_per_contact=70.0)), (10.0,), 0.3)[0] == 70.0


def test_a_bed_that_gas_moves_starts_loose_and_one_at_rest_does_not(tmp_path):
    moving = mini(0.1).with_group(place="settled")
    assert fluidised(moving)
    path, notes = shared_case(moving, tmp_path)
    assert load_case(path).group.place == "lattice"
    assert any("loose lattice" in note for note in notes)
    still = replace(moving, gas=replace(moving.gas, U_0=0.1))  # U_mf of such particles is some tenths of a metre per s
    assert not fluidised(still)


def test_a_stiff_bed_at_rest_is_settled_by_a_softer_spring():
    """Hertz's reference may be stiff; what it starts from is a packing in which overlaps are a thousandth of d."""
    from kncal.scene.plan import plan

    def overlap(young: float) -> float:
        scene = mini(0.1)
        scene = replace(scene, materials={"soft": replace(scene.materials["soft"], young=young)})
        scene = scene.with_group(place="settled", settle_k_n=settling_spring(scene))
        model = plan(to_settle(scene), ("linear",))["linear"]
        return bottom_overlaps(model)[0, 0] / scene.diameter

    assert overlap(7e10) == pytest.approx(START_OVERLAP)
    assert overlap(5e5) > START_OVERLAP / STIFF


@pytest.mark.parametrize("count", [300, 20_000])
def test_all_candidates_settle_alike_however_many_particles_there_are(tmp_path, count):
    """A packing is found by a hash of what it depends on: the contact that is tried is not among that."""

    from kncal.engines.settle import _key
    from kncal.scene.placement import Start
    from kncal.scene.plan import plan

    scene = load_case("packed_bed")
    width, depth, height = scene.box.size
    scene = scene.with_box(size=(width, depth, height * max(count / scene.number, 1.0)))
    scene = scene.with_group(count=count, place="settled", frozen=False)
    case = written(replace(scene, gas=None), tmp_path)
    path, _ = shared_case(load_case(case), tmp_path / "trade")
    top, tried = contacts(case, TradeOptions(factors=(1.0, 0.1)))
    keys = set()
    for contact in (top, *tried):
        for steps in (10.0, 50.0):
            bed_scene = load_case(path, overrides=contact.at(steps).variant.overrides)
            assert bed_scene.number == count
            keys.add(_key(plan(to_settle(bed_scene), ("linear",))["linear"], Start.at(np.zeros((1, 3)))))
    assert len(keys) == 1


# --- runs in part -------------------------------------------------------------


def ran(*spans: tuple[int, float], couplings: int = 1000) -> Runs:
    done, cpu = spans[-1]
    status = "completed" if done == couplings else "timed_out"
    ended = VariantRun(variant=Variant(name="run", model="linear"), status=status, cpu_seconds=(cpu,))
    there = {"spans": {"run": list(spans)}, "couplings": {"run": couplings}, "ended": {"run": ended}}
    return Runs(case="nowhere", folder=Path("nowhere"), **there)


def test_cpu_time_is_extrapolated_from_what_followed_the_start_up():
    # 0.1 s a coupling at the start, 0.2 s later
    run = ran((100, 10.0), (300, 50.0), (500, 90.0))
    assert run.seconds("run") == pytest.approx((200.0, 200.0))
    assert run.rates("run") == pytest.approx((0.1, 0.2))
    assert run.share("run") == pytest.approx(0.5)
    assert ran((100, 10.0)).seconds("run") == pytest.approx((100.0,))
    assert ran((100, 10.0)).rates("run") == ()
    assert ran((1000, 77.0)).seconds("run") == (77.0,)  # completed: measured
    assert ran((100, 10.0), (1000, 77.0)).seconds("run") == (77.0,)


# --- for real -----------------------------------------------------------------

OPTIONS = TradeOptions(
    steps=(10.0,), factors=(1.0, 0.1, 1e-4), overlaps=(), tolerances={"pressure_drop": 0.2, "z_mean": 0.1}, workers=2
)


def folders_of(trade: Path, *points):
    """The run folders of points: asked for without running anything."""
    runs = Runs(case=next((trade / "start").iterdir()), folder=trade / "runs", apart=True)
    runs.run([point.candidate for point in points], look=True)
    return [runs.ended[point.candidate.name].folder for point in points]


@pytest.mark.solver
def test_a_small_bed_is_traded_to_its_end(tmp_path):
    scene = mini(0.006)
    case = written(scene, tmp_path)
    said: list[str] = []
    trade = trade_scene(case, scene, tmp_path / "trade", OPTIONS, said.append)
    reference = trade.reference
    assert reference.completed
    assert reference.ran_share == pytest.approx(1.0)
    assert reference.errors == {}
    hard, soft = (trade.point(name) for name in ("linear-mean_overlap-N10", "linear-mean_overlap-over-10-N10"))
    assert hard.completed
    assert soft.completed
    # a tenth of the stiffness: a step sqrt(10) times as long, but for whole numbers of steps in a coupling
    assert hard.steps / soft.steps == pytest.approx(math.sqrt(10.0), rel=0.1)
    gone = trade.point("linear-mean_overlap-over-10000-N10")
    assert gone.status == "refused"
    assert gone.cpu_seconds == ()
    assert gone.message
    # the same numbers as a comparison of the same two run folders
    linear, hertz = (load(folder) for folder in folders_of(tmp_path / "trade", hard, reference))
    row = compare(linear, hertz).row("z_mean")
    assert hard.errors["z_mean"].difference.value == row.difference.value
    assert hard.cpu_seconds == pytest.approx((linear.result.cpu_seconds,))
    assert linear.series.reaction_error.max() <= REACTION_LIMIT
    names = {sign.name for sign in soft.signs}
    assert {"overlap_share", "leaking", "contact_number", "sound_speed", "static_overlap"} <= names
    # softer is worse in every sign that grows with softness
    for name in ("overlap_share", "sound_speed", "static_overlap"):
        one, ten = (next(s.value for s in p.signs if s.name == name) for p in (hard, soft))
        assert ten > one
    # again: nothing runs, and the same comes out
    said.clear()
    again = trade_scene(case, scene, tmp_path / "trade", OPTIONS, said.append)
    assert again.point(hard.candidate.name).errors == hard.errors
    assert said == ["one start for all runs"]


@pytest.mark.solver
def test_runs_that_a_budget_stopped_go_on(tmp_path, monkeypatch):
    monkeypatch.setattr(averaged, "SHORTEST", 0.5)
    monkeypatch.setattr(loop, "REST", 0.2)
    monkeypatch.setattr(bed_runs, "OVERHEAD", 0.5)
    scene = mini(20.0)
    case = written(scene, tmp_path)
    told: list[str] = []

    def trade(budget: float):
        return trade_scene(case, scene, tmp_path / "trade", replace(OPTIONS, budget=budget), told.append)

    # on a busy machine the solvers' start may take all of a short one
    first = next(found for budget in (5.0, 10.0, 20.0, 40.0) if (found := trade(budget)).reference.ran_share > 0.0)
    assert first.reference.ran_share < 1.0
    assert any("in part" in caveat for caveat in first.caveats)
    second = trade(1.6 * first.options.budget)
    shares = [[point.ran_share for point in (trade.reference, *trade.points)] for trade in (first, second)]
    assert all(after >= before for before, after in zip(*shares, strict=True))
    assert sum(shares[1]) > sum(shares[0])
    assert not list(tmp_path.glob("trade/runs/**/attempt-*"))  # none began again
    (run,) = folders_of(tmp_path / "trade", second.reference)
    series = load_part(run).series
    assert np.array_equal(series.coupling, np.arange(1, len(series.t) + 1))
    assert len(series.t) / couplings_of(scene) == pytest.approx(second.reference.ran_share)


@pytest.mark.solver
def test_a_candidate_of_the_same_model_runs_beside_the_reference(tmp_path):
    scene = mini(20.0)
    top, tried = contacts(written(scene, tmp_path), OPTIONS)
    other = next(c for c in tried if c.model == "hertz" and c.factor == 0.1)
    runs = Runs(case=tmp_path / "bed", folder=tmp_path / "runs", workers=2, apart=True)
    reference, beside = top.at(10.0), other.at(10.0)
    runs.run_beside(reference, [beside], seconds=6.0, limit=2.0)
    # two sweeps in one folder would have been refused; how far the two came is the machine's matter
    assert all(runs.ended[c.name].folder is not None for c in (reference, beside))


def couplings_of(scene: Scene) -> int:
    from kncal.scene.plan import plan

    return plan(scene, ("hertz",))["hertz"].couplings
