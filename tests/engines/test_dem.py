"""LIGGGHTS as the particle side of a coupled bed: mechanics, statistics, restart."""

from __future__ import annotations

import math
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from beds import BOX, D, G, mass, model, scene, still, weight
from scipy.spatial import cKDTree

from kncal.core.checks import Array
from kncal.core.errors import InputError, RenderError
from kncal.engines.liggghts.deck import bed_deck, deck_text
from kncal.engines.liggghts.library import LOG, LiggghtsDem
from kncal.scene.contact import ContactChoice
from kncal.scene.groups import AT_REST
from kncal.scene.model import KINDS, Plan
from kncal.scene.placement import Start, lattice

solver = pytest.mark.solver
ROUGH = ContactChoice(e_n=0.8, friction=0.3, rolling_friction=0.02)
SMOOTH = ContactChoice(e_n=0.8)
LAYER = {"box": replace(BOX, size=(0.03, D, 0.06)), "layer": "y"}
#: A bed with more room above it.
TALL = replace(BOX, size=(0.015, 0.006, 0.3))
#: Numbers of the normal law, all that may differ between the decks of the two models.
NORMAL_LAW = {"kn", "kt", "gamman_abs", "gammat_abs", "youngsModulus", "poissonsRatio", "coefficientRestitution"}


def stirring(given: Plan, intervals: int, seed: int = 0) -> Array:
    """Forces (intervals, n, 3) that keep a bed moving: 0.7 of the weight up, twice the weight at random."""
    n, unit = given.scene.number, mass(given.scene) * G
    return unit * np.random.default_rng(seed).normal([0.0, 0.0, 0.7], 2.0, (intervals, n, 3))


def commands(text: str) -> set[str]:
    joined = text.replace("&\n", " ")
    return {" ".join(line.split()) for line in joined.splitlines() if line and not line.startswith("#")}


# --- the deck ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["overlap", "force"])
def test_decks_differ_in_the_normal_law_only(end: str) -> None:
    bed = scene(contact=replace(ROUGH, end=end))
    both = {kind: deck_text(bed_deck(model(bed, kind, dt=dt))) for kind, dt in (("linear", 1e-5), ("hertz", 7e-6))}
    law = {"linear": "hooke/stiffness", "hertz": "hertz"}
    # the normal law's name and its switch for damping in SI units stand in every line of pair and walls
    linear, hertz = (
        commands(text.replace(f"model {law[kind]} ", "model LAW ").replace("absolute_damping on ", ""))
        for kind, text in both.items()
    )
    for line in linear ^ hertz:
        words = line.split()
        assert words[0] in ("timestep", "hard_particles", "soft_particles") or words[1] in NORMAL_LAW, line
    for deck in (linear, hertz):
        (switches,) = (line for line in deck if line.startswith("pair_style"))
        assert "tangential_damping off" in switches
        assert ("limitForce on" in switches) == (end == "force")


def test_a_law_that_liggghts_has_not_is_refused() -> None:
    given = model(scene(), "hertz")
    contacts = {names: replace(c, law="hunt_crossley", p=1.5) for names, c in given.contacts.items()}
    with pytest.raises(RenderError, match="hunt_crossley"):
        deck_text(bed_deck(replace(given, contacts=contacts)))
    other = {names: replace(c, k=1.01 * c.k) for names, c in given.contacts.items()}
    with pytest.raises(RenderError, match="Hertz stiffness"):
        deck_text(bed_deck(replace(given, contacts=other)))


def test_a_thin_periodic_column_is_refused() -> None:
    with pytest.raises(RenderError, match=r"periodic over 0\.0024 m in y"):
        deck_text(bed_deck(model(scene(box=replace(BOX, size=(0.015, 2.0 * D, 0.06)), periodic=("y",)))))


@solver
def test_the_deck_runs_by_hand(tmp_path: Path) -> None:
    given = model(scene(50))
    with LiggghtsDem(given, tmp_path, Start.at(lattice(given.scene))):
        pass
    command = ["liggghts", "-in", "in.liggghts", "-log", "none", "-var", "steps", "200"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=60, check=True)
    assert b"KNCAL_DONE" in done.stdout
    assert "ITEM: NUMBER OF ATOMS\n50\n" in (tmp_path / "settled.dump").read_text()


