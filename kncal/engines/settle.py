"""Settled packings: particles on a loose lattice are let down by LIGGGHTS, once for all runs of a bed."""

from __future__ import annotations

import hashlib
import itertools
import json
import logging
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from functools import partial
from pathlib import Path

import numpy as np

from kncal.core.arrays import read_npz
from kncal.core.awake import awake
from kncal.core.checks import Array
from kncal.core.errors import InputError, ReadError, RunError, SolverMissingError, failure_of
from kncal.core.files import replacing, sweep_parts
from kncal.core.lock import only_one
from kncal.core.scratch import scratch
from kncal.core.shipped import cache_folder
from kncal.core.stopping import check_stop
from kncal.engines.base import Progress, Tell
from kncal.engines.liggghts.deck import bed_deck, data_text, deck_text
from kncal.engines.liggghts.library import LiggghtsDem
from kncal.scene.box_limits import places
from kncal.scene.groups import AT_REST
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.plan import MOST_STEPS, plan
from kncal.scene.scene import Scene
from kncal.scene.start import start_of

#: Settled: mean kinetic energy of a particle below this share of m g d, ...
RESTING = 1e-5
_MOST_BYTES = 1 << 27  # of a saved packing: a million particles take 24 MB
#: ... with so many DEM steps per contact duration (or the model's, if those are fewer): forces in balance do not depend
#: on the step, and a fall with impacts that are some per cent off ends in a packing like any other, ...
SETTLING_STEPS = 10.0
#: ... within so many times the fall from the lattice's height, sqrt(2 h/g).
PATIENCE = 40.0
#: Without gravity g is the acceleration of a particle by a contact that overlaps by this share of the diameter.
PRESSED = 1e-5
_USUAL = 20  # looks from the end of the fall to rest: measured 12 to 37, for 500 and 3000 particles of e_n 0.5 to 0.97
_PART = 4_000_000  # particles times steps between two words about progress: a second or two
_LONG = 10.0  # s; how long it takes is said if it is more


def start_positions(scene: Scene, *, tell: Tell | None = None, progress: Progress | None = None) -> Start:
    """Return the particles at the start, the same for both models (a settled packing is cached by its inputs).

    ``tell``, ``progress``: see `packing`.
    """
    if scene.number == 0 or not scene.settles:
        return start_of(scene)
    log = logging.getLogger("kncal")
    log.info("packing %d particles", scene.number)
    try:
        kept = cache_folder() / "packings"
        kept.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        log.warning("settled packings cannot be kept (%s): each run settles its own", error)
        kept = None
    settling = to_settle(scene)
    found = packing(plan(settling, ("linear",))["linear"], kept, tell=tell, progress=progress)
    if scene.run.coupling is not None:
        return found
    index = {c.name: i for i, c in enumerate(scene.classes)}
    kinds = np.array([index[c.name] for c in settling.classes])
    return start_of(scene, replace(found, kind=kinds[found.kind]))


def to_settle(scene: Scene) -> Scene:
    """Return the scene as it settles: the settled groups and the frozen ones, no wall that moves or goes.

    Others join them when the run begins. With the spring ``settle_k_n`` of the first group that has one, whatever the
    scene's own contact and step.
    """
    still = {
        name: replace(wall, motion=(), surface_velocity=AT_REST, remove_at=None) for name, wall in scene.walls.items()
    }
    there = {name: group for name, group in scene.particles.items() if group.place == "settled" or group.frozen}
    scene = replace(scene, walls=still, outlets={}, particles=there)
    k_n = next((group.settle_k_n for group in there.values() if group.settle_k_n is not None), None)
    if k_n is None:
        return scene
    contact = replace(scene.contact, k_n=k_n, pairs=tuple(replace(pair, k_n=None) for pair in scene.contact.pairs))
    return replace(scene, contact=contact, run=replace(scene.run, steps_per_contact=SETTLING_STEPS))


