"""Small scenes of many particles without gas, and decks of them run by hand."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kncal.core.checks import Array
from kncal.engines.liggghts.deck import DECK, bed_deck, deck_text, write_deck
from kncal.scene.case_file import load_case, parse_case
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.plan import plan

G = 9.81
HEAD = """
gravity = [0.0, 0.0, -9.81]
[materials.glass]
young = 5e6
poisson = 0.3
density = 2500
[contact]
v_0 = 0.5
e_n = 0.5
friction = 0.5
[domain]
low = [-0.03, -0.03, -0.02]
high = [0.03, 0.03, 0.12]
[run]
until_time = 0.3
sample_every = 0.005
frames_every = 0.02
steps_per_contact = 20
"""
BEADS = """
[particles.beads]
material = "glass"
diameter = 0.005
"""

#: A stream on a paddle that turns, an outlet that counts and one that deletes; two sizes.
RAIN = """
[particles.small]
material = "glass"
diameter = 0.004
count = 120
place = "stream"
rate = 0.04
velocity = [0, 0, -0.5]
[particles.small.region]
low = [-0.02, -0.02, 0.06]
high = [0.02, 0.02, 0.08]
[particles.large]
material = "glass"
diameter = 0.006
positions = [[0, 0, 0.03], [0.01, 0, 0.03], [0, 0.01, 0.04]]
[walls.paddle]
shape = "plate"
corner = [-0.012, -0.012, 0.02]
edge_1 = [0.024, 0.0, 0.0]
edge_2 = [0.0, 0.024, 0.0]
material = "glass"
[[walls.paddle.motion]]
kind = "rotate"
axis = [0, 0, 1]
period = 0.5
start = 0.05
[walls.tube]
shape = "cylinder"
radius = 0.028
material = "glass"
[outlets.middle]
position = 0.015
delete = false
[outlets.out]
position = 0.0
"""


def plan_of(
    text: str,
    kind: str = "linear",
    *,
    gravity: float = G,
    until: float = 0.3,
    periodic: str = "",
    home: Path | None = None,
    **run: float,
) -> Plan:
    """Return the plan of a scene: ``text`` is added to `HEAD`, with these values in it (sample, frames: every [s]).

    ``periodic``: that line of the case; ``home``: where the files lie that it names.
    """
    given = {"until": until} | run
    keys = {"until": "until_time", "sample": "sample_every", "frames": "frames_every"}
    head = periodic + HEAD.replace("-9.81", repr(-gravity))
    for key, value in given.items():
        name = keys.get(key, key)
        head = re.sub(rf"\b{name} = \S+", f"{name} = {value!r}", head)
    if home is None:
        return plan(parse_case(head + text, name="granular"))[kind]
    (home / "case.toml").write_text(head + text)
    return plan(load_case(home, name="granular"))[kind]


def placed(*positions: Sequence[float]) -> str:
    """Return a group of beads at these places."""
    return f"{BEADS}positions = {[[float(c) for c in x] for x in positions]}\n"


def start_at(model: Plan) -> Start:
    """Return the particles that the case places itself, each group of one size."""
    parts = []
    for kind, group in enumerate(model.scene.particles.values()):
        x = np.array(group.centres).reshape(-1, 3)
        parts.append((x, np.ones((len(x), 1)) * np.array(group.velocity), np.full(len(x), kind)))
    x, v, kinds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Start.at(x, v, kind=kinds)


def run_by_hand(model: Plan, folder: Path, *, instead: tuple[str, str] = ("", "")) -> str:
    """Write the deck of a model, run it as a person would, and return what LIGGGHTS printed."""
    folder.mkdir(exist_ok=True)
    write_deck(bed_deck(model, start_at(model), by_hand=True), folder)
    text = (folder / DECK).read_text()
    assert instead[0] in text
    (folder / DECK).write_text(text.replace(*instead))
    done = subprocess.run(
        ["./Allrun"], cwd=folder, capture_output=True, text=True, errors="replace", timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    return done.stdout


def driven_text(model: Plan, time: float = 0.0) -> str:
    """Return the deck as kncal drives it, from a restart at ``time`` [s]."""
    return deck_text(bed_deck(model, time=time))


def frames(folder: Path) -> dict[int, Array]:
    """Return the rows of every frame of a run by hand, by step: id, type, radius, x, y, z, v, spin."""
    found: dict[int, Array] = {}
    for part in (folder / "particles.dump").read_text().split("ITEM: TIMESTEP\n")[1:]:
        lines = part.splitlines()
        rows = [[float(word) for word in line.split()] for line in lines[8:]]
        found[int(lines[0])] = np.array(rows).reshape(-1, 12)
    return found


def table(path: Path) -> Array:
    """Return the rows of a file of averages by time step."""
    return np.loadtxt(path, ndmin=2)