@solver
@pytest.mark.parametrize("count", [1, 30])
@pytest.mark.parametrize("side", [0.1, 50.0])
def test_a_large_column_costs_no_more(count: int, side: float, tmp_path: Path) -> None:
    """A few grains of 0.1 mm fall alike in a column of any size; 1e12 bins of their size would fit into the largest."""
    bed = scene(count, box=replace(BOX, size=(side, side, side))).with_group(diameter=1e-4)
    given = model(bed, dt=1e-6)
    start = lattice(bed) + np.array([0.01, 0.01, 0.05])
    with LiggghtsDem(given, tmp_path, Start.at(start)) as dem:
        before = dem.cpu_seconds
        for _ in range(4):
            dem.run(1000, still(bed))
        spent = dem.cpu_seconds - before
        x, *_ = dem.state()
    assert x[:, 2] - start[:, 2] == pytest.approx(np.full(count, -0.5 * G * 4e-3**2), rel=1e-6)
    assert spent < 4000 * (2e-5 + 1e-6 * count)  # s: 10 to 20 us a step


@solver
def test_collisions_in_a_large_column_are_those_in_a_small_one(tmp_path: Path) -> None:
    """Larger bins of space change how neighbours are found, not which."""
    bed = scene(60)
    start = lattice(bed)
    ends = []
    for side in (0.06, 6.0):
        given = model(scene(60, box=replace(BOX, size=(0.015, 0.006, side))))
        with LiggghtsDem(given, tmp_path / f"{side:g}", Start.at(start)) as dem:
            dem.run(4000, still(bed))
            ends.append(dem.state()[0])
    assert 0.45 * D < ends[0][:, 2].min() < 0.51 * D  # they landed: a free fall is 7.8 mm deep
    assert ends[1] == pytest.approx(ends[0], abs=1e-9)


# --- mechanics --------------------------------------------------------------------------------------------------------


@solver
def test_free_flight_is_exact(tmp_path: Path) -> None:
    """Verlet is exact for a constant acceleration; a new force comes in with half a step of the old one."""
    given = model(scene(8, box=TALL))
    bed, dt = given.scene, given.dt
    x0 = lattice(bed) + np.array([0.0, 0.0, 0.2])
    v0 = np.zeros_like(x0)
    v0[:, 2] = 0.1
    force = mass(bed) * np.linspace(-0.5, 0.5, 24).reshape(8, 3)
    with LiggghtsDem(given, tmp_path, Start.at(x0, v0)) as dem:
        dem.run(500, force)
        x1, v1, *_ = dem.state()
        dem.run(300, -force)
        _, v2, *_ = dem.state()
    t = 500 * dt
    a = force / mass(bed) - [0.0, 0.0, G]
    assert v1 == pytest.approx(v0 + a * t, rel=1e-11, abs=1e-14)
    assert x1 == pytest.approx(x0 + v0 * t + 0.5 * a * t**2, rel=1e-12)
    after = v1 + (-force / mass(bed) - [0.0, 0.0, G]) * 300 * dt + force / mass(bed) * dt
    assert v2 == pytest.approx(after, rel=1e-10, abs=1e-13)


@solver
@pytest.mark.parametrize("kind", KINDS)
def test_momentum_balance_with_the_floor(tmp_path: Path, kind: str) -> None:
    """Gas + floor - weight = dP/dt in every interval; smooth side walls carry nothing."""
    bed = scene(300, contact=SMOOTH)
    given, W = model(bed, kind), weight(bed)
    forces = stirring(given, 40)
    old, momentum = forces[0], 0.0
    carried = []
    with LiggghtsDem(given, tmp_path, Start.at(lattice(bed))) as dem:
        for force in forces:
            step = dem.run(50, force)
            gained = mass(bed) * float(dem.state()[1][:, 2].sum()) - momentum
            momentum += gained
            gas = float((0.99 * force + 0.01 * old)[:, 2].sum())  # half a step of 50 is still the old force
            old = force
            assert gas + step.floor_force - W == pytest.approx(gained / (50 * given.dt), abs=1e-10 * W)
            assert step.other_walls_force == pytest.approx(0.0, abs=1e-10 * W)
            carried.append(step.floor_force / W)
    assert max(carried) > 0.1  # the floor was hit


