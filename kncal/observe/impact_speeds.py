"""The impact speeds that a run had, and the stiffness that its case's method gives at them.

Three speeds stand for a distribution: the mean; the energy-weighted mean, sum v³/sum v², which is the speed at which
the energy of the impacts arrives; and the 99th percentile, which the largest overlaps belong to. Each has a 95 %
confidence interval: of a bed from its time series (`kncal.physics.statistics`), of single contacts none, since they
are all there are.

Sources: ratio estimators linearised, as in Cochran, Sampling Techniques (1977), section 6.3; interval of a percentile
from that of the distribution function at it: Woodruff, J. Am. Stat. Assoc. 47 (1952) 635.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import InputError, ValidityError
from kncal.observe.signals import rows_from
from kncal.physics.material import Pair
from kncal.physics.statistics import Average, Interval, average
from kncal.record.series import BedSeries
from kncal.scene.contact import ContactChoice
from kncal.scene.pair_contact import PairNumbers, calibration_for
from kncal.scene.species import SpeciesPair, SpeciesTable

if TYPE_CHECKING:
    from kncal.scene.contact_event import ContactEvent

#: The three speeds, by the names that `contact.measured.statistic` takes.
STATISTICS: Mapping[str, str] = {
    "mean": "mean",
    "energy_weighted": "energy-weighted mean",
    "p99": "99th percentile",
}
#: Which impacts of a bed of one kind of particles are told apart, with the pair of species: of two particles, of a
#: particle and a wall.
KINDS_OF_IMPACTS: Mapping[str, SpeciesPair] = {"particles": (0, 0), "walls": (0, 1)}
#: Fewer impacts than this say too little of a mean; of the 99th percentile, a hundred times less the share above it.
LEAST_IMPACTS, LEAST_FOR_P99 = 100, 1000
_P99 = 0.99


@dataclass(frozen=True, kw_only=True)
class ImpactSpeeds:
    """The impact speeds of one kind of contacts.

    Attributes
    ----------
    kind : of `kinds_of_impacts`, or "all"
    count : number of impacts that were seen
    speeds : name of `STATISTICS` -> Interval [m/s]; empty without impacts
    edges : (bins + 1,) [m/s]; counts : (bins,) of the histogram
    """

    kind: str
    count: int
    speeds: Mapping[str, Interval]
    edges: Array
    counts: Array

    def ppf(self, q: Array, /) -> Array:
        """Return the speeds [m/s] that shares ``q`` of all impacts do not exceed, of its shape; 1e-12 in place of 0."""
        return np.maximum(histogram_quantiles(self.edges, self.counts, np.asarray(q, dtype=np.float64)), 1e-12)

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        speeds = {name: asdict(estimate) for name, estimate in self.speeds.items()}
        histogram = {"edges": self.edges.tolist(), "counts": self.counts.tolist()}
        return {"kind": self.kind, "count": self.count, "speeds": speeds, "histogram": histogram}


@dataclass(frozen=True, kw_only=True)
class Enduring:
    """Contacts between particles that no impact speed describes.

    Attributes
    ----------
    duration : mean duration of a contact over the duration of an impact t_c [-]
    share : least share of the contacts at any moment that are older than an impact lasts [-]
    """

    duration: float
    share: float


@dataclass(frozen=True, kw_only=True)
class StiffnessAt:
    """Linear stiffness k_n [N/m] at one of the three speeds of a pair; None with a ``problem``."""

    statistic: str
    v_0: Interval
    k_n: Interval | None
    problem: str = ""


def kinds_of_impacts(species: SpeciesTable) -> Mapping[str, SpeciesPair]:
    """Return which impacts of a run with averages are told apart: those of each pair of species, by their names."""
    pairs = list(species.pairs())
    if pairs == list(KINDS_OF_IMPACTS.values()):
        return KINDS_OF_IMPACTS
    return {"–".join(species.names(pair)): pair for pair in pairs}


def bed_impact_speeds(
    series: BedSeries, begin: float, doubt: str = "", kinds: Mapping[str, SpeciesPair] = KINDS_OF_IMPACTS
) -> dict[str, ImpactSpeeds]:
    """Return the impact speeds of a bed from ``begin`` [s] on, by kind; ``doubt`` about the run goes to all of them.

    ``kinds``: of `kinds_of_impacts`.

    Raises
    ------
    InputError
        If the run has no record of them: its particles do not move.
    """
    if not series.facts.impact_edges:
        raise InputError("impact speeds: not recorded, its particles do not move: expected a run of moving particles")
    rows = rows_from(series, begin)
    edges = np.array(series.facts.impact_edges)
    found = {}
    for kind, pair in kinds.items():
        if pair not in series.facts.pairs:  # nothing of that kind can meet
            continue
        k = series.facts.pairs.index(pair)
        counts, sums = series.impacts[rows, k].astype(np.float64), series.impact_sums[rows, k]
        number = counts.sum(axis=1)
        speeds = {}
        if number.sum():
            t = series.t[rows]
            speeds = {
                "mean": _ratio(t, sums[:, 0], number, int(number.sum())),
                "energy_weighted": _ratio(t, sums[:, 2], sums[:, 1], int(number.sum())),
                "p99": _percentile(t, counts, edges),
            }
        if doubt:
            speeds = {name: replace(one, why="; ".join(filter(None, (doubt, one.why)))) for name, one in speeds.items()}
        found[kind] = ImpactSpeeds(
            kind=kind, count=int(number.sum()), speeds=speeds, edges=edges, counts=counts.sum(axis=0)
        )
    return found


def contact_impact_speeds(contacts: Sequence[ContactEvent]) -> ImpactSpeeds:
    """Return the impact speeds of a run of single contacts, of all pairs together.

    Counted are contacts whose start was seen and began with an approach. The speeds are those of the run, not samples
    of something: their intervals have no width.
    """
    v = np.array([contact.v_in for contact in contacts if contact.v_in > 0.0])
    if not len(v):
        return ImpactSpeeds(kind="all", count=0, speeds={}, edges=np.array([0.0, 1.0]), counts=np.zeros(1))
    edges = np.concatenate(([0.0], np.geomspace(0.5 * v.min(), 2.0 * v.max(), 101)))
    values = {"mean": v.mean(), "energy_weighted": (v**3).sum() / (v**2).sum(), "p99": np.quantile(v, _P99)}
    speeds = {name: Interval(value=float(x), low=float(x), high=float(x)) for name, x in values.items()}
    return ImpactSpeeds(
        kind="all", count=len(v), speeds=speeds, edges=edges, counts=np.histogram(v, edges)[0].astype(np.float64)
    )


def enduring(series: BedSeries, begin: float, t_c: float) -> Enduring | None:
    """Return what of a bed's contacts from ``begin`` [s] on is not described by impacts of duration ``t_c`` [s].

    Contacts begin at a rate r and N are there at a time, so they last N/r in the mean (Little's law). At most r t_c of
    them are younger than t_c. None if no contact was seen.
    """
    rows = rows_from(series, begin)
    own = [j < len(series.facts.radii) for _, j in series.facts.pairs]  # two particles
    new, watched = float(series.impacts[rows][:, own].sum()), float(series.watched[rows].sum())
    number = float(np.nanmean(series.contacts[rows])) if rows.any() else 0.0
    if not new or not number > 0.0:
        return None
    young = new / watched * t_c / number
    return Enduring(duration=1.0 / young, share=max(0.0, 1.0 - young))


def stiffness_at(
    speeds: ImpactSpeeds, contact: ContactChoice, both: Pair, numbers: PairNumbers
) -> tuple[StiffnessAt, ...]:
    """Return k_n by the case's method at each of the speeds; ``numbers`` of the pair: only e_n is used.

    For a case that prescribes k_n: what its method would give in place of it.
    """
    rows = []
    for name, speed in speeds.speeds.items():
        ends = (speed.value, speed.low, speed.high)
        try:
            found = [calibration_for(contact, both, PairNumbers(numbers.e_n, 0.0, v, None)) for v in ends]
            values = [float(calibration.k_n) for calibration in found if calibration is not None]
        except (ValidityError, InputError) as error:
            rows.append(StiffnessAt(statistic=name, v_0=speed, k_n=None, problem=str(error)))
            continue
        k_n = Interval(value=values[0], low=min(values), high=max(values), why=speed.why)
        rows.append(StiffnessAt(statistic=name, v_0=speed, k_n=k_n))
    return tuple(rows)


def histogram_quantiles(edges: Array, counts: Array, shares: Array) -> Array:
    """Return where the cumulative histogram reaches ``shares`` (any shape).

    Within a bin the logarithm of the share above is linear, as in an exponential tail, which keeps high percentiles
    right in wide bins; within the last that is filled, the share itself.
    """
    filled = counts > 0
    cumulative = np.concatenate([[0.0], np.cumsum(counts[filled]) / counts.sum()])
    last = int(filled.sum()) - 1
    at = np.clip(np.searchsorted(cumulative, shares, side="left") - 1, 0, last)
    low, high, begin, end = edges[:-1][filled][at], edges[1:][filled][at], cumulative[at], cumulative[at + 1]
    linear = (shares - begin) / (end - begin)
    inner = np.where(at < last, end, begin)  # no logarithm of 0
    part = np.log((1.0 - np.minimum(shares, inner)) / (1.0 - begin)) / np.log(
        np.where(at < last, (1.0 - inner) / (1.0 - begin), 0.5)
    )
    values: Array = low + (high - low) * np.where(at < last, part, linear)
    return values


def _ratio(t: Array, above: Array, below: Array, count: int) -> Interval:
    """Return sum(above)/sum(below) and its interval, from the linearised ratio in every coupling."""
    value = float(above.sum() / below.sum())
    signal = value + (above - value * below) / below.mean()
    found = average(t, signal, float(t[0]))
    why = _doubts(found, count, LEAST_IMPACTS)
    return Interval(value=value, low=max(value - found.uncertainty, 0.0), high=value + found.uncertainty, why=why)


def _percentile(t: Array, counts: Array, edges: Array) -> Interval:
    total = counts.sum(axis=0)
    value = float(histogram_quantiles(edges, total, np.array(_P99)))
    at = int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(total) - 1))
    part = (_P99 * total.sum() - total[:at].sum()) / total[at]
    below, number = counts[:, :at].sum(axis=1) + part * counts[:, at], counts.sum(axis=1)
    found = average(t, (below - _P99 * number) / number.mean(), float(t[0]))
    ends = np.clip([_P99 - found.uncertainty, _P99 + found.uncertainty], 0.0, 1.0)
    low, high = histogram_quantiles(edges, total, ends)
    return Interval(value=value, low=float(low), high=float(high), why=_doubts(found, int(total.sum()), LEAST_FOR_P99))


def _doubts(found: Average, count: int, least: int) -> str:
    few = [f"only {count} impacts were seen, {least} are needed"] if count < least else []
    return "; ".join([*few, found.why] if found.why else few)
