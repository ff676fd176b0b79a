"""What the runs of a bed come to: points without numbers, refusals before a run, and what to keep in mind."""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Iterator, Sequence

from kncal.observe.softness import secant
from kncal.scene.limits import check
from kncal.scene.model import PairContact
from kncal.study.trade.base import TradePoint
from kncal.study.trade.bed_runs import STOPPED, WAITING, Track
from kncal.study.trade.budget import Budget


def planned(track: Track) -> TradePoint:
    """Return a point with what is known before a run: stiffness and steps, and how its run stands."""
    model = track.model
    shortest: PairContact = min(model.contacts.values(), key=lambda contact: contact.t_c)
    waiting = track.status in (WAITING, STOPPED)
    return TradePoint(
        candidate=track.candidate,
        status="skipped" if waiting else track.status,
        message=track.message or ("the budget ended before its turn" if waiting else ""),
        k_n=secant(shortest),
        steps=model.couplings * model.steps_per_coupling,
        dt=model.dt,
        ran_share=track.done / track.length,
    )


def refused_by(track: Track) -> str:
    """Return why a limit of the bed refuses the run (see `kncal.scene.limits`); empty if none does."""
    return "; ".join(dict.fromkeys(f.message for f in check(track.model) if f.level == "refuse"))


def caveats(
    tracks: Sequence[Track], top: Track, step: tuple[float, float], budget: Budget, load: float, workers: int
) -> Iterator[str]:
    """Tell what to keep in mind.

    Parameters
    ----------
    tracks : all runs; top : that of the reference
    step : its N, and the discretisation error of its contacts that is predicted there
    budget : that was given; load : load average at the start; workers : runs at a time
    """
    n, error = step
    yield (
        f"The reference, Hertz at the real modulus, has N = {n:g}: there the step changes its contacts by"
        f" {100.0 * error:.2g} % in the mean, by prediction; what it does to averages was not resolved by runs"
        " of their own unless another N is among the points."
    )
    if top.couplings < top.model.couplings:
        yield (
            f"The reference was run in part: {top.done:.3g} of {top.length:.3g} s. Averages are over that time,"
            " with the wider intervals of it; CPU times are extrapolated to the whole time."
        )
    part = [t for t in tracks if 0 < t.couplings < t.model.couplings and t is not top]
    if part:
        yield f"{len(part)} more run(s) came to a part of their time only (ran_share); the same holds for them."
    held = [ratio for track in tracks if (ratio := track.held()) is not None]
    if held:
        worst = max(held, key=lambda ratio: abs(math.log(ratio)))
        yield (
            f"Extrapolation of CPU times, checked on {len(held)} run(s): what followed the first part took"
            f" {statistics.median(held):.3g} times as long as that predicted (median; farthest: {worst:.3g})."
        )
    loads = [part.load for track in tracks for part in track.parts]
    yield (
        f"{workers} run(s) side by side on {os.cpu_count()} cores; load average {load:.2f} at the start,"
        f" {os.getloadavg()[0]:.2f} at the end{f', {min(loads):.2f} to {max(loads):.2f} between' if loads else ''}:"
        " others' work makes CPU times longer, by the cache, and more so wall-clock times."
    )
    if budget.seconds is not None:
        waiting = sum(track.status == WAITING for track in tracks)
        yield (
            f"Budget {budget.seconds:g} s, used {budget.spent():.0f} s; {waiting} candidate(s) had no"
            " turn. The same command with a larger budget goes on with these runs; with another run.end_time"
            " they would be others."
        )
