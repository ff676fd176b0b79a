"""Start packings: the loose lattice, and what LIGGGHTS lets settle."""

from __future__ import annotations

import math
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from beds import BOX, D, model, scene, still, weight
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from kncal.core.errors import InputError, RunError
from kncal.engines import settle as packing_module
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.engines.settle import packing
from kncal.scene.case_file import parse_case
from kncal.scene.contact import ContactChoice
from kncal.scene.groups import AT_REST
from kncal.scene.placement import PLACEMENTS, Start, lattice
from kncal.scene.plan import plan

solver = pytest.mark.solver
#: What bounds a box in y, as fields of a scene.
SIDES: dict[str, dict[str, Any]] = {"walls": {}, "periodic": {"periodic": ("y",)}, "layer": {"layer": "y"}}


@settings(max_examples=40)
@given(
    count=st.integers(1, 400),
    seed=st.integers(0, 1000),
    front_back=st.sampled_from(["walls", "periodic", "layer"]),
    width=st.floats(3 * D, 30 * D),
)
def test_a_lattice_touches_nothing(count: int, seed: int, front_back: str, width: float) -> None:
    depth = D if front_back == "layer" else 5 * D
    box = replace(BOX, size=(width, depth, 500 * D))
    bed = scene(count, box=box, seed=seed, **SIDES[front_back])
    x = lattice(bed)
    assert x.shape == (count, 3)
    half, size = 0.5 * D, np.array([width, depth, 500 * D])
    axes = [0, 1, 2] if front_back == "walls" else [0, 2]
    assert (x[:, axes] > half).all()
    assert (x[:, axes] < size[axes] - half).all()
    box = [1e3, depth, 1e3] if front_back == "periodic" else None
    wrapped = np.column_stack([x[:, 0], x[:, 1] % depth, x[:, 2]])
    assert not cKDTree(wrapped, boxsize=box).query_pairs(D)
    if front_back == "layer":
        assert (x[:, 1] == 0.5 * depth).all()


def test_a_lattice_that_does_not_fit() -> None:
    with pytest.raises(InputError, match="has 0 places"):
        lattice(scene(1, box=replace(BOX, size=(D, 0.006, 0.06))))
    with pytest.raises(InputError, match="expected a larger column"):
        lattice(scene(10_000))


@pytest.mark.parametrize("front_back", ["walls", "periodic"])
def test_a_huge_column_takes_no_more_memory(front_back: str) -> None:
    """Its lattice has 1e18 places, of which a few are taken."""
    huge = scene(400, box=replace(BOX, size=(1e3, 1e3, 1e3)), **SIDES[front_back])
    tracemalloc.start()
    x = lattice(huge)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1e6
    assert len(np.unique(x, axis=0)) == 400
    assert (x > 0.5 * D).all()


def test_seeds_differ_and_repeat() -> None:
    assert np.array_equal(lattice(scene(seed=1)), lattice(scene(seed=1)))
    assert not np.array_equal(lattice(scene(seed=1)), lattice(scene(seed=2)))


def test_given_positions() -> None:
    places = ((0.002, 0.003, 0.004), (0.006, 0.003, 0.004))
    assert packing(model(scene(2, place="given", positions=places))).x.tolist() == [list(p) for p in places]
    with pytest.raises(InputError, match="positions"):
        packing(model(scene(3, place="given", positions=places)))
    with pytest.raises(InputError, match="place"):
        packing(model(scene(3, place="heap")))
    assert set(PLACEMENTS) == {"settled", "lattice", "given", "stream"}


def test_what_cannot_settle() -> None:
    with pytest.raises(InputError, match="gravity"):
        packing(model(scene(gravity=AT_REST)))
    with pytest.raises(InputError, match="linear"):
        packing(model(scene(), "hertz"))
    with pytest.raises(InputError, match="steps"):  # 1e10 of them
        packing(model(scene(gravity=(0.0, 0.0, -1e-10))))


