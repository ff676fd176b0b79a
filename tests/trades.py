"""Hand-made points and trades."""

from __future__ import annotations

from kncal.study import Variant
from kncal.study.trade.trade import Candidate, MetricError, Trade, TradeOptions, TradePoint


def error(metric, value, uncertainty=0.0):
    return MetricError(
        metric=metric, unit="–", value=1.0, reference=1.0, error=value, uncertainty=uncertainty, basis="relative"
    )


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


def trade(points, tolerances, *, bed=False, reference=None):
    reference = reference or point("reference", 100_000, {}, cpu=(10.0, 12.0, 11.0), how="reference", model="hertz")
    return Trade(
        case="made",
        title="",
        bed=bed,
        reference=reference,
        convergence=None,
        points=tuple(points),
        tolerances=tolerances,
        options=TradeOptions(tolerances=tolerances),
    )
