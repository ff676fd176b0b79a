"""What walls carry, by height: the law of Janssen fitted to the forces on walls and floor of a silo.

A slice of a filling of weight w per height hands N + w dz - N/lambda dz down: N(z) is the force through the
cross-section, and the walls take N/lambda per height. With the hydraulic diameter D = 4 A/P, lambda = D/(4 K mu); the
stress far below the surface is w lambda/A. Source: Janssen, Z. Ver. Dtsch. Ing. 39 (1895) 1045.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError
from kncal.scene.walls import AnyWall, ConeWall, CylinderWall, DiscWall, PlaneWall, PlateWall

#: A flat wall whose normal has less than this share along gravity stands.
_STEEP = 0.5


@dataclass(frozen=True, kw_only=True)
class Silo:
    """Vertical force in a filling, downwards, and the length of Janssen.

    Attributes
    ----------
    edges : (bins + 1,) heights [m]
    through : (bins + 1,) force through the cross-section at the edges, from the weight above less the walls' [N]
    carried : (bins,) what the side walls carry [N]; top : height of the surface [m]
    length : lambda [m], inf if the walls carry nothing; limit : force far below the surface w lambda [N]
    spread : of the length that the upper and the lower half of the filling give alone, half their distance [m]
    fitted : (bins,) which bins were fitted
    """

    edges: Array
    through: Array
    carried: Array
    top: float
    length: float
    limit: float
    spread: float
    fitted: NDArray[np.bool_]


def upright(wall: AnyWall | None, up: Sequence[float]) -> bool | None:
    """Return whether a wall is one that stands, against a floor or a lid; None for one that may be both."""
    if isinstance(wall, CylinderWall | ConeWall):
        return True
    if isinstance(wall, PlaneWall):
        normal = np.eye(3)["xyz".index(wall.axis)]
    elif isinstance(wall, DiscWall):
        normal = np.asarray(wall.normal, dtype=np.float64)
    elif isinstance(wall, PlateWall):
        normal = np.cross(wall.edge_1, wall.edge_2)
    else:
        return None
    return bool(abs(normal @ np.asarray(up)) < _STEEP * np.linalg.norm(normal))


def silo(edges: Array, weight: Array, carried: Array) -> Silo:
    """Fit Janssen's length to what walls carry by height.

    Parameters
    ----------
    edges : (bins + 1,) heights [m]
    weight : (bins,) of the particles whose centres lie in each bin [N]
    carried : (bins,) vertical force of the particles on the side walls there, positive downwards [N]

    Raises
    ------
    InputError
        If fewer than three full bins are there.

    The length is the least-squares one of carried = N/lambda dz over bins that are full (at least half of the median
    weight of those that hold any) and not cut by the surface.
    """
    above = np.concatenate([np.cumsum((weight - carried)[::-1])[::-1], [0.0]])
    some = weight > 0.0
    full = weight >= 0.5 * np.median(weight[some]) if some.any() else some
    if full.sum() < 3:
        raise InputError(f"{full.sum()} bins of height are full: expected at least 3 for Janssen's law")
    middle = 0.5 * (above[:-1] + above[1:]) * np.diff(edges)
    lower, upper = np.array_split(np.flatnonzero(full), 2)
    length, *ends = (_length(carried[of], middle[of]) for of in (np.flatnonzero(full), lower, upper))
    whole = weight >= 0.9 * np.median(weight[full])
    per_height = float(weight[whole].sum() / np.diff(edges)[whole].sum())
    last = int(np.flatnonzero(whole)[-1])
    return Silo(
        edges=edges,
        through=above,
        carried=carried,
        top=float(edges[last + 1] + weight[last + 1 :].sum() / per_height),
        length=length,
        limit=per_height * length,
        spread=0.5 * abs(ends[0] - ends[1]) if np.isfinite(ends).all() else length,
        fitted=full,
    )


def _length(carried: Array, through: Array) -> float:
    share = float((carried * through).sum() / (through**2).sum())
    return 1.0 / share if share > 0.0 else float("inf")
