"""What is compared in beds: the names and units of the metrics that a case may set a tolerance for."""

from __future__ import annotations

from collections.abc import Mapping

#: Metric -> (unit, what it is). All are time averages after the start-up, unless said otherwise.
BED_METRICS: Mapping[str, tuple[str, str]] = {
    "pressure_drop": ("Pa", "gauge pressure at the inlet"),
    "weight_balance": ("–", "gas force on the particles plus reaction of floor and walls, over their weight"),
    "ergun_ratio": ("–", "pressure gradient over Ergun's, each cell with its own void fraction and velocity"),
    "floor_share": ("–", "share of the bed's weight that stands on the floor"),
    "z_mean": ("m", "mean height of the particles"),
    "z_95": ("m", "height below which 95 % of the particles are"),
    "bed_height": ("m", "height at which the laterally averaged void fraction crosses 0.8"),
    "kinetic_energy": ("J", "kinetic energy of the particles' translation"),
    "granular_temperature": ("m²/s²", "mean square of the particles' velocity fluctuation, per direction"),
    "dominant_frequency": ("Hz", "frequency of the largest peak of the pressure drop's spectrum"),
    "overlap_mean": ("m", "mean overlap of all contacts"),
    "overlap_max": ("m", "largest overlap of the run"),
    "contacts": ("–", "number of contacts between particles"),
    "bubble_diameter": ("m", "mean equivalent diameter of the bubbles"),
    "bubble_velocity": ("m/s", "mean rise velocity of the bubbles"),
    "eps_g": ("–", "rms difference of the time-mean void fraction fields"),
    "U_mf": ("m/s", "minimum fluidisation velocity, from a ramp of the gas velocity"),
    "velocity": ("m/s", "final velocity of a single particle"),
}
