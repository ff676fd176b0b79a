"""The verdict on two beds in words: whether they agree as far as can be told, what it saves, what to mind."""

from __future__ import annotations

import math
from collections.abc import Sequence

from kncal.core.units import quantity
from kncal.observe.averages import BedObservations
from kncal.observe.bed_cost import BedCost
from kncal.observe.bed_rows import RMS, BedRow, called_by_chance, sampled
from kncal.observe.cost import Speed
from kncal.observe.fluidization_curve import Branch
from kncal.observe.invariants import Invariant
from kncal.observe.known import KnownAnswer, known_sentence
from kncal.observe.verdict import allowed, factor, not_judged
from kncal.scene.bed_metrics import NOT_AVERAGED
from kncal.scene.gas_limits import COURANT_LARGE
from kncal.scene.model import BedModel


def sentences(
    models: tuple[BedModel, BedModel],
    rows: Sequence[BedRow],
    invariants: Sequence[Invariant],
    known: Sequence[KnownAnswer],
    costs: tuple[BedCost, BedCost],
    speed: tuple[Speed, float | None],
    observations: tuple[BedObservations, BedObservations],
) -> tuple[str, ...]:
    """Return the verdict as sentences: the judgement, the speed, then notes (theory, invariants, surprises, caveats).

    A known answer that is missed comes first; that the models agree is a note then.

    Every pair of models, costs and observations is (linear, hertz).
    """
    collide = bool(models[0].contacts) and observations[0].kind not in ("frozen", "gas")
    # a difference that chance explains is none
    told = [r for r in rows if r.tolerance is not None or r.significant is not False]
    missed = [text for verdict in ("outside", "undecided") if (text := known_sentence(known, verdict))]
    alike = _judgement(*models, rows, "Models alike" if missed else "Within tolerance")
    first, *more = [*missed, alike + not_judged(told, difference_text)]
    return (
        first,
        _speed(costs, *speed) if collide else _no_contacts(costs, observations[0].kind),
        *more,
        *filter(None, (known_sentence(known, "ok"),)),
        *against_theory(observations),
        *_broken(invariants),
        *_coarse(invariants),
        *_undecided(rows),
        _differences(rows),
        *_doubts(rows),
        *(speed[0].caveats if collide else ()),
    )


def against_theory(observations: tuple[BedObservations, BedObservations]) -> list[str]:
    """Return what the runs (linear, hertz) give beside a theory, where there is one: one sentence each."""
    texts: dict[str, list[str]] = {}
    for kind, seen in zip(("linear", "Hertz"), observations, strict=True):
        for text in _theory(seen):
            texts.setdefault(text, []).append(kind)
    return [f"{' and '.join(kinds)}: {text}" for text, kinds in texts.items()]


def _theory(seen: BedObservations) -> list[str]:
    texts = []
    if (final := seen.final) is not None:
        ode = (
            ""
            if final.settling is None
            else (
                f"; the equation of motion gives {final.settling:.5g} m/s for the velocity,"
                f" {100.0 * (final.velocity - final.settling) / final.slip:+.2g} % of the slip away"
            )
        )
        texts.append(
            f"after {final.time:.3g} s the particle moves with {final.velocity:.5g} m/s, a slip of {final.slip:.5g} m/s"
            f" (terminal, by the drag law: {final.terminal:.5g} m/s){ode}."
        )
    if seen.plateaus:
        ratios = ", ".join(f"{p.ratio:.4f} at {p.U_0:.3g} m/s" for p in seen.plateaus)
        means = ", ".join(f"{p.gradient / p.ergun_mean:.3f}" for p in seen.plateaus)
        texts.append(
            f"pressure gradient over Ergun's with each cell's own void fraction and velocity: {ratios}; over Ergun's at"
            f" the mean void fraction, {seen.plateaus[-1].eps_g:.3f}: {means} (the gas takes the looser ways)."
        )
    if (curve := seen.curve) is not None:
        texts.append(
            f"U_mf is {_branch(curve.falling)} with falling, {_branch(curve.rising)} with rising gas velocity; by Wen"
            f" and Yu's correlation {curve.wen_yu:.3g} m/s. Largest pressure drop on the way up:"
            f" {curve.rising.largest:.3g} of weight/area."
        )
    return texts


