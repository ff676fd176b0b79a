"""Hand-made points and trades."""

from __future__ import annotations

from dataclasses import replace

from kncal.observe.estimate import Estimate, missing
from kncal.observe.row import Row, judge
from kncal.study import Variant
from kncal.study.trade.trade import Candidate, Trade, TradeOptions, TradePoint

ONE = Estimate(value=1.0)


def error(metric, value, uncertainty=0.0):
    found = Estimate(value=value, width=uncertainty)
    return Row(metric=metric, unit="–", text="", run=ONE, reference=ONE, difference=found, scale=1.0, basis="relative")


def point(name, steps, errors, *, cpu=(), how="softened", model="linear", factor=0.1, n=20.0, k_n=1.0, signs=()):
    """A completed point; ``errors``: metric -> error, or (error, uncertainty)."""
    found = {m: error(m, *(e if isinstance(e, tuple) else (e,))) for m, e in errors.items()}
    return TradePoint(
        candidate=Candidate(
            name=name, how=how, factor=factor, steps_per_contact=n, variant=Variant(name=name, model=model)
        ),
        status="completed",
        k_n=k_n,
        steps=steps,
        dt=1e-6,
        cpu_seconds=tuple(cpu),
        errors=found,
        signs=tuple(signs),
    )


def judged(made, tolerances):
    """The same point, judged; one without a metric that has a tolerance lacks it."""
    lacking = {m: replace(error(m, None), run=missing("")) for m in tolerances if m not in made.errors}
    rows = {m: judge(row, tolerances.get(m)) for m, row in {**made.errors, **lacking}.items()}
    for m, row in rows.items():  # what a longer run would need is the statistics' matter: here it is as made
        rows[m] = replace(row, difference=made.errors[m].difference) if m in made.errors else row
    return replace(made, errors=rows)


def trade(points, tolerances, *, cost="steps", fixed="the start of the solver", reference=None):
    reference = reference or point("reference", 100_000, {}, cpu=(10.0, 12.0, 11.0), how="reference", model="hertz")
    return Trade(
        case="made",
        title="",
        cost=cost,
        fixed=fixed,
        reference=reference,
        convergence=None,
        points=tuple(judged(p, tolerances) for p in points),
        tolerances=tolerances,
        options=TradeOptions(tolerances=tolerances),
    )
