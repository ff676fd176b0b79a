"""Two balls between walls that touch each other again and again, with friction: both engines forget an old contact."""

import numpy as np
import pytest

from kncal.engines.registry import get_engine
from kncal.observe.contacts import observe
from kncal.physics.material import Material
from kncal.scene.bodies import Particle, Wall
from kncal.scene.contact import ContactChoice
from kncal.scene.plan import plan
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

SOFT = Material(young=1e7, poisson=0.3, density=2500.0, name="soft")
SHAKEN = Scene.of(
    name="shaken",
    spheres=(
        Particle(name="lower", material=SOFT, radius=1e-3, position=(0.0, 0.0, 1.0005e-3)),
        Particle(
            name="upper",
            material=SOFT,
            radius=1e-3,
            position=(2e-4, 0.0, 3.3e-3),
            velocity=(0.0, 0.0, -0.3),
            spin=(0.0, 200.0, 0.0),
        ),
    ),
    planes=(
        Wall(name="floor", axis="z", position=0.0, material=SOFT),
        Wall(name="left", axis="x", position=-1.05e-3, material=SOFT),
        Wall(name="right", axis="x", position=1.25e-3, material=SOFT),
    ),
    gravity=(0.0, 0.0, -9.81),
    contact=ContactChoice(e_n=0.8, friction=0.4, v_0=0.3),
    run=RunControl(until_time=0.08),
)


@pytest.mark.solver
@pytest.mark.parametrize("kind", ["linear", "hertz"])
def test_a_pair_that_touches_again_starts_without_its_old_tangential_spring(kind, tmp_path):
    model = plan(SHAKEN, (kind,))[kind]
    frames = []
    for name in ("builtin", "liggghts"):
        engine, folder = get_engine(name), tmp_path / name
        folder.mkdir()
        engine.render(model, folder)
        assert engine.run(model, folder).status == "completed"
        frames.append(engine.read(model, folder))
    ours, theirs = frames
    assert sum(c.pair == ("lower", "upper") for c in observe(model, ours).contacts) >= 4
    both = np.intersect1d(ours.step, theirs.step)
    one, two = (f.spin[np.searchsorted(f.step, both)] for f in frames)
    # Rounding grows from contact to contact; an old spring at the second one alone makes 3 to 50 rad/s.
    assert np.abs(one - two).max() < 1e-5 * np.abs(ours.spin).max()
