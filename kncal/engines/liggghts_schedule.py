"""When LIGGGHTS writes a frame: dense in contact, sparse in flight, in between as soon as a touch may come.

With no contact, two bodies cannot touch before they have closed their gap at their closing speed (and what gravity
adds to it towards a wall). The next frame comes before that, for every pair at once, so between two frames that are
further apart than in a contact there is free flight alone: no touch is missed, whatever earlier collisions did to the
speeds. The approach to a contact is a geometric series of a few frames.
"""

from __future__ import annotations

import math

from kncal.model import Model
from kncal.scene import AXES, Particle

#: About as many frames are written in flight: a frame costs as much as some 40 steps of a few particles.
FLIGHT_FRAMES = 50
#: The shortest time to a touch is taken for this much shorter.
MARGIN = 1.2


def schedule(model: Model) -> dict[str, object]:
    """Return the recording schedule as the deck's template needs it.

    With D = ``dense`` and S = ``sparse`` steps between frames in contact and in flight, the next frame comes after
    D + (S - D) f steps, f the product over all pairs of min(1, max(0, r)), r = gap/(``reach`` |v| + ``floor``) - D/S:
    ``reach`` is MARGIN S dt [s], v the closing velocity [m/s], ``floor`` what gravity adds [m]. A pair then closes at
    most D |v| dt + (gap - D |v| dt)/MARGIN of its gap.

    ``pairs`` holds for spheres i, j the sum of radii ``length`` [m]; for sphere i and a wall on ``axis`` the
    coordinate ``zero`` [m] of the touch and on which side the sphere is (``above``).
    """
    dense, sparse = model.record_every, max(model.flight_every, model.n_steps // FLIGHT_FRAMES)
    reach = MARGIN * sparse * model.dt
    ids = {particle.name: index for index, particle in enumerate(model.scene.particles, start=1)}
    pairs: list[dict[str, object]] = []
    for a, b in model.scene.body_pairs():
        # Never zero: nothing at rest divides by it, and a gap of a radius is far for it.
        floor = 1e-9 * a.radius
        if isinstance(b, Particle):
            length = a.radius + b.radius
            pairs.append({"wall": False, "i": ids[a.name], "j": ids[b.name], "length": length, "floor": floor})
            continue
        axis = AXES.index(b.axis)
        above = a.position[axis] > b.position
        zero = b.position + math.copysign(a.radius, 1.0 if above else -1.0)
        floor += reach**2 * abs(model.scene.gravity[axis])
        pairs.append({"wall": True, "i": ids[a.name], "axis": b.axis, "above": above, "zero": zero, "floor": floor})
    return {"dense": dense, "sparse": sparse, "reach": reach, "offset": dense / sparse, "pairs": pairs}
