"""One contact of two bodies, as it was found in a run or solved exactly."""

from __future__ import annotations

from dataclasses import dataclass

Names = tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class ContactEvent:
    """One contact of two bodies.

    Attributes
    ----------
    pair : names of the two bodies
    t_start, t_c : first touch and duration [s]; up to the end of the run for a contact that does not end
    delta_max, delta_mean : maximum and time mean of the overlap [m]
    v_in : closing speed at the start [m/s]
    v_out : leaving speed at the end [m/s], None if the contact does not end
    e_n : v_out/v_in [-], None for a contact that is not complete or did not start with an approach
    complete : whether both start and end were seen
    """

    pair: Names
    t_start: float
    t_c: float
    delta_max: float
    delta_mean: float
    v_in: float
    v_out: float | None
    e_n: float | None
    complete: bool
