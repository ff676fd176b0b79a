"""The particles at work: LIGGGHTS in a child process, which may end at any time without harm to this one.

A socket pair carries small messages, a mapping of anonymous memory the arrays; both are inherited, so nothing has a
name, and nothing is left when either side is gone. No wait is without a limit.
"""

from __future__ import annotations

import json
import mmap
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.disk import blame
from kncal.core.errors import InputError, RunError, SolverMissingError
from kncal.core.process import ProcessResult, signal_name, solver_environment
from kncal.core.solver_process import PeerLostError, SolverProcess
from kncal.engines.liggghts.c_library import LIBRARY
from kncal.engines.liggghts.deck import DECK, RESTART, bed_deck, deck_context, write_deck
from kncal.engines.liggghts.deck_description import Deck
from kncal.engines.liggghts.deck_walls import change_lines, change_times
from kncal.engines.liggghts.impacts import Surface, speed_edges
from kncal.engines.liggghts.library_child import SAVED_FORCES, VARIABLE
from kncal.engines.liggghts.shared import Shared, Sizes, histogram_edges
from kncal.record.facts import HEIGHTS, heights, room
from kncal.record.steps import DemStep, ParticleState
from kncal.scene.box_limits import places
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.scene import Scene

LOG = "log.liggghts"
#: What `LiggghtsDem.save` writes.
SAVED = (RESTART, SAVED_FORCES)

_START_LIMIT = 120.0  # s: deck, neighbour lists, and a machine that is busy with other things
_RUN_LIMIT = 10.0  # s, of any run; and
_STEP_LIMIT = 2e-5  # s per particle and step, a hundred times what one takes
_RANK_LIMIT = 0.1  # s per step for ranks that wait for each other, also where they have no core of their own
_SAVE_LIMIT = 300.0  # s, for slow disks