@solver
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_settled_bed_rests_on_its_floor(tmp_path: Path, friction: float) -> None:
    bed = scene(450, contact=ContactChoice(e_n=0.8, friction=friction))
    linear = model(bed, k_n=50.0, dt=2e-5)
    x = packing(linear).x
    assert x.shape == (450, 3)
    c = linear.between("beads", "column")
    with LiggghtsDem(linear, tmp_path, Start.at(x)) as dem:
        rest = [dem.run(1000, still(bed)) for _ in range(5)][-1]
        y, *_ = dem.state()
    # It stays where it was, but for a loose one that rolls on; and the bed does not sag.
    assert np.median(np.abs(y - x)) < 1e-3 * D
    assert abs(np.mean(y[:, 2] - x[:, 2])) < 2e-3 * D
    # No particle sinks deeper than a fifth of the bed on it would press it.
    assert (x[:, 2] > 0.5 * D - 0.2 * weight(bed) / c.k).all()
    on_floor = c.k * np.clip(0.5 * D - y[:, 2], 0.0, None).sum()
    assert rest.floor_force == pytest.approx(on_floor, abs=0.01 * weight(bed))
    assert rest.floor_force + rest.other_walls_force == pytest.approx(weight(bed), rel=0.01)
    if friction == 0.0:
        assert rest.floor_force == pytest.approx(weight(bed), rel=0.01)
    # Void fraction between two heights inside the bed, by the volume of each sphere between them.
    low, high = 2.0 * D, float(np.quantile(x[:, 2], 0.9))
    column_volume = bed.box.width * bed.box.depth * (high - low)
    solid = sum(_between(z, low, high) for z in x[:, 2])
    assert 0.36 < 1.0 - solid / column_volume < 0.5


def _between(z: float, low: float, high: float) -> float:
    """Volume of a sphere of diameter D at height z between two planes."""
    r = 0.5 * D

    def below(h: float) -> float:
        cap = min(max(h - (z - r), 0.0), 2.0 * r)
        return math.pi * cap**2 * (r - cap / 3.0)

    return below(high) - below(low)


