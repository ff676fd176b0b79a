"""What is compared in beds: the one table of metrics, and which of them a kind of bed has."""

from __future__ import annotations

from collections.abc import Mapping

#: Metric -> (unit, what it is), in the order of the rows of a comparison; a case may set a tolerance for each.
#: Time averages after the start-up, unless in `NOT_AVERAGED`.
BED_METRICS: Mapping[str, tuple[str, str]] = {
    "velocity": ("m/s", "final velocity of a single particle, upwards, relative to the column"),
    "slip": ("m/s", "final velocity of a single particle, downwards, relative to the gas (U_0)"),
    "ergun_ratio": (
        "–",
        "pressure gradient over Ergun's, each cell with its own void fraction and velocity;"
        " of several gas velocities the one farthest from 1",
    ),
    "U_mf": ("m/s", "minimum fluidisation velocity: falling gas velocity, packed bed's curve meets weight/area"),
    "U_mf_rising": ("m/s", "the same with rising gas velocity, from the packing at the start"),
    "overshoot": ("–", "largest pressure drop with rising gas velocity, over weight/area, less 1"),
    "plateau": ("–", "mean pressure drop of the fluidised bed over weight/area, falling gas velocity"),
    "eps_mf": ("–", "mean void fraction of the packed bed of the falling branch"),
    "pressure_drop": ("Pa", "gauge pressure at the inlet"),
    "pressure_fluctuation": ("Pa", "standard deviation of the pressure at the inlet"),
    "dominant_frequency": ("Hz", "frequency of the largest peak of the pressure drop's spectrum"),
    "weight_balance": ("–", "gas force on the particles plus reaction of floor and walls, over their weight"),
    "weight_closure": ("–", "(Δp A + floor + walls − weight − change of momentum)/weight, gas weight taken off"),
    "floor_share": ("–", "share of the bed's weight that stands on the floor"),
    "z_mean": ("m", "mean height of the particles"),
    "z_95": ("m", "height below which 95 % of the particles are"),
    "bed_height": ("m", "height at which the laterally averaged void fraction crosses 0.8"),
    "height_pressure": ("m", "height at which the pressure line of the bed meets that of the freeboard"),
    "voidage": ("–", "mean void fraction below the bed height"),
    "eps_g": ("–", "rms difference of the time-mean void fraction fields"),
    "bubble_number": ("–", "bubbles in the bed at a time"),
    "bubble_share": ("–", "share of the bed's volume that is bubbles"),
    "bubble_diameter": ("m", "mean equivalent diameter of the bubbles"),
    "bubble_velocity": ("m/s", "mean rise velocity of the bubbles"),
    "kinetic_energy": ("J", "kinetic energy of the particles' translation"),
    "granular_temperature": ("m²/s²", "mean square of the particles' velocity fluctuation, per direction"),
    "contacts": ("–", "number of contacts between particles"),
    "overlap_mean": ("m", "mean overlap of all contacts"),
    "overlap_max": ("m", "largest overlap of the run"),
    "overlap_share": ("–", "share of contacts with an overlap above 1 % of the diameter"),
}
#: Differences of these are absolute: their Hertz value is zero but for errors, or near it by chance.
ABSOLUTE = ("weight_closure", "overshoot")
#: Values with an uncertainty of their own kind, which a longer run does not make smaller as it does that of an average.
NOT_AVERAGED = ("velocity", "slip", "ergun_ratio", "U_mf", "U_mf_rising", "overshoot", "plateau", "eps_mf")

#: Kinds of beds: see `kncal.observe.signals.bed_kind`.
KINDS_OF_BEDS: Mapping[str, str] = {
    "gas": "gas alone",
    "single": "a single particle",
    "frozen": "a frozen bed (the particles do not move)",
    "ramp": "a bed in a gas velocity that changes",
    "steady": "a moving bed in a steady gas velocity",
}
_FLOW = ("pressure_drop", "pressure_fluctuation", "dominant_frequency")
_CURVE = ("U_mf", "U_mf_rising", "overshoot", "plateau", "eps_mf")
#: Kind of bed -> the metrics that mean something there; "steady" has all that the others have not for themselves.
_OF: Mapping[str, tuple[str, ...]] = {
    "gas": _FLOW,
    "single": ("velocity", "slip"),
    "frozen": ("ergun_ratio", *_FLOW),
    "ramp": (*_CURVE, "weight_closure", "overlap_max"),
    "steady": (*(n for n in BED_METRICS if n not in ("velocity", "slip", "ergun_ratio", *_CURVE)), "z_twice"),
}  # fmt: skip


def why_not(name: str, kind: str, changes: bool) -> str:
    """Return why a bed of ``kind`` has no metric ``name``; empty if it may have it.

    ``changes``: see `kncal.observe.signals.gas_changes`.
    """
    if name not in _OF[kind]:
        if kind == "ramp" and name in _OF["steady"]:
            return "the gas velocity changes: it would be an average over different states"
        own = [text for of, text in KINDS_OF_BEDS.items() if name in _OF[of]]
        return f"only of {' or '.join(own)}; this is {KINDS_OF_BEDS[kind]}"
    if changes and name in _FLOW:
        return "the gas velocity changes: it would be an average over different states"
    return ""
