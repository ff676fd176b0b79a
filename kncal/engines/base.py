"""What an engine is, and the two sides of a coupled one: the gas and the particles.

Row order: every particle array has one row for each particle that will ever be there, always the same one.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

from kncal import __version__
from kncal.core.checks import Array
from kncal.core.disk import blame
from kncal.core.errors import InputError, KncalError, ReadError, SolverMissingError, failure_of
from kncal.record.frames import Trajectory
from kncal.record.liggghts_dump import read_trajectory
from kncal.record.outcome import RunResult
from kncal.record.steps import DemStep, GasFields, GasStep, ParticleState
from kncal.scene.gas import Jet
from kncal.scene.model import Plan
from kncal.scene.placement import Start
from kncal.scene.scene import Depth, Scene
from kncal.scene.values import (
    Cells,
    GasDensity,
    GasSpeed,
    GasViscosity,
    Number,
    Seconds,
    Size,
    Word,
    checked_class,
    within,
)

#: The recorded frames of a run, in its folder.
FRAMES = "particles.dump"

#: Called while a run goes on with (steps done, steps in all), of a coupled one with couplings.
Progress = Callable[[int, int], None]
#: Called with a sentence about what is done.
Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Profile:
    """What this machine has of an engine: ``program`` is None (and ``problem`` says why) if it is missing.

    ``warning`` says what is unusual about one that is there; ``environment`` is all that its process is given.
    """

    engine: str
    program: Path | None
    version: str
    problem: str = ""
    warning: str = ""
    environment: Mapping[str, str] = field(default_factory=dict)


class Engine(ABC):
    """What makes a run of a plan: `render` writes its input, `run` solves it, `read` parses what it left.

    Attributes
    ----------
    name : as in `kncal.engines.registry.ENGINES`
    ranks : number of processes that share one run
    written_by_run : parts of the input that `run` writes itself: a run folder begins without them
    """

    name: str
    ranks: int = 1
    written_by_run: tuple[str, ...] = ()

    @abstractmethod
    def profile(self) -> Profile:
        """Look for the solver on this machine."""

    def check(self, scene: Scene, *, by_hand: bool = False) -> None:
        """Refuse a scene that this engine cannot run (``by_hand``: that it cannot render).

        Raises
        ------
        InputError
            Saying why.
        """
        if scene.coupled:
            raise InputError(f"{scene.name}: the engine {self.name} has no gas; expected the engine coupled")

    def start(self, scene: Any, *, tell: Tell | None = None, progress: Progress | None = None) -> Start | None:
        """Return the particles of all plans of a scene at their start; None: as the scene says."""
        del scene, tell, progress
        return None

    @abstractmethod
    def command(self, plan: Any, *, by_hand: bool = False) -> tuple[str, ...]:
        """Return the command that `run` starts in the run's folder."""

    @abstractmethod
    def render(self, plan: Any, folder: Path, *, start: Start | None = None, by_hand: bool = False) -> None:
        """Write the solver's input for ``plan`` into ``folder`` (exists, empty).

        ``start``: from `start`; ``by_hand``: for a person to run, not for `run`.
        """

    def resumes_at(self, plan: Any, folder: Path) -> str:
        """Say where an unfinished run in ``folder`` can resume; empty: nowhere."""
        del plan, folder
        return ""

    @abstractmethod
    def run(
        self,
        plan: Any,
        folder: Path,
        *,
        start: Start | None = None,
        timeout: float | None = None,
        progress: Progress | None = None,
        resume: bool = False,
        pass_fds: Sequence[int] = (),
    ) -> RunResult:
        """Run what `render` wrote; never raises for a failed run, the status says so.

        Parameters
        ----------
        start : from `start`
        timeout : wall-clock limit [s]
        resume : go on from where `resumes_at` says
        pass_fds : descriptors that a solver's process inherits (the lock of the run folder)
        """

    def read(self, plan: Any, folder: Path) -> Trajectory:
        """Read the recorded frames of a completed run; see `read_frames`."""
        return read_frames(plan, folder)


def run_result(engine: str, model: Plan, folder: Path, status: str, **fields: Any) -> RunResult:
    """Return the result of a run of ``model``; what is not in ``fields`` is empty or zero."""
    rest: dict[str, Any] = {"cpu_seconds": 0.0, "wall_seconds": 0.0, "version": ""} | fields
    return RunResult(
        status=status, engine=engine, model=model.kind, folder=folder, steps=model.n_steps, dt=model.dt, **rest
    )


