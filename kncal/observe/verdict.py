"""The verdict on a comparison in words: one sentence, at most three points under it, and details."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kncal.core.units import plus_minus, quantity
from kncal.observe.averages import BedObservations
from kncal.observe.cost import Speed
from kncal.observe.fluidization_curve import Branch
from kncal.observe.invariants import Invariant
from kncal.observe.known import known_sentence
from kncal.observe.row import RMS, Row, allowed, difference_text, needed_end
from kncal.observe.run_data import RunData
from kncal.scene.gas_limits import COURANT_LARGE
from kncal.scene.model import Plan

#: The largest difference without a tolerance is named in the verdict if it is larger than this.
NOTABLE = 0.01
#: Points under the sentence of a verdict.
MOST_POINTS = 3


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A verdict in words.

    Attributes
    ----------
    state : "within", "outside", "undecided", or "open" if nothing is judged
    sentence : the judgement
    points : what matters most beside it, such as what is saved; few (`MOST_POINTS`)
    details : all else that is to be known
    """

    state: str
    sentence: str
    points: tuple[str, ...]
    details: tuple[str, ...]

    @classmethod
    def of(cls, state: str, sentences: Sequence[str], points: int = MOST_POINTS) -> Verdict:
        """Return a verdict: the first sentence is the judgement, ``points`` more are points, the rest details."""
        first, *rest = sentences
        return cls(state=state, sentence=first, points=tuple(rest[:points]), details=tuple(rest[points:]))

    @property
    def all(self) -> tuple[str, ...]:
        """Every sentence, in this order."""
        return (self.sentence, *self.points, *self.details)


def state_of(rows: Iterable[Row], known: Iterable[Row] = ()) -> str:
    """Return the verdict in a word: "outside", "undecided", "within", or "open" if no row has a tolerance.

    A known answer that is missed, or perhaps missed, makes it "outside" or "undecided" whatever the rows say.
    """
    judged = {row.verdict for row in rows} - {"-"}
    verdicts = judged | {row.verdict for row in known}
    if verdicts & {"outside", "missing"}:
        return "outside"
    if "undecided" in verdicts:
        return "undecided"
    return "within" if judged else "open"


def verdict(
    runs: tuple[RunData, RunData],
    rows: Sequence[Row],
    exact: Sequence[Row],
    known: Sequence[Row],
    invariants: Sequence[Invariant],
    speed: Speed,
    limits: Sequence[str] = (),
) -> Verdict:
    """Return the verdict on a run and its reference, ``runs``.

    A known answer that is missed comes first; that the models agree is a point then. ``limits`` of the contacts are
    warnings.
    """
    models = (runs[0].model, runs[1].model)
    seen = [run.seen for run in runs if run.signals is not None]
    missed = [text for each in ("outside", "undecided") if (text := known_sentence(known, each))]
    alike = _judgement(*models, rows, "Models alike" if missed else "Within tolerance")
    sentence, *severe = [*missed, alike]
    severe += [
        *_broken(invariants),
        *(f"Warning: {text}." for text in limits),
        *_odd(exact),
    ]
    collide = not seen or (bool(models[0].contacts) and seen[0].kind not in ("frozen", "gas"))
    saved = _speed(runs, speed) if collide else _no_contacts(runs, seen[0].kind)
    points = [saved, *not_judged(rows), *severe]
    details = [
        *points[MOST_POINTS:],
        *filter(None, (known_sentence(known, "ok"),)),
        *against_theory(dict(zip(("linear", "Hertz"), seen, strict=False))),
        *_coarse(invariants),
        *_undecided(rows),
        *_differences(rows),
        *_blurred(rows),
        *_doubts(rows),
        *(speed.caveats if collide else ()),
    ]
    return Verdict(
        state=state_of(rows, known), sentence=sentence, points=tuple(points[:MOST_POINTS]), details=tuple(details)
    )


# --- the sentence -------------------------------------------------------------------------------------------------


def _judgement(linear: Plan, hertz: Plan, rows: Sequence[Row], within: str) -> str:
    laws = ", ".join(dict.fromkeys(c.law for c in hertz.contacts.values())) or hertz.kind
    who = f"the linear spring ({spring(linear)})"
    judged = [r for r in rows if r.tolerance is not None]
    if not judged:
        return f"Not judged: no tolerance is given; {who} was compared with {laws}, the differences are below."
    failed = [r for r in judged if r.verdict in ("outside", "missing")]
    undecided = [r for r in judged if r.verdict == "undecided"]
    if failed:
        texts = [
            _told(r) if r.verdict == "outside" else f"{r.metric}, which could not be computed ({r.reason})"
            for r in failed
        ]
        rest = f"; {len(undecided)} undecided" if undecided else ""
        if not any(r.verdict == "outside" for r in failed):
            return f"Not judged: {', '.join(texts)}{rest}."
        how_many = f"{len(failed)} of {len(judged)} metrics judged"
        return f"Outside tolerance: {who} does not agree with {laws} in {how_many}: {', '.join(texts)}{rest}."
    if undecided:
        why, remedy = _remedy(undecided)
        agree = (
            f"; {len(judged) - len(undecided)} of {len(judged)} metrics agree" if len(undecided) < len(judged) else ""
        )
        return f"Undecided: {why} {', '.join(map(_told, undecided))}: {remedy}{agree}."
    count = "the one metric" if len(judged) == 1 else f"all {len(judged)} metrics"
    nearest = max(judged, key=lambda r: r.reach)
    return f"{within}: {who} agrees with {laws} in {count} judged; closest to its limit: {_told(nearest)}."


