"""What a deck says, before it is written: see `kncal.engines.liggghts.deck`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.engines.liggghts.deck_flow import DeckOutlet, DeckStream
from kncal.engines.liggghts.deck_tables import AtomType, Contacts
from kncal.engines.liggghts.deck_walls import DeckWall
from kncal.scene.bodies import Vector

#: Up to so many particles each is compared with each, and none are sorted: there is nothing to gain.
FEW = 20

Side = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Particles:
    """Where particles are at the start: arrays (n, 3) in m, m/s, rad/s, and the index (n,) of each one's atom type.

    ``names`` of a few that the deck itself creates; without names they are read from `DATA`.
    """

    kinds: NDArray[np.intp]
    x: Array
    v: Array
    spin: Array
    names: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Deck:
    """What a deck says, whatever kind of scene it is of.

    Attributes
    ----------
    scene, kind : names of the scene and of its model
    style : LIGGGHTS' normal model, one of `STYLES`
    types : atom types, those of particles first
    contacts, unmet : by pairs of types (see `contact_context`)
    tangential : whether contacts have friction and tangential springs
    walls : primitives first; of a scene with gas the first is the one whose reaction is summed up for kncal
    streams, outlets : where particles come and go
    gas : whether kncal puts forces on the particles
    box : lower and upper end on each axis [m]; periodic : the axes that are, as "y" or "xy"
    processors : parts into which the box is cut on each axis, one for each rank
    grows : whether the box grows with the particles, so that none can leave it
    gravity : vector [m/s²]
    dt : time step [s]; steps : number of steps, None: by hand as many as asked for, and kncal drives it as a library
    interval : steps in an interval of a run of many particles, at whose ends walls change; time : that at which the
        deck begins, of a run that goes on [s]
    frames_every : steps between frames of a run of many particles by hand
    thermo_every : steps between lines of the log
    start : Particles; None: from the file `RESTART`
    near : distance in diameters within which a contact that opened is forgotten
    count : number of particles; skin : of neighbour lists [m]; d_min : smallest diameter [m]
    bin_size : edge of the bins of neighbour lists and sorting [m], 0 for LIGGGHTS' own
    schedule : when frames are recorded (see `kncal.engines.liggghts.schedule`); None: kncal reads the particles itself
    """

    scene: str
    kind: str
    style: str
    types: Sequence[AtomType]
    contacts: Contacts
    unmet: Contacts = field(default_factory=dict)
    tangential: bool = True
    walls: Sequence[DeckWall]
    streams: Sequence[DeckStream] = ()
    outlets: Sequence[DeckOutlet] = ()
    gas: bool = False
    box: tuple[Side, Side, Side]
    periodic: str = ""
    processors: tuple[int, int, int] = (1, 1, 1)
    grows: bool = False
    gravity: Vector
    dt: float
    steps: int | None = None
    interval: int = 0
    time: float = 0.0
    frames_every: int = 0
    thermo_every: int = 1000
    start: Particles | None
    count: int
    near: float
    skin: float
    d_min: float = 0.0
    bin_size: float = 0.0
    schedule: Mapping[str, object] | None = None

    @property
    def every(self) -> float:
        """Length of an interval [s]."""
        return self.interval * self.dt

    @property
    def few(self) -> bool:
        """Whether each particle is compared with each; triangles want bins."""
        return self.grows or (self.count <= FEW and not self.outlets and not any(wall.is_mesh for wall in self.walls))

    @property
    def has_floor(self) -> bool:
        """Whether the first wall is the floor of a box that is there to the end."""
        return bool(self.walls) and self.walls[0].side == "floor" and self.walls[0].wall.stays_whole
