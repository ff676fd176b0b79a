"""What a case says of its contacts: the classes of ``[contact]`` and of its exceptions for single pairs."""

from __future__ import annotations

from collections.abc import Container
from typing import Annotated, Literal

from pydantic import Field

from kncal.scene.values import (
    Cohesion,
    Friction,
    Name,
    Number,
    Option,
    Restitution,
    Seconds,
    Share,
    Speed,
    Stiffness,
    Whole,
    Word,
    checked_class,
    within,
)

#: Most exceptions of a scene.
MOST_PAIRS = 200


@checked_class
class PairChoice:
    """``[[contact.pairs]]``: what differs for one pair."""

    between: tuple[Name, Name] = Field(description="two names of particles, walls or materials")
    e_n: Restitution | None = Field(default=None, description="normal restitution [-]")
    friction: Friction | None = Field(default=None, description="Coulomb friction coefficient [-]")
    v_0: Speed | None = Field(default=None, description="impact speed to calibrate at [m/s]")
    k_n: Stiffness | None = Field(default=None, description="prescribed linear stiffness [N/m]")
    rolling_friction: Friction | None = Field(default=None, description="rolling friction coefficient [-]")
    cohesion_energy_density: Cohesion | None = Field(default=None, description="cohesion energy density [J/m³]")


@checked_class
class MeasuredSpeed:
    """``[contact.measured]``: how the speed is measured with ``v_0 = "measured"`` (`kncal.runs.measure_speed`)."""

    statistic: Literal["energy_weighted", "mean", "p99"] = Field(
        default="energy_weighted", description='of the impact speeds: "energy_weighted" mean, "mean" or "p99"'
    )
    start: Speed | None = Field(default=None, description="first guess of v_0 [m/s]; none: the first impact's")
    run_time: Seconds | None = Field(
        default=None, description="end time of a measuring round [s]; none: as the case runs"
    )
    tolerance: Share = Field(default=0.02, description="relative change of k_n below which it has settled [-]")
    rounds: Annotated[Whole, within(1, 50)] = Field(default=6, description="most rounds")


@checked_class
class ContactChoice:
    """``[contact]``: the reference contact law and how its linear counterpart is found.

    ``measured`` is there where the case says ``v_0 = "measured"``: such a scene has no numbers before
    `kncal.runs.measure_speed.resolve_measured` puts a speed in its place. Of ``pairs`` the first match counts.
    """

    law: Word = Field(default="tsuji", description="reference contact law")
    e_n: Restitution = Field(default=1.0, description="normal restitution [-]")
    end: Literal["overlap", "force"] = Field(default="overlap", description='contact end: "overlap" or "force"')
    method: Word = Field(default="mean_overlap", description="how k_n is found")
    v_0: Speed | None = Field(
        default=None, description='impact speed to calibrate at [m/s], or "measured"; none: the first impact\'s'
    )
    measured: MeasuredSpeed | None = Field(default=None, description='[contact.measured], for v_0 = "measured"')
    k_n: Stiffness | None = Field(default=None, description="prescribed linear stiffness [N/m], in place of a method")
    friction: Friction = Field(default=0.0, description="Coulomb friction coefficient [-]")
    k_t_ratio: Annotated[Number, within(0.0, 10.0)] | None = Field(
        default=None, description="k_t/k_n of the linear contact [-]; none: the Mindlin ratio of the pair"
    )
    tangential_damping: Literal["none", "liggghts", "half_normal"] = Field(
        default="none",
        description='of a contact that sticks: "none", "liggghts" (the damping ratio of the normal direction) or '
        '"half_normal" (half of the normal coefficient, as MFIX)',
    )
    rolling_friction: Friction = Field(default=0.0, description="rolling friction coefficient [-]")
    rolling_model: Literal["cdt", "epsd", "epsd2"] = Field(
        default="cdt",
        description='"cdt" (a torque of constant size against the spin), "epsd" or "epsd2" (a spring that yields)',
    )
    rolling_damping: Annotated[Number, within(0.0, 10.0)] = Field(
        default=0.0, description='damping of the spring of "epsd", as a share of the critical one [-]'
    )
    cohesion_energy_density: Cohesion = Field(
        default=0.0, description="attraction per contact area (sjkr) [J/m³]; 0: none"
    )
    cohesion_keeps: Literal["density", "force"] = Field(
        default="density",
        description='what the linear contact has in common with Hertz: the energy "density", or the "force" of '
        "cohesion at the largest overlap of an impact at v_0",
    )
    options: dict[Name, Option] = Field(default_factory=dict, description="options of the method")
    pairs: Annotated[tuple[PairChoice, ...], Field(max_length=MOST_PAIRS)] = Field(
        default=(), description="exceptions for single pairs"
    )

    def exception(self, names_a: Container[str], names_b: Container[str]) -> PairChoice | None:
        """Return the first exception that names both bodies, each known by several names, or None."""
        for choice in self.pairs:
            one, two = choice.between
            if (one in names_a and two in names_b) or (two in names_a and one in names_b):
                return choice
        return None