@solver
def test_friction_at_a_side_wall(tmp_path: Path) -> None:
    """A particle pressed against a side wall slides down: the wall carries friction times the pressing force."""
    given = model(scene(1, contact=ContactChoice(e_n=0.3, friction=0.2)), dt=5e-6)
    press = 0.5 * mass(given.scene) * G
    c = given.between("beads", "column")
    start = np.array([[0.015 - 0.5 * D + press / c.k, 0.003, 0.05]])
    with LiggghtsDem(given, tmp_path, Start.at(start)) as dem:
        dem.run(2000, np.array([[press, 0.0, 0.0]]))
        step = dem.run(200, np.array([[press, 0.0, 0.0]]))
    assert step.floor_force == 0.0
    assert step.other_walls_force == pytest.approx(0.2 * press, rel=1e-6)


@solver
def test_rows_keep_their_particles(tmp_path: Path) -> None:
    """However LIGGGHTS sorts: each row moves by its own velocity, and a push reaches the particle it is meant for."""
    bed = scene(300, box=replace(BOX, size=(0.03, 0.01, 0.06)), contact=SMOOTH, gravity=AT_REST)
    given = model(bed)
    x0 = lattice(bed)
    v0 = np.random.default_rng(3).normal(0.0, 0.5, x0.shape)
    with LiggghtsDem(given, tmp_path, Start.at(x0, v0)) as dem:
        for _ in range(60):
            dem.run(99, still(bed))
            x, v, *_ = dem.state()
            dem.run(1, still(bed))
            x1, v1, *_ = dem.state()
            # But for the change of a contact's force in the step; other particles are diameters away.
            assert np.abs(x1 - x - 0.5 * given.dt * (v + v1)).max() < 1e-3 * D
        assert np.abs(x1 - x0).max() > 5.0 * D
        for chosen in (0, 137, 299):
            before = dem.state()[1]
            push = still(bed)
            push[chosen, 0] = mass(bed) * 1e6
            dem.run(2, push)
            dem.run(1, still(bed))
            assert int(np.argmax(np.abs(dem.state()[1] - before)[:, 0])) == chosen


@solver
def test_a_layer_stays_in_its_plane(tmp_path: Path) -> None:
    """One second of a moving layer, pushed across its plane too: not one bit changes there."""
    bed = scene(200, **LAYER, contact=ROUGH)
    given = model(bed, k_n=20.0, dt=4e-5)
    forces = stirring(given, 250)
    moved = 0.0
    with LiggghtsDem(given, tmp_path, Start.at(lattice(bed))) as dem:
        for force in forces:
            dem.run(100, force)
            x, v, *_ = dem.state()
            assert (x[:, 1] == 0.5 * D).all()
            assert not v[:, 1].any()
            moved = max(moved, float(np.abs(v).max()))
    assert moved > 0.1
    assert 250 * 100 * given.dt >= 1.0


@solver
def test_a_layer_off_its_plane_is_refused(tmp_path: Path) -> None:
    given = model(scene(20, **LAYER))
    x = lattice(given.scene)
    with pytest.raises(InputError, match="plane"):
        LiggghtsDem(given, tmp_path, Start.at(x + np.array([0.0, 1e-12, 0.0])))
    with pytest.raises(InputError, match="plane"):
        LiggghtsDem(given, tmp_path, Start.at(x, np.full_like(x, 1e-3)))
    with pytest.raises(InputError, match="outside the column"):
        LiggghtsDem(given, tmp_path, Start.at(x - np.array([0.1, 0.0, 0.0])))


# --- overlaps ---------------------------------------------------------------------------------------------------------


