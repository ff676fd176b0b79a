"""What is compared: the names and units of the metrics, and one row of a comparison with its verdict."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

#: Metric (without the suffix _2, _3 ... of a later contact) -> (unit, what it is).
METRICS: Mapping[str, tuple[str, str]] = {
    "e_n": ("–", "normal restitution"),
    "t_c": ("s", "contact duration"),
    "delta_max": ("m", "maximum overlap"),
    "delta_mean": ("m", "mean overlap"),
    "v_out": ("m/s", "relative normal speed after the contact"),
    "rebound_height": ("m", "rebound height"),
    "slip_end_time": ("s", "time at which slip ends"),
    "slip_end_speed": ("m/s", "speed at which slip ends"),
    "tangential_restitution": ("–", "tangential restitution"),
    "spin_out": ("rad/s", "spin after the contact"),
    "rebound_angle": ("rad", "rebound angle"),
    "trajectory": ("–", "largest distance of the two paths / extent of the motion"),
    "trajectory_rms": ("–", "rms distance of the two paths / extent of the motion"),
}


@dataclass(frozen=True, kw_only=True)
class MetricRow:
    """One metric of both runs.

    Attributes
    ----------
    metric, unit : name and unit of ``linear`` and ``hertz``
    linear, hertz : values, or None
    difference : (linear - hertz)/scale [-], or None if it cannot be computed
    basis : what the scale is
    tolerance : allowed size of the difference [-], None: informative
    verdict : "ok", "outside", "missing" (has a tolerance, cannot be computed) or "-" (no tolerance)
    exact_difference : the same difference of the two exact solutions [-], or None
    numerical : predicted discretisation error of the two runs together, as a share of the scale [-], or None
    reason : why a value is missing, or what to know about the row
    """

    metric: str
    unit: str
    linear: float | None
    hertz: float | None
    difference: float | None
    basis: str
    tolerance: float | None
    verdict: str
    exact_difference: float | None = None
    numerical: float | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class ExactRow:
    """One metric of one run against the exact solution of the same model.

    Attributes
    ----------
    model : "linear" or "hertz"
    deviation : (value - exact)/scale [-], None if the run has no such value
    predicted : predicted discretisation error [-], or None
    explained : whether the predicted error (and a tenth more) covers the deviation; None where one of them is not known
    """

    model: str
    metric: str
    unit: str
    value: float | None
    exact: float
    deviation: float | None
    basis: str
    predicted: float | None
    explained: bool | None


def split_metric(name: str) -> tuple[str, int]:
    """Return the metric and the number of the contact: ("t_c", 2) for "t_c_2", ("t_c", 1) for "t_c"."""
    found = re.fullmatch(r"(.+?)_(\d+)", name)
    return (found[1], int(found[2])) if found else (name, 1)


def metric_order(name: str) -> tuple[int, int, str]:
    """Return the key to sort metrics by: contact after contact, each as in `METRICS`."""
    base, contact = split_metric(name)
    known = list(METRICS)
    return contact, known.index(base) if base in METRICS else len(known), name


def metric_unit(name: str) -> str:
    """Return the unit of a metric, "" for a name that kncal doesn't know."""
    return METRICS.get(split_metric(name)[0], ("", ""))[0]


def metric_text(name: str) -> str:
    """Return a metric in words, e.g. "contact duration, contact 2"."""
    base, contact = split_metric(name)
    text = METRICS.get(base, ("", name))[1]
    return text if contact == 1 else f"{text}, contact {contact}"


def judge(
    name: str,
    linear: float | None,
    hertz: float | None,
    difference: float | None,
    *,
    basis: str,
    tolerance: float | None,
    exact_difference: float | None = None,
    numerical: float | None = None,
    reason: str = "",
) -> MetricRow:
    """Make the row of a metric and give the verdict; the arguments are the fields of `MetricRow`."""
    if tolerance is None:
        verdict = "-"
    elif difference is None:
        verdict = "missing"
    else:
        verdict = "ok" if abs(difference) <= tolerance else "outside"
    return MetricRow(
        metric=name,
        unit=metric_unit(name),
        linear=linear,
        hertz=hertz,
        difference=difference,
        basis=basis,
        tolerance=None if tolerance is None else float(tolerance),
        verdict=verdict,
        exact_difference=exact_difference,
        numerical=numerical,
        reason=reason,
    )
