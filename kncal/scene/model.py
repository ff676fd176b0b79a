"""A scene with numbers: the contact of every pair, for one model ("linear" or "hertz"), and the time step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from kncal.scene.scene import Scene
from kncal.scene.species import SpeciesPair, SpeciesTable, species_of

KINDS = ("linear", "hertz")


@dataclass(frozen=True, kw_only=True)
class PairContact:
    """The contact of one pair of bodies, in the numbers a solver works with.

    Normal force (positive = repulsion): F = k delta^n + c delta^p delta_dot.
    Tangential force: -k_t delta^(n-1) s - c_t delta_dot_t (linear) or the Mindlin form (hertz), cut at friction·|F|.

    Attributes
    ----------
    law : "linear", "tsuji", "hertz", ...
    k : normal stiffness: k_n [N/m] (linear) or k_h [N/m^1.5]
    n : stiffness exponent, 1 or 1.5
    c : damping coefficient [N s/m^(1+p)]; eta_n of the linear law
    p : damping exponent: 0 (linear), 0.25 (tsuji), 0.5, 1.5
    end : "overlap", or "force": attraction is cut off
    e_n : normal restitution asked for [-]
    v_0 : impact speed calibrated at [m/s], or None where k_n was prescribed
    t_c : duration of the contact at v_0 [s] (linear with prescribed k_n: independent of speed)
    delta_max : maximum overlap at v_0 [m], None without v_0
    m_eff, R_eff, E_eff, G_eff : of the pair [kg], [m], [Pa], [Pa]
    friction : Coulomb coefficient [-]
    k_t : tangential stiffness: [N/m] (linear), or 8 G_eff sqrt(R_eff) [N/m^1.5], times sqrt(delta) (hertz)
    warnings : what the calibration says about this pair, code -> sentence
    """

    law: str
    k: float
    n: float
    c: float
    p: float
    end: str
    e_n: float
    v_0: float | None
    t_c: float
    delta_max: float | None
    m_eff: float
    R_eff: float
    E_eff: float
    G_eff: float
    friction: float
    rolling_friction: float
    k_t: float
    warnings: Mapping[str, str] = field(default_factory=dict)

    def overlap_under(self, force: float) -> float:
        """Return the overlap [m] at which the spring carries ``force`` [N]: (F/k)^(1/n)."""
        return float((force / self.k) ** (1.0 / self.n))


def distinct(contacts: Mapping[tuple[str, str], PairContact]) -> dict[tuple[str, str], tuple[PairContact, int]]:
    """Return each contact once, with the number of pairs that have it, under the names of the first of them."""
    first: dict[int, tuple[str, str]] = {}
    number: dict[int, int] = {}
    for names, contact in contacts.items():
        first.setdefault(id(contact), names)
        number[id(contact)] = number.get(id(contact), 0) + 1
    return {names: (contacts[names], number[which]) for which, names in first.items()}


@dataclass(frozen=True, kw_only=True)
class Model:
    """One model of a scene, ready to be rendered or integrated.

    Attributes
    ----------
    scene : Scene
    kind : "linear" or "hertz"
    contacts : (name, name) of two bodies, in the order of `Scene.body_pairs` -> PairContact; the same for all
        pairs of bodies of one pair of species, but for the t_c of bodies that start pressed together
    unmet : contacts of pairs of species that no two bodies of this scene form (a species of one body with itself): a
        deck that is used further needs them; pairs that cannot be calibrated are missing
    dt : time step [s]
    t_end : end time [s]
    n_steps : number of steps, ceil(t_end/dt)
    record_every : steps between frames in contact
    flight_every : most steps between frames in flight; an engine takes fewer where a touch may come
    """

    scene: Scene
    kind: str
    contacts: Mapping[tuple[str, str], PairContact]
    dt: float
    t_end: float
    n_steps: int
    record_every: int
    flight_every: int
    unmet: Mapping[SpeciesPair, PairContact] = field(default_factory=dict)

    @cached_property
    def species(self) -> SpeciesTable:
        """The species of the scene's bodies."""
        return species_of(self.scene)

    @cached_property
    def by_species(self) -> Mapping[SpeciesPair, PairContact]:
        """The contacts by pair of species, of the pairs that bodies of the scene form."""
        found: dict[SpeciesPair, PairContact] = {}
        for names, contact in self.contacts.items():
            found.setdefault(self.species.pair_of(names), contact)
        return found

    def without_friction(self) -> Model:
        """Return the same model with smooth contacts: its normal motion is that of a sphere on a wall with friction."""
        return replace(self, contacts={names: replace(c, friction=0.0) for names, c in self.contacts.items()})
