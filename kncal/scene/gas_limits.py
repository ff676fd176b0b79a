"""What gas, gas step and coupling interval of a bed leave out: limits for `kncal.scene.limits`.

Where a bound rests on an estimate (speeds, voidage), the message says so. Bounds without a source here are those of
the coupled algorithm: void fraction from particle centres, constant gas force on a particle during the coupling
interval.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

from kncal.physics.fluidization import minimum_fluidization_velocity, relaxation_time, terminal_velocity
from kncal.scene.finding import Finding
from kncal.scene.gas import Gas
from kncal.scene.load import largest_superficial, settled_height
from kncal.scene.model import Plan
from kncal.scene.scene import Scene

#: Courant number U dt/h of the gas step.
COURANT_LARGEST, COURANT_LARGE = 2.0, 1.0
#: Coupling interval over particle relaxation time: the drag is too small by about this share.
BIAS_LARGEST, BIAS_LARGE = 0.2, 0.01
#: Way of a particle in one coupling interval over its diameter.
WAY_LARGEST, WAY_LARGE = 1.0, 0.5
#: Gas velocity from which its density is no longer constant [m/s], as it is in the solver: Mach 0.3 of air.
FAST_GAS = 100.0
#: Gas density over particle density from which added mass, half of that ratio of the inertia, is no longer small.
HEAVY_GAS = 0.05


def _fastest_gas(scene: Scene, gas: Gas, eps: float) -> tuple[float, str]:
    """Estimate of the fastest interstitial gas [m/s], and where it is."""
    if gas.jet is not None:
        return gas.jet.velocity, "the jet"
    share = eps if scene.number > 1 else 1.0
    return largest_superficial(scene) / share, f"the bed (U_0/{share:.2g})" if share < 1.0 else "the column"


def courant(model: Plan, gas: Gas, eps: float) -> Iterator[Finding]:
    """Find gas steps too long for the gas cells."""
    scene = model.scene
    speed, place = _fastest_gas(scene, gas, eps)
    h = scene.box.height / gas.cells[2]
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


def relaxation(model: Plan, gas: Gas, eps: float) -> Iterator[Finding]:
    """Find coupling intervals too long for the drag on particles that move."""
    scene = model.scene
    rho = scene.density
    if scene.frozen:
        return
    fall = float(terminal_velocity(scene.diameter, rho, gas.density, gas.viscosity, scene.g))
    if scene.number == 1:
        slip, voidage = fall, 1.0
    else:
        slip, voidage = largest_superficial(scene) / eps, eps
    tau = float(relaxation_time(rho, scene.diameter, gas.density, gas.viscosity, slip=slip, eps_g=voidage))
    bias = model.coupling / tau
    if bias > BIAS_LARGE:
        yield Finding(
            "relaxation",
            "refuse" if bias > BIAS_LARGEST else "warn",
            f"the coupling interval is {bias:.2g} of the particle relaxation time ({tau:.2g} s at a slip of "
            f"{slip:.3g} m/s and eps_g = {voidage:.2g}): the drag comes out about {100.0 * bias / (1.0 + bias):.2g} % "
            f"too small; run.coupling = {BIAS_LARGE * tau:.2g} s would bring that to 1 %",
        )


def _particle_speed(scene: Scene, gas: Gas) -> tuple[float, str]:
    """Estimate of the fastest particles [m/s], and from what."""
    excess = float(terminal_velocity(scene.diameter, scene.density, gas.density, gas.viscosity, scene.g))
    if scene.number == 1:
        return max(abs(largest_superficial(scene) - excess), 0.0), "its velocity relative to the column in the end"
    # Bubbles and slugs throw particles up, and drop them, by about the height of the bed.
    fall = math.sqrt(2.0 * scene.g * settled_height(scene))
    return max(fall, scene.contact.v_0 or 0.0), "a fall from the top of the bed, or contact.v_0"


def way(model: Plan, gas: Gas) -> Iterator[Finding]:
    """Find coupling intervals in which particles move too far."""
    if model.scene.frozen:
        return
    speed, why = _particle_speed(model.scene, gas)
    d = model.scene.diameter
    way = speed * model.coupling / d
    if way > WAY_LARGE:
        yield Finding(
            "particle-way",
            "refuse" if way > WAY_LARGEST else "warn",
            f"particles move about {way:.2g} diameters per coupling interval ({speed:.3g} m/s, {why}): expected below "
            f"{WAY_LARGE:g}, or the gas solver bounces them off the walls itself; run.coupling = "
            f"{WAY_LARGE * d / speed:.2g} s would do",
        )


def added_mass(scene: Scene, gas: Gas) -> Iterator[Finding]:
    """Find a gas so heavy that the inertia of what a particle displaces is missed.

    A sphere that accelerates takes half of the displaced mass with it (Clift, Grace & Weber, Bubbles, Drops, and
    Particles (1978), chapter 11).
    """
    ratio = gas.density / scene.density
    if scene.number and not scene.frozen and ratio > HEAVY_GAS:
        yield Finding(
            "added-mass",
            "warn",
            f"gas.density is {ratio:.2g} of the particles': added mass is left out (it would add {50.0 * ratio:.2g} % "
            f"to a particle's inertia), and so are history and lift forces: expected at most {HEAVY_GAS:g}; steady "
            "velocities are right, accelerations are not",
        )


def fast_gas(scene: Scene, gas: Gas, eps: float) -> Iterator[Finding]:
    """Find a gas so fast that it is compressed."""
    speed, _ = _fastest_gas(scene, gas, eps)
    if speed > FAST_GAS:
        yield Finding(
            "gas-fast",
            "warn",
            f"the gas reaches about {speed:.3g} m/s: it is computed as incompressible, which holds below a third of "
            f"its speed of sound, for air {FAST_GAS:g} m/s: expected less",
        )


def held_drag(model: Plan, gas: Gas, eps: float) -> Iterator[Finding]:
    """Find gas steps too long for the drag on particles that are held.

    The gas solver moves its parcel by implicit drag from rest: the mean drag of a step dt is that of the start divided
    by 1 + dt/tau, tau the relaxation time of the particle.

    Parameters
    ----------
    eps : void fraction [-]
    """
    scene, speed = model.scene, largest_superficial(model.scene)
    if not scene.number or not scene.frozen or speed == 0.0:
        return
    voidage = eps if scene.number > 1 else 1.0
    slip = speed / voidage
    tau = float(relaxation_time(scene.density, scene.diameter, gas.density, gas.viscosity, slip=slip, eps_g=voidage))
    bias = model.gas_step / tau
    if bias > BIAS_LARGE:
        yield Finding(
            "held-drag",
            "warn",
            f"the particles are held, and the gas step is {bias:.2g} of their relaxation time ({tau:.2g} s at a slip "
            f"of {slip:.3g} m/s and eps_g = {voidage:.2g}): drag and pressure drop come out divided by about "
            f"{1.0 + bias:.3g}, {100.0 * bias / (1.0 + bias):.2g} % too small; run.gas_step = {BIAS_LARGE * tau:.2g} s "
            f"would bring that to {100.0 * BIAS_LARGE:g} %",
        )


def lift(scene: Scene, gas: Gas, eps: float) -> Iterator[Finding]:
    """Find a gas too slow to fluidise the bed, or so fast that it carries it out."""
    if scene.number == 1 or (speed := largest_superficial(scene)) == 0.0:
        return
    U_mf = float(minimum_fluidization_velocity(scene.diameter, scene.density, gas.density, gas.viscosity, eps, scene.g))
    if speed < U_mf:
        yield Finding(
            "below-u-mf",
            "warn",
            f"the gas ({speed:.3g} m/s superficial, at most) does not fluidise the bed: U_mf is about {U_mf:.3g} m/s "
            f"(Ergun at eps_g = {eps:.3g}): expected more for a bubbling bed, or"
            " particles.frozen = true for a packed one",
        )
    v_t = float(terminal_velocity(scene.diameter, scene.density, gas.density, gas.viscosity, scene.g))
    if speed >= v_t:
        yield Finding(
            "carried-out",
            "warn",
            f"the gas ({speed:.3g} m/s superficial) is faster than a particle falls ({v_t:.3g} m/s): the bed is "
            "carried to the lid, which is a wall for particles: expected less for a bed",
        )
