"""The edge of stability of a probe: bisection in dt by the builtin engine, confirmed (or found anew) by LIGGGHTS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kncal.core.errors import KncalError, RunError
from kncal.engines.builtin.integrator import integrate
from kncal.runs.workflow import load
from kncal.scene.case_file import write_case
from kncal.study import Variant, run_variants
from kncal.study.stability.limits import advised_limit, arrangement_limit, impact_limit
from kncal.study.stability.outcome import REFUSED, Outcome, judge, outcome_of_error, outcome_of_failure
from kncal.study.stability.probes import Probe, at_step

#: Steps of a run at rest. An instability 1 % beyond the edge grows by 1.3 per step without damping, by 1.03 at
#: zeta = 1: two thirds of these steps show it.
STEPS = 400
#: Relative width of an edge's bracket at which bisection ends.
RESOLUTION = 0.005
#: Bracket to start with, over the limit of the arrangement; widened by this where the edge is not in it.
START = (0.9, 1.1)
_WIDEN = 1.5
#: A bracket that has to be widened more often than this has no edge.
_MOST = 12

#: From a probe and (time step [s], number of steps) of each of its runs to the outcomes.
Runner = Callable[[Probe, Sequence[tuple[float, int]]], list[Outcome]]
#: Called with a sentence about what is going on.
Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Bracket:
    """An edge: stable at ``low``, not at ``high`` [s]; ``beyond``: what happens at ``high``."""

    low: float
    high: float
    beyond: str

    @property
    def middle(self) -> float:
        """Best estimate of the edge [s]."""
        return 0.5 * (self.low + self.high)


@dataclass(frozen=True, kw_only=True)
class Edge:
    """The edge of one probe beside what theory says.

    Attributes
    ----------
    probe : Probe
    advised : the limit that kncal advises by, `kncal.physics.timestep.verlet_limit` with the probe's number of
        contacts, for
        the case's own contacts: at the largest overlap of an impact at v_0 [s]
    limit : the same at the overlaps of the probe, which may be far smaller (a Hertz contact is softer there) [s]
    arrangement : the limit of this very arrangement, `kncal.study.stability.limits.arrangement_limit` [s]
    measured : engine -> Bracket, of the probe
    """

    probe: Probe
    advised: float
    limit: float
    arrangement: float
    measured: Mapping[str, Bracket]

    def safe_by(self, engine: str) -> float:
        """Return by which share the edge lies above the limit by the formula; below zero: the advice is unsafe."""
        return self.measured[engine].middle / self.limit - 1.0

    def at_v_0(self, engine: str) -> float:
        """Return the edge [s] of the case's own contacts: as far from the advised limit as the probe's from its own.

        Exact for a damping that scales with the stiffness (linear, elastic, tsuji).
        """
        return self.advised * (1.0 + self.safe_by(engine))

    def off_by(self, engine: str) -> float:
        """Return by which share the edge lies above the limit of the arrangement: zero within the resolution."""
        return self.measured[engine].middle / self.arrangement - 1.0


def run_builtin(probe: Probe, runs: Sequence[tuple[float, int]]) -> list[Outcome]:
    """Run a probe by the builtin engine, in this process: a few hundred steps take milliseconds and leave no folder."""
    return [_integrated(probe, dt, n_steps) for dt, n_steps in runs]


def _integrated(probe: Probe, dt: float, n_steps: int) -> Outcome:
    model = at_step(probe.model, dt, n_steps)
    try:
        return judge(model, integrate(model), pressed=probe.pressed)
    except KncalError as error:
        return outcome_of_error(error)


def liggghts_runner(folder: Path, workers: int | None = None) -> Runner:
    """Return what runs probes by LIGGGHTS, as variants of a case of their own in ``folder``."""

    def run(probe: Probe, wanted: Sequence[tuple[float, int]]) -> list[Outcome]:
        there = folder / f"{probe.name}-e{probe.e_n:g}"
        there.mkdir(parents=True, exist_ok=True)
        case = there / "case.toml"
        write_case(probe.scene, case)
        variants = [
            Variant(
                name=f"dt-{i}",
                model=probe.kind,
                changes={"run.dt": dt, "run.until_time": dt * n_steps},
            )
            for i, (dt, n_steps) in enumerate(wanted)
        ]
        runs = run_variants(case, variants, there / "runs", workers=workers)
        outcomes = []
        for done in runs.values():
            if not done.completed or done.folder is None:
                failure = done.failure or "solver-error"
                outcomes.append(outcome_of_failure(failure, done.message))
                continue
            data = load(done.folder)
            outcomes.append(judge(data.model, data.trajectory, pressed=probe.pressed))
        return outcomes

    return run


def find_edge(run: Runner, probe: Probe, low: float, high: float, resolution: float = RESOLUTION) -> Bracket:
    """Bisect for the edge of a probe at rest, from a bracket that is widened until the edge is in it.

    Raises
    ------
    RunError
        If there is no edge within a factor of a hundred, or a run failed for another reason than its physics.
    """
    at_low, at_high = run(probe, ((low, STEPS), (high, STEPS)))
    for _ in range(_MOST):
        if at_low.stable:
            break
        low, high, at_high = low / _WIDEN, low, at_low
        (at_low,) = run(probe, ((low, STEPS),))
    for _ in range(_MOST):
        if not at_high.stable:
            break
        low, high = high, high * _WIDEN
        (at_high,) = run(probe, ((high, STEPS),))
    if not at_low.stable or at_high.stable:
        raise RunError(f"{probe.name}: no edge of stability between {low:.3g} and {high:.3g} s: {at_high.message}")
    while high / low - 1.0 > resolution:
        middle = 0.5 * (low + high)
        (found,) = run(probe, ((middle, STEPS),))
        low, high, at_high = (middle, high, at_high) if found.stable else (low, middle, found)
    return Bracket(low=low, high=high, beyond=at_high.code)


def edges(
    probes: Sequence[Probe],
    liggghts: Runner | None = None,
    *,
    tell: Tell | None = None,
) -> list[Edge]:
    """Return the edge of each probe: by the builtin engine, and by LIGGGHTS if there is a runner for it.

    LIGGGHTS is asked at both ends of the builtin engine's bracket; only where it disagrees it bisects for itself. It
    has no edge for a contact that it cannot simulate (strong damping with Hertz).
    """
    found = []
    for probe in probes:
        if tell:
            tell(f"{probe.name}, e_n = {probe.e_n:g}")
        limit = arrangement_limit(probe.model)
        own = find_edge(run_builtin, probe, START[0] * limit, START[1] * limit)
        measured = {"builtin": own}
        if liggghts is not None and liggghts(probe, ((own.low, STEPS),))[0].code != REFUSED:
            measured["liggghts"] = find_edge(liggghts, probe, own.low, own.high)
        found.append(
            Edge(
                probe=probe,
                advised=impact_limit(probe.model, probe.contacts),
                limit=advised_limit(probe.model, probe.contacts),
                arrangement=limit,
                measured=measured,
            )
        )
    return found