class LiggghtsDem:
    """Many particles in one LIGGGHTS (a `kncal.engines.base.ParticleSolver`).

    The child dies with the thread that made this object, also if that is killed. Use it from one thread.

    Parameters
    ----------
    model : Plan
    folder : Path
        The child's folder (made if missing): deck, particles, log.
    start : Start, None with ``restart``
    restart : Path, optional
        A folder that `save` wrote after the end of interval ``first``: go on from there, with the contact history.
    ranks : int
        Processes that share the particles; ``oversubscribe``: also more than there are cores.
    pass_fds : sequence of int
        Open descriptors that the child inherits, e.g. the lock of the run folder.

    Raises
    ------
    InputError
        If positions are missing, outside the column, or off the plane of a layer.
    RenderError
        If LIGGGHTS cannot simulate the model.
    RunError
        If LIGGGHTS ends while it reads the deck; the text holds its own.
    SolverMissingError
        If its library is not installed.
    """

    def __init__(
        self,
        model: Plan,
        folder: Path,
        start: Start | None,
        restart: Path | None = None,
        *,
        first: int = 0,
        ranks: int = 1,
        oversubscribe: bool = False,
        pass_fds: Sequence[int] = (),
    ) -> None:
        scene = model.scene
        self.histogram_edges = histogram_edges(scene.d_min)
        self.impact_edges = speed_edges()
        self.walls = () if scene.run.coupling is not None else (*scene.walls, *_held(scene))
        self._plan, self._folder = model, folder
        self._plane = middle(scene) if scene.layer else None
        self._cpu, self._waits = 0.0, _RANK_LIMIT if ranks > 1 else 0.0
        self._step = first * model.steps_per_coupling
        folder.mkdir(parents=True, exist_ok=True)
        if restart is not None:
            for name in SAVED:
                _copy_saved(restart / name, folder / name)
            self._deck = bed_deck(model, time=first * model.coupling, ranks=ranks)
        elif start is not None:
            _check_start(scene, start)
            self._deck = bed_deck(model, start, ranks=ranks)
        else:
            raise InputError("start: None, expected particles, or a restart folder")
        self._flowing: set[str] = set()
        write_deck(self._deck, folder)
        sizes = Sizes(scene.number, len(tuple(model.species.pairs())), len(self.walls), HEIGHTS)
        arguments = _arguments(model, self._deck, sizes) | {"saved": SAVED_FORCES if restart else ""}
        arguments |= self._of_walls(first) | {"ranks": ranks}
        # The child imports what this process imports.
        environment = solver_environment() | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        memory = os.memfd_create("kncal-particles", os.MFD_CLOEXEC)
        try:
            os.ftruncate(memory, sizes.bytes)
            buffer = mmap.mmap(memory, sizes.bytes)
            self._process = SolverProcess(
                "LIGGGHTS",
                [sys.executable, "-P", "-m", "kncal.engines.liggghts.library_child", json.dumps(arguments)],
                cwd=folder,
                log=folder / LOG,
                environment=environment,
                variable=VARIABLE,
                descriptor=memory,
                pass_fds=pass_fds,
                ranks=ranks,
                oversubscribe=oversubscribe,
            )
        finally:
            os.close(memory)
        self._shared = Shared.over(buffer, sizes)
        self._take(self._receive(_START_LIMIT), None)

    @property
    def step(self) -> int:
        """Number of the last step, counted from the start of the bed."""
        return self._step

    @property
    def cpu_seconds(self) -> float:
        """CPU time of the child so far [s]."""
        # Of several ranks the process that was started is their launcher, which has worked little.
        return max(self._process.cpu_seconds, self._cpu)

    @property
    def pid(self) -> int:
        """Number of the child process."""
        return self._process.pid

    def state(self) -> ParticleState:
        """Return a copy of the particles as they are; periodic coordinates within the box."""
        shared = self._open()
        return ParticleState(shared.x.copy(), shared.v.copy(), shared.spin.copy(), shared.kind.copy())

    def run(self, steps: int, force: Array | None = None) -> DemStep:
        """Hold ``force`` (n, 3) [N] on the particles, None: as before (at first none), and run ``steps``.

        Velocity Verlet opens the interval with half a kick of the last interval's force: half a step of lag. A layer
        takes no force across its plane: that component is left out, and its plane is checked to the last bit.

        Raises
        ------
        InputError
            If ``steps`` is not positive, or the forces are not (n, 3) finite numbers.
        RunError
            If LIGGGHTS ends or hangs, loses particles, stops early, or computes what is not finite.
        """
        shared = self._open()
        if steps < 1:
            raise InputError(f"steps = {steps}: expected at least 1")
        if force is not None:
            given = np.asarray(force, dtype=np.float64)
            if given.shape != shared.force.shape or not np.isfinite(given).all():
                raise InputError(f"force: shape {given.shape}, expected {shared.force.shape} finite numbers [N]")
            shared.force[:] = given
            if self._plane is not None:
                shared.force[:, 1] = 0.0
        self._insert()
        request = {"do": "run", "steps": steps, "with_force": force is not None}
        limit = _RUN_LIMIT + _STEP_LIMIT * steps * (len(shared.x) + 100) + self._waits * steps
        answer = self._ask(request, limit, steps)
        return DemStep(
            floor_force=answer["floor"],
            other_walls_force=answer["other_walls"],
            contacts=answer["contacts"],
            overlap_max=answer["overlap_max"],
            overlap_mean=answer["overlap_mean"],
            histogram=shared.histogram.copy(),
            watched=answer["watched"],
            impacts=shared.impacts.copy(),
            impact_sums=shared.impact_sums.copy(),
            out_number=np.array(answer["out_number"], dtype=np.int64),
            out_mass=np.array(answer["out_mass"], dtype=np.float64),
            wall_force=shared.wall_force.copy(),
        )

    def _insert(self) -> None:
        """Let those streams bring particles in the next step that are due then."""
        lines = []
        for stream in self._deck.streams:
            found = stream.insert_lines(self._step, self._plan.dt, again=stream.fix in self._flowing)
            self._flowing |= {stream.fix} if found else set()
            lines += found
        if lines:
            self._ask({"do": "change", "commands": lines, "walls": {}}, _START_LIMIT, 0)

    def end_interval(self, number: int) -> None:
        """Carry out what happens to walls at the end of interval ``number``."""
        deck = self._deck
        times = {round(time / deck.every): time for time in change_times(deck.walls, deck.every)}
        if number not in times:
            return
        context = deck_context(deck)
        words = str(context["selectors"]), str(context["switches"])
        lines = change_lines(deck.walls, times[number], deck.every, *words)
        self._ask({"do": "change", "commands": lines, "walls": self._of_walls(number)}, _START_LIMIT, 0)

    def _of_walls(self, number: int) -> dict[str, Any]:
        """Return what the child has to know of the walls that are there after interval ``number``."""
        there = [wall for wall in self._deck.walls if wall.there(number * self._deck.every, self._deck.every)]
        place = {name: i for i, name in enumerate(self.walls)}
        plain = [wall for wall in there if not wall.is_mesh]
        return {
            "surfaces": [
                Surface(wall.kind, "xyz".index(wall.axis), wall.position, wall.centre, wall.radius) for wall in plain
            ],
            "meshes": [{"kind": wall.kind, "wall": place[wall.name]} for wall in there if wall.is_mesh],
            "forces": [(place[wall.name], f"force_{wall.fix}") for wall in plain if wall.name in place],
        }

    def save(self, folder: Path) -> None:
        """Write the state (contact history included) into ``folder``, made if missing: the files `SAVED`.

        This run goes on from the very state that was written, so that a continued run repeats it bit by bit. A run that
        was never saved differs at most by rounding, from particles brought back into a periodic box (1e-13 m after
        40 couplings); without periodic sides it was found to be the same, too.
        """
        self._ask({"do": "save"}, _SAVE_LIMIT, 0)
        folder.mkdir(parents=True, exist_ok=True)
        for name in SAVED:
            shutil.move(self._folder / name, folder / name)

    def close(self) -> None:
        """End the child; leaves no process and no file descriptor behind. May be called twice."""
        self._process.end()

    def __enter__(self) -> LiggghtsDem:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _open(self) -> Shared:
        if self._process.ended:
            raise RunError(f"{self._folder}: LIGGGHTS has ended, nothing more can be asked of it; log: {self._log}")
        return self._shared

    @property
    def _log(self) -> Path:
        return self._folder / LOG

    def _ask(self, request: dict[str, Any], limit: float, steps: int) -> dict[str, Any]:
        self._open()
        self._process.send(json.dumps(request).encode())
        answer = self._receive(limit)
        self._take(answer, steps)
        return answer

    def _receive(self, limit: float) -> dict[str, Any]:
        """Return the next answer, within ``limit`` [s]; whatever else happens ends the child."""
        try:
            answer: dict[str, Any] = json.loads(self._process.receive(limit))
        except PeerLostError as error:
            raise self._failure(error.result) from error
        return answer

    def _take(self, answer: dict[str, Any], steps: int | None) -> None:
        """Book an answer; refuse a state that no one should go on with."""
        shared = self._open()
        problem, failure = "", "solver-error"
        begin = len(shared.x) - sum(stream.total for stream in self._deck.streams)
        due = begin + sum(stream.number_by(answer["step"]) for stream in self._deck.streams)
        if answer["come"] < due:
            problem = (
                f"{answer['come'] - begin} particles were inserted, expected {due - begin} by now: the region of a "
                "stream is too full; expected a larger region, a faster stream or a smaller rate"
            )
            failure = "lost-particles"
        elif answer["count"] != due - answer["deleted"]:
            problem = (
                f"{answer['count']} particles are left of {due}, and {answer['deleted']} passed outlets: some left "
                f"the domain elsewhere, by t = {answer['step'] * self._deck.dt:.3g} s. It is {_reach(self._deck)}: "
                "expected walls or an outlet where they leave, or a larger [domain]"
            )
            failure = "lost-particles"
        elif steps is not None and answer["step"] != self._step + steps:
            problem = f"it stopped at step {answer['step']}, expected {self._step + steps}: was it sent a signal?"
        elif not all(np.isfinite(part[shared.kind >= 0]).all() for part in (shared.x, shared.v)):
            problem = "positions or velocities are not finite: do two particles start at one point, is dt too large?"
            failure = "not-finite"
        elif not answer["in_plane"]:
            problem = f"particles move or spin out of the plane y = {self._plane!r} m of the layer"
        self._step, self._cpu = answer["step"], answer["cpu"]
        if problem:
            self._process.kill()
            raise RunError(f"LIGGGHTS: {problem}; log: {self._log}", failure)

    def _failure(self, ended: ProcessResult) -> RunError:
        how = f"ended with exit code {ended.returncode}"
        if ended.signal is not None:
            how = f"ended by signal {ended.signal} ({signal_name(ended.signal)})"
        lines = [line for line in ended.last_lines if line]
        if any(LIBRARY in line and "cannot open" in line for line in lines):
            return SolverMissingError(f"{LIBRARY} is not installed: apt-get install liggghts; log: {self._log}")
        errors = [line for line in lines if line.startswith("ERROR")]
        text = errors[0] if errors else " | ".join(lines[-3:]) or "(no output)"
        failure = "solver-error" if ended.signal is None else "peer-died"
        if "lost atoms" in text.lower():
            text = (
                f"particles left the domain, which is {_reach(self._deck)} (LIGGGHTS' counts mean nothing): {text}; "
                "expected walls or an outlet where they leave, or a larger domain"
            )
            failure = "lost-particles"
        failure, text = blame(failure, f"LIGGGHTS {how}: {text}; log: {self._log}", self._folder)
        return RunError(text, failure)


