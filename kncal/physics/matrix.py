"""Calibration of every pair of several particle types and wall materials, as solvers want it: per type pair.

One `gamman` (damping per effective mass) for all pairs gives the wrong restitution at walls and between unlike sizes:
tuned to e_n = 0.9 for an equal pair it gives 0.8615 at a wall. The matrix form gives each pair its own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array, one_of, plain_name, short, single
from kncal.core.errors import InputError, KncalError
from kncal.physics.calibration import COLUMNS, Calibration, calibrate
from kncal.physics.material import Material, pair, wall_pair

if TYPE_CHECKING:
    import pandas as pd

#: What `PairMatrix.matrix` serves.
QUANTITIES = (*COLUMNS, "gamma_n", "zeta", "v_0", "e_n")

#: Most particle types and walls together: there are half as many pairs as its square.
MOST_TYPES = 100
#: Pairs that an error lists.
_SHOWN = 20

#: A value for every pair, or one per pair of names (in any order; missing and unknown pairs are an error).
PerPair = float | Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class PairMatrix:
    """Calibrations of every pair that can touch (particle–particle and particle–wall).

    Attributes
    ----------
    particles, walls : names of the particle types and wall materials, in the order given
    calibrations : (name, name) -> Calibration, in type order (i <= j)
    materials : name -> Material, None for a rigid wall
    """

    particles: tuple[str, ...]
    walls: tuple[str, ...]
    calibrations: Mapping[tuple[str, str], Calibration]
    materials: Mapping[str, Material | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # They go into decks, where a line break would start a command.
        for name in self.names:
            plain_name("name", name)

    @property
    def names(self) -> tuple[str, ...]:
        """Particle types, then walls: the order of the matrices (type 1, 2, ... of a LIGGGHTS deck)."""
        return (*self.particles, *self.walls)

    def __getitem__(self, names: tuple[str, str]) -> Calibration:
        """Return the calibration of two names, in any order."""
        if (key := _known(names, self.calibrations)) is not None:
            return self.calibrations[key]
        raise InputError(f"no contact {short(names)}: expected two names of {_listed(self.calibrations)}")

    def matrix(self, quantity: str) -> Array:
        """Return a number of the calibrations ("k_n", "eta_n", "gamma_n", "t_c" ...) as a symmetric matrix.

        Returns
        -------
        (n, n) array in the order of `names`. Two walls never touch; their entries repeat the largest of the others,
        since a solver wants a number there.

        Raises
        ------
        InputError
            For another quantity.
        """
        one_of("quantity", quantity, QUANTITIES)
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

    Parameters are those of `kncal.calibrate`, single numbers only; ``v_0`` and ``e_n`` may be mappings
    (name, name) -> value. A name has at most 64 letters, digits, ``.``, ``_`` and ``-``.

    Raises
    ------
    InputError
        As `calibrate`, with the names of the pair; if no particle type is given; if a name occurs twice or could not
        be written into a deck; for more than `MOST_TYPES` types; if a mapping lacks a pair, names an unknown one, or
        names one twice.
    ValidityError
        As `calibrate`, with the names of the pair.
    """
    walls = {} if walls is None else walls
    for argument, given in (("particles", particles), ("walls", walls)):
        if not isinstance(given, Mapping):
            raise InputError(f"{argument} = {short(given)}: expected a mapping from names")
        for name in given:
            plain_name(f"name in {argument}", name)
    if not particles:
        raise InputError("particles = {}: expected at least one particle type")
    if (types := len(particles) + len(walls)) > MOST_TYPES:
        raise InputError(f"{types} particle types and walls: expected at most {MOST_TYPES}, each a type of a deck")
    if both := sorted(set(particles) & set(walls)):
        raise InputError(f"name {both[0]!r} is a particle type and a wall: expected distinct names")
    bodies = {name: _body(name, given) for name, given in particles.items()}
    names = list(bodies)
    keys = [(a, b) for i, a in enumerate(names) for b in names[i:]] + [(a, w) for a in names for w in walls]
    speeds, restitutions = _per_pair("v_0", v_0, keys), _per_pair("e_n", e_n, keys)
    calibrations = {}
    for a, b in keys:
        try:
            calibrations[a, b] = calibrate(
                pair(*bodies[a], *bodies[b]) if b in bodies else wall_pair(*bodies[a], walls[b]),
                v_0=speeds[a, b],
                e_n=restitutions[a, b],
                law=law,
                method=method,
                end=end,
                **method_options,
            )
            single("k_n (every argument is one number here)", calibrations[a, b].k_n)
        except KncalError as error:
            raise type(error)(f"{a}–{b}: {error}") from error
    materials = {name: material for name, (material, _) in bodies.items()} | dict(walls)
    return PairMatrix(tuple(names), tuple(walls), calibrations, materials)


def _body(name: str, given: object) -> tuple[Material, float]:
    if isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], Material):
        return given[0], single(f"radius of {name}", given[1])
    raise InputError(f"particles[{name!r}] = {short(given)}: expected (Material, radius [m])")


def _per_pair(argument: str, given: PerPair, keys: Collection[tuple[str, str]]) -> dict[tuple[str, str], float]:
    """The value of every pair; refuses keys of a mapping that are missing, unknown, or the same pair again."""
    if not isinstance(given, Mapping):
        return dict.fromkeys(keys, single(argument, given))
    values: dict[tuple[str, str], float] = {}
    for names, value in given.items():
        key = _known(names, keys)
        if key is None:
            raise InputError(f"{argument}: {short(names)} is no pair that can touch: expected one of {_listed(keys)}")
        number = single(f"{argument} of {key[0]}–{key[1]}", value)
        if values.setdefault(key, number) != number:
            raise InputError(f"{argument} has two values for the pair {key[0]}–{key[1]}: expected one")
    for key in keys:
        if key not in values:
            raise InputError(f"{argument} has no value for the pair {key[0]}–{key[1]}: expected a key {key!r}")
    return values


def _known(names: object, keys: Collection[tuple[str, str]]) -> tuple[str, str] | None:
    """The key of two names in any order, or None."""
    if not (isinstance(names, tuple) and all(isinstance(name, str) for name in names)):
        return None  # what compares otherwise than names do
    return next((key for key in keys if names in (key, key[::-1])), None)


def _listed(keys: Collection[tuple[str, str]]) -> str:
    some = ", ".join(f"{a}–{b}" for a, b in list(keys)[:_SHOWN])
    return some if len(keys) <= _SHOWN else f"{some} and {len(keys) - _SHOWN} more"
