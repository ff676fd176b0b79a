"""Which physics a scene requires: limits, symmetries, and scenes whose answer follows from mechanics."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from models import with_bodies

from kncal.core.errors import InputError
from kncal.physics.material import Material
from kncal.scene.bodies import Particle, Vector, Wall
from kncal.scene.contact import ContactChoice, PairChoice
from kncal.scene.needs import OVERRULABLE, PHYSICS, decide
from kncal.scene.run_control import RunControl
from kncal.scene.scene import Scene

GLASS = Material(name="glass", young=70e9, poisson=0.22, density=2500.0)
FLOOR = Wall(name="floor", axis="z", position=0.0)
DOWN = (0.0, 0.0, -9.81)
ROUGH = ContactChoice(e_n=0.9, friction=0.3)


def ball(name: str, position: Vector, **more: Any) -> Particle:
    return Particle(name=name, material=GLASS, radius=0.5, position=position, **more)


def scene(*particles: Particle, **more: Any) -> Scene:
    return Scene.of(name="sample", spheres=particles, run=RunControl(until_time=1.0), **more)


def head_on(**more: Any) -> Scene:
    left = ball("left", (-1.0, 0.0, 0.0), velocity=(1.0, 0.0, 0.0))
    return scene(left, ball("right", (1.0, 0.0, 0.0), velocity=(-1.0, 0.0, 0.0)), **more)


def used(of: Scene) -> set[str]:
    needs = decide(of)
    return {name for name in PHYSICS if needs.uses(name)}


def reason(of: Scene, name: str) -> str:
    return next(item.reason for item in decide(of).items if item.name == name)


def test_head_on_impact_is_a_line_without_surface_forces() -> None:
    assert used(head_on()) == {"pair_contacts"}
    assert decide(head_on()).dimensions == 1
    rough = head_on(contact=ROUGH)
    assert used(rough) == {"pair_contacts", "damping"}
    assert "head-on" in reason(rough, "tangential")


def test_gravity_pulls_both_alike_and_leaves_a_head_on_impact_head_on() -> None:
    falling = head_on(contact=ROUGH, gravity=DOWN)
    assert used(falling) == {"pair_contacts", "damping", "gravity"}
    assert decide(falling).dimensions == 2
    assert "tangential" in used(with_bodies(falling, planes=(replace(FLOOR, position=-5.0),)))


@pytest.mark.parametrize("spin", [(0.0, 0.0, 9.0), (0.0, -1e-3, 0.0)])
def test_spin_across_the_normal_rubs_and_opens_a_plane(spin: Vector) -> None:
    start = head_on(contact=ROUGH)
    left, right = start.spheres
    spinning = with_bodies(start, spheres=(replace(left, spin=spin), right))
    assert {"tangential", "rotation"} <= used(spinning)
    assert "'left' spins" in reason(spinning, "tangential")
    assert decide(spinning).dimensions == 2
    smooth = replace(spinning, contact=ContactChoice())
    assert used(smooth) == {"pair_contacts"}
    assert decide(smooth).dimensions == 1
    both = with_bodies(start, spheres=(replace(left, spin=(0.0, 1.0, 0.0)), replace(right, spin=(0.0, 0.0, 1.0))))
    assert decide(both).dimensions == 3


def test_surfaces_that_go_alike_do_not_rub() -> None:
    """Equal spheres that meet head-on and spin against each other: gears. Either spin alone, or both alike, rub."""
    start = head_on(contact=ROUGH)
    left, right = start.spheres
    gears = with_bodies(start, spheres=(replace(left, spin=(0.0, 9.0, 1.0)), replace(right, spin=(0.0, -9.0, -1.0))))
    assert "tangential" not in used(gears)
    for spin in ((0.0, 0.0, 0.0), (0.0, 9.0, 1.0), (0.0, -9.0, -1.1)):
        assert "tangential" in used(with_bodies(gears, spheres=(gears.spheres[0], replace(right, spin=spin))))


def test_spin_about_the_line_of_centres_does_not_rub() -> None:
    start = head_on(contact=ROUGH)
    left, right = start.spheres
    drilling = with_bodies(start, spheres=(replace(left, spin=(50.0, 0.0, 0.0)), right))
    assert used(drilling) == {"pair_contacts", "damping"}
    assert decide(drilling).dimensions == 1


def test_offset_centres_meet_at_an_angle_until_they_pass() -> None:
    def offset(y: float) -> Scene:
        left = ball("left", (-1.0, 0.0, 0.0), velocity=(1.0, 0.0, 0.0))
        return scene(left, ball("right", (1.0, y, 0.0), velocity=(-1.0, 0.0, 0.0)), contact=ROUGH)

    assert {"tangential", "pair_contacts"} <= used(offset(0.5))
    assert decide(offset(0.5)).dimensions == 2
    assert used(offset(1.001)) == set()
    assert decide(offset(1.001)).dimensions == 1
    assert reason(offset(1.001), "pair_contacts") == "the particles pass each other"


def test_deflected_particle_may_hit_a_third() -> None:
    start = head_on(contact=ROUGH)
    left, right = start.spheres
    glancing = replace(right, position=(1.0, 0.5, 0.0))
    beside = ball("third", (0.0, -4.0, 0.0))
    needs = decide(with_bodies(start, spheres=(left, glancing, beside)))
    assert needs.uses("pair_contacts")
    above = ball("third", (0.0, -4.0, 1.5))  # no force ever leaves the plane z = 0
    assert decide(with_bodies(start, spheres=(left, glancing, above))).dimensions == 2


def test_drop_slide_and_throw_on_a_floor() -> None:
    drop = scene(ball("a", (0.0, 0.0, 3.0)), planes=(FLOOR,), gravity=DOWN, contact=ROUGH)
    assert used(drop) == {"gravity", "walls", "damping"}
    assert decide(drop).dimensions == 1
    resting = ball("a", (0.0, 0.0, 0.5 - 1e-9), velocity=(1.0, 0.0, 0.0))
    slide = with_bodies(drop, spheres=(resting,))
    assert {"tangential", "rotation"} <= used(slide)
    assert decide(slide).dimensions == 2
    touching = with_bodies(drop, spheres=(replace(resting, position=(0.0, 0.0, 0.5)),))
    assert "tangential" in used(touching)
    weightless = replace(touching, gravity=(0.0, 0.0, 0.0))
    assert used(weightless) == set()
    assert "walls" not in used(replace(drop, gravity=(0.0, 0.0, 0.0)))
    away = ball("a", (0.0, 0.0, 3.0), velocity=(0.0, 0.0, 2.0))
    assert "walls" in used(with_bodies(drop, spheres=(away,)))  # gravity brings it back
    assert "walls" not in used(with_bodies(drop, spheres=(away,), gravity=(0.0, 0.0, 0.0)))


def test_walls_that_nothing_reaches() -> None:
    side = Wall(name="side", axis="x", position=9.0)
    drop = scene(ball("a", (0.0, 0.0, 3.0)), planes=(FLOOR, side), gravity=DOWN, contact=ROUGH)
    assert reason(drop, "walls") == "'floor' can be touched"
    assert decide(drop).dimensions == 1
    only_side = with_bodies(drop, planes=(side,))
    assert reason(only_side, "walls") == "no wall can be touched"
    assert reason(only_side, "damping") == "nothing can touch"


def test_friction_and_restitution_of_single_pairs_count() -> None:
    thrown = ball("a", (0.0, 0.0, 3.0), velocity=(1.0, 0.0, 0.0))
    other = ball("b", (50.0, 30.0, 3.0))
    exceptions = (
        PairChoice(between=("floor", "a"), friction=0.0, e_n=0.5),
        PairChoice(between=("glass", "rigid"), friction=0.7),
    )
    contact = ContactChoice(friction=0.3, pairs=exceptions)
    at_floor = scene(thrown, other, planes=(FLOOR,), gravity=DOWN, contact=contact)
    assert at_floor.choice_for(thrown, FLOOR) is exceptions[0]
    assert at_floor.choice_for(other, FLOOR) is exceptions[1]
    assert at_floor.choice_for(thrown, other) is None
    alone = with_bodies(at_floor, spheres=(thrown,))
    assert "tangential" not in used(alone)
    assert "damping" in used(alone)
    assert "tangential" in used(replace(alone, contact=replace(contact, pairs=exceptions[1:])))


def test_rolling_friction_needs_something_that_rolls() -> None:
    rolling = ContactChoice(friction=0.3, rolling_friction=0.1)
    drop = scene(ball("a", (0.0, 0.0, 3.0)), planes=(FLOOR,), gravity=DOWN, contact=rolling)
    assert "rolling" not in used(drop)
    thrown = with_bodies(drop, spheres=(ball("a", (0.0, 0.0, 3.0), velocity=(1.0, 0.0, 0.0)),))
    assert {"rolling", "rotation"} <= used(thrown)
    spinning = ball("a", (0.0, 0.0, 3.0), spin=(0.0, 1.0, 0.0))
    smooth = with_bodies(drop, spheres=(spinning,), contact=ContactChoice(rolling_friction=0.1))
    assert used(smooth) & {"tangential", "rotation", "rolling"} == {"rotation", "rolling"}


def test_overruling() -> None:
    start = head_on(contact=ROUGH)
    wanted = decide(replace(start, needs={"tangential": True}))
    assert wanted.uses("tangential")
    assert wanted.uses("rotation")
    marked = {row["physics"]: row["decided_by"] for row in wanted.rows()}
    assert [name for name, who in marked.items() if who == "user"] == ["tangential"]
    same = decide(replace(start, needs={"tangential": False}))
    assert same == decide(start)  # agreeing with kncal overrules nothing
    for name in {*PHYSICS, "nonsense"} - {*OVERRULABLE}:
        with pytest.raises(InputError, match="physics to overrule"):
            decide(replace(start, needs={name: True}))
    with pytest.raises(InputError, match="did you mean 'tangential'"):
        wanted.uses("tangentail")


def test_table_has_every_line_with_a_reason() -> None:
    needs = decide(head_on(gravity=DOWN, contact=ROUGH, planes=(FLOOR,)))
    rows = needs.rows()
    assert [row["physics"] for row in rows] == ["dimensions", *PHYSICS]
    assert all(row["why"] for row in rows)
    assert {row["needed"] for row in rows[1:]} <= {"yes", "no"}
    frame = needs.to_frame()
    assert frame.to_dict(orient="records") == rows


def rotation(angles: Vector) -> np.ndarray:
    a, b, c = angles
    about_z = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1.0]])
    about_x = np.array([[1.0, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
    return about_z @ about_x @ np.array([[math.cos(c), 0, math.sin(c)], [0, 1.0, 0], [-math.sin(c), 0, math.cos(c)]])


angle = st.floats(-math.pi, math.pi)
coordinate = st.sampled_from([-1.0, 0.0, 0.0, 1.0])
vector = st.tuples(coordinate, coordinate, coordinate)


@given(vector, vector, vector, vector, vector, st.tuples(angle, angle, angle))
def test_answer_does_not_depend_on_the_frame(
    offset: Vector, speed: Vector, spin: Vector, gravity: Vector, boost: Vector, angles: Vector
) -> None:
    """Two particles without walls: rotate everything, or look from a frame that moves along gravity."""
    assume(any(offset))
    # Whether a grazing pair touches is a matter of rounding; a clear hit or miss is not.
    relative, x = np.asarray(speed), 4.0 * np.asarray(offset)
    miss = float(np.linalg.norm(np.cross(x, relative)) / np.linalg.norm(relative)) if any(speed) else 9.0
    assume(abs(miss - 1.0) > 1e-6)
    turn = rotation(angles)

    def seen(by: np.ndarray, drift: np.ndarray) -> Scene:
        def v(x: Any) -> Any:
            return tuple(float(c) for c in by @ np.asarray(x))

        start = 4.0 * np.asarray(offset)
        return scene(
            ball("a", (0.0, 0.0, 0.0), velocity=v(np.asarray(speed) + drift), spin=v(spin)),
            ball("b", v(start), velocity=v(drift)),
            gravity=v(gravity),
            contact=ROUGH,
        )

    still = np.zeros(3)
    here, turned = decide(seen(np.eye(3), still)), decide(seen(turn, still))
    assert turned.dimensions == here.dimensions
    assert [i.used for i in turned.items] == [i.used for i in here.items]
    moving = decide(seen(np.eye(3), np.asarray(boost)))
    assert [i.used for i in moving.items] == [i.used for i in here.items]


@given(vector, vector, st.floats(0.1, 2.0))
def test_two_spheres_need_the_span_of_offset_and_speed(offset: Vector, speed: Vector, friction: float) -> None:
    """The impulse between two spheres lies in the span of their offset and their relative velocity."""
    assume(any(offset) and any(speed))
    start = tuple(4.0 * c for c in offset)
    pair = scene(
        ball("a", (0.0, 0.0, 0.0), velocity=speed),
        ball("b", start),  # type: ignore[arg-type]
        contact=ContactChoice(friction=friction),
    )
    needs = decide(pair)
    rank = np.linalg.matrix_rank(np.array([offset, speed]))
    assert needs.dimensions == (rank if needs.uses("pair_contacts") else 1)
    assert needs.uses("tangential") == (needs.uses("pair_contacts") and rank == 2)


def test_needs_of_many_spinning_bodies_in_contact_are_decided_at_once() -> None:
    # memory and time once went with the square of the number of contacts
    heap = [(1.0 - 1e-3) * np.array([i % 4, i // 4 % 4, i // 16]) for i in range(48)]
    balls = [ball(f"b{i}", tuple(x), spin=(float(i % 2), 0.0, 3.0)) for i, x in enumerate(heap)]
    start = time.process_time()
    needs = decide(scene(*balls, contact=ROUGH))
    assert time.process_time() - start < 5.0
    assert needs.dimensions == 3
    assert needs.uses("tangential")
