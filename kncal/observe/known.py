"""Beds whose answer is known: each run judged against it, since two models that agree may be wrong alike."""

from __future__ import annotations

from collections.abc import Sequence

from kncal.observe.estimate import Estimate
from kncal.observe.row import Row, allowed, difference_text, judge, row_of
from kncal.observe.run_data import RunData

#: Metric -> how far from the answer a run may be [-]. Coarse cells and coupled steps cost less than half of the first
#: two where nothing is wrong; the gas prefers the looser regions of a bed, which raises U_mf by 10 %.
ALLOWED = {"ergun_ratio": 0.05, "slip": 0.05, "U_mf": 0.15}
#: The drag law that the answers are of.
_LAW = "ErgunWenYu"


def known_answers(run: RunData) -> tuple[Row, ...]:
    """Return a run against every answer that theory gives: Ergun's gradient, the slip of one particle, U_mf.

    The source of each is its ``basis``.
    """
    if run.signals is None or run.model.scene.drag != _LAW:
        return ()
    seen = run.seen
    found: list[tuple[str, float, float, float, str]] = []
    if (worst := seen.get("worst_plateau")) is not None:
        found.append(("ergun_ratio", worst.ratio, worst.uncertainty, 1.0, "Ergun's equation in every cell"))
    if (final := seen.get("final")) is not None:
        if final.settling is None:
            found.append(("slip", final.slip, final.slip_uncertainty, final.terminal, "the terminal velocity"))
        else:
            slip = final.slip + final.velocity - final.settling
            found.append(("slip", final.slip, 0.0, slip, "the equation of motion"))
    if (curve := seen.get("curve")) is not None:
        branch = curve.falling
        source = f"Ergun's equation at the bed's void fraction of {branch.eps_g:.3f}"
        found.append(("U_mf", branch.U_mf, branch.uncertainty, branch.ergun, source))
    return tuple(_judge(run.model.kind, *each) for each in found if each[3] != 0.0)


def _judge(model: str, metric: str, value: float, width: float, answer: float, source: str) -> Row:
    row = row_of(
        metric,
        Estimate(value=value, width=width, chance=True),
        Estimate(value=answer, width=0.0),
        Estimate(value=(value - answer) / answer, width=width / abs(answer), chance=True),
        scale=abs(answer),
        basis=source,
        model=model,
    )
    return judge(row, ALLOWED[metric])


def known_sentence(known: Sequence[Row], verdict: str) -> str:
    """Return what there is to say of the answers with ``verdict``; empty if there are none."""
    told = [k for k in known if k.verdict == verdict]
    if not told:
        return ""
    texts = [
        f"{k.metric} of the {'Hertz' if k.model == 'hertz' else k.model} run is {k.run.value:.4g}, by {k.basis}"
        f" {k.reference.value:.4g} ({difference_text(k)}, {allowed(k.tolerance)} allowed)"
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
