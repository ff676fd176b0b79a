"""A bed at rest: its height and voidage, what its bottom carries, and the gas that enters it."""

from __future__ import annotations

import math

import numpy as np

from kncal.core.checks import Array
from kncal.physics.fluidization import minimum_fluidization_velocity
from kncal.physics.material import sphere_mass
from kncal.scene.model import Plan
from kncal.scene.scene import Scene
from kncal.scene.species import SpeciesPair
from kncal.scene.walls import BoxWall

#: Void fraction of a settled packing of equal spheres, where no positions are given to measure it.
EPS_SETTLED = 0.40
#: And of a bed as loose as U_mf is stated at.
EPS_MF = 0.45


def layers(scene: Scene) -> float:
    """Return the number of particles above the cross-section d² of one, N d²/(floor area), at least 1 (itself)."""
    return max(scene.number * scene.diameter**2 / floor_area(scene), 1.0)


def floor_area(scene: Scene) -> float:
    """Return the area on which the particles of a coupled scene rest [m²].

    That of the box's floor; without a box the cross-section of the smallest region that particles are put into, in a
    periodic scene of the domain.
    """
    boxes = [wall for wall in scene.walls.values() if isinstance(wall, BoxWall)]
    if boxes:
        return boxes[0].width * boxes[0].depth
    across = int(np.argmax(np.abs(scene.up)))
    low, high = scene.extent
    whole = math.prod(high[k] - low[k] for k in range(3) if k != across)
    regions = [group.region for group in scene.particles.values() if group.region is not None]
    heights = [float((region.bounds[1] - region.bounds[0])[across]) for region in regions]
    return min([region.volume / height for region, height in zip(regions, heights, strict=True)], default=whole)


def bottom_load(scene: Scene) -> float:
    """Return the weight [N] that a particle at the bottom of the bed at rest carries, its own included.

    That of all above its cross-section d²: side walls carry none, the gas neither. Of several sizes the largest.
    """
    own = max(float(sphere_mass(sphere.material, sphere.radius)) for sphere in scene.spheres)
    if scene.d_min == scene.d_max:
        return own * scene.g * layers(scene)
    return max(own, scene.mass * scene.d_max**2 / floor_area(scene)) * scene.g


def bottom_overlaps(model: Plan) -> dict[SpeciesPair, float]:
    """Return the overlap [m] at which each contact of a bed carries `bottom_load`, by pair of species: (F/k)^(1/n)."""
    load = bottom_load(model.scene)
    return {pair: contact.overlap_under(load) for pair, contact in model.contacts.items()}


def largest_superficial(scene: Scene) -> float:
    """Return the largest superficial gas velocity of the run, mean over the floor [m/s]; 0 without gas."""
    gas = scene.gas
    if gas is None:
        return 0.0
    if gas.jet is not None:
        return gas.jet.velocity * (gas.jet.x_high - gas.jet.x_low) / scene.box.width
    return max((velocity for _, velocity in gas.ramp), default=gas.U_0)


def settled_height(scene: Scene, eps_g: float = EPS_SETTLED) -> float:
    """Return the height of the bed at rest [m] at the void fraction ``eps_g``: solid volume/((1 - eps_g) area)."""
    solid = scene.number * math.pi / 6.0 * scene.diameter**3
    return solid / ((1.0 - eps_g) * floor_area(scene))


def settled_voidage(scene: Scene, positions: Array) -> float:
    """Return the void fraction of a packing [-] between a tenth and three quarters of its height.

    The height is that below which 95 % of the centres are; counted are the centres in between. ``positions``:
    (n, 3) [m]. `EPS_SETTLED` for fewer than 50 particles, which have no voidage to speak of.
    """
    z = positions[:, 2]
    if len(z) < 50:
        return EPS_SETTLED
    top = float(np.quantile(z, 0.95))
    low, high = 0.1 * top, 0.75 * top
    inside = np.count_nonzero((z >= low) & (z < high))
    box, d = scene.box, scene.diameter
    solids = inside * math.pi / 6.0 * d**3 / ((high - low) * box.width * box.depth)
    return float(np.clip(1.0 - solids, 0.2, 0.95))


def fluidised(scene: Scene) -> bool:
    """Return whether steady gas moves the bed: faster than U_mf (Ergun) of the bed as loose as U_mf is stated at."""
    gas = scene.gas
    if gas is None or gas.ramp or scene.frozen or scene.g == 0.0:
        return False
    U_mf = minimum_fluidization_velocity(scene.diameter, scene.density, gas.density, gas.viscosity, EPS_MF, scene.g)
    return gas.jet is not None or float(U_mf) < gas.U_0
