"""What gas cells, gas properties and coupling interval leave out: findings for `kncal.scene.bed_limits`."""

from __future__ import annotations

import math
from collections.abc import Iterator

from kncal.physics.fluidization import relaxation_time
from kncal.scene.bed_model import BedModel
from kncal.scene.bed_scene import BedScene, Gas
from kncal.scene.finding import Finding

#: Gas cell edge over particle diameter from which a cell averages over what it is to resolve, and share of the bed at
#: rest, or of its wider side, that it may be.
CELL_LARGE, CELL_SHARE = 8.0, 0.25
#: Fewer particles than this are no bed that gas cells would have to resolve.
FEWEST = 50
#: Gas velocity from which its density is no longer constant [m/s], as it is in the solver: Mach 0.3 of air.
FAST_GAS = 100.0
#: Gas density over particle density from which added mass, half of that ratio of the inertia, is no longer small.
HEAVY_GAS = 0.05


def coarse_cells(scene: BedScene, height: float, fine: float) -> Iterator[Finding]:
    """Find gas cells too large for the bed.

    Parameters
    ----------
    height : of the bed at rest [m]
    fine : edge over diameter below which cells are too small: no finer ones are advised
    """
    column, p = scene.column, scene.particles
    if p.count < FEWEST:
        return
    d = p.diameter
    edges = {
        axis: size / n
        for axis, size, n in zip("xyz", (column.width, column.depth, column.height), column.cells, strict=True)
        if axis != "y" or column.front_back != "layer"  # a layer's only cell in depth is as deep as the case says
    }
    wide = "y" if "y" in edges and column.depth > column.width else "x"
    side = column.depth if wide == "y" else column.width
    fitting = math.floor(side / (fine * d) * (1.0 + 1e-9))
    if not p.frozen and column.cells["xyz".index(wide)] == 1 and fitting >= 2:
        yield Finding(
            "cell-single",
            "refuse",
            f"one gas cell over the whole {'depth' if wide == 'y' else 'width'} of {side / d:.3g} particle diameters: "
            "a bed that moves has gas that rises here and particles that sink there, which one cell cannot hold: "
            f"expected column.cells of at most {CELL_LARGE:g} diameters, {fitting} in {wide}",
        )
        return
    large = {axis: f"{edge / d:.3g} particle diameters" for axis, edge in edges.items() if edge > CELL_LARGE * d}
    if edges["z"] > CELL_SHARE * height:
        large.setdefault("z", f"{edges['z'] / height:.2g} of the height of the bed at rest ({height:.3g} m)")
    if not p.frozen and edges[wide] > CELL_SHARE * side * (1.0 + 1e-9):
        large.setdefault(wide, f"{edges[wide] / side:.2g} of the bed's {'depth' if wide == 'y' else 'width'}")
    for axis, size in large.items():
        yield Finding(
            "cell-coarse",
            "warn",
            f"gas cells are {size} in {axis}: they average over what drives the bed (bubbles, its surface): expected "
            f"at most {CELL_LARGE:g} diameters and {CELL_SHARE:g} of the bed; use more column.cells, or a larger bed",
        )


def added_mass(scene: BedScene, gas: Gas) -> Iterator[Finding]:
    """Find a gas so heavy that the inertia of what a particle displaces is missed.

    A sphere that accelerates takes half of the displaced mass with it (Clift, Grace & Weber, Bubbles, Drops, and
    Particles (1978), chapter 11).
    """
    p = scene.particles
    ratio = gas.density / float(p.material.density)
    if p.count and not p.frozen and ratio > HEAVY_GAS:
        yield Finding(
            "added-mass",
            "warn",
            f"gas.density is {ratio:.2g} of the particles': added mass is left out (it would add {50.0 * ratio:.2g} % "
            f"to a particle's inertia), and so are history and lift forces: expected at most {HEAVY_GAS:g}; steady "
            "velocities are right, accelerations are not",
        )


def fast_gas(speed: float) -> Iterator[Finding]:
    """Find a gas so fast that it is compressed; ``speed``: an estimate of its largest [m/s]."""
    if speed > FAST_GAS:
        yield Finding(
            "gas-fast",
            "warn",
            f"the gas reaches about {speed:.3g} m/s: it is computed as incompressible, which holds below a third of "
            f"its speed of sound, for air {FAST_GAS:g} m/s: expected less",
        )


def held_drag(model: BedModel, gas: Gas, speed: float, eps: float, small: float) -> Iterator[Finding]:
    """Find gas steps too long for the drag on particles that are held.

    The gas solver moves its parcel by implicit drag from rest: the mean drag of a step dt is that of the start divided
    by 1 + dt/tau, tau the relaxation time of the particle.

    Parameters
    ----------
    speed : largest superficial gas velocity [m/s]
    eps : void fraction [-]
    small : dt/tau that is passed over
    """
    p = model.scene.particles
    if not p.count or not p.frozen or speed == 0.0:
        return
    voidage = eps if p.count > 1 else 1.0
    slip = speed / voidage
    tau = float(
        relaxation_time(float(p.material.density), p.diameter, gas.density, gas.viscosity, slip=slip, eps_g=voidage)
    )
    bias = model.gas_step / tau
    if bias > small:
        yield Finding(
            "held-drag",
            "warn",
            f"the particles are held, and the gas step is {bias:.2g} of their relaxation time ({tau:.2g} s at a slip "
            f"of {slip:.3g} m/s and eps_g = {voidage:.2g}): drag and pressure drop come out divided by about "
            f"{1.0 + bias:.3g}, {100.0 * bias / (1.0 + bias):.2g} % too small; run.gas_step = {small * tau:.2g} s "
            f"would bring that to {100.0 * small:g} %",
        )
