"""Beds whose answer is known: each run judged against it, since two models that agree may be wrong alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kncal.observe.averages import BedObservations
from kncal.observe.bed_rows import decide
from kncal.scene.bed_scene import Gas

#: Metric -> how far from the answer a run may be [-]. Coarse cells and coupled steps cost less than half of the first
#: two where nothing is wrong; the gas takes the looser ways through a bed, which raises U_mf by 10 %.
ALLOWED = {"ergun_ratio": 0.05, "slip": 0.05, "U_mf": 0.15}
#: The drag law that the answers are of.
_LAW = "ErgunWenYu"


@dataclass(frozen=True, kw_only=True)
class KnownAnswer:
    """One run against the answer that theory gives.

    Attributes
    ----------
    metric : its name; kind : of the model, "linear" or "hertz"
    value, uncertainty : of the run, in the unit of the metric
    answer : by theory; source : which
    difference : (value - answer)/answer [-]; allowed : its largest size [-]
    verdict : "ok", "outside", or "undecided" (closer to the limit than it is known)
    """

    metric: str
    kind: str
    value: float
    uncertainty: float
    answer: float
    source: str
    difference: float
    allowed: float
    verdict: str


def known_answers(kind: str, seen: BedObservations, gas: Gas | None) -> tuple[KnownAnswer, ...]:
    """Return every answer that is known of a run: Ergun's gradient, the slip of one particle, U_mf."""
    if gas is None or gas.drag != _LAW:
        return ()
    found: list[tuple[str, float, float, float, str]] = []
    if seen.plateaus:
        worst = max(seen.plateaus, key=lambda p: abs(p.ratio - 1.0))
        found.append(("ergun_ratio", worst.ratio, worst.uncertainty, 1.0, "Ergun's equation in every cell"))
    if (final := seen.final) is not None:
        if final.settling is None:
            found.append(("slip", final.slip, final.slip_uncertainty, final.terminal, "the terminal velocity"))
        else:
            slip = final.slip + final.velocity - final.settling
            found.append(("slip", final.slip, 0.0, slip, "the equation of motion"))
    if (curve := seen.curve) is not None:
        branch = curve.falling
        source = f"Ergun's equation at the bed's void fraction of {branch.eps_g:.3f}"
        found.append(("U_mf", branch.U_mf, branch.uncertainty, branch.ergun, source))
    return tuple(_judge(kind, *each) for each in found if each[3] != 0.0)


def _judge(kind: str, metric: str, value: float, uncertainty: float, answer: float, source: str) -> KnownAnswer:
    allowed = ALLOWED[metric]
    return KnownAnswer(
        metric=metric,
        kind=kind,
        value=value,
        uncertainty=uncertainty,
        answer=answer,
        source=source,
        difference=(value - answer) / answer,
        allowed=allowed,
        verdict=decide(abs(value - answer), uncertainty, allowed * abs(answer)),
    )


def known_sentence(known: Sequence[KnownAnswer], verdict: str) -> str:
    """Return what there is to say of the answers with ``verdict``; empty if there are none."""
    told = [k for k in known if k.verdict == verdict]
    if not told:
        return ""
    texts = [
        f"{k.metric} of the {'Hertz' if k.kind == 'hertz' else k.kind} run is {k.value:.4g}, by {k.source}"
        f" {k.answer:.4g} ({100.0 * k.difference:+.2g} %, ±{100.0 * k.allowed:g} % allowed)"
        for k in told
    ]
    lead, end = {
        "ok": ("Known answer met", ""),
        "undecided": ("Undecided against a known answer", ""),
        "outside": (
            "Outside tolerance against a known answer",
            ". What both models share does not show in their difference: look at the warnings (gas step, cells)",
        ),
    }[verdict]
    return f"{lead}: {'; '.join(texts)}{end}."
