"""The flags that describe one contact on the command line: two bodies, a speed, a restitution, a law."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.physics.material import Material, Pair
    from kncal.physics.matrix import PairMatrix

_OF_SECOND = "of the second sphere or of the wall; default: as the first"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ContactFlags:
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
    end: Annotated[Literal["overlap", "force"], Parameter(help="the contact ends at zero overlap or at zero force")] = (
        "overlap"
    )
    against: Annotated[
        Literal["sphere", "wall", "rigid-wall"], Parameter(help="a second sphere, a wall of a material, a rigid wall")
    ] = "sphere"
    young_2: Annotated[float | None, Parameter(help=_OF_SECOND)] = None
    poisson_2: Annotated[float | None, Parameter(help=_OF_SECOND)] = None
    density_2: Annotated[float | None, Parameter(help=_OF_SECOND)] = None
    radius_2: Annotated[float | None, Parameter(help="of the second sphere [m]; default: as the first")] = None

    def given(self) -> list[str]:
        """Return the flags that differ from their defaults."""
        return [f"--{f.name.replace('_', '-')}" for f in fields(self) if getattr(self, f.name) != f.default]

    def title(self) -> str:
        """Return what meets what, for a heading."""
        return {"sphere": "sphere on sphere", "wall": "sphere on wall", "rigid-wall": "sphere on rigid wall"}[
            self.against
        ]

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

        first, radius, second = self._first(), _needed("--radius", self.radius), self._second()
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
            changed = {"young": self.young_2, "poisson": self.poisson_2, "density": self.density_2}
            given: dict[str, Any] = {key: value for key, value in changed.items() if value is not None}
            second = replace(material, **given)
            if self.against == "sphere":
                return pair(material, radius, second, radius if self.radius_2 is None else self.radius_2)
            return wall_pair(material, radius, None if self.against == "rigid-wall" else second)

        return self._first(), _needed("--radius", self.radius), meet

    def matrix(self, method: str, options: Mapping[str, Any]) -> PairMatrix:
        """Return the calibrations of the pairs of these two bodies, for a deck: the flags' own contact among them."""
        from kncal.physics.matrix import calibrate_matrix

        first, radius, second = self._first(), _needed("--radius", self.radius), self._second()
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
            method=method,
            end=self.end,
            **options,
        )

    def _first(self) -> Material:
        from kncal.physics.material import Material

        return Material(
            young=_needed("--young", self.young), poisson=self.poisson, density=_needed("--density", self.density)
        )

    def _second(self) -> Material:
        from kncal.physics.material import Material

        first = self._first()
        return Material(
            young=first.young if self.young_2 is None else self.young_2,
            poisson=first.poisson if self.poisson_2 is None else self.poisson_2,
            density=first.density if self.density_2 is None else self.density_2,
        )


def _needed(flag: str, value: float | None) -> float:
    if value is None:
        raise InputError(f"{flag} is missing: give the contact by flags (see `kncal kn --help`) or name a case")
    return value
