"""What the solvers and the physics of a bed can't do: found before a run, refused or said; nothing is changed.

Where a bound rests on an estimate (speeds, voidage), the message says so. Bounds without a source here are those of
the coupled algorithm: void fraction from particle centres, constant gas force on a particle during the coupling
interval.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import Array
from kncal.physics.fluidization import (
    expanded_voidage,
    minimum_fluidization_velocity,
    relaxation_time,
    terminal_velocity,
)
from kncal.physics.timestep import verlet_limit
from kncal.scene.bed_model import BedModel
from kncal.scene.bed_scene import BedScene, Gas
from kncal.scene.finding import Finding
from kncal.scene.gas_limits import added_mass, coarse_cells, fast_gas, held_drag
from kncal.scene.load import bottom_overlaps, layers
from kncal.scene.step_error import step_error

#: Void fraction of a settled packing of equal spheres, where no positions are given to measure it.
EPS_SETTLED = 0.40
#: Smallest gas cell edge over particle diameter: void fractions mean nothing below the first, are coarse below the
#: second.
CELL_SMALLEST, CELL_COARSE = 1.0, 2.5
#: Courant number U dt/h of the gas step.
COURANT_LARGEST, COURANT_LARGE = 2.0, 1.0
#: Coupling interval over particle relaxation time: the drag is too small by about this share.
BIAS_LARGEST, BIAS_LARGE = 0.2, 0.01
#: Way of a particle in one coupling interval over its diameter.
WAY_LARGEST, WAY_LARGE = 1.0, 0.5
#: Overlap at the bottom of the settled bed over the diameter: the bed is lower by about half of that share, more than a
#: softer contact is meant to cost, from the second on; at a radius (the first) it does not carry the bed.
STATIC_LARGEST, STATIC_LARGE = 0.5, 0.05
#: Contacts per particle for the stability limit of the DEM step.
CONTACTS_DENSE = 12.0
#: Walls that a particle touches at once, in a corner.
CORNER = 3

#: Limits of the single contacts, which differ from model to model.
_OF_CONTACTS = ("dem-step", "static-overlap")


def findings_of(models: Iterable[BedModel]) -> Iterator[Finding]:
    """Yield the limits that the models of one bed run into; what both have of gas and coupling only once.

    Coupling intervals of the models are whole numbers of their own steps, so numbers in the texts differ a little.
    """
    said: set[tuple[str, str]] = set()
    for model in models:
        found = [f for f in check_bed(model) if f.code in _OF_CONTACTS or (f.code, f.level) not in said]
        said |= {(finding.code, finding.level) for finding in found}
        yield from found


def check_bed(model: BedModel, positions: ArrayLike | None = None) -> tuple[Finding, ...]:
    """Return every limit that a bed runs into, refusals first.

    Parameters
    ----------
    model : BedModel
    positions : (n, 3) centres of the settled packing [m]; its voidage is then measured instead of assumed
    """
    x = None if positions is None else np.asarray(positions, dtype=np.float64)
    scene = model.scene
    found = [*_positions(scene, x)] if x is not None else []
    if any(finding.code == "positions" for finding in found):
        x = None  # nothing to measure
    found += [*_depth(scene), *_contact_steps(model), *_static(model)]
    if scene.gas is not None:
        eps = EPS_SETTLED if x is None else settled_voidage(scene, x)
        found += [*_jet(scene), *_cells(scene), *_courant(model, scene.gas, eps)]
        found += coarse_cells(scene, settled_height(scene, eps), CELL_COARSE)
        found += [*added_mass(scene, scene.gas), *fast_gas(_fastest_gas(scene, scene.gas, eps)[0])]
        found += held_drag(model, scene.gas, largest_superficial(scene), eps, BIAS_LARGE)
        if scene.particles.count and scene.gravity > 0.0:
            found += [*_relaxation(model, scene.gas, eps), *_way(model, scene.gas)]
            if not scene.particles.frozen:
                found += [*_lift(scene, scene.gas, eps), *_room(scene, scene.gas, eps)]
    return tuple(sorted(found, key=lambda finding: finding.level != "refuse"))


def largest_superficial(scene: BedScene) -> float:
    """Return the largest superficial gas velocity of the run, mean over the floor [m/s]; 0 without gas."""
    gas = scene.gas
    if gas is None:
        return 0.0
    if gas.jet is not None:
        return gas.jet.velocity * (gas.jet.x_high - gas.jet.x_low) / scene.column.width
    return max((velocity for _, velocity in gas.ramp), default=gas.U_0)


def settled_height(scene: BedScene, eps_g: float = EPS_SETTLED) -> float:
    """Return the height of the bed at rest [m] at the void fraction ``eps_g``: solid volume/((1 - eps_g) area)."""
    particles, column = scene.particles, scene.column
    solid = particles.count * math.pi / 6.0 * particles.diameter**3
    return solid / ((1.0 - eps_g) * column.width * column.depth)


def settled_voidage(scene: BedScene, positions: Array) -> float:
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
    column, d = scene.column, scene.particles.diameter
    solids = inside * math.pi / 6.0 * d**3 / ((high - low) * column.width * column.depth)
    return float(np.clip(1.0 - solids, 0.2, 0.95))


def _positions(scene: BedScene, x: Array) -> Iterator[Finding]:
    if x.ndim != 2 or x.shape != (scene.particles.count, 3) or not np.isfinite(x).all():
        yield Finding(
            "positions",
            "refuse",
            f"positions of shape {x.shape}: expected ({scene.particles.count}, 3), finite",
        )
        return
    column = scene.column
    outside = ((x < 0.0) | (x > (column.width, column.depth, column.height))).any(axis=1)
    if outside.any():
        k = int(np.flatnonzero(outside)[0])
        yield Finding(
            "outside",
            "refuse",
            f"{np.count_nonzero(outside)} particle(s) outside the column, the first at {x[k].tolist()} m: expected "
            "centres inside",
        )


def _depth(scene: BedScene) -> Iterator[Finding]:
    column, d = scene.column, scene.particles.diameter
    if scene.column.front_back == "periodic" and scene.particles.count and column.depth < 3.0 * d:
        yield Finding(
            "depth-periodic",
            "refuse",
            f"periodic depth of {column.depth / d:.3g} diameters: a particle would meet its own images: expected at "
            "least 3; deepen the column or use a layer",
        )
    if column.front_back == "walls" and scene.particles.count > 1 and column.depth < 1.5 * d:
        yield Finding(
            "depth-one-layer",
            "warn",
            f"walls {column.depth / d:.3g} diameters apart hold a single layer that rubs on both of them: expected "
            'front_back = "layer" for a two-dimensional bed, or a deeper column',
        )


def _jet(scene: BedScene) -> Iterator[Finding]:
    if scene.gas is None or (jet := scene.gas.jet) is None:
        return
    h = scene.column.width / scene.column.cells[0]
    for name, x in (("x_low", jet.x_low), ("x_high", jet.x_high)):
        if abs(x / h - round(x / h)) > 1e-6:
            near = round(x / h) * h
            yield Finding(
                "jet-faces",
                "refuse",
                f"gas.jet.{name} = {x:g}: lies inside a gas cell: expected a cell face (multiples of {h:g} m; the "
                f"nearest is {near:g}), or another number of cells in x",
            )


def _cells(scene: BedScene) -> Iterator[Finding]:
    column, d = scene.column, scene.particles.diameter
    if not scene.particles.count:
        return
    sizes = dict(zip("xyz", (column.width, column.depth, column.height), strict=True))
    edges = {a: size / n for (a, size), n in zip(sizes.items(), column.cells, strict=True)}
    if column.front_back == "layer":
        del edges["y"]  # the layer's only cell in depth is as deep as the case says
    axis = min(edges, key=edges.__getitem__)
    ratio = edges[axis] / d
    if ratio < CELL_SMALLEST * (1.0 - 1e-9):
        yield Finding(
            "cell-size",
            "refuse",
            f"gas cells are {ratio:.3g} particle diameters in {axis}, smaller than a particle: the void fraction has "
            f"no meaning there: expected at least {CELL_SMALLEST:g} (better {CELL_COARSE:g}); use fewer column.cells",
        )
    elif ratio < CELL_COARSE * (1.0 - 1e-9) and scene.gas is not None and scene.gas.parcels_per_particle == 1:
        yield Finding(
            "cell-size",
            "warn",
            f"gas cells are {ratio:.3g} particle diameters in {axis}: a particle's whole volume goes to the cell of "
            f"its centre, which is coarse below {CELL_COARSE:g}; use fewer column.cells or parcels_per_particle = 8",
        )


def _fastest_gas(scene: BedScene, gas: Gas, eps: float) -> tuple[float, str]:
    """Estimate of the fastest interstitial gas [m/s], and where it is."""
    if gas.jet is not None:
        return gas.jet.velocity, "the jet"
    share = eps if scene.particles.count > 1 else 1.0
    return largest_superficial(scene) / share, f"the bed (U_0/{share:.2g})" if share < 1.0 else "the column"


def _courant(model: BedModel, gas: Gas, eps: float) -> Iterator[Finding]:
    scene = model.scene
    speed, place = _fastest_gas(scene, gas, eps)
    h = scene.column.height / scene.column.cells[2]
    courant = speed * model.gas_step / h
    if courant > COURANT_LARGE:
        level: Literal["refuse", "warn"] = "refuse" if courant > COURANT_LARGEST else "warn"
        yield Finding(
            "courant",
            level,
            f"Courant number of the gas step about {courant:.3g}, from {speed:.3g} m/s in {place}: expected below "
            f"{COURANT_LARGE:g} (refused above {COURANT_LARGEST:g}); run.gas_step = {COURANT_LARGE * h / speed:.2g} s "
            "would do",
        )


def _relaxation(model: BedModel, gas: Gas, eps: float) -> Iterator[Finding]:
    scene = model.scene
    p = scene.particles
    rho = float(p.material.density)
    if p.frozen:
        return
    fall = float(terminal_velocity(p.diameter, rho, gas.density, gas.viscosity, scene.gravity))
    if p.count == 1:
        slip, voidage = fall, 1.0
    else:
        slip, voidage = largest_superficial(scene) / eps, eps
    tau = float(relaxation_time(rho, p.diameter, gas.density, gas.viscosity, slip=slip, eps_g=voidage))
    bias = model.coupling / tau
    if bias > BIAS_LARGE:
        yield Finding(
            "relaxation",
            "refuse" if bias > BIAS_LARGEST else "warn",
            f"the coupling interval is {bias:.2g} of the particle relaxation time ({tau:.2g} s at a slip of "
            f"{slip:.3g} m/s and eps_g = {voidage:.2g}): the drag comes out about {100.0 * bias / (1.0 + bias):.2g} % "
            f"too small; run.coupling = {BIAS_LARGE * tau:.2g} s would bring that to 1 %",
        )


def _particle_speed(scene: BedScene, gas: Gas) -> tuple[float, str]:
    """Estimate of the fastest particles [m/s], and from what."""
    p = scene.particles
    excess = float(terminal_velocity(p.diameter, float(p.material.density), gas.density, gas.viscosity, scene.gravity))
    if p.count == 1:
        return max(abs(largest_superficial(scene) - excess), 0.0), "its velocity relative to the column in the end"
    # Bubbles and slugs throw particles up, and drop them, by about the height of the bed.
    fall = math.sqrt(2.0 * scene.gravity * settled_height(scene))
    return max(fall, scene.contact.v_0 or 0.0), "a fall from the top of the bed, or contact.v_0"


def _way(model: BedModel, gas: Gas) -> Iterator[Finding]:
    if model.scene.particles.frozen:
        return
    speed, why = _particle_speed(model.scene, gas)
    d = model.scene.particles.diameter
    way = speed * model.coupling / d
    if way > WAY_LARGE:
        yield Finding(
            "particle-way",
            "refuse" if way > WAY_LARGEST else "warn",
            f"particles move about {way:.2g} diameters per coupling interval ({speed:.3g} m/s, {why}): expected below "
            f"{WAY_LARGE:g}, or the gas solver bounces them off the walls itself; run.coupling = "
            f"{WAY_LARGE * d / speed:.2g} s would do",
        )


def _contact_steps(model: BedModel) -> Iterator[Finding]:
    others = model.scene.particles.count - 1
    most = min(CONTACTS_DENSE, others + CORNER)
    shortest = min((c.t_c for c in model.contacts.values()), default=math.inf)
    for (a, b), contact in model.contacts.items():
        if a == b and not others:
            continue  # a lone particle meets none of its kind
        steps = contact.t_c / model.dt
        # tangent stiffness and damping at the largest overlap; those of the linear contact are constant
        delta = contact.delta_max or (1.0 if contact.n == 1.0 else 0.0)
        if delta > 0.0:
            stiffness = contact.n * contact.k * delta ** (contact.n - 1.0)
            limit = float(verlet_limit(stiffness, contact.m_eff, contact.c * delta**contact.p, most))
            if model.dt > limit:
                yield Finding(
                    "dem-step",
                    "refuse",
                    f"{a}–{b}: the DEM step of {model.dt:.3g} s is above the stability limit of a particle with "
                    f"{most:g} contacts, {limit:.3g} s ({steps:.3g} steps per contact): expected a larger "
                    "run.steps_per_contact",
                )
                continue
        if (coarse := step_error(contact, model.dt, shortest)) is not None:
            yield Finding("dem-step", "warn", f"{a}–{b}: {coarse}")


def _static(model: BedModel) -> Iterator[Finding]:
    p = model.scene.particles
    if p.frozen or p.count == 0:
        return
    for (a, b), overlap in bottom_overlaps(model).items():
        share = overlap / p.diameter
        if share > STATIC_LARGE:
            refused = share >= STATIC_LARGEST
            yield Finding(
                "static-overlap",
                "refuse" if refused else "warn",
                f"{a}–{b}: the weight of {layers(model.scene):.3g} layers needs an overlap of {share:.2g} diameters at "
                f"the bottom of the bed{': the contact cannot carry it' if refused else ''}: expected at most "
                f"{STATIC_LARGE:g}; take a stiffer contact",
            )


def _lift(scene: BedScene, gas: Gas, eps: float) -> Iterator[Finding]:
    p = scene.particles
    if p.count == 1 or (speed := largest_superficial(scene)) == 0.0:
        return
    U_mf = float(
        minimum_fluidization_velocity(p.diameter, p.material.density, gas.density, gas.viscosity, eps, scene.gravity)
    )
    if speed < U_mf:
        yield Finding(
            "below-u-mf",
            "warn",
            f"the gas ({speed:.3g} m/s superficial, at most) does not fluidise the bed: U_mf is about {U_mf:.3g} m/s "
            f"(Ergun at eps_g = {eps:.3g}): expected more for a bubbling bed, or"
            " particles.frozen = true for a packed one",
        )
    v_t = float(terminal_velocity(p.diameter, p.material.density, gas.density, gas.viscosity, scene.gravity))
    if speed >= v_t:
        yield Finding(
            "carried-out",
            "warn",
            f"the gas ({speed:.3g} m/s superficial) is faster than a particle falls ({v_t:.3g} m/s): the bed is "
            "carried to the lid, which is a wall for particles: expected less for a bed",
        )


def _room(scene: BedScene, gas: Gas, eps: float) -> Iterator[Finding]:
    p, height = scene.particles, scene.column.height
    if p.count == 1:
        return
    rest = settled_height(scene, eps)
    if rest > height:
        yield Finding(
            "column-low",
            "refuse",
            f"the settled bed is about {rest:.3g} m high (eps_g = {eps:.2g}), the column {height:.3g} m: expected room "
            "for the bed and its expansion",
        )
        return
    speed = largest_superficial(scene)
    if speed == 0.0:
        return
    hovering = expanded_voidage(speed, p.diameter, float(p.material.density), gas.density, gas.viscosity, scene.gravity)
    expanded = rest * (1.0 - eps) / (1.0 - hovering) if hovering < 1.0 else math.inf
    expanded = max(expanded, rest)
    # Bubbling beds throw particles to about twice their mean height; the lid must be above that.
    if 2.0 * expanded > height:
        yield Finding(
            "column-low",
            "warn",
            f"the bed expands to about {expanded:.3g} m on average (homogeneous, {rest:.3g} m at rest) and throws "
            f"particles to about twice that, the column is {height:.3g} m: particles may hit the lid; expected more "
            "column.height",
        )