def _branch(branch: Branch) -> str:
    plateau = (
        ""
        if branch.U_mf_plateau is None
        else (f", {branch.U_mf_plateau:.3g} m/s where it meets the plateau measured, {branch.plateau:.3g}")
    )
    return (
        f"{plus_minus(branch.U_mf, branch.uncertainty)} m/s (Ergun at the bed's void fraction of {branch.eps_g:.3f}:"
        f" {branch.ergun:.3g} m/s{plateau})"
    )


def _no_contacts(costs: tuple[BedCost, BedCost], kind: str) -> str:
    why = "The particles did not move" if kind == "frozen" else "No contact was to be computed"
    totals = " and ".join(quantity(cost.total, "s", 3) for cost in costs)
    return f"{why}, so neither model saves anything: the gas took {totals} of CPU time."


def spring(model: BedModel) -> str:
    """Return the linear springs of a bed in words: "k_n = 100 N/m by mean_overlap"."""
    stiffness = sorted({c.k for c in model.contacts.values()})
    if not stiffness:
        return "no contact"
    numbers = " to ".join(quantity(k, "N/m", 4) for k in dict.fromkeys((stiffness[0], stiffness[-1])))
    choice = model.scene.contact
    return f"k_n = {numbers} {'prescribed' if choice.k_n is not None else f'by {choice.method}'}"


def plus_minus(value: float, uncertainty: float, *, signed: bool = False) -> str:
    """Return "105.3 ± 1.2": two digits of the uncertainty, and the value to the same decimals."""
    sign = "+" if signed else ""
    if uncertainty <= 1e-9 * abs(value):  # rounding
        return f"{value:{sign}.4g} ± 0"
    decimals = 1 - math.floor(math.log10(uncertainty))
    if decimals > 6:  # both are mostly zeros
        return f"{value:{sign}.4g} ± {uncertainty:.2g}"
    places = max(decimals, 0)
    return f"{round(value, places) + 0.0:{sign}.{places}f} ± {uncertainty:.{places}f}"  # + 0.0: no "-0.0"


def difference_text(row: BedRow) -> str:
    """Return a difference with its uncertainty: "+1.2 ± 0.4 %", or "–"."""
    if row.difference is None:
        return "–"
    if row.basis == RMS:
        return f"{quantity(row.difference, '%')} ({quantity(row.uncertainty, '%')} by chance)"
    return f"{plus_minus(100.0 * row.difference, 100.0 * (row.uncertainty or 0.0), signed=True)} %"


def _judgement(linear: BedModel, hertz: BedModel, rows: Sequence[BedRow], within: str) -> str:
    laws = ", ".join(dict.fromkeys(c.law for c in hertz.contacts.values())) or hertz.kind
    who = f"in {hertz.scene.name} the linear spring ({spring(linear)})"
    judged = [r for r in rows if r.tolerance is not None]
    if not judged:
        return f"Not judged: no tolerance is given; {who} was compared with {laws}, the differences are below."
    outside = [r for r in judged if r.verdict == "outside"]
    missing = [r for r in judged if r.verdict == "missing"]
    undecided = [r for r in judged if r.verdict == "undecided"]
    if outside or missing:
        texts = [f"{r.metric} by {difference_text(r)} ({allowed(r.tolerance)} allowed)" for r in outside]
        texts += [f"{r.metric} could not be computed ({r.reason})" for r in missing]
        how_many = f"{len(texts)} of {len(judged)} quantities judged"
        rest = f"; {len(undecided)} more undecided" if undecided else ""
        return f"Outside tolerance: {who} fails against {laws} in {how_many}: {'; '.join(texts)}{rest}."
    if undecided:
        texts = [f"{r.metric} {difference_text(r)} ({allowed(r.tolerance)} allowed)" for r in undecided]
        times = [r.needed_end_time for r in undecided]
        known = [t for t in times if t is not None]
        needed, why = "run much longer, or allow more", "the runs are too short for"
        if all(r.metric in NOT_AVERAGED for r in undecided):
            needed, why = "let it come to its end, or allow more", "too uncertain is"
        if len(known) == len(times):
            needed = f"run until about {max(known):.3g} s (run.end_time) to decide"
        ok = f"{len(judged) - len(undecided)} of {len(judged)} quantities judged agree"
        return f"Undecided: {who} against {laws}: {ok}, {why} {'; '.join(texts)}: {needed}."
    count = "the one quantity" if len(judged) == 1 else f"all {len(judged)} quantities"
    nearest = max(judged, key=_use)
    return (
        f"{within}: {who} agrees with {laws} in {count} judged; closest to its limit:"
        f" {nearest.metric}, {difference_text(nearest)} where {allowed(nearest.tolerance)} is allowed."
    )


