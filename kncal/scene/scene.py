"""A scene: what is simulated, said once, independent of any solver. SI units throughout."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field

from kncal.physics.material import Material

Vector = tuple[float, float, float]
AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class Particle:
    """A solid sphere.

    Attributes
    ----------
    name : unique among particles and walls
    material : Material
    radius : [m]
    position, velocity : of the centre at t = 0 [m], [m/s]
    spin : angular velocity at t = 0 [rad/s]
    """

    name: str
    material: Material
    radius: float
    position: Vector
    velocity: Vector = (0.0, 0.0, 0.0)
    spin: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Wall:
    """An infinite plane wall normal to a coordinate axis; a particle stays on the side where it starts.

    Attributes
    ----------
    name : unique among particles and walls
    axis : "x", "y" or "z", the plane's normal
    position : coordinate of the plane on that axis [m]
    material : Material, or None for a rigid wall
    """

    name: str
    axis: str
    position: float
    material: Material | None = None


@dataclass(frozen=True, kw_only=True)
class PairChoice:
    """What differs for one pair; ``between`` holds two names of particles, walls or materials."""

    between: tuple[str, str]
    e_n: float | None = None
    friction: float | None = None
    v_0: float | None = None
    k_n: float | None = None


@dataclass(frozen=True, kw_only=True)
class MeasuredSpeed:
    """How the impact speed to calibrate at is measured (``contact.v_0 = "measured"``; see `kncal.runs.measure_speed`).

    Attributes
    ----------
    statistic : of the impact speeds: "energy_weighted", "mean" or "p99" (see `kncal.observe.impact_speeds`)
    start : first guess of v_0 [m/s]; None (single contacts only): the first impact, from ballistics
    run_time : end time of a measuring round [s]; None (single contacts only): as the case runs
    tolerance : relative change of k_n below which it has settled [-]
    rounds : most rounds
    """

    statistic: str = "energy_weighted"
    start: float | None = None
    run_time: float | None = None
    tolerance: float = 0.02
    rounds: int = 6


@dataclass(frozen=True, kw_only=True)
class ContactChoice:
    """The reference contact law and how its linear counterpart is found.

    Attributes
    ----------
    law : reference law ("tsuji", "hertz", ...)
    e_n : normal coefficient of restitution [-]
    end : contact end, "overlap" or "force"
    method : how k_n is found; not used where ``k_n`` is given
    method_options : options of the method
    v_0 : impact speed to calibrate at [m/s]; None: the scene's first impact, from ballistics
    measured : not None where the case says ``v_0 = "measured"`` (then ``v_0`` is None): such a scene has no numbers
        before `kncal.runs.measure_speed.resolve_measured` puts a speed in its place
    k_n : prescribed linear stiffness [N/m]; overrules the method
    friction : Coulomb coefficient [-]
    k_t_ratio : k_t/k_n of the linear contact [-]; None: the Mindlin ratio of the pair
    rolling_friction : rolling friction coefficient [-]
    pairs : exceptions for single pairs; the first match counts
    """

    law: str = "tsuji"
    e_n: float = 1.0
    end: str = "overlap"
    method: str = "mean_overlap"
    method_options: Mapping[str, float | str] = field(default_factory=dict)
    v_0: float | None = None
    measured: MeasuredSpeed | None = None
    k_n: float | None = None
    friction: float = 0.0
    k_t_ratio: float | None = None
    rolling_friction: float = 0.0
    pairs: tuple[PairChoice, ...] = ()

    def exception(self, names_a: Container[str], names_b: Container[str]) -> PairChoice | None:
        """Return the first exception that names both bodies, each known by several names, or None."""
        for choice in self.pairs:
            one, two = choice.between
            if (one in names_a and two in names_b) or (two in names_a and one in names_b):
                return choice
        return None


@dataclass(frozen=True, kw_only=True)
class RunControl:
    """How long and how finely to run.

    Attributes
    ----------
    steps_per_contact : steps N per contact duration, the same meaning for every model
    until_time : end time [s], or None
    until_bounces : run to the apex after this many contacts (of the model that needs longer), or None
    dt : prescribed time step [s] for both models; None: from steps_per_contact
    record_every : steps between recorded frames during a contact (and just before and after it)
    """

    steps_per_contact: float = 50.0
    until_time: float | None = None
    until_bounces: int | None = None
    dt: float | None = None
    record_every: int = 1


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything that a run needs to know, and nothing about the solver that will run it.

    Attributes
    ----------
    name : short name, also the folder's name: ``[A-Za-z0-9][A-Za-z0-9._-]{0,63}``
    title, source : one line each: what it is, where its parameters come from
    gravity : acceleration [m/s²]
    tolerances : metric name -> allowed relative difference of linear against Hertz [-]
    overrules : physics name -> the user's decision against `kncal.scene.needs`
    """

    name: str
    title: str = ""
    source: str = ""
    particles: tuple[Particle, ...]
    walls: tuple[Wall, ...] = ()
    gravity: Vector = (0.0, 0.0, 0.0)
    contact: ContactChoice = field(default_factory=ContactChoice)
    run: RunControl = field(default_factory=RunControl)
    tolerances: Mapping[str, float] = field(default_factory=dict)
    overrules: Mapping[str, bool] = field(default_factory=dict)

    @property
    def bodies(self) -> tuple[Particle | Wall, ...]:
        """Particles, then walls, in the order of the case file."""
        return (*self.particles, *self.walls)

    def body_pairs(self) -> tuple[tuple[Particle, Particle | Wall], ...]:
        """Every pair that may touch: particle–particle (i < j) and particle–wall."""
        spheres = self.particles
        pairs: list[tuple[Particle, Particle | Wall]] = [
            (a, b) for i, a in enumerate(spheres) for b in spheres[i + 1 :]
        ]
        pairs += [(a, w) for a in spheres for w in self.walls]
        return tuple(pairs)

    def choice_for(self, a: Particle, b: Particle | Wall) -> PairChoice | None:
        """Return the first exception of the case that names both bodies (or their materials), or None."""
        return self.contact.exception(names_of(a), names_of(b))


def names_of(body: Particle | Wall) -> tuple[str, str]:
    """Return the names that an exception of the case knows a body by: its own, and its material's."""
    return body.name, "rigid" if body.material is None else body.material.name
