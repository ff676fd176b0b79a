"""Materials, and what two bodies in contact have in common: effective mass, radius, modulus.

Sources: Johnson, *Contact Mechanics* (1985), ch. 4, for the effective radius and modulus and the Hertz force.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from kncal.core.checks import Array, Range, common_shape, in_range, instance, positive

FloatOrArray = float | Array

#: Radii that have a contact mechanics [m]: from a few atoms to a kilometre.
RADII = (1e-9, 1e3)
_MATERIAL = "made by kncal.Material"
#: What the numbers of a material may be.
RANGES = {
    "young": Range(1e3, 1e13, "Pa", "Young's modulus is in Pa: 70 GPa is 70e9"),
    "poisson": Range(0.0, 0.5),
    "density": Range(10.0, 1e6, "kg/m³", "2.5 g/cm³ is 2500 kg/m³"),
    "yield_strength": Range(1.0, 1e13, "Pa"),
}


def plain(value: Array) -> FloatOrArray:
    """Return a Python float for a 0-d array, else the array itself."""
    return float(value) if value.ndim == 0 else value


@dataclass(frozen=True, kw_only=True)
class Material:  # noqa: PLW1641 - the dataclass makes its hash
    """An isotropic elastic material.

    Parameters
    ----------
    young : float or array
        Young's modulus [Pa], 1e3 to 1e13 (a value below is nearly always one in GPa or MPa).
    poisson : float or array
        Poisson's ratio [-], 0 to 0.5.
    density : float or array
        Density [kg/m³], 10 to 1e6 (a value below is nearly always one in g/cm³).
    yield_strength : float or array, optional
        Yield strength [Pa], 1 to 1e13; given, a calibration says when the impact would be plastic.
    name : str
        For tables and messages.

    Raises
    ------
    InputError
        If a value is not finite or out of its range, or arrays do not broadcast.
    """

    young: FloatOrArray
    poisson: FloatOrArray
    density: FloatOrArray
    yield_strength: FloatOrArray | None = None
    name: str = ""

    def __post_init__(self) -> None:
        given = {key: value for key in RANGES if (value := getattr(self, key)) is not None or key != "yield_strength"}
        checked = {key: RANGES[key].check(key, value) for key, value in given.items()}
        common_shape(**checked)
        instance("name", self.name, str, "a short text")
        for key, value in checked.items():
            object.__setattr__(self, key, plain(value))

    def __eq__(self, other: object) -> bool:
        """Whether every value is the same, also where they are arrays."""
        if not isinstance(other, Material):
            return NotImplemented
        return all(np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape that the values broadcast to; () for floats."""
        return _shape(self)

    @property
    def shear(self) -> FloatOrArray:
        """Shear modulus G = E / (2 (1 + nu)) [Pa]."""
        return self.young / (2.0 * (1.0 + self.poisson))

    @property
    def compliance(self) -> FloatOrArray:
        """(1 - nu²)/E [1/Pa], this body's share of 1/E_eff."""
        return (1.0 - self.poisson**2) / self.young

    @property
    def shear_compliance(self) -> FloatOrArray:
        """(2 - nu)/G [1/Pa], this body's share of 1/G_eff."""
        return (2.0 - self.poisson) / self.shear


@dataclass(frozen=True, eq=False)
class Pair:
    """Two bodies in contact (sphere–sphere or sphere–flat wall). Made by `pair` and `wall_pair`.

    Every field is a float or an array; arrays broadcast against each other.

    Attributes
    ----------
    m_eff : effective mass [kg], 1/m_eff = Σ 1/m_i (a wall has infinite mass)
    R_eff : effective radius [m], 1/R_eff = Σ 1/R_i (a flat wall has infinite radius)
    E_eff : effective modulus [Pa], 1/E_eff = Σ (1 - nu_i²)/E_i (a rigid wall drops its term)
    G_eff : effective shear modulus [Pa], 1/G_eff = Σ (2 - nu_i)/G_i
    R_min : radius of the smaller sphere [m]; the overlap is judged against it
    R_sum : sum of the radii [m] (against a wall: the sphere's radius)
    wave_speed : elastic wave speed of the slower body, sqrt(E/rho) [m/s]
    yield_strength : smaller yield strength of the two [Pa], or None if neither gives one
    size_ratio : larger radius over smaller [-] (1 against a wall)
    is_wall : whether the second body is a wall
    """

    m_eff: FloatOrArray
    R_eff: FloatOrArray
    E_eff: FloatOrArray
    G_eff: FloatOrArray
    R_min: FloatOrArray
    R_sum: FloatOrArray
    wave_speed: FloatOrArray
    yield_strength: FloatOrArray | None
    size_ratio: FloatOrArray
    is_wall: bool

    def __post_init__(self) -> None:
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "is_wall"}
        for name, value in numbers.items():
            if value is not None or name != "yield_strength":
                positive(name, value)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape that the fields broadcast to; () for floats."""
        return _shape(self)

    @property
    def k_h(self) -> FloatOrArray:
        """Hertz stiffness (4/3) E_eff sqrt(R_eff) [N/m^1.5]: F = k_h delta^1.5."""
        return 4.0 / 3.0 * self.E_eff * np.sqrt(self.R_eff)

    @property
    def k_t_ratio(self) -> FloatOrArray:
        """Mindlin ratio of tangential to normal tangent stiffness, 4 G_eff/E_eff [-].

        Mindlin, J. Appl. Mech. 16 (1949) 259: 8 G_eff a over 2 E_eff a; 2 (1 - nu)/(2 - nu) for equal materials.
        """
        return 4.0 * self.G_eff / self.E_eff


def _shape(of: Material | Pair) -> tuple[int, ...]:
    values = (getattr(of, f.name) for f in fields(of))
    return np.broadcast_shapes(*(value.shape for value in values if isinstance(value, np.ndarray)))


def sphere_mass(material: Material, radius: FloatOrArray) -> FloatOrArray:
    """Mass of a solid sphere [kg]."""
    return material.density * (4.0 / 3.0 * np.pi) * radius**3


def checked_radius(name: str, value: ArrayLike) -> FloatOrArray:
    """Return a sphere's radius [m] as a float or an array; `InputError` outside `RADII`."""
    hint = "a radius is in m: 1 mm is 1e-3"
    return plain(in_range(name, value, *RADII, unit="m", hint=hint))


