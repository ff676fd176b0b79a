"""What is compared of a bed beyond `kncal.observe.averages`: fluctuation, balance, voidage, overlap share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.observe.averages import BedObservations
from kncal.observe.estimate import Estimate, averaged, missing
from kncal.observe.fields import frames_from, voidage_heights
from kncal.observe.signals import rows_from
from kncal.physics.statistics import Average, average
from kncal.record.series import BedSeries
from kncal.scene.metrics import why_not

#: Contacts with a larger overlap than this share of the diameter are counted in ``overlap_share``.
OVERLAP_LIMIT = 0.01


def quantities(series: BedSeries, observations: BedObservations) -> dict[str, Estimate]:
    """Return every metric of a run but for those of added packages: the averages of ``observations``, and those here.

    What means nothing for its kind of bed (see `kncal.scene.metrics.why_not`) is not among them.
    """
    begin, end = observations.begin, float(series.t[-1])
    found = {name: averaged(average, begin, end) for name, average in observations.averages.items()} | _own(
        observations
    )
    for name, why in observations.missing.items():
        if name not in found and not why_not(name, observations.kind, observations.changes):
            found[name] = missing(why)
    computed: dict[str, Callable[[BedSeries, float], Average]] = {
        "pressure_fluctuation": _fluctuation,
        "weight_balance": _balance,
        "weight_closure": _closure,
        "voidage": _voidage,
        "overlap_share": _overlap_share,
    }
    for name, compute in computed.items():
        if name in found or why_not(name, observations.kind, observations.changes):
            continue
        try:
            found[name] = averaged(compute(series, begin), begin, end)
        except InputError as error:
            found[name] = missing(str(error))
    return found


def _own(observations: BedObservations) -> dict[str, Estimate]:
    """What single particles, frozen beds and ramps have of their own: one value each, with a width of its own kind."""
    found: dict[str, Estimate] = {}

    def add(name: str, value: float, width: float) -> None:
        found[name] = Estimate(value=value, width=width, chance=True)

    if (final := observations.final) is not None:
        add("velocity", final.velocity, final.uncertainty)
        add("slip", final.slip, final.slip_uncertainty)
    if observations.plateaus:
        worst = max(observations.plateaus, key=lambda p: abs(p.ratio - 1.0))
        add("ergun_ratio", worst.ratio, worst.uncertainty)
    if (curve := observations.curve) is not None:
        for name, branch in (("U_mf", curve.falling), ("U_mf_rising", curve.rising)):
            add(name, branch.U_mf, branch.uncertainty)
        add("overshoot", curve.rising.largest - 1.0, curve.rising.largest_uncertainty)
        add("eps_mf", curve.falling.eps_g, curve.falling.eps_g_uncertainty)
        if curve.falling.plateau is not None:
            add("plateau", curve.falling.plateau, curve.falling.plateau_uncertainty)
    return found


def _fluctuation(series: BedSeries, begin: float) -> Average:
    """Average the squared deviation of the pressure; the uncertainty of its root follows to first order."""
    if series.facts.gas_density <= 0.0:
        raise InputError("no gas")
    pressure = series.p_in
    squares = (pressure - pressure[rows_from(series, begin)].mean()) ** 2
    found = average(series.t, squares, begin)
    if found.mean <= 0.0:
        return replace(found, mean=0.0)
    std = float(np.sqrt(found.mean))
    slope = 0.5 / std
    return replace(
        found,
        mean=std,
        uncertainty=slope * found.uncertainty,
        standard_error=slope * found.standard_error,
        std=slope * found.std,
    )


def _forces(series: BedSeries) -> None:
    """Refuse a run whose particles do not move, or have no weight."""
    if not series.facts.weight > 0.0:
        raise InputError("the particles have no weight")
    if not np.isfinite(series.floor + series.walls).all():
        raise InputError("no contacts were recorded (particles do not move)")


def _balance(series: BedSeries, begin: float) -> Average:
    """Average gas force and reaction of floor and walls over the weight."""
    _forces(series)
    return average(series.t, (series.drag_z + series.floor + series.walls) / series.facts.weight, begin)


def _closure(series: BedSeries, begin: float) -> Average:
    """Average the sum of the vertical forces on the bed, pressure form; see `kncal.observe.signals.force_balance`."""
    facts = series.facts
    _forces(series)
    if facts.gas_density <= 0.0:
        raise InputError("no gas")
    if facts.jet:
        raise InputError("the gas enters through a jet: the pressure on the rest of the floor is not recorded")
    gas_volume = float(np.prod(facts.size)) - facts.mass / facts.density
    gas_weight = facts.gas_density * facts.gravity * gas_volume
    rate = np.diff(series.momentum_z) / facts.coupling
    sums = (series.p_in * facts.floor_area - gas_weight + series.floor + series.walls)[1:] - rate
    return average(series.t[1:], sums / facts.weight - 1.0, begin)  # the momentum before the first is not recorded


def _voidage(series: BedSeries, begin: float) -> Average:
    """Average the void fraction below the bed height, frame by frame."""
    facts = series.facts
    heights = voidage_heights(series, begin)
    frames = frames_from(series, begin)
    if not (heights > 0.0).all():
        raise InputError("not defined in every frame: no layer is denser than the freeboard")
    nz = facts.cells[2]
    edges = np.linspace(0.0, facts.size[2], nz + 1)
    solids = 1.0 - series.eps_g[frames].mean(axis=(2, 3), dtype=np.float64)
    below = np.concatenate([np.zeros((len(frames), 1)), np.cumsum(solids * facts.size[2] / nz, axis=1)], axis=1)
    filled = np.array([np.interp(h, edges, c) for h, c in zip(heights, below, strict=True)])
    steps = np.diff(series.frame_coupling[frames])
    even = slice(0, 1 + int(np.cumprod(steps == steps[0]).sum())) if len(steps) else slice(None)
    values: Array = 1.0 - filled / heights
    return average(series.t_frame[frames][even], values[even], begin)


def _overlap_share(series: BedSeries, begin: float) -> Average:
    """Average the share of overlaps above `OVERLAP_LIMIT`, every contact counting once.

    A ratio of two means: its uncertainty is that of the mean of ``(above - share n)/mean n``, to first order (the
    ratio estimator of survey sampling: Cochran, "Sampling Techniques" (1977), chapter 6).
    """
    facts = series.facts
    edges = np.array(facts.histogram_edges)
    rows = rows_from(series, begin)
    limit = OVERLAP_LIMIT * facts.diameter
    # the share of each bin above the limit: 1 above, 0 below, linear within
    weight = np.clip((edges[1:] - limit) / np.diff(edges), 0.0, 1.0)
    above, number = series.histogram @ weight, series.histogram.sum(axis=1).astype(np.float64)
    mean = float(number[rows].mean())
    if mean <= 0.0:
        raise InputError("no contact between particles was recorded")
    share = float(above[rows].mean()) / mean
    return average(series.t, share + (above - share * number) / mean, begin)
