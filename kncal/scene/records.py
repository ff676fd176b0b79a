"""What a run of a scene will record, so that its metrics can be offered before it runs."""

from __future__ import annotations

from kncal.scene.metrics import FEW_PARTICLES
from kncal.scene.scene import Scene


def records_of(scene: Scene) -> tuple[str, ...]:
    """Return the names of `kncal.scene.metrics.RECORDS` that a run of ``scene`` will have."""
    if not scene.coupled:
        return FEW_PARTICLES
    groups = [group for group in scene.particles.values() if not group.frozen]
    box = scene.run.coupling is not None  # a bed that may be given a gas keeps its tolerances without one
    grains = scene.gas is None and not scene.frozen
    has = {
        "frames": True,
        "series:pressure": box,
        "series:forces": box,
        "series:particles": True,
        "series:overlaps": True,
        "fields:eps_g": box,
        "frames:grains": grains,
        "frames:kinds": grains and (len(groups) > 1 or any(group.sizes or group.file for group in groups)),
        "frames:surface": grains and scene.observe.surface is not None,
        "series:outlets": bool(scene.outlets),
        "series:grains": grains,
        "series:walls": grains and bool(scene.walls or scene.held),
    }
    return tuple(name for name, there in has.items() if there)
