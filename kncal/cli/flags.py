"""Flags that several commands share, as dataclasses that cyclopts flattens: of the case, the engine, one contact."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from kncal.cli import show
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.engines.base import Engine
    from kncal.physics.material import Material, Pair
    from kncal.physics.matrix import PairMatrix
    from kncal.scene.scene import Scene


Case = Annotated[str, Parameter(help="name of a shipped case, a case folder, or a case.toml")]
Json = Annotated[bool, Parameter(name="--json", help="print data for programs")]
ModelChoice = Annotated[
    Literal["both", "linear", "hertz"], Parameter(name="--model", help="which contact model to use")
]
Transport = Annotated[
    Literal["auto", "live", "restart"],
    Parameter(help="with gas: how gas and particles exchange data; auto: live if its adapter is built"),
]
Timeout = Annotated[float | None, Parameter(name="--timeout", help="wall-clock limit of each run [s]")]
Workers = Annotated[int | None, Parameter(help="number of runs at the same time; default: one per core (and rank)")]


def several(name: str, text: str) -> Parameter:
    """Return the parameter of a flag that may be repeated."""
    return Parameter(name=name, help=f"{text} (may be repeated)")


def refuse_ignored(beside: str, given: Iterable[str]) -> None:
    """Refuse the first of the flags ``given``, which would be ignored ``beside`` something else."""
    for name in given:
        raise InputError(f"{name} has no meaning with {beside}: leave it out")


def kinds(model: str) -> tuple[str, ...]:
    """Return the models that --model asks for."""
    return ("linear", "hertz") if model == "both" else (model,)


class Flags:
    """What all of these dataclasses can do."""

    def given(self) -> list[str]:
        """Return the flags that differ from their defaults."""
        changed = [f.name for f in fields(self) if getattr(self, f.name) != f.default]  # type: ignore[arg-type]
        return ["--set" if name == "overrides" else f"--{name.replace('_', '-')}" for name in changed]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CaseFlags(Flags):
    """Which values of a case are replaced, and where the results go."""

    overrides: Annotated[
        list[str] | None, several("--set", "KEY=VALUE: replace a value of the case file, e.g. run.until_time=0.2")
    ] = None
    out: Annotated[
        Path | None,
        Parameter(help="folder of the results; default: runs/<case>, of a study runs/<case>_<study>"),
    ] = None

    def load(self, case: str, study: str = "") -> tuple[Scene, Path]:
        """Return what ``case`` describes, with the values of --set, and the folder of the results."""
        from kncal.scene.case_file import load_case

        scene = load_case(case, overrides=self.overrides or ())
        return scene, self.out or Path("runs") / (f"{scene.name}_{study}" if study else scene.name)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class EngineFlags(Flags):
    """What simulates a case."""

    engine: Annotated[
        Literal["liggghts", "builtin", "liggghts-hooke"],
        Parameter(help="builtin: Python alone, for few bodies; liggghts-hooke: LIGGGHTS finds the stiffness itself"),
    ] = "liggghts"
    transport: Transport = "auto"

    def check(self, scene: Scene) -> None:
        """Refuse a flag that this scene would ignore."""
        from kncal.runs.solving import check_options

        check_options(scene, engine=self.engine, transport=self.transport)

    def measured(self, scene: Scene, folder: Path, timeout: float | None = None) -> Scene:
        """Return the scene with the impact speed that it asks to be measured, which may take runs in ``folder``."""
        if scene.contact.measured is None:
            return scene
        from kncal.runs.measure_speed import resolve_measured

        with show.working("measuring"):
            return resolve_measured(
                scene, folder, engine=self.engine, transport=self.transport, timeout=timeout, tell=show.note
            )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RanksFlags(EngineFlags):
    """What simulates a case, on how many processes."""

    ranks: Annotated[
        int, Parameter(name=("--ranks", "-n"), help="processes that share one run (MPI); with gas: they share the gas")
    ] = 1
    oversubscribe: Annotated[bool, Parameter(help="allow more ranks than cores")] = False

    def solver(self, scene: Scene) -> Engine:
        """Return the engine that runs this scene; refuses a flag that it would ignore."""
        from kncal.engines.registry import engine_for

        self.check(scene)
        return engine_for(scene, self.engine, self.transport, ranks=self.ranks, oversubscribe=self.oversubscribe)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MethodFlags(Flags):
    """How the linear stiffness is found."""

    method: Annotated[str, Parameter(help="method for k_n, see `kncal laws`")] = "mean_overlap"
    fraction: Annotated[float, Parameter(help="for limited_overlap: allowed overlap over the diameter")] = 0.01
    t_c: Annotated[float | None, Parameter(name="--t-c", help="for contact_time: duration of the contact [s]")] = None
    force: Annotated[float | None, Parameter(help="for static_load: force at rest [N]")] = None
    factor: Annotated[float, Parameter(help="for youngs_modulus: prefactor")] = 1.0

    @property
    def options(self) -> dict[str, Any]:
        """The options of all methods that are known."""
        given = {"fraction": self.fraction, "t_c": self.t_c, "force": self.force, "factor": self.factor}
        return {name: value for name, value in given.items() if value is not None}

    def own(self) -> dict[str, Any]:
        """Return the options of the method."""
        from kncal.physics.methods import METHODS

        return METHODS.find(self.method).own(self.options)


_OF_SECOND = "of the second sphere or of the wall; default: as the first"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ContactFlags(Flags):
    """One contact, as given on the command line; numbers in SI units."""

    young: Annotated[float | None, Parameter(help="Young's modulus E [Pa], e.g. 70e9")] = None
    poisson: Annotated[float, Parameter(help="Poisson's ratio")] = 0.25
    density: Annotated[float | None, Parameter(help="density [kg/m³]")] = None
    radius: Annotated[float | None, Parameter(help="radius of the sphere [m]")] = None
    v0: Annotated[float | None, Parameter(name=["--v0", "--v-0"], help="normal impact speed [m/s]")] = None
    en: Annotated[
        float | None, Parameter(name=["--en", "--e-n"], help="normal coefficient of restitution, in (0, 1]")
    ] = None
    law: Annotated[str, Parameter(help="reference law, see `kncal laws`")] = "tsuji"
    end: Annotated[
        Literal["overlap", "force"], Parameter(help="the contact ends at zero overlap, or at zero force")
    ] = "overlap"
    against: Annotated[
        Literal["sphere", "wall", "rigid-wall"],
        Parameter(help="a second sphere, a wall of a material, or a rigid wall"),
    ] = "sphere"
    young_2: Annotated[float | None, Parameter(help=_OF_SECOND)] = None
    poisson_2: Annotated[float | None, Parameter(help=_OF_SECOND)] = None
    density_2: Annotated[float | None, Parameter(help=_OF_SECOND)] = None
    radius_2: Annotated[float | None, Parameter(help="of the second sphere [m]; default: as the first")] = None

    @property
    def title(self) -> str:
        """What meets what, for a heading."""
        return f"sphere on {self.against.replace('-', ' ')}"

    def speed(self) -> float:
        """Return v_0 [m/s]."""
        return _needed("--v0", self.v0)

    def restitution(self) -> float:
        """Return e_n; 0 is refused with what to take instead."""
        if self.en == 0.0:
            from kncal.physics.timestep import USUAL_STEPS, instead_of_zero

            raise InputError(
                f"--en = 0: expected a value in (0, 1]; {instead_of_zero(USUAL_STEPS, ('linear', self.law), self.end)}"
            )
        return _needed("--en", self.en)

    def pair(self) -> Pair:
        """Return the pair of bodies.

        Raises
        ------
        InputError
            For a missing flag, a bad number, or a radius of a wall.
        """
        from kncal.physics.material import pair, wall_pair

        first, radius = self._first(), _needed("--radius", self.radius)
        second = self._second(first)
        if self.against == "sphere":
            return pair(first, radius, second, self.radius_2)
        if self.radius_2 is not None:
            raise InputError(
                f"--radius-2 = {self.radius_2:g}: a wall is flat; expected no second radius with --against wall"
            )
        return wall_pair(first, radius, None if self.against == "rigid-wall" else second)

    def bodies(self) -> tuple[Material, float, Callable[[Material, Any], Pair]]:
        """Return the first body's material and radius, and what makes the pair of them.

        A flag of the second body that is not given follows the first, also where that varies.
        """
        from kncal.physics.material import pair, wall_pair

        self.pair()  # refuses what is missing or wrong

        def meet(material: Material, radius: Any) -> Pair:
            second = self._second(material)
            if self.against == "sphere":
                return pair(material, radius, second, radius if self.radius_2 is None else self.radius_2)
            return wall_pair(material, radius, None if self.against == "rigid-wall" else second)

        return self._first(), _needed("--radius", self.radius), meet

    def matrix(self, how: MethodFlags) -> PairMatrix:
        """Return the calibrations of the pairs of these two bodies, for a deck: the flags' own contact among them."""
        from kncal.physics.matrix import calibrate_matrix

        first, radius = self._first(), _needed("--radius", self.radius)
        second = self._second(first)
        spheres = {"sphere": (first, radius)}
        walls: dict[str, Material | None] = {}
        if self.against != "sphere":
            walls["wall"] = None if self.against == "rigid-wall" else second
        else:
            if (second, self.radius_2 or radius) != (first, radius):
                spheres["sphere_2"] = (second, self.radius_2 or radius)
            walls["wall_of_same_material"] = first
        return calibrate_matrix(
            spheres,
            walls,
            v_0=self.speed(),
            e_n=self.restitution(),
            law=self.law,
            method=how.method,
            end=self.end,
            **how.own(),
        )

    def _first(self) -> Material:
        from kncal.physics.material import Material

        return Material(
            young=_needed("--young", self.young), poisson=self.poisson, density=_needed("--density", self.density)
        )

    def _second(self, first: Material) -> Material:
        if self.against == "rigid-wall":
            for flag in ("young_2", "poisson_2", "density_2"):
                if getattr(self, flag) is not None:
                    name = f"--{flag.replace('_', '-')}"
                    raise InputError(f"{name} has no meaning for a rigid wall: leave it out, or --against wall")
        changed = {"young": self.young_2, "poisson": self.poisson_2, "density": self.density_2}
        given: dict[str, Any] = {key: value for key, value in changed.items() if value is not None}
        return replace(first, **given)


def _needed(flag: str, value: float | None) -> float:
    if value is None:
        raise InputError(f"{flag} is missing: give the contact by flags (see `kncal kn --help`) or name a case")
    return value
