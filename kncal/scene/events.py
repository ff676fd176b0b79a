"""What changes during a run: walls that go, motions that begin and end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

from kncal.scene.walls import WallKeys


class Event(NamedTuple):
    """One change.

    ``time`` [s]; ``what``: "remove" the wall, "start" or "stop" one of its motions; ``wall``: its name; ``motion``:
    number of the motion in the wall's list, from 0. Carried out at the first end of an interval at or after its time.
    """

    time: float
    what: Literal["remove", "start", "stop"]
    wall: str
    motion: int = 0


def events_of(name: str, wall: WallKeys) -> Iterator[Event]:
    """Yield what happens to the wall ``name``; motions that start with the run included."""
    for i, motion in enumerate(wall.motion):
        yield Event(motion.start, "start", name, i)
        if motion.stop is not None:
            yield Event(motion.stop, "stop", name, i)
    if wall.remove_at is not None:
        yield Event(wall.remove_at, "remove", name)