def _told(row: Row) -> str:
    """Return a judged row in words: "e_n +1.2 ± 0.4 % (±2 % allowed)"."""
    return f"{row.metric} {difference_text(row)} ({allowed(row.tolerance)} allowed)"


def _remedy(undecided: Sequence[Row]) -> tuple[str, str]:
    """Return why rows are undecided, in words that precede them, and what to do."""
    if not any(r.difference.chance for r in undecided):
        steps = "take more steps per contact (run.steps_per_contact), or allow more"
        return "the error of the time step is too large to judge", steps
    if (end := needed_end(undecided)) is not None:
        return "the runs are too short to judge", f"run until about {end:.3g} s (run.until_time)"
    if not any(by_length(r) for r in undecided):
        return "it is not known well enough to judge", "let the run come to its end, take more particles, or allow more"
    return "the runs are too short to judge", "run much longer, or allow more"


def by_length(row: Row) -> bool:
    """Whether a longer run makes the difference more certain."""
    return row.basis == RMS or row.run.average is not None


def spring(model: Plan) -> str:
    """Return the linear springs of a model in words: "k_n = 100 N/m by mean_overlap"."""
    stiffness = sorted({c.k for c in model.contacts.values()})
    if not stiffness:
        return "no contact"
    numbers = " to ".join(quantity(k, "N/m", 4) for k in dict.fromkeys((stiffness[0], stiffness[-1])))
    choice = model.scene.contact
    return f"k_n = {numbers} {'prescribed' if choice.k_n is not None else f'by {choice.method}'}"


# --- points -------------------------------------------------------------------------------------------------------


def not_judged(rows: Sequence[Row]) -> list[str]:
    """Return what a verdict says of the largest difference that nobody judged; none if nothing is judged, or it is
    small, or no larger than the width that decides."""
    left = [
        row
        for row in rows
        if row.tolerance is None and abs(row.difference.value or 0.0) > max(NOTABLE, row.difference.deciding)
    ]
    if not left or all(r.tolerance is None for r in rows):
        return []
    worst = max(left, key=lambda r: abs(r.difference.value or 0.0))
    return [f"Largest difference that no tolerance judges: {worst.metric}, {difference_text(worst)}."]


def _speed(runs: Sequence[RunData], speed: Speed) -> str:
    linear, hertz = (run.cost for run in runs)
    of = " of the particles" if linear.transport else ""
    text = f"Steps{of}: {linear.steps:,} linear, {hertz.steps:,} Hertz, {gain(speed.steps)}."
    text += f" CPU time{of}: {quantity(linear.cpu_seconds, 's', 3)} and {quantity(hertz.cpu_seconds, 's', 3)}"
    if speed.cpu is None:
        return f"{text}." if "builtin" in (linear.engine, hertz.engine) else f"{text}, too short for a ratio."
    text += f", {gain(speed.cpu)}"
    if min(linear.runs, hertz.runs) > 1:
        text += f" (ratio {speed.cpu_low:.2f} to {speed.cpu_high:.2f} over {linear.runs} and {hertz.runs} runs)"
    if linear.transport and speed.total is not None:
        totals = " and ".join(quantity(cost.total, "s", 3) for cost in (linear, hertz))
        what = "gas and exchange" if any(cost.has_gas for cost in (linear, hertz)) else "recording"
        text += f"; with {what} {totals}, {gain(speed.total)}"
    return f"{text}."


def gain(ratio: float) -> str:
    """Return reference over run in words: "speed-up 2.00"."""
    if abs(ratio - 1.0) < 0.005:
        return "no difference"
    return f"speed-up {ratio:.2f}" if ratio > 1.0 else f"slow-down {1.0 / ratio:.2f}"


def _no_contacts(runs: Sequence[RunData], kind: str) -> str:
    why = "The particles did not move" if kind == "frozen" else "No contact was to be computed"
    totals = " and ".join(quantity(run.cost.total, "s", 3) for run in runs)
    return f"{why}, so neither model saves anything: the gas took {totals} of CPU time."


def _broken(invariants: Sequence[Invariant]) -> list[str]:
    texts = [
        f"{i.name} (linear {_number(i.run)}, Hertz {_number(i.reference)};"
        f" {'more than' if i.at_least else 'at most'} {i.limit:g} expected)"
        for i in invariants
        if not i.holds
    ]
    return _about(texts, "Not to be trusted before this is understood: {}.")


