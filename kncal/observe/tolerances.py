"""What a user tolerates: ``restitution=1%``, by the names of the metrics or by words for them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping

from kncal.core.checks import nearest
from kncal.core.errors import InputError
from kncal.scene.metrics import METRICS, offered, split_metric

#: Words for metrics; of each those count that the runs of a case can have.
WORDS: Mapping[str, tuple[str, ...]] = {
    "restitution": ("e_n",),
    "overlap": ("delta_max", "delta_mean", "overlap_mean", "overlap_max"),
    "duration": ("t_c",),
    "pressure": ("pressure_drop",),
    "height": ("bed_height",),
    "bubbles": ("bubble_number", "bubble_share", "bubble_diameter", "bubble_velocity"),
    "angle": ("angle_of_repose", "dynamic_angle"),
    "flow": ("mass_flow",),
    "packing": ("packing_fraction",),
    "mixing": ("mixing_index",),
}


def parse_tolerances(given: Iterable[str], recorded: Collection[str]) -> dict[str, float]:
    """Return metric -> largest allowed abs(error) [-] of texts like ``restitution=1%`` or ``t_c=0.05``.

    ``recorded``: what a run of the case records, names of `kncal.scene.metrics.RECORDS`.

    Raises
    ------
    InputError
        If one is not of that form, not above zero, of no metric that such a case has, or given twice.
    """
    found: dict[str, float] = {}
    for text in given:
        name, sign, number = (part.strip() for part in text.partition("="))
        if not sign or not name:
            raise InputError(f"--tolerance {text[:100]!r}: expected METRIC=SHARE, e.g. restitution=1% or t_c=0.05")
        value = _share(text, number)
        for metric in _metrics(name, offered(recorded)):
            if metric in found:
                raise InputError(f"--tolerance {text[:100]!r}: {metric} has one already; expected each metric once")
            found[metric] = value
    return found


def _share(text: str, number: str) -> float:
    try:
        value = float(number[:-1]) / 100.0 if number.endswith("%") else float(number)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise InputError(f"--tolerance {text[:100]!r}: {number[:50]!r}: expected a share above 0, e.g. 1% or 0.01")
    if value >= 1.0 and not number.endswith("%"):
        raise InputError(
            f"--tolerance {text[:100]!r}: {number[:50]} is a share, {100.0 * value:g} %: expected e.g. "
            f"{number[:50]}% or {value / 100.0:g} (a tolerance of so much is written with its sign, {100.0 * value:g}%)"
        )
    return value


def _metrics(name: str, offer: Collection[str]) -> tuple[str, ...]:
    words = {word: of for word, metrics in WORDS.items() if (of := tuple(m for m in metrics if m in offer))}
    base, later = split_metric(name)
    if name in words:
        return words[name]
    if name in offer or (base in offer and METRICS[base].each and later > 1):
        return (name,)
    allowed = [*words, *offer]
    raise InputError(f"--tolerance {name[:50]!r}: expected one of {', '.join(allowed)}{nearest(name, allowed)}")
