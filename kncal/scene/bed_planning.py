"""From a bed to models that can run: contacts in numbers, DEM step, coupling interval (scenes: `kncal.scene.plan`)."""

from __future__ import annotations

import math
from collections.abc import Iterable

from kncal.core.errors import CaseFileError
from kncal.physics.material import Pair, pair, wall_pair
from kncal.scene.bed_model import BedModel
from kncal.scene.bed_needs import decide
from kncal.scene.bed_scene import BedScene
from kncal.scene.load import bottom_load
from kncal.scene.model import KINDS, PairContact
from kncal.scene.needs import Needs
from kncal.scene.pair_contact import Rest, numbers_of, pair_contact, smooth
from kncal.scene.plan import MOST_STEPS

#: Records that take more than this are refused before the run [bytes]: a report reads all of them.
MOST_SERIES_BYTES = 8 * 1024**3
#: What is recorded of a coupling [bytes], two histograms of impact speeds and one of overlaps the most of it.
COUPLING_BYTES = 2700
#: The two kinds of bodies in a bed; also the names in `BedModel.contacts` and in the exceptions of a case.
PARTICLES, WALLS = "particles", "walls"


def bed_pairs(scene: BedScene) -> dict[tuple[str, str], Pair]:
    """Return the `Pair` of two particles, and of a particle and a wall, by their names."""
    particles = scene.particles
    radius = particles.diameter / 2.0
    return {
        (PARTICLES, PARTICLES): pair(particles.material, radius),
        (PARTICLES, WALLS): wall_pair(particles.material, radius, scene.column.wall_material),
    }


def plan_bed(scene: BedScene, kinds: Iterable[str] = KINDS) -> dict[str, BedModel]:
    """Return the models of a bed by kind.

    The DEM step is the shortest contact duration over ``steps_per_contact`` (of each model by itself), but no longer
    than the coupling interval; the coupling interval is the largest whole number of DEM steps in ``run.coupling``, and
    is cut into as few gas steps as ``run.gas_step`` allows.
    A bed that LIGGGHTS has nothing to do for (gas only, or frozen particles whose positions are known) has no
    contacts, and one DEM step per coupling.

    Raises
    ------
    CaseFileError
        If a contact lacks its impact speed and stiffness, or the run would need more than `MOST_STEPS` steps.
    """
    needs = decide(scene)
    return {kind: _model(scene, kind, needs) for kind in kinds}


def _model(scene: BedScene, kind: str, needs: Needs) -> BedModel:
    contacts = _contacts(scene, kind, needs) if needs.uses("liggghts") else {}
    wish = scene.run.coupling
    shortest = min((c.t_c for c in contacts.values()), default=math.inf)
    dt = min(shortest / scene.run.steps_per_contact, wish)
    # 1e-9: a wish that is a whole number of steps but for rounding is that number
    per_coupling = max(math.floor(wish / dt * (1.0 + 1e-9)), 1)
    coupling = per_coupling * dt
    number = scene.run.end_time / coupling * (1.0 - 1e-9)  # may be infinite
    if number * per_coupling > MOST_STEPS:
        raise CaseFileError(
            f"{scene.name}: the {kind} model needs {number * per_coupling:.3g} steps of {dt:.3g} s: expected at most "
            f"{MOST_STEPS:.3g}; shorten run.end_time, or take a softer material (beds are customarily run with a "
            "Young's modulus far below the real one) or a smaller run.steps_per_contact"
        )
    couplings = math.ceil(number)
    gas_steps = 1.0 if (step := scene.run.gas_step) is None else coupling / step * (1.0 - 1e-9)
    if number * gas_steps > MOST_STEPS:
        raise CaseFileError(
            f"{scene.name}: the gas needs {number * gas_steps:.3g} steps of {scene.run.gas_step:.3g} s: expected at "
            f"most {MOST_STEPS:.3g}; take a longer run.gas_step, or shorten run.end_time"
        )
    frames_every = max(round(min(scene.run.frames_every / coupling, couplings + 1.0)), 1)
    _check_series(scene, couplings, couplings // frames_every)
    return BedModel(
        scene=scene,
        kind=kind,
        contacts=contacts,
        dt=dt,
        steps_per_coupling=per_coupling,
        coupling=coupling,
        couplings=couplings,
        frames_every=frames_every,
        gas_steps=max(math.ceil(gas_steps), 1),
    )


def _check_series(scene: BedScene, couplings: int, frames: int) -> None:
    """Refuse records that would fill disk and memory: single precision, six numbers a particle, five a gas cell."""
    size = 24 * scene.particles.count + (20 * math.prod(scene.column.cells) if scene.gas is not None else 0)
    if frames * size + couplings * COUPLING_BYTES > MOST_SERIES_BYTES:
        raise CaseFileError(
            f"{scene.name}: {frames} frames of {size / 1e6:.3g} MB and {couplings} couplings of "
            f"{COUPLING_BYTES / 1e3:.3g} kB are to be recorded: expected at most {MOST_SERIES_BYTES / 1e9:.3g} GB in "
            "all; take a longer run.frames_every, a longer run.coupling or a shorter run.end_time"
        )


def _contacts(scene: BedScene, kind: str, needs: Needs) -> dict[tuple[str, str], PairContact]:
    column, particles = scene.column, scene.particles
    materials = {
        PARTICLES: (PARTICLES, particles.material.name),
        WALLS: (WALLS, "rigid" if column.wall_material is None else column.wall_material.name),
    }
    # Prescribed k_n and no impact speed: the Hertz contact is judged at the bottom of the settled bed.
    load = bottom_load(scene)
    contacts = {}
    for (a, b), both in bed_pairs(scene).items():
        numbers = numbers_of(scene.contact, scene.contact.exception(materials[a], materials[b]))
        if numbers.v_0 is None and numbers.k_n is None:
            raise CaseFileError(
                f"{scene.name}: contact of {a} and {b}: a bed has no first impact to calibrate at: expected "
                "contact.v_0 [m/s], typical of this bed, or contact.k_n [N/m]"
            )
        contact = pair_contact(
            scene.contact,
            both,
            numbers,
            kind,
            Rest(0.0, load),
            scene=scene.name,
            names=f"{a} and {b}",
        )
        contacts[a, b] = smooth(contact, tangential=needs.uses("tangential"), rolling=needs.uses("rolling"))
    return contacts