def packing(
    model: Plan, cache_dir: Path | None = None, *, tell: Tell | None = None, progress: Progress | None = None
) -> Start:
    """Return the particles of ``model.scene`` at their start.

    If any are "settled", all fall under gravity in LIGGGHTS, with the linear contact of ``model``, until the mean
    kinetic energy of a particle is below `RESTING` m g d, twice in a row. Without gravity those of a periodic box start
    pressed into one another (`kncal.scene.filling`), and come to rest.

    Parameters
    ----------
    model : Plan
        The linear one, so that the linear and the Hertz run start alike.
    cache_dir : Path, optional
        Settled packings are kept there under a hash of all that they depend on, and taken from there.
    tell : callable, optional
        Called with a sentence about what is done if the particles are settled now, and how long it will take.
    progress : callable, optional
        Called while they settle with (steps done, steps that it takes in all as far as one can tell).

    Raises
    ------
    InputError
        If the column is too small, there is no gravity to settle under, or the model is not the linear one.
    RunError
        If LIGGGHTS fails, or the particles do not come to rest.
    """
    scene = model.scene
    start = start_of(scene)
    if not scene.settles:
        return start
    if model.kind != "linear":
        raise InputError(f"{scene.name}: packing of the {model.kind!r} model, expected the linear one")
    if scene.g <= 0.0 and not scene.presses:
        raise InputError(f'{scene.name}: place = "settled" without gravity: expected gravity, or place = "lattice"')
    model = replace(model, dt=max(model.dt, min(c.t_c for c in model.contacts.values()) / SETTLING_STEPS))
    if cache_dir is None:
        return _settle(model, start, tell or _silent, progress)
    cache_dir.mkdir(parents=True, exist_ok=True)
    path = cache_dir / f"{_key(model, start)}.npz"
    sweep_parts(cache_dir)
    with only_one(path.with_suffix(".lock")):  # many runs of a sweep may want the same packing at once
        kept = _load(path, scene)
        if kept is not None and len(kept) == len(start.x):
            return Start.at(kept, kind=start.kind)
        settled = _settle(model, start, tell or _silent, progress)
        _store(path, settled.x)
        return settled


def _silent(_: str) -> None:
    pass


def _settle(model: Plan, start: Start, tell: Tell, progress: Progress | None) -> Start:
    scene = model.scene
    d, g, fall = scene.diameter, scene.g, 0.0
    if scene.presses:
        softest = min(model.contacts.values(), key=lambda contact: contact.k)
        g = PRESSED * d * softest.k * scene.number / scene.mass
    else:
        heights = start.x @ scene.up
        bottom = 0.0 if scene.run.coupling is not None else float(min(corner @ scene.up for corner in _corners(scene)))
        fall = math.sqrt(2.0 * (float(heights.max()) - bottom) / g)
    if fall > MOST_STEPS * model.dt:
        raise InputError(
            f"{scene.name}: the particles fall for {fall:.3g} s until they are settled, {fall / model.dt:.3g} steps: "
            f'expected at most {MOST_STEPS:.3g}; take more gravity, or place = "lattice"'
        )
    chunk = max(1, round(math.sqrt(d / g) / model.dt))
    looks = math.ceil(PATIENCE * (fall / (chunk * model.dt) or 50.0))
    falling = math.ceil(fall / (chunk * model.dt))
    quiet, shares = 0, [math.inf]
    said = _Said(scene, chunk * (falling + _USUAL), model.dt, tell, progress)
    with scratch() as folder, _while_settling(scene), LiggghtsDem(model, folder, start) as dem:
        said(chunk * (falling + _USUAL), 0, 0)
        for look in range(looks):
            total = chunk * (look + min(_looks_left(shares, falling), looks - look))
            _run_in_parts(dem, chunk, len(start.x), partial(said, total, chunk * look))
            state = dem.state()
            share = float(0.5 * np.mean(np.sum(state.v * state.v, axis=1)) / (g * d))
            shares.append(share)
            quiet = quiet + 1 if share < RESTING else 0
            if quiet == 2:
                said(chunk * (look + 1), chunk * (look + 1), 0)
                return Start.at(state.x[: len(start.x)], kind=start.kind)
    raise RunError(
        f"{scene.name}: the particles did not settle in {looks * chunk * model.dt:.3g} s: mean kinetic energy "
        f"{share:.2g} m g d, expected below {RESTING:g}; take e_n below 1, a rolling friction "
        '(particles that roll on a plane do not stop), a smaller time step, or place = "lattice"'
    )


