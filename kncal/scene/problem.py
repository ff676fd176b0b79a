"""What is wrong with a scene: the path of the key, and a text; and what several checks look at."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

from kncal.core.checks import one_of
from kncal.core.errors import InputError
from kncal.physics.statistics import MIN_SAMPLES
from kncal.scene.groups import Particles
from kncal.scene.scene import Scene

Path = tuple[str | int, ...]
Problem = tuple[Path, str]


def known_name(path: Path, value: str, allowed: Collection[str], label: str = "") -> Iterator[Problem]:
    """Yield a problem if ``value`` is not one of the ``allowed`` names."""
    try:
        one_of(label or str(path[-1]), value, allowed)
    except InputError as error:
        yield path, str(error)


def first_speed(scene: Scene, shortest: float) -> Iterator[Problem]:
    """Yield what lacks for a speed to calibrate at; ``shortest``: half of the shortest measuring run [s]."""
    contact = scene.contact
    if (measured := contact.measured) is not None:
        for key, what in (("start", "a first guess of v_0 [m/s]"), ("run_time", "the time to measure over [s]")):
            if getattr(measured, key) is None:
                yield ("contact", "measured", key), f"missing: expected {what}: a bed has no first impact"
        if measured.run_time is not None and measured.run_time < (least := 2.0 * shortest):
            # at most half of a run is start-up
            yield (
                ("contact", "measured", "run_time"),
                f"run_time = {measured.run_time:g}: expected at least {2 * MIN_SAMPLES} couplings, {least:g} s",
            )
    elif contact.v_0 is contact.k_n is None:
        yield (
            ("contact", "v_0"),
            "missing: expected the impact speed to calibrate at [m/s], typical of this bed (0.1 to 1 is usual), or a "
            "prescribed contact.k_n [N/m]: a bed has no first impact to take it from",
        )


def interval(scene: Scene, key: str) -> Iterator[Problem]:
    """Yield what is wrong with the interval ``key`` of ``run``, and with the start-up."""
    run, end, interval = scene.run, scene.run.until_time or math.inf, scene.interval or 0.0
    if interval > end:
        yield ("run", key), f"{key} = {interval:g}: expected at most until_time, {end:g} s"
    if run.discard is not None and run.discard >= end:
        yield ("run", "discard"), f"discard = {run.discard:g}: expected less than until_time, {end:g} s"


def one_of_two(name: str, group: Particles) -> Iterator[Problem]:
    """Yield a problem if a group has a position and positions."""
    if group.position is not None and group.positions:
        yield ("particles", name, "position"), "given together with positions: expected one of them"
