"""A small case file, and what becomes of it with one word changed."""

from __future__ import annotations

import pytest

from kncal.core.errors import CaseFileError
from kncal.scene.case_file import parse_case

GOOD = """\
title = "two beads"
gravity = [0, 0, -9.81]

[materials.glass]
young = 70e9
poisson = 0.22
density = 2500.0

[particles.a]
material = "glass"
diameter = 1e-3
position = [-0.001, 0.0, 0.0]
velocity = [0.5, 0.0, 0.0]

[particles.b]
material = "glass"
diameter = 2e-3
position = [0.002, 0.0, 0.0]

[walls.floor]
axis = "z"
position = -0.01
material = "rigid"

[contact]
law = "tsuji"
e_n = 0.9
method = "max_overlap"
friction = 0.3

[[contact.pairs]]
between = ["a", "floor"]
e_n = 0.5

[run]
until_time = 1e-3

[tolerances]
delta_max = 0.05
t_c_2 = 0.1

[needs]
tangential = true
"""


def changed(old: str, new: str) -> str:
    assert GOOD.count(old) == 1, f"{old!r} must stand exactly once in the sample"
    return GOOD.replace(old, new)


def refused(text: str) -> str:
    with pytest.raises(CaseFileError) as caught:
        parse_case(text, name="sample", where="here/case.toml")
    message = str(caught.value)
    assert all(line.startswith("here/case.toml") for line in message.splitlines())
    assert message.isprintable() or "\n" in message
    return message