@solver
def test_packings_are_kept_by_their_inputs(tmp_path: Path) -> None:
    bed = scene(60, contact=ContactChoice(e_n=0.5, friction=0.3))
    first = packing(model(bed), tmp_path).x
    (file,) = tmp_path.glob("*.npz")
    stamp = file.stat().st_mtime_ns
    assert np.array_equal(packing(model(bed), tmp_path).x, first)
    assert [p.stat().st_mtime_ns for p in tmp_path.glob("*.npz")] == [stamp]
    packing(model(bed, k_n=150.0), tmp_path)
    packing(model(bed.with_group(seed=7)), tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 3


@solver
def test_settling_says_what_it_does_and_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bed = scene(60, contact=ContactChoice(e_n=0.5, friction=0.3))
    alone = packing(model(bed)).x
    monkeypatch.setattr(packing_module, "_PART", 60 * 100)  # parts of 100 steps
    monkeypatch.setattr(packing_module, "_LONG", 0.0)
    said: list[str] = []
    seen: list[tuple[int, int]] = []
    together = packing(model(bed), tmp_path, tell=said.append, progress=lambda done, total: seen.append((done, total)))
    assert np.array_equal(alone, together.x)  # to tell it in parts changes nothing
    assert "60 particles" in said[0]
    assert re.search(r"\d:\d\d:\d\d", said[1])
    done = [number for number, _ in seen]
    assert done == sorted(done)
    assert max(np.diff(done)) <= 100
    assert all(number <= total for number, total in seen)
    assert seen[-1] == (done[-1], done[-1])
    half = next(total for number, total in seen if number >= 0.5 * done[-1])
    assert 0.5 < half / done[-1] < 2.0
    packing(model(bed), tmp_path, tell=said.append)  # nothing is settled that is kept
    assert len(said) == 2


@solver
@pytest.mark.parametrize("damage", ["cut", "junk", "shape", "not finite", "outside"])
def test_a_damaged_packing_is_made_anew(tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str) -> None:
    bed = scene(8, contact=ContactChoice(e_n=0.5))
    first = packing(model(bed), tmp_path).x
    (file,) = tmp_path.glob("*.npz")
    wrong = {"shape": first[:-1], "not finite": first * np.nan, "outside": first - 1.0}
    if damage in wrong:
        np.savez(file, positions=wrong[damage])
    else:
        file.write_bytes(file.read_bytes()[:-200] if damage == "cut" else b"junk")
    for name in (".packing.abcdefgh.part", f".{file.name}.abcdefgh.part"):  # of starts that were killed
        (tmp_path / name).write_bytes(b"half")
    assert np.array_equal(packing(model(bed), tmp_path).x, first)
    assert not list(tmp_path.glob(".*.part"))
    assert str(file) in caplog.text
    caplog.clear()
    assert np.array_equal(packing(model(bed), tmp_path).x, first)
    assert caplog.text == ""


@solver
def test_perfectly_elastic_spheres_do_not_settle() -> None:
    bed = scene(20, contact=ContactChoice(e_n=1.0))
    with pytest.raises(RunError, match="did not settle"):
        packing(model(bed))


PRESSED = """
periodic = ["x", "y", "z"]
[materials.glass]
young = 5e7
poisson = 0.3
density = 2500
[particles.beads]
material = "glass"
sizes.shares = {sizes}
fill = {fill}
place = "settled"
region = {{low = [0.0, 0.0, 0.0], high = [0.024, 0.024, 0.024]}}
[domain]
low = [0.0, 0.0, 0.0]
high = [0.024, 0.024, 0.024]
[contact]
e_n = 0.5
v_0 = 0.1
[run]
until_time = 0.01
sample_every = 1e-3
"""
EQUAL, MIXTURE = "[[4e-3, 1.0]]", "[[2e-3, 0.3], [4e-3, 0.7]]"


@solver
@pytest.mark.parametrize(
    ("sizes", "fill", "jammed"),
    [
        (EQUAL, 0.58, False),
        (EQUAL, 0.68, True),
        pytest.param(MIXTURE, 0.65, False, marks=pytest.mark.long),
        (MIXTURE, 0.72, True),
    ],
)
def test_spheres_that_are_pressed_together_carry_each_other_above_the_jamming_density(
    sizes: str, fill: float, jammed: bool
) -> None:
    """Frictionless equal spheres jam at 0.64 (O'Hern et al. 2003: 0.639), these of two sizes at 0.68 (Farr & Groot
    2009: 0.682): below it nothing touches, above it all but the rattlers are in balance by at least six contacts
    (isostatic: three coordinates each, one contact for two).
    """
    pressed = plan(parse_case(PRESSED.format(sizes=sizes, fill=fill), name="pressed"), ("linear",))["linear"]
    start = packing(pressed)
    side = 0.024
    classes = pressed.scene.classes
    radii = 0.5 * np.array([c.diameter for c in classes])[start.kind]
    pairs = cKDTree(start.x, boxsize=side).query_pairs(2.0 * radii.max(), output_type="ndarray")
    way = start.x[pairs[:, 0]] - start.x[pairs[:, 1]]
    way -= side * np.round(way / side)
    distance = np.linalg.norm(way, axis=1)
    overlap = radii[pairs].sum(axis=1) - distance
    way, distance, pairs, overlap = (part[overlap > 0.0] for part in (way, distance, pairs, overlap))
    if not jammed:
        assert overlap.sum() < 1e-4 * radii.max()
        return
    stiffness = np.zeros((len(classes), len(classes)))
    for i, j in pressed.contacts:
        if j < len(classes):
            stiffness[i, j] = stiffness[j, i] = pressed.contacts[i, j].k
    size = stiffness[tuple(start.kind[pairs].T)] * overlap
    push = (size / distance)[:, None] * way
    force = np.zeros_like(start.x)
    np.add.at(force, pairs[:, 0], push)
    np.add.at(force, pairs[:, 1], -push)
    assert np.linalg.norm(force, axis=1).max() < 0.02 * size.mean()
    carries = np.bincount(pairs.ravel(), minlength=len(start.x)) > 3
    both = carries[pairs].all(axis=1)
    number = np.bincount(pairs[both].ravel(), minlength=len(start.x))[carries]
    assert 5.9 <= number.mean() < 8.0  # some more rattlers have four contacts
