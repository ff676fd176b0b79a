"""Numbers of a plan that no engine may be given: it would compute with them all the same."""

from __future__ import annotations

import math

from kncal.core.errors import RenderError
from kncal.scene.model import PairContact, Plan


def expect(condition: bool, where: object, what: str, expected: str) -> None:
    """Raise `RenderError` unless ``condition``; ``where`` is a pair of names or one name."""
    if not condition:
        place = f"pair {where[0]}, {where[1]}" if isinstance(where, tuple) else str(where)
        raise RenderError(f"{place}: {what}: expected {expected}")


def check_contact(names: tuple[str, str], c: PairContact) -> None:
    """Refuse a contact with a number out of its range."""
    for key in ("k", "m_eff", "R_eff", "E_eff", "G_eff"):
        value = getattr(c, key)
        expect(math.isfinite(value) and value > 0.0, names, f"{key} = {value!r}", "a finite value > 0")
    for key in ("c", "friction", "rolling_friction", "rolling_damping", "k_t", "c_t", "cohesion"):
        value = getattr(c, key)
        expect(math.isfinite(value) and value >= 0.0, names, f"{key} = {value!r}", "a finite value >= 0")
    expect(c.end in ("overlap", "force"), names, f"contact end {c.end!r}", "'overlap' or 'force'")


def check_schedule(model: Plan) -> None:
    """Refuse a time step, a number of steps or a recording schedule that is none."""
    name, every = model.scene.name, model.record_every
    expect(math.isfinite(model.dt) and model.dt > 0.0, name, f"dt = {model.dt!r} s", "a finite dt > 0")
    expect(model.n_steps >= 1, name, f"{model.n_steps} steps", "at least 1 step")
    expect(every >= 1, name, f"record_every = {every}", "at least 1 step")
    flight = f"flight_every = {model.flight_every}"
    expect(model.flight_every >= every, name, flight, f"at least record_every = {every}")