def guarded(engine: str, model: Plan, folder: Path, work: Callable[[], Mapping[str, Any]], **known: Any) -> RunResult:
    """Return the result of a run that ``work`` does, with the fields that it returns; its errors become a status.

    ``known``: fields that also a failed run has. Without others the costs are those of this thread.
    """
    wall, cpu = time.monotonic(), time.thread_time()
    status, found = "completed", {"version": __version__} | known
    try:
        found |= work()
    except SolverMissingError as error:
        status, found["message"] = "not_installed", str(error)
    except KeyboardInterrupt:
        status, found["message"] = "interrupted", "interrupted by the user"
    except TimeoutError as error:
        status, found["message"] = "timed_out", str(error)
    except MemoryError:
        status, found["failure"] = "failed", "killed"
        found["message"] = "out of memory: record fewer frames, or make the run shorter"
    except (KncalError, OSError) as error:
        status = "failed"
        found["failure"], found["message"] = blame(failure_of(error), str(error), folder)
    costs: dict[str, Any] = {"wall_seconds": time.monotonic() - wall, "cpu_seconds": time.thread_time() - cpu}
    return run_result(engine, model, folder, **({"status": status} | costs | found))


def read_frames(model: Plan, folder: Path) -> Trajectory:
    """Read the recorded frames of a completed run of ``model``.

    Raises
    ------
    ReadError
        If the frames are missing, truncated, not those of the model's particles, or do not span the model's steps.
    """
    particles = model.scene.spheres
    path = folder / FRAMES
    frames = read_trajectory(path, tuple(p.name for p in particles), [p.radius for p in particles], model.dt)
    first, last = int(frames.step[0]), int(frames.step[-1])
    if (first, last) != (0, model.n_steps):
        raise ReadError(f"{path}: frames of step {first} to {last}, expected 0 to {model.n_steps}: not of this run")
    return frames


@checked_class
class GasSetup:
    """All that the gas side needs to know.

    Attributes
    ----------
    size : (3,) box [m]; cells : number of cells per axis
    inlet : superficial velocity through the floor [m/s] (0 with a jet); jet : Jet or None
    density [kg/m³], viscosity (dynamic) [Pa s], gravity (downwards) [m/s²]
    step : gas step [s]
    drag : name of the drag law (`kncal.physics.drag.DRAGS`)
    walls : "slip" or "noSlip"; front_back : "walls", "periodic" or "layer" (no gas motion in y: patch type empty)
    parcels_per_particle : 1, 8 or 27
    """

    size: Size
    cells: Cells
    inlet: GasSpeed
    jet: Jet | None
    density: GasDensity
    viscosity: GasViscosity
    gravity: Annotated[Number, within(0.0, 1e5, "m/s²")]
    step: Seconds
    drag: Word = "ErgunWenYu"
    walls: Literal["slip", "noSlip"] = "slip"
    front_back: Depth = "walls"
    parcels_per_particle: Literal[1, 8, 27] = 1


def gas_setup(model: Plan) -> GasSetup | None:
    """Return what the gas side needs to know, None for a bed without gas."""
    scene, gas = model.scene, model.scene.gas
    if gas is None:
        return None
    return GasSetup(
        size=scene.box.size,
        cells=gas.cells,
        inlet=gas.inlet_at(0.0),
        jet=gas.jet,
        density=gas.density,
        viscosity=gas.viscosity,
        gravity=scene.g,
        step=model.gas_step,
        drag=gas.drag,
        walls=gas.walls,
        front_back=scene.front_back,
        parcels_per_particle=gas.parcels_per_particle,
    )


class _Side(Protocol):
    """A solver at work, of the gas or of the particles."""

    def save(self, folder: Path) -> None:
        """Write the state after the last step into ``folder`` (made if missing)."""
        ...

    @property
    def cpu_seconds(self) -> float:
        """CPU time of the solver's processes so far [s]."""
        ...

    def close(self) -> None:
        """End the solver; leaves no process, file descriptor or shared memory behind. May be called twice."""
        ...


class GasSolver(_Side, Protocol):
    """One gas solver at work. `step` may be called with a changing number of particles."""

    setup: GasSetup

    def step(self, x: Array, v: Array, diameter: Array, density: Array) -> GasStep:
        """Advance the gas by one step with particles at ``x``, ``v`` (n, 3), of ``diameter``, ``density`` (n,).

        Raises RunError with the solver's own error text if it ends, hangs, or loses a parcel.
        """
        ...

    def set_inlet(self, velocity: float) -> None:
        """Change the superficial inlet velocity for the following steps [m/s]."""
        ...

    def fields(self) -> GasFields:
        """Return the gas fields after the last step."""
        ...

    def load(self, folder: Path) -> None:
        """Take up a state that `save` of any gas solver wrote, before the first `step`."""
        ...


class ParticleSolver(_Side, Protocol):
    """The particles at work; `histogram_edges` [m] and `impact_edges` [m/s] as in `kncal.record.facts.BedFacts`.

    ``walls``: names of the walls whose forces it tells.
    """

    histogram_edges: Array
    impact_edges: Array
    walls: tuple[str, ...]

    def state(self) -> ParticleState:
        """Return a copy of the particles as they are."""
        ...

    def run(self, steps: int, force: Array | None) -> DemStep | None:
        """Hold ``force`` (n, 3) [N] on the particles and run; RunError if the solver ends, hangs or loses particles.

        ``force`` None: there is no gas. What is returned is None if nothing was observed, since nothing moves.
        """
        ...

    def end_interval(self, number: int) -> None:
        """Carry out what happens to walls at the end of interval ``number``, from 1; before the state is saved."""
        ...
