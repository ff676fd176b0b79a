"""The trade of single contacts, by the builtin engine: candidates, errors and their split, files."""

import math

import numpy as np
import pytest

from kncal.core.errors import InputError
from kncal.engines.registry import get_engine
from kncal.observe.compare import PREDICTION_MARGIN
from kncal.physics.impact import dimensionless_impact
from kncal.runs.workflow import load, run_case
from kncal.scene.case_file import load_case
from kncal.scene.plan import plan
from kncal.study.trade.candidates import contacts, softened, softer_materials
from kncal.study.trade.errors import Reference, converge
from kncal.study.trade.run import trade_scene
from kncal.study.trade.trade import TradeOptions
from kncal.study.trade.workflow import run_trade
from kncal.study.variants import texts

pytestmark = pytest.mark.slow

FACTOR = 0.1

THREE_PAIRS = """
[materials.soft]
young = 1e7
poisson = 0.25
density = 2500.0

[particles.small]
material = "soft"
diameter = 0.001
position = [0.0, 0.0, 0.0051]
velocity = [0.0, 0.0, -1.0]

[particles.large]
material = "soft"
diameter = 0.004
position = [0.0, 0.0, 0.0021]
velocity = [0.0, 0.0, -0.5]

[walls.floor]
axis = "z"
position = 0.0
material = "soft"

[contact]
e_n = 0.9
friction = 0.1

[[contact.pairs]]
between = ["small", "large"]
e_n = 0.8
k_n = 5000.0

[run]
until_time = 0.002

[tolerances]
e_n = 0.01
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    options = TradeOptions(
        tolerances={"e_n": 0.05, "delta_max": 5.0, "trajectory": 10.0},
        factors=(1.0, FACTOR),
        steps=(20.0, 50.0),
        overlaps=(),
        rounds=2,
        engine="builtin",
    )
    return run_trade("wall_impact", tmp_path_factory.mktemp("trade"), options)


def exact(e_n=0.6):
    """Overlap and duration of the linear and the Hertz contact in units of their own stiffness, closed forms."""
    linear, hertz = dimensionless_impact("linear", e_n), dimensionless_impact("tsuji", e_n)
    models = plan(load_case("wall_impact"))
    (c,), (h,) = (tuple(models[kind].contacts.values()) for kind in ("linear", "hertz"))
    v_0 = c.v_0

    def of_linear(k_n):
        omega = math.sqrt(k_n / c.m_eff)
        return {"delta_max": float(linear.x_max) * v_0 / omega, "t_c": float(linear.tau_c) / omega, "e_n": e_n}

    def of_hertz(k_h):
        length = (h.m_eff * v_0**2 / k_h) ** 0.4
        return {"delta_max": float(hertz.x_max) * length, "t_c": float(hertz.tau_c) * length / v_0, "e_n": e_n}

    return of_linear, of_hertz, c.k, h.k


@pytest.mark.parametrize("metric", ["e_n", "delta_max", "t_c"])
@pytest.mark.parametrize("steps", [20, 50])
def test_the_split_of_a_softened_impact_is_the_difference_of_closed_forms(found, metric, steps):
    of_linear, of_hertz, k_n, k_h = exact()
    real = of_hertz(k_h)[metric]
    unsoftened, soft = of_linear(k_n)[metric], of_linear(FACTOR * k_n)[metric]
    name = f"linear-mean_overlap-over-10-N{steps}"
    (split,) = (s for s in found.trade.splits[name] if s.metric == metric)
    # the parts carry the discretisation error of the converged runs, predicted for the worst sub-step phase
    assert abs(split.softness.value - (soft - unsoftened) / real) <= PREDICTION_MARGIN * split.softness.width
    assert abs(split.model.value - (unsoftened - real) / real) <= PREDICTION_MARGIN * split.model.width
    # and these errors are small against what is split
    assert split.softness.width <= 0.02 * max(abs(soft / real), 1.0)
    # the step: at most the worst error predicted at its N, of the softened contact
    from kncal.physics.timestep import predict_error

    worst = predict_error("linear", 0.6, float(steps)).worst[metric] * soft / real
    assert abs(split.discretisation.value) <= PREDICTION_MARGIN * worst + split.discretisation.width
    # of numbers the parts add up
    assert split.interaction == pytest.approx(0.0, abs=1e-12 * max(1.0, abs(split.total.value)))


def test_a_reduced_modulus_is_softness_alone(found):
    _, of_hertz, _, k_h = exact()
    (split,) = (s for s in found.trade.splits["hertz-E-over-10-N50"] if s.metric == "delta_max")
    assert split.model is None
    expected = of_hertz(FACTOR * k_h)["delta_max"] / of_hertz(k_h)["delta_max"] - 1.0
    assert abs(split.softness.value - expected) <= PREDICTION_MARGIN * split.softness.width


def test_paths_are_apart_by_no_more_than_their_parts_together(found):
    # largest distances obey the triangle inequality, so that the interaction is never above zero
    splits = [s for splits in found.trade.splits.values() for s in splits if s.metric == "trajectory"]
    assert splits
    for split in splits:
        assert split.interaction <= 1e-9


def test_n_means_the_same_for_every_contact_and_all_runs_end_together(found):
    ends = []
    for p in found.trade.points:
        kind = p.candidate.model
        model = plan(load_case("wall_impact", overrides=p.candidate.variant.overrides), (kind,))[kind]
        (contact,) = model.contacts.values()
        assert p.dt * p.candidate.steps_per_contact == pytest.approx(contact.t_c, rel=1e-12)
        ends.append(model.t_end)
    assert len(set(ends)) == 1
    # long enough for the softest contact
    assert max(c.t_c for c in model.contacts.values()) < ends[0]


def test_the_error_of_every_point_covers_the_exact_error_of_its_contact(found):
    of_linear, of_hertz, k_n, k_h = exact()
    real = of_hertz(k_h)
    for p in found.trade.points:
        factor = p.candidate.factor
        if p.candidate.how in ("softened", "mean_overlap"):
            own = of_linear(factor * k_n)
        elif p.candidate.how == "reduced_modulus":
            own = of_hertz(factor * k_h)
        else:
            continue
        for metric in ("e_n", "delta_max"):
            e = p.errors[metric]
            # the interval goes up to the converged error plus the worst of all phases
            limit = abs(e.difference.value) + e.difference.width
            assert abs(own[metric] / real[metric] - 1.0) <= PREDICTION_MARGIN * limit


def test_the_chosen_case_runs_and_repeats_the_error(found, tmp_path):
    chosen = found.conclusion.chosen
    # the tolerances admit all that keeps e_n: the cheapest is a softened one
    assert chosen is not None and chosen.candidate.factor == FACTOR
    scene = load_case(found.case)
    assert "steps per contact" in scene.title and "10" in scene.title
    assert scene.run.until_bounces == 1
    kind = chosen.candidate.model
    run_case(scene, get_engine("builtin"), tmp_path / "out", (kind,))
    metrics = load(tmp_path / "out" / kind).observations.metrics
    for metric in ("e_n", "delta_max"):
        # the same steps, but for the end
        assert metrics[metric] == pytest.approx(chosen.errors[metric].run.value, rel=1e-9)


def test_the_files_of_a_trade(found):
    import pandas as pd

    from kncal.core.files import read_json

    data = read_json(found.folder / "trade.json")
    assert data["chosen"] == found.conclusion.chosen.candidate.name
    table = pd.read_csv(found.folder / "trade.csv", comment="#")
    assert len(table) == len(found.trade.points) + 1
    assert list(table.loc[table["chosen"], "name"]) == [data["chosen"]]
    page = found.page.read_text("utf-8")
    assert found.answer.sentence.split(":")[0] in page
    assert {"front.png", "split.png", "law.png"} <= {path.name for path in found.page.parent.iterdir()}


def test_the_same_trade_again_runs_nothing(found):
    before = {path: path.stat().st_mtime_ns for path in found.folder.glob("screening/**/result.json")}
    again = trade_scene("wall_impact", load_case("wall_impact"), found.folder, found.trade.options, lambda _: None)
    assert {path: path.stat().st_mtime_ns for path in found.folder.glob("screening/**/result.json")} == before
    assert again.points == found.trade.points


def case(tmp_path, text):
    folder = tmp_path / "three"
    folder.mkdir()
    (folder / "case.toml").write_text(text)
    return folder


def test_softening_scales_every_pair_and_nothing_else(tmp_path):
    where = case(tmp_path, THREE_PAIRS)
    scene = load_case(where)
    before = plan(scene, ("linear",))["linear"]
    assert len({c.k for c in before.contacts.values()}) == 3
    changes = softened(where, scene, before, FACTOR, {"contact.pairs.0.k_n": None})
    after = plan(load_case(where, overrides=texts(changes)), ("linear",))["linear"]
    for names, contact in before.contacts.items():
        soft = after.contacts[names]
        assert soft.k == pytest.approx(FACTOR * contact.k, rel=1e-12)
        assert (soft.e_n, soft.friction, soft.v_0) == (contact.e_n, contact.friction, contact.v_0)
        assert soft.t_c == pytest.approx(contact.t_c / math.sqrt(FACTOR), rel=1e-9)


def test_every_contact_is_a_valid_variant_of_the_case(tmp_path):
    where = case(tmp_path, THREE_PAIRS)
    reference, tried = contacts(where, TradeOptions(reference=("materials.soft.young=2e7",), factors=(1.0, 0.1)))
    assert reference.model == "hertz"
    assert len({contact.name for contact in tried}) == len(tried)
    real = plan(load_case(where, overrides=texts(reference.changes)), ("hertz",))["hertz"]
    for contact in tried:
        model = plan(load_case(where, overrides=contact.at(20.0).variant.overrides), (contact.model,))[contact.model]
        if contact.how == "reduced_modulus":
            for names, c in model.contacts.items():
                # k_h is proportional to the modulus where all materials have the same factor
                assert c.k == pytest.approx(contact.factor * real.contacts[names].k, rel=1e-12)


def test_reference_overrides_come_before_the_reduction(tmp_path):
    where = case(tmp_path, THREE_PAIRS)
    assert softer_materials(where, ("materials.soft.young=4e7",), 0.25) == {"materials.soft.young": 1e7}


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        ({"reference": ("run.until_time=1.0",)}, "materials"),
        ({"factors": (1.0, 2.0)}, "factor"),
        ({"steps": (1.0,)}, "steps per contact"),
        ({"steps": (20.0, 20.0)}, "given twice"),
        ({"rounds": 0}, "rounds"),
        ({"budget": -1.0}, "budget"),
    ],
)
def test_bad_options_are_refused_before_any_run(tmp_path, change, hint):
    with pytest.raises(InputError, match=hint):
        run_trade("wall_impact", tmp_path / "out", TradeOptions(engine="builtin", **change))
    assert not list(tmp_path.rglob("result.json"))


def test_a_case_without_tolerances_needs_them(tmp_path):
    where = case(tmp_path, THREE_PAIRS.partition("[tolerances]")[0])
    with pytest.raises(InputError, match="--tolerance"):
        run_trade(where, tmp_path / "out", TradeOptions(engine="builtin"))


def test_values_from_outside_hold_for_all_and_for_the_chosen_case(tmp_path):
    options = TradeOptions(
        factors=(1.0,), steps=(50.0,), overlaps=(), rounds=1, engine="builtin", tolerances={"e_n": 0.2}
    )
    result = run_trade("wall_impact", tmp_path, options, overrides=["contact.e_n=0.5"])
    assert {p.errors["e_n"].reference.value for p in result.trade.points} == {
        result.trade.convergence.values["e_n"][-1]
    }
    assert result.trade.convergence.values["e_n"][-1] == pytest.approx(
        0.5, rel=result.trade.convergence.left["e_n"] + 1e-9
    )
    assert load_case(result.case).contact.e_n == 0.5


def test_what_is_left_of_the_reference_is_its_distance_to_the_exact_solution(found):
    _, of_hertz, _, k_h = exact()
    convergence = found.trade.convergence
    assert convergence.converged
    for metric, value in of_hertz(k_h).items():
        last = convergence.values[metric][-1]
        # closed forms and the event-driven motion agree to 1e-9
        assert abs(last - value) / value <= convergence.left[metric] + 1e-8


def test_a_reference_converges_only_when_it_stands_still(found):
    runs = {}
    for n in (100.0, 200.0):
        folders = found.folder.glob("screening/round-1/hertz/runs/*/hertz")
        for folder in folders:
            data = load(folder)
            scene = data.model.scene
            if scene.run.steps_per_contact == n and "young" not in scene.title:
                runs[n] = data
    assert set(runs) == {100.0, 200.0}
    moved = converge(runs, {"e_n": 0.1}, 1e-12, None, 1)
    assert not moved.converged
    assert not converge({100.0: runs[100.0]}, {"e_n": 0.1}, 1.0, None, 1).converged
    assert converge(runs, {"e_n": 0.1}, 1.0, None, 1).converged
    # paths are compared up to the end that was asked for, and a run is no distance from itself
    reference = Reference(run=runs[200.0], until=1e-5, contacts=1)
    assert reference.step("trajectory", 1.0, runs[200.0], runs[200.0]) == 0.0
    assert np.isfinite(reference.differences(runs[100.0])["trajectory"].difference.value)


def test_a_softened_contact_softens_every_wall_of_a_scene(tmp_path):
    """Walls of one material have one contact; an exception that names one of them would leave the others stiff."""
    text = """
gravity = [0.0, 0.0, -9.81]
materials.glass = {young = 5e6, poisson = 0.3, density = 2500}
contact = {e_n = 0.5, v_0 = 0.3, friction = 0.5}
run = {until_time = 0.1, sample_every = 1e-3}
[particles.beads]
material = "glass"
sizes.shares = [[2e-3, 0.5], [3e-3, 0.5]]
count = 100
place = "lattice"
region = {shape = "cylinder", radius = 0.02, low = 0.0, high = 0.1}
[walls.tube]
shape = "cylinder"
radius = 0.02
material = "glass"
[walls.floor]
shape = "disc"
centre = [0.0, 0.0, 0.0]
radius = 0.02
material = "glass"
"""
    (tmp_path / "case.toml").write_text(text)
    scene = load_case(tmp_path)
    hard = plan(scene, ("linear",))["linear"]
    changes = softened(tmp_path, scene, hard, 0.01, {})
    soft = plan(load_case(tmp_path, overrides=texts(changes)), ("linear",))["linear"]
    for one in scene.spheres:
        for other in scene.bodies:
            assert soft.between(one.name, other.name).k == pytest.approx(0.01 * hard.between(one.name, other.name).k)
