"""How many particles of which sizes the groups of a scene have. SI units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kncal.scene.groups import Particles
from kncal.scene.particle_files import Given, read_particles
from kncal.scene.sizes import Classes

#: Diameters of a file become classes so narrow that k_n and e_n are no farther off than this.
CLASS_ERROR = 0.02


@dataclass(frozen=True, kw_only=True)
class SizeClass:
    """The particles of one size of a group: ``name`` is the group's, with a number where it has several sizes.

    ``diameter`` [m]; ``number`` of them, those included that a stream brings later.
    """

    group: str
    name: str
    diameter: float
    number: int


class FromFile(NamedTuple):
    """Particles of a file, their classes of size, and the number of the class of each (n,)."""

    particles: Given
    classes: Classes
    kind: NDArray[np.int64]


def from_file(path: Path, diameter: float | None, e_n: float, scale: float = 1.0) -> FromFile:
    """Read particles, in units of ``scale`` [m]; all of ``diameter`` [m], or as the file says, in classes.

    These keep k_n and e_n to `CLASS_ERROR`.

    Raises
    ------
    ReadError, InputError
        As `kncal.scene.particle_files.read_particles`, and if there is no diameter at all.
    """
    found = read_particles(path, scale)
    if diameter is not None:
        return FromFile(found, Classes(np.array([diameter]), np.ones(1)), np.zeros(len(found.x), dtype=np.int64))
    return FromFile(found, *found.classes(CLASS_ERROR, e_n))


def number_of(group: Particles, given: int, volume: float, density: float) -> int:
    """Return the number of particles of a group: its count, or what its mass or its share of the region makes.

    ``given``: number of centres that the case or its file gives; ``volume``: mean of a particle [m³]; ``density``
    [kg/m³].
    """
    if group.count is not None:
        return group.count
    if group.mass is not None and volume * density > 0.0:
        return round(group.mass / (volume * density))
    if group.fill is not None and group.region is not None and volume > 0.0:
        return round(group.fill * group.region.volume / volume)
    return given