def _reach(deck: Deck) -> str:
    """Return the box of a deck in words."""
    return ", ".join(
        f"from {low:.4g} to {high:.4g} m in {axis}" for axis, (low, high) in zip("xyz", deck.box, strict=True)
    )


def _arguments(model: Plan, deck: Deck, sizes: Sizes) -> dict[str, object]:
    """Return what the child has to know, as `kncal.engines.liggghts.library_child.Child` takes it."""
    scene, species = model.scene, model.species
    low, size = room(scene)
    up = scene.up.tolist()
    return {
        "sizes": sizes,
        "deck": DECK,
        "dt": model.dt,
        "d_min": scene.d_min,
        "gravity": scene.g,
        "up": up,
        "plane": middle(scene) if scene.layer else None,
        "low": low,
        "periods": [side if axis in deck.periodic else 0.0 for axis, side in zip("xyz", size, strict=True)],
        "heights": heights(low, size, up).tolist(),
        "pairs": list(species.pairs()),
        "kinds": len(species.members),
        "floor": deck.has_floor,
        "held": [i for i, c in enumerate(scene.classes) if c.group in scene.held],
        "outlets": [
            {
                "fix": outlet.fix,
                "deletes": outlet.deletes,
                "axis": "xyz".index(outlet.axis),
                "position": scene.outlets[outlet.name].position,
                "reach": scene.d_max,
            }
            for outlet in deck.outlets
        ],
        "flows": bool(deck.outlets or deck.streams),
    }


