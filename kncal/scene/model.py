"""A scene with numbers: the contact of every pair, for one model ("linear" or "hertz"), time step and schedule."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from kncal.core.checks import Array
from kncal.physics.cohesion import pull_off
from kncal.physics.tangential import stick_restitution
from kncal.scene.needs import Needs
from kncal.scene.scene import Scene
from kncal.scene.species import SpeciesPair, SpeciesTable, species_of

KINDS = ("linear", "hertz")


@dataclass(frozen=True, kw_only=True)
class PairContact:
    """The contact of one pair of bodies, in the numbers a solver works with.

    Normal force (positive = repulsion): F = k delta^n + c delta^p delta_dot; cohesion pulls beside it.
    Tangential force: -k_t delta^(n-1) s - c_t delta^p u of a spring stretched by s, with the velocity u of the contact
    point; where the spring pulls with more than friction·|F| it slips at that force, without damping. Without the
    spring the dashpot alone pulls, with friction·|F| at most.

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
    c_t : tangential damping [N s/m^(1+p)]
    spring : whether the contact has its tangential spring
    rolling_model, rolling_damping : as in the case
    cohesion : energy density of the attraction by contact area [J/m³]
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
    c_t: float = 0.0
    spring: bool = True
    rolling_model: str = "cdt"
    rolling_damping: float = 0.0
    cohesion: float = 0.0
    warnings: Mapping[str, str] = field(default_factory=dict)

    def force(self, delta: Array, delta_dot: Array) -> Array:
        """Return the normal force [N] while the bodies touch; without its attraction for the end "force"."""
        force: Array = self.k * delta**self.n + self.c * delta**self.p * delta_dot
        return np.maximum(force, 0.0) if self.end == "force" else force

    def stick_restitution(self) -> float | None:
        """Return -u(t_c)/u(0) of the contact point if it never slips (`kncal.physics.tangential`); None without v_0."""
        if self.v_0 is None and self.n != 1.0:
            return None
        numbers = {key: getattr(self, key) for key in ("n", "p", "k", "c", "c_t", "m_eff", "end")}
        return stick_restitution(
            **numbers, k_t=self.k_t if self.spring else 0.0, v_0=1.0 if self.v_0 is None else self.v_0
        )

    def pull_off(self) -> float:
        """Return the largest force [N] that the contact at rest resists when it is pulled; 0 of a linear one."""
        return pull_off(self.k, self.n, self.cohesion, self.R_eff)

    def overlap_under(self, force: float) -> float:
        """Return the overlap [m] at which the spring carries ``force`` [N]: (F/k)^(1/n)."""
        return float((force / self.k) ** (1.0 / self.n))


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A scene with numbers, for one model: what rendering and running need, decided once by `kncal.scene.plan`.

    Attributes
    ----------
    scene : the scene
    kind : "linear" or "hertz"
    needs : which physics the scene requires
    contacts : pair of species -> PairContact, of the pairs that bodies of the scene form, in the order of its bodies;
        t_c is that of the two bodies that start deepest in each other. Empty where no contact is computed
    unmet : contacts of pairs of species that no two bodies of this scene form (a species of one body with itself): a
        deck that is used further needs them; pairs that cannot be calibrated are missing
    dt : time step of the particles [s]
    t_end : end time [s]
    n_steps : number of steps
    record_every, flight_every : steps between frames in contact, and most steps between frames in flight (an engine
        takes fewer where a touch may come); 0 where frames go with couplings
    steps_per_coupling, couplings : steps in a coupling interval, and the number of these; 0: nothing is coupled
    coupling : coupling interval [s], exactly ``steps_per_coupling * dt``
    frames_every : couplings between recorded frames
    gas_steps : gas steps per coupling interval
    """

    scene: Scene
    kind: str
    needs: Needs
    contacts: Mapping[SpeciesPair, PairContact]
    unmet: Mapping[SpeciesPair, PairContact] = field(default_factory=dict)
    dt: float
    t_end: float = math.nan
    n_steps: int = 0
    record_every: int = 0
    flight_every: int = 0
    steps_per_coupling: int = 0
    couplings: int = 0
    frames_every: int = 0
    gas_steps: int = 1

    @cached_property
    def species(self) -> SpeciesTable:
        """The species of the scene's bodies."""
        return species_of(self.scene)

    @cached_property
    def named(self) -> Mapping[tuple[str, str], PairContact]:
        """The contacts by the names of two bodies that stand for their species."""
        return {self.species.names(pair): contact for pair, contact in self.contacts.items()}

    @property
    def coupling(self) -> float:
        """Coupling interval [s]."""
        return self.steps_per_coupling * self.dt

    @property
    def gas_step(self) -> float:
        """Time step of the gas [s]."""
        return self.coupling / self.gas_steps

    @property
    def shortest(self) -> float:
        """Duration of the shortest contact [s]; infinite without contacts."""
        return min((contact.t_c for contact in self.contacts.values()), default=math.inf)

    def between(self, one: str, other: str) -> PairContact:
        """Return the contact of two bodies by their names; `KeyError` if they have none."""
        return self.contacts[self.species.pair_of((one, other))]

    def without_friction(self) -> Plan:
        """Return the same plan with smooth contacts: its normal motion is that of a sphere on a wall with friction."""
        return replace(self, contacts={pair: replace(c, friction=0.0) for pair, c in self.contacts.items()})