@contextmanager
def _while_settling(scene: Scene) -> Iterator[None]:
    """Tell that a failure is one of the settling; its log is gone with it."""
    try:
        yield
    except SolverMissingError:
        raise
    except RunError as error:
        text = f"{scene.name}: while the particles settled: {str(error).partition('; log: ')[0]}"
        raise RunError(text, failure_of(error)) from error


def _corners(scene: Scene) -> Iterator[Array]:
    """The corners of the box that is simulated."""
    low, high = scene.extent
    for corner in itertools.product(*zip(low, high, strict=True)):
        yield np.array(corner)


def _run_in_parts(dem: LiggghtsDem, steps: int, particles: int, told: Callable[[int], None]) -> None:
    """Run ``steps`` in parts of a few seconds, and tell after each how many are done."""
    part, done = max(1, _PART // particles), 0
    while done < steps:
        check_stop()
        number = min(part, steps - done)
        dem.run(number)
        done += number
        told(done)


def _looks_left(shares: list[float], falling: int) -> int:
    """Return after how many more looks the particles will be at rest, by how their energy has decayed since the fall.

    ``shares``: the energy at each look so far; ``falling``: looks that the fall takes.
    """
    done = len(shares) - 1
    usual = max(falling + _USUAL - done, 2)
    since = shares[falling + 1 :]
    if len(since) < 3 or not 0.0 < since[-1] < since[0]:
        return usual
    decay = math.log(since[0] / since[-1]) / (len(since) - 1)
    return max(math.ceil(math.log(max(since[-1] / RESTING, 1.0)) / decay) + 1, 1)


class _Said:
    """Says what is done and, after the first steps, how long it will take."""

    def __init__(self, scene: Scene, steps: int, dt: float, tell: Tell, progress: Progress | None) -> None:
        self._tell, self._progress = tell, progress
        tell(
            f"packing: {scene.number} particles settle in LIGGGHTS before the run, about {steps:.2g} steps of "
            f'{dt:.3g} s; the packing is kept for other runs of this scene (without: place = "lattice")'
        )
        self._began: float | None = None

    def __call__(self, total: int, before: int, now: int) -> None:
        """Take note of ``before`` + ``now`` steps of ``total``."""
        done = before + now
        if self._progress is not None:
            self._progress(done, total)
        if self._began is not None:
            seconds = (awake() - self._began) * (total - done) / done
            if seconds > _LONG:
                self._tell(f"packing: that will take about {timedelta(seconds=round(seconds))}")
        self._began = awake() if done == 0 else None


def _key(model: Plan, start: Start) -> str:
    """Return a hash of all that a settled packing depends on."""
    deck = bed_deck(model, start)
    assert deck.start is not None  # noqa: S101  # it was given
    inputs = [deck_text(deck), data_text(deck, deck.start), RESTING, PATIENCE]
    return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()


def _store(path: Path, positions: Array) -> None:
    """Write beside ``path`` and move into place: others find no file, or a whole one."""
    with replacing(path) as file:
        np.savez(file, positions=positions)


def _load(path: Path, scene: Scene) -> Array | None:
    """Return the kept packing; None, with a warning, if the file is damaged: then it is made anew."""
    if not os.path.lexists(path):
        return None
    try:
        positions = np.asarray(read_npz(path, _MOST_BYTES)["positions"], dtype=np.float64)
        if scene.run.coupling is not None and (wrong := next(places(scene, positions), None)):
            raise ReadError(wrong.message)
    except (ReadError, KeyError) as error:
        logging.getLogger("kncal").warning("%s: damaged (%s); the packing is made anew", path, error)
        return None
    return positions