def _odd(exact: Sequence[Row]) -> list[str]:
    return _about(
        [f"{r.metric} ({r.model})" for r in exact if r.verdict == "outside"],
        "Further from the exact solution than the predicted discretisation error: {}."
        " Look for a contact that was not resolved before you trust the comparison.",
    )


# --- details ------------------------------------------------------------------------------------------------------


def against_theory(seen: dict[str, BedObservations]) -> list[str]:
    """Return what the runs of a bed (by the name of their model) give beside a theory, one sentence each."""
    texts: dict[str, list[str]] = {}
    for kind, observed in seen.items():
        for text in _theory(observed):
            texts.setdefault(text, []).append(kind)
    return [f"{' and '.join(kinds)}: {text}" for text, kinds in texts.items()]


def _theory(seen: BedObservations) -> list[str]:
    texts = []
    if (final := seen.get("final")) is not None:
        ode = ""
        if final.settling is not None:
            away = 100.0 * (final.velocity - final.settling) / final.slip
            ode = (
                f"; the equation of motion gives a velocity of {final.settling:.5g} m/s, {away:+.2g} % of the slip away"
            )
        texts.append(
            f"after {final.time:.3g} s the velocity of the particle is {final.velocity:.5g} m/s, its slip"
            f" {final.slip:.5g} m/s (terminal, by the drag law: {final.terminal:.5g} m/s){ode}."
        )
    if (plateaus := seen.get("plateaus")) is not None:
        ratios = ", ".join(f"{p.ratio:.4f} at {p.U_0:.3g} m/s" for p in plateaus)
        means = ", ".join(f"{p.gradient / p.ergun_mean:.3f}" for p in plateaus)
        texts.append(
            f"pressure gradient over Ergun's with each cell's own void fraction and velocity: {ratios}; over Ergun's at"
            f" the mean void fraction, {plateaus[-1].eps_g:.3f}: {means} (more gas flows where the bed is looser)."
        )
    if (curve := seen.get("curve")) is not None:
        texts.append(
            f"U_mf is {_branch(curve.falling)} with falling, {_branch(curve.rising)} with rising gas velocity; by Wen"
            f" and Yu's correlation {curve.wen_yu:.3g} m/s. Largest pressure drop on the way up:"
            f" {curve.rising.largest:.3g} of weight/area."
        )
    return texts


def _branch(branch: Branch) -> str:
    plateau = ""
    if branch.U_mf_plateau is not None:
        plateau = f", {branch.U_mf_plateau:.3g} m/s where it meets the plateau measured, {branch.plateau:.3g}"
    return (
        f"{plus_minus(branch.U_mf, branch.uncertainty)} m/s (Ergun at the bed's void fraction of {branch.eps_g:.3f}:"
        f" {branch.ergun:.3g} m/s{plateau})"
    )


def _coarse(invariants: Sequence[Invariant]) -> list[str]:
    found = [i for i in invariants if i.name == "courant_max" and i.holds]
    largest = max((value for i in found for value in (i.run, i.reference) if value is not None), default=0.0)
    if largest <= COURANT_LARGE:
        return []
    return [
        f"The gas moved up to {largest:.3g} cells in a step: stable, but coarse in time; a run with half the"
        " run.gas_step tells whether that matters."
    ]


def _undecided(rows: Sequence[Row]) -> list[str]:
    open_ones = [(r.metric, r.difference.needed_end) for r in rows if r.verdict == "undecided" and by_length(r)]
    texts = [f"{name} {'out of reach' if end is None else f'about {end:.3g} s'}" for name, end in open_ones]
    return _about(texts, "End time predicted to decide: {}.")


def _differences(rows: Sequence[Row]) -> list[str]:
    known = [r for r in rows if r.difference.chance]
    # one value of each run that agree as well as the case asks: that they are not equal to the last bit says nothing
    names = [r.metric for r in known if r.difference.significant and (by_length(r) or r.verdict != "ok")]
    if names:
        return [
            f"Differences larger than their uncertainty: {', '.join(names)}."
            " Of twenty averages of equal runs one differs so by chance."
        ]
    return ["No difference is seen for sure; a smaller one may be there."] if known else []


def _blurred(rows: Sequence[Row]) -> list[str]:
    judged = any(r.tolerance is not None for r in rows)
    blurred = [
        r.metric
        for r in rows
        if not r.difference.chance and r.difference.significant is False and r.difference.value
        if r.tolerance is not None or not judged
    ]
    return _about(blurred, "{}: the two runs differ by no more than the predicted discretisation error.")


def _doubts(rows: Sequence[Row]) -> list[str]:
    return _about(
        [r.metric for r in rows if r.difference.value is not None and not r.difference.reliable],
        "Uncertainty not reliable, so taken three times as wide: {}. The runs are too short for it, or still drift.",
    )


def _about(what: Sequence[str], text: str) -> list[str]:
    """Return the sentence about some things, whose names stand at its "{}"; none about nothing."""
    return [text.format(", ".join(what))] if what else []


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
