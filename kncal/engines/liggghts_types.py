"""Atom types of a LIGGGHTS deck: which bodies share one, and what every pair of types is given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from kncal.material import Material
from kncal.scene import Particle, Scene

Pairs = Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class AtomTypes:
    """Atom types, in the order 1, 2, ... of the deck.

    Attributes
    ----------
    roles : "particles" or "walls" per type
    bodies : names of the bodies of each type
    materials : Material per type, None for a rigid wall
    index : body name -> type, counted from 0
    """

    roles: tuple[str, ...]
    bodies: tuple[tuple[str, ...], ...]
    materials: tuple[Material | None, ...]
    index: Mapping[str, int]


def group(scene: Scene, columns: Mapping[str, Pairs]) -> AtomTypes:
    """Return one type per distinct (material, radius) and per wall material.

    Where that would give one pair of types two different numbers in a column, every body gets a type of its
    own instead: always exact, only longer.
    """
    shared = _group(scene, shared=True)
    if all(_unambiguous(shared, column) for column in columns.values()):
        return shared
    return _group(scene, shared=False)


def matrix(types: AtomTypes, column: Pairs) -> list[list[float]]:
    """Return the symmetric table of ``column`` by pairs of types.

    Pairs that never touch (two walls, a particle and itself) repeat the column's largest value, since
    LIGGGHTS wants a number for every pair of types.
    """
    filler = max(column.values(), default=1.0)
    size = len(types.bodies)
    rows = [[filler] * size for _ in range(size)]
    for (a, b), value in column.items():
        i, j = types.index[a], types.index[b]
        rows[i][j] = rows[j][i] = value
    return rows


def _group(scene: Scene, *, shared: bool) -> AtomTypes:
    members: dict[object, list[str]] = {}
    kinds: dict[object, tuple[str, Material | None]] = {}
    for body in scene.bodies:
        role = "particles" if isinstance(body, Particle) else "walls"
        radius = body.radius if isinstance(body, Particle) else None
        own: object = (role, body.material, radius) if shared else body.name
        members.setdefault(own, []).append(body.name)
        kinds[own] = (role, body.material)
    return AtomTypes(
        roles=tuple(kinds[key][0] for key in members),
        bodies=tuple(tuple(names) for names in members.values()),
        materials=tuple(kinds[key][1] for key in members),
        index={name: number for number, names in enumerate(members.values()) for name in names},
    )


def _unambiguous(types: AtomTypes, column: Pairs) -> bool:
    seen: dict[tuple[int, int], float] = {}
    for (a, b), value in column.items():
        i, j = sorted((types.index[a], types.index[b]))
        # The same pair the other way round may differ in the last digit.
        if not math.isclose(seen.setdefault((i, j), value), value, rel_tol=1e-14):
            return False
    return True