@solver
@pytest.mark.parametrize("depth", ["walls", "periodic"])
def test_overlap_statistics_are_those_of_the_positions(tmp_path: Path, depth: str) -> None:
    bed = scene(300, periodic=("y",) if depth == "periodic" else (), contact=ROUGH)
    given = model(bed)
    with LiggghtsDem(given, tmp_path, Start.at(lattice(bed))) as dem:
        empty = dem.run(1, still(bed))
        dem.run(6000, still(bed))
        step = dem.run(1, still(bed))  # one look, at the end of the step
        x, *_ = dem.state()
    assert (empty.contacts, empty.overlap_max, empty.overlap_mean, empty.histogram.sum()) == (0.0, 0.0, 0.0, 0.0)
    box = [1.0, bed.box.depth, 1.0] if depth == "periodic" else None
    pairs = cKDTree(x, boxsize=box).query_pairs(D, output_type="ndarray")
    apart = x[pairs[:, 0]] - x[pairs[:, 1]]
    if box is not None:
        apart[:, 1] -= bed.box.depth * np.round(apart[:, 1] / bed.box.depth)
    overlaps = D - np.linalg.norm(apart, axis=1)
    assert step.contacts == len(overlaps) > 300
    assert step.overlap_max == pytest.approx(overlaps.max(), rel=1e-10)
    assert step.overlap_mean == pytest.approx(overlaps.mean(), rel=1e-10)
    assert dem.histogram_edges[0] == 0.0
    assert (np.diff(dem.histogram_edges) > 0.0).all()
    assert step.histogram.tolist() == np.histogram(overlaps, dem.histogram_edges)[0].tolist()


# --- restart ----------------------------------------------------------------------------------------------------------


@solver
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sides", [{}, {"periodic": ("y",)}, LAYER], ids=["walls", "periodic", "layer"])
def test_a_continued_run_repeats_the_saved_one(tmp_path: Path, kind: str, sides: dict[str, Any]) -> None:
    """Bit by bit; and a run that was never saved differs by rounding at most.

    The latter needs contacts that are forgotten when they open: else the next one's spring would depend on when
    neighbour lists were made.
    """
    bed = scene(300, **sides, contact=ROUGH)
    given = model(bed, kind)
    forces = stirring(given, 50)
    floor: dict[str, list[float]] = {"saved": [], "continued": []}
    with LiggghtsDem(given, tmp_path / "plain", Start.at(lattice(bed))) as plain:
        for force in forces:
            plain.run(50, force)
        untouched = plain.state()
    with LiggghtsDem(given, tmp_path / "saved", Start.at(lattice(bed))) as saved:
        for force in forces[:25]:
            saved.run(50, force)
        saved.save(tmp_path / "state")
        at_save = saved.state()
        for force in forces[25:]:
            floor["saved"].append(saved.run(50, force).floor_force)
        repeated = saved.state()
    with LiggghtsDem(given, tmp_path / "continued", None, restart=tmp_path / "state") as continued:
        assert [np.array_equal(a, b) for a, b in zip(continued.state(), at_save, strict=True)] == [True] * 4
        for force in forces[25:]:
            floor["continued"].append(continued.run(50, force).floor_force)
        assert [np.array_equal(a, b) for a, b in zip(continued.state(), repeated, strict=True)] == [True] * 4
    assert floor["continued"] == pytest.approx(floor["saved"], abs=1e-12 * weight(bed))
    assert np.abs(repeated[0] - untouched[0]).max() < 1e-9 * D
    assert np.abs(repeated[1] - untouched[1]).max() < 1e-8
    assert np.abs(untouched[1]).max() > 0.05


@solver
def test_the_log_stays_small(tmp_path: Path) -> None:
    bed = scene(5, box=TALL)
    with LiggghtsDem(model(bed), tmp_path, Start.at(lattice(bed))) as dem:
        start = (tmp_path / LOG).stat().st_size
        for _ in range(1500):
            dem.run(1, still(bed))
    assert (tmp_path / LOG).stat().st_size < start + 70_000
    assert math.isfinite(dem.cpu_seconds)
