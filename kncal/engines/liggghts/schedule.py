"""When LIGGGHTS writes a frame: dense in contact, sparse in flight, in between as soon as a touch may come.

With no contact, two bodies cannot touch before they have closed their gap at their closing speed (and what gravity
adds to it towards a wall). The next frame comes before that, for every pair at once, so between two frames that are
further apart than in a contact there is free flight alone: no touch is missed, whatever earlier collisions did to the
speeds. The approach to a contact is a geometric series of a few frames.
"""

from __future__ import annotations

import math

from kncal.scene.bodies import AXES, Particle
from kncal.scene.model import Plan

#: At least as many frames would be written in a pure flight: a frame costs as much as some 40 steps of few particles.
FLIGHT_FRAMES = 30


def schedule(model: Plan) -> dict[str, object]:
    """Return the recording schedule as the deck's template needs it.

    With D = ``dense`` and S = ``sparse`` steps between frames in contact and in flight, the next frame comes after
    D + D floor((S - D)/D f) steps, f the product over all pairs of 0 in contact, else gap/(gap + ``reach`` |v| +
    ``floor``): ``reach`` is 2 S dt [s], v the closing velocity [m/s], ``floor`` what gravity adds [m]. So either it
    comes after D steps, or before half the gap and D more steps are closed, which is less than the gap.

    ``pairs`` holds for spheres i, j the sum of radii ``length`` [m]; for sphere i and a wall on ``axis`` the
    coordinate ``zero`` [m] of the touch and on which side the sphere is (``above``). ``tiny`` [m] keeps a gap of zero
    from being divided by.
    """
    dense, sparse = model.record_every, max(model.flight_every, model.n_steps // FLIGHT_FRAMES)
    reach = 2.0 * sparse * model.dt
    ids = {particle.name: index for index, particle in enumerate(model.scene.spheres, start=1)}
    pairs: list[dict[str, object]] = []
    for a, b in model.scene.body_pairs():
        entry: dict[str, object] = {"i": ids[a.name], "tiny": 1e-12 * a.radius}
        if isinstance(b, Particle):
            entry |= {"wall": False, "j": ids[b.name], "length": a.radius + b.radius, "floor": 0.0}
        else:
            axis = AXES.index(b.axis)
            above = a.position[axis] > b.position
            entry |= {
                "wall": True,
                "axis": b.axis,
                "above": above,
                "zero": b.position + math.copysign(a.radius, 1.0 if above else -1.0),
                # the speed gained within S steps, over `reach`
                "floor": 0.5 * reach**2 * abs(model.scene.gravity[axis]),
            }
        pairs.append(entry)
    return {"dense": dense, "sparse": sparse, "reach": reach, "pairs": pairs}
