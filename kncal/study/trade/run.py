"""One flow for any scene: the candidates are run, as far as a budget allows, judged, and put together to a trade."""

from __future__ import annotations

import os
from pathlib import Path

from kncal.core.errors import InterruptedRunError
from kncal.scene.scene import Scene
from kncal.study.trade.averaged import Averaged
from kncal.study.trade.budget import Budget
from kncal.study.trade.resolved import Resolved
from kncal.study.trade.trade import Tell, Trade, TradeOptions
from kncal.study.trade.trials import Trials

#: Kept of a budget for what follows the runs (files, pictures): share, and seconds.
REST_SHARE, REST = 0.02, 5.0


def trade_scene(case: str | Path, scene: Scene, folder: Path, options: TradeOptions, tell: Tell) -> Trade:
    """Trade speed for accuracy in a scene; what ``folder`` holds already is used, and continues where it stopped.

    Parameters
    ----------
    case, scene : the case, and what it describes
    folder : of the runs
    options : with the tolerances to judge by
    tell : told what is done now

    Raises
    ------
    CaseFileError, InputError
        If the case cannot be planned, has no contacts, or its stiffness cannot be softened.
    RunError
        If the reference or a packing does not complete.
    InterruptedRunError
        After Ctrl-C; the same call again continues.
    """
    budget = Budget(None if options.budget is None else options.budget - _rest(options.budget))
    load = os.getloadavg()[0]
    kind: type[Trials] = Averaged if scene.coupled else Resolved
    trials = kind(case, scene, folder, options, budget, tell)
    try:
        trials.run()
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted; run the same command again to continue") from None
    reference, points = trials.point(trials.reference), [trials.point(c) for c in trials.candidates]
    return Trade(
        case=scene.name,
        title=scene.title,
        cost=trials.cost,
        fixed=trials.fixed,
        reference=reference,
        convergence=trials.convergence,
        points=tuple(points),
        tolerances=dict(options.tolerances),
        splits=trials.splits([point for point in points if point.completed]),
        caveats=tuple(trials.caveats(reference, points, load)),
        options=options,
        wall_seconds=budget.spent(),
    )


def _rest(budget: float) -> float:
    """Time of a budget to keep for what follows the runs [s]."""
    return min(max(REST_SHARE * budget, REST), 0.1 * budget)
