"""A study of stability: probes from a case, their edges, accuracy, maps; for beds also the coupled algorithm."""

from __future__ import annotations

from pathlib import Path

from kncal.core.checks import one_of
from kncal.core.errors import SolverMissingError
from kncal.engines.registry import get_engine
from kncal.scene.model import KINDS
from kncal.scene.scene import Scene
from kncal.study.stability.accuracy import accuracy_edges
from kncal.study.stability.coupling_edges import bed_edges
from kncal.study.stability.edges import Tell, edges, liggghts_runner
from kncal.study.stability.maps import RESTITUTIONS, outcome_maps
from kncal.study.stability.packings import packing
from kncal.study.stability.probes import DIRECTIONS, Ingredients, Probe, ingredients, pressed
from kncal.study.stability.results import Stability

ENGINES = ("liggghts", "builtin")
#: What is in the folder of a study: its record; rounds that measure the speed, where the case asks for it; runs.
RECORD, SPEED, PROBES, BEDS = "stability.json", "speed", "probes", "beds"
STARTED = (SPEED, PROBES, BEDS)
#: Restitutions of the pressed probe whose damping is varied, and size ratios of the unequal pair.
DAMPED = (1.0, 0.9, 0.5, 0.1)
RATIOS = (10.0, 100.0)


def study_stability(
    case: Scene,
    folder: Path,
    *,
    engine: str = "liggghts",
    quick: bool = False,
    transport: str = "auto",
    workers: int | None = None,
    tell: Tell | None = None,
) -> Stability:
    """Find where a case stops to be simulated right.

    Parameters
    ----------
    case : Scene or Scene
    folder : for the runs of solvers; the same study again there runs only what is missing
    engine : "liggghts" (the builtin engine looks, LIGGGHTS confirms) or "builtin" alone; of the coupled runs of a bed
        always both solvers
    quick : fewer probes, coarser maps
    transport : of coupled runs
    workers : LIGGGHTS runs at a time
    tell : called with a sentence about what is going on

    Raises
    ------
    InputError
        If the case has no impact speed, or the engine is unknown.
    SolverMissingError
        If the solvers asked for are not there.
    RunError
        If a probe has no edge.
    """
    one_of("engine", engine, ENGINES)
    given = ingredients(case)
    runner = None
    if engine == "liggghts":
        profile = get_engine(engine).profile()
        if profile.program is None:
            raise SolverMissingError(profile.problem)
        runner = liggghts_runner(folder / PROBES, workers)
    e_n = given.contact.e_n
    damped = (1.0, e_n) if quick else (*DAMPED, e_n)
    restitutions = sorted({1.0} if given.contact.law == "hertz" else {*damped}, reverse=True)
    varied = (1.0,) if given.contact.law == "hertz" else RESTITUTIONS[::2] if quick else RESTITUTIONS
    say = tell or (lambda _: None)
    found = edges(_probes(given, restitutions, quick=quick), runner, tell=lambda what: say(f"edge of {what}"))
    say("steps that a right restitution needs")
    accuracy = [a for kind in KINDS for e in {1.0, e_n} for a in accuracy_edges(given, kind, e, runner)]
    say("maps of outcomes")
    cells = outcome_maps(given, KINDS, runner, quick=quick, restitutions=varied)
    coupling = []
    if case.coupled and engine == "liggghts":
        coupling = bed_edges(case, folder / BEDS, transport=transport, quick=quick, tell=say)
    return Stability(
        given=given,
        engines=("builtin",) if engine == "builtin" else ("builtin", "liggghts"),
        edges=tuple(found),
        accuracy=tuple(accuracy),
        cells=tuple(cells),
        coupling=tuple(coupling),
    )


def _probes(given: Ingredients, restitutions: list[float], *, quick: bool) -> list[Probe]:
    e_n, probes = given.contact.e_n, []
    for kind in KINDS:
        probes.append(pressed(given, kind, e_n, 1))
        probes += [pressed(given, kind, e, 2) for e in restitutions]
        probes += [pressed(given, kind, e_n, 2, size_ratio=ratio) for ratio in RATIOS]
        probes += [pressed(given, kind, e_n, z) for z in DIRECTIONS if z > 2 and (z == 12 or not quick)]
        probes += [] if quick else [packing(given, kind, e_n, sticks=sticks) for sticks in (False, True)]
    return probes
