"""One contact of two bodies, as it was found in a run or solved exactly."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

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
    e_n : v_out/v_in [-], None for a contact that is not complete, did not start with an approach, or was disturbed
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


def only_binary(events: Sequence[ContactEvent], moving: Container[str]) -> tuple[ContactEvent, ...]:
    """Return the contacts; e_n is None where another contact of one of their ``moving`` bodies was there meanwhile.

    What then leaves is not what this contact gives back: of a resting sphere that is hit the ratio is in the thousands.
    """

    def disturbed(event: ContactEvent) -> bool:
        return any(
            other is not event
            and other.t_start < event.t_start + event.t_c
            and event.t_start < other.t_start + other.t_c
            and any(name in event.pair and name in moving for name in other.pair)
            for other in events
        )

    return tuple(replace(event, e_n=None) if event.e_n is not None and disturbed(event) else event for event in events)
