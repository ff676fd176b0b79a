"""Calibration of every pair of several particle types and wall materials, as solvers want it: per type pair.

One `gamman` (damping per effective mass) for all pairs gives the wrong restitution at walls and between unlike sizes:
tuned to e_n = 0.9 for an equal pair it gives 0.8615 at a wall. The matrix form gives each pair its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.calibration import Calibration, calibrate
from kncal.checks import Array
from kncal.errors import InputError
from kncal.material import Material, pair, wall_pair

if TYPE_CHECKING:
    import pandas as pd

#: A value for every pair, or one per pair of names (in any order; missing pairs are an error).
PerPair = float | Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class PairMatrix:
    """Calibrations of every pair that can touch (particle–particle and particle–wall).

    Attributes
    ----------
    particles, walls : names of the particle types and wall materials, in the order given
    calibrations : (name, name) -> Calibration, in type order (i <= j)
    """

    particles: tuple[str, ...]
    walls: tuple[str, ...]
    calibrations: Mapping[tuple[str, str], Calibration]

    @property
    def names(self) -> tuple[str, ...]:
        """Particle types, then walls: the order of the matrices (type 1, 2, ... of a LIGGGHTS deck)."""
        return (*self.particles, *self.walls)

    def __getitem__(self, names: tuple[str, str]) -> Calibration:
        """Return the calibration of two names, in any order."""
        for key in (names, names[::-1]):
            if key in self.calibrations:
                return self.calibrations[key]
        known = ", ".join(f"{a}–{b}" for a, b in self.calibrations)
        raise InputError(f"no contact between {names[0]!r} and {names[1]!r}: expected one of {known}")

    def matrix(self, quantity: str) -> Array:
        """Return an attribute of the calibrations ("k_n", "eta_n", "gamma_n", "t_c" ...) as a symmetric matrix.

        Returns
        -------
        (n, n) array in the order of `names`. Two walls never touch; their entries repeat the largest of the others,
        since a solver wants a number there.
        """
        size = len(self.names)
        out = np.zeros((size, size))
        index = {name: i for i, name in enumerate(self.names)}
        for (a, b), calibration in self.calibrations.items():
            value = float(getattr(calibration, quantity))
            out[index[a], index[b]] = out[index[b], index[a]] = value
        first_wall = len(self.particles)
        out[first_wall:, first_wall:] = out.max()
        return out

    @property
    def t_c(self) -> float:
        """Shortest contact duration of all pairs [s]: the time step follows from this one."""
        return min(float(c.t_c) for c in self.calibrations.values())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of all pairs, each with the names of its pair."""
        return tuple(f"{a}–{b}: {w}" for (a, b), c in self.calibrations.items() for w in c.warnings)

    def to_frame(self) -> pd.DataFrame:
        """Return one row per pair, the names first."""
        import pandas as pd

        frames = []
        for (a, b), calibration in self.calibrations.items():
            frame = calibration.to_frame()
            frame.insert(0, "type_1", a)
            frame.insert(1, "type_2", b)
            frames.append(frame)
        return pd.concat(frames, ignore_index=True)

    def liggghts(self) -> str:
        """Return deck lines for `hooke/stiffness`: kn and gamman of every type pair, 17 digits."""
        size = len(self.names)
        types = ", ".join(f"{i} = {name}" for i, name in enumerate(self.names, 1))
        lines = [f"# atom types: {types}", f"# k_n [N/m] and damping per effective mass [1/s], {size}x{size}"]
        for prop, quantity in (("kn", "k_n"), ("gamman", "gamma_n")):
            numbers = " ".join(repr(float(x)) for x in self.matrix(quantity).ravel())
            lines.append(f"fix {prop} all property/global {prop} peratomtypepair {size} {numbers}")
        return "\n".join(lines) + "\n"


def calibrate_matrix(
    particles: Mapping[str, tuple[Material, float]],
    walls: Mapping[str, Material | None] | None = None,
    *,
    v_0: PerPair,
    e_n: PerPair,
    law: str = "tsuji",
    method: str = "mean_overlap",
    end: str = "overlap",
    **method_options: Any,
) -> PairMatrix:
    """Calibrate every pair of ``particles`` (name -> material, radius [m]) and ``walls`` (name -> material or None).

    Parameters are those of `kncal.calibrate`; ``v_0`` and ``e_n`` may be mappings (name, name) -> value.

    Raises
    ------
    InputError
        As `calibrate`, with the names of the pair; if no particle type is given; if a name occurs twice.
    """
    walls = walls or {}
    if not particles:
        raise InputError("particles = {}: expected at least one particle type")
    if both := sorted(set(particles) & set(walls)):
        raise InputError(f"name {both[0]!r} is a particle type and a wall: expected distinct names")
    names = list(particles)
    contacts = {(a, b): pair(*particles[a], *particles[b]) for i, a in enumerate(names) for b in names[i:]} | {
        (a, w): wall_pair(*particles[a], walls[w]) for a in names for w in walls
    }
    calibrations = {}
    for key, contact in contacts.items():
        calibrations[key] = calibrate(
            contact,
            v_0=_value("v_0", v_0, key),
            e_n=_value("e_n", e_n, key),
            law=law,
            method=method,
            end=end,
            **method_options,
        )
    return PairMatrix(tuple(names), tuple(walls), calibrations)


def _value(argument: str, given: PerPair, key: tuple[str, str]) -> float:
    if not isinstance(given, Mapping):
        return given
    for names in (key, key[::-1]):
        if names in given:
            return given[names]
    raise InputError(f"{argument} has no value for the pair {key[0]}–{key[1]}: expected a key {key!r}")
