"""How long and how finely a case runs: a table of the case file. SI units."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from kncal.scene.values import Number, Seconds, Step, Time, Whole, checked_class, within

StepsPerContact = Annotated[Number, within(4.0, 1e6, hint="50 is usual")]


@checked_class
class RunControl:
    """``[run]``: how long and how finely to run.

    With ``coupling`` or ``sample_every``, particles (and gas) go on in intervals, and each is recorded; without, the
    solver runs once from start to end, and every contact is recorded step by step.
    """

    until_time: Seconds | None = Field(default=None, description="end time [s]")
    until_bounces: Annotated[Whole, within(1, 1000)] | None = Field(
        default=None,
        description="number of contacts; the run ends at the apex after the last (of the model that needs longer), or "
        "half way to a contact before it",
    )
    steps_per_contact: StepsPerContact = Field(
        default=50.0, description="steps per contact duration [-], the same meaning for every model"
    )
    dt: Step | None = Field(default=None, description="time step of all models [s]; none: from steps_per_contact")
    record_every: Annotated[Whole, within(1, 1e6)] = Field(
        default=1, description="steps between recorded frames during a contact"
    )
    coupling: Seconds | None = Field(
        default=None,
        description="coupling interval [s], rounded down to whole steps of each model; none: nothing is coupled",
    )
    sample_every: Seconds | None = Field(
        default=None,
        description="without gas, in place of coupling: interval at whose end a run of many particles is looked at [s]",
    )
    gas_step: Seconds | None = Field(default=None, description="longest gas step [s]; none: one per coupling interval")
    discard: Time | None = Field(default=None, description="start-up left out of averages [s]; none: detected")
    frames_every: Seconds = Field(
        default=0.01, description="time between recorded frames of particles and gas fields of a coupled run [s]"
    )
