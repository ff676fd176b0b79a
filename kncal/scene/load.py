"""What the bottom of a bed at rest carries."""

from __future__ import annotations

from kncal.physics.material import sphere_mass
from kncal.scene.bed_model import BedModel
from kncal.scene.bed_scene import BedScene


def layers(scene: BedScene) -> float:
    """Return the number of particles above the cross-section d² of one, N d²/(floor area), at least 1 (itself)."""
    particles, column = scene.particles, scene.column
    return max(particles.count * particles.diameter**2 / (column.width * column.depth), 1.0)


def bottom_load(scene: BedScene) -> float:
    """Return the weight [N] that a particle at the bottom of the bed at rest carries, its own included.

    That of all above its cross-section d²: side walls carry none, the gas neither.
    """
    particles = scene.particles
    return float(sphere_mass(particles.material, particles.diameter / 2.0)) * scene.gravity * layers(scene)


def bottom_overlaps(model: BedModel) -> dict[tuple[str, str], float]:
    """Return the overlap [m] at which each contact of a bed carries `bottom_load`, by its names: (F/k)^(1/n)."""
    load = bottom_load(model.scene)
    return {names: contact.overlap_under(load) for names, contact in model.contacts.items()}