def _use(row: BedRow) -> float:
    """Share of its tolerance that the interval of a row reaches."""
    reach = abs(row.difference or 0.0) + (row.uncertainty or 0.0)
    return reach / row.tolerance if row.tolerance else float(reach > 0.0)


def _speed(costs: tuple[BedCost, BedCost], saved: Speed, total: float | None) -> str:
    linear, hertz = costs
    text = f"The linear run took {linear.dem.steps:,} DEM steps, the Hertz run {hertz.dem.steps:,}:"
    text += f" {factor(saved.steps, 'steps')}. CPU time of the particles:"
    text += f" {quantity(linear.dem.cpu_seconds, 's', 3)} against {quantity(hertz.dem.cpu_seconds, 's', 3)}"
    if saved.cpu is None or total is None:
        return f"{text}, too short for a ratio."
    text += f", {factor(saved.cpu, 'CPU time')}; with gas and exchange"
    return (
        f"{text} {quantity(linear.total, 's', 3)} against {quantity(hertz.total, 's', 3)}, {factor(total, 'CPU time')}."
    )


def _broken(invariants: Sequence[Invariant]) -> list[str]:
    texts = [
        f"{i.name} (linear {_number(i.linear)}, Hertz {_number(i.hertz)};"
        f" {'more than' if i.at_least else 'at most'} {i.limit:g} expected)"
        for i in invariants
        if not i.holds
    ]
    if not texts:
        return []
    return [f"Not to be trusted before this is understood: {'; '.join(texts)}."]


def _coarse(invariants: Sequence[Invariant]) -> list[str]:
    found = [i for i in invariants if i.name == "courant_max" and i.holds]
    largest = max((value for i in found for value in (i.linear, i.hertz) if value is not None), default=0.0)
    if largest <= COURANT_LARGE:
        return []
    return [
        f"The gas moved up to {largest:.3g} cells in a step: stable, but coarse in time; a run with half the"
        " run.gas_step tells whether that matters."
    ]


def _undecided(rows: Sequence[BedRow]) -> list[str]:
    texts = [
        f"{r.metric} about {r.needed_end_time:.3g} s" if r.needed_end_time is not None else f"{r.metric} out of reach"
        for r in rows
        if r.verdict == "undecided" and r.metric not in NOT_AVERAGED
    ]
    return [f"End time predicted to decide: {', '.join(texts)}."] if texts else []


def _differences(rows: Sequence[BedRow]) -> str:
    known = sampled(rows)
    # one value of each run that agree as well as the case asks: that they are not equal to the last digit says nothing
    names = [r.metric for r in rows if r.significant and not (r.metric in NOT_AVERAGED and r.verdict == "ok")]
    larger = f"Differences larger than their uncertainty: {', '.join(names)}"
    seen = larger if names else "No difference is larger than its uncertainty"
    if not known:
        return f"{seen}."
    return (
        f"{seen}. Of {len(known)} quantities about {called_by_chance(rows):.1f} would be called different"
        " by chance alone; where no difference is seen, one up to the uncertainty may still be there."
    )


def _doubts(rows: Sequence[BedRow]) -> list[str]:
    doubted = [r.metric for r in rows if r.difference is not None and r.reason and r.linear is not None]
    if not doubted:
        return []
    return [
        f"Uncertainties not to be relied upon (taken three times as wide before they decide): {', '.join(doubted)}."
        " The runs are short for them, or still drift."
    ]


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