def _smaller(a: FloatOrArray | None, b: FloatOrArray | None) -> FloatOrArray | None:
    if a is None or b is None:
        return a if b is None else b
    return plain(np.minimum(a, b))


def pair(
    material_1: Material,
    radius_1: ArrayLike,
    material_2: Material | None = None,
    radius_2: ArrayLike | None = None,
) -> Pair:
    """Two spheres in contact; the second is a copy of the first where it is not given.

    Parameters
    ----------
    material_1, material_2 : Material
    radius_1, radius_2 : float or array
        Radii [m], 1e-9 to 1e3.

    Raises
    ------
    InputError
        If a radius is not finite or out of its range, a material is none, or arrays do not broadcast.
    """
    instance("material_1", material_1, Material, _MATERIAL)
    other = material_1 if material_2 is None else instance("material_2", material_2, Material, _MATERIAL)
    r_1 = checked_radius("radius_1", radius_1)
    r_2 = r_1 if radius_2 is None else checked_radius("radius_2", radius_2)
    common_shape(material_1=material_1, radius_1=r_1, material_2=other, radius_2=r_2)
    m_1, m_2 = sphere_mass(material_1, r_1), sphere_mass(other, r_2)
    smaller, larger = np.minimum(r_1, r_2), np.maximum(r_1, r_2)
    return Pair(
        m_eff=m_1 * (m_2 / (m_1 + m_2)),
        R_eff=r_1 * (r_2 / (r_1 + r_2)),
        E_eff=1.0 / (material_1.compliance + other.compliance),
        G_eff=1.0 / (material_1.shear_compliance + other.shear_compliance),
        R_min=plain(smaller),
        R_sum=r_1 + r_2,
        wave_speed=plain(np.sqrt(np.minimum(material_1.young / material_1.density, other.young / other.density))),
        yield_strength=_smaller(material_1.yield_strength, other.yield_strength),
        size_ratio=plain(larger / smaller),
        is_wall=False,
    )


def wall_pair(material: Material, radius: ArrayLike, wall_material: Material | None = None) -> Pair:
    """A sphere against a flat wall; ``wall_material=None`` is a rigid wall.

    Raises
    ------
    InputError
        If the radius is not finite or out of 1e-9 to 1e3 m, a material is none, or arrays do not broadcast.
    """
    instance("material", material, Material, _MATERIAL)
    walls = () if wall_material is None else (instance("wall_material", wall_material, Material, _MATERIAL),)
    r = checked_radius("radius", radius)
    common_shape(material=material, radius=r, wall_material=walls[0] if walls else 0.0)
    speed_squared = material.young / material.density
    strength = material.yield_strength
    for wall in walls:
        speed_squared = plain(np.minimum(speed_squared, wall.young / wall.density))
        strength = _smaller(strength, wall.yield_strength)
    return Pair(
        m_eff=sphere_mass(material, r),
        R_eff=r,
        E_eff=1.0 / (material.compliance + sum(w.compliance for w in walls)),
        G_eff=1.0 / (material.shear_compliance + sum(w.shear_compliance for w in walls)),
        R_min=r,
        R_sum=r,
        wave_speed=plain(np.asarray(np.sqrt(speed_squared))),
        yield_strength=strength,
        size_ratio=1.0,
        is_wall=True,
    )