def _held(scene: Scene) -> tuple[str, ...]:
    """Return the name under which the force on frozen particles is recorded: LIGGGHTS knows that on all together."""
    return ("+".join(scene.held),) if scene.held else ()


def middle(scene: Scene) -> float:
    """Return the y of a layer's plane [m]."""
    return 0.5 * scene.box.depth


def _check_start(scene: Scene, start: Start) -> None:
    x, v = start.x, start.v
    if scene.run.coupling is not None and (wrong := next(places(scene, x), None)):
        raise InputError(f"{scene.name}: {wrong.message}")
    for name, part in (("x", x), ("v", v), ("spin", start.spin)):
        if part.shape != (len(start.kind), 3) or not np.isfinite(part).all():
            raise InputError(f"{name} of shape {part.shape}: expected {(len(start.kind), 3)}, finite")
    if scene.layer:
        y = middle(scene)
        if (x[:, 1] != y).any():
            raise InputError(f"positions: a layer lies in the plane y = depth/2 = {y!r} m, some are beside it")
        if v[:, 1].any():
            raise InputError("velocities: a layer has none across its plane, expected vy = 0 for all")


def _copy_saved(source: Path, target: Path) -> None:
    try:
        shutil.copyfile(source, target)
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror}); expected what `save` wrote") from error
