"""Tables and curves that put one calibration in context: all methods, k_n against v_0 and e_n, error against dt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kncal.core.checks import Array
from kncal.core.errors import ValidityError
from kncal.physics.calibration import calibrate, calibrate_all
from kncal.physics.laws import LAWS
from kncal.physics.material import Pair
from kncal.physics.timestep import predict_error
from kncal.scene.model import Plan
from kncal.scene.needs import decide
from kncal.scene.plan import pair_choice, pair_of

if TYPE_CHECKING:
    import pandas as pd

#: Steps per contact of the speed–accuracy table.
STEPS = (10, 20, 50, 100, 200)


def _nothing() -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame()


@dataclass(frozen=True, kw_only=True)
class Context:
    """What puts a comparison in context; each may be empty.

    Attributes
    ----------
    methods : of `method_table`
    kn_curves : of `kn_curves`
    errors : of `error_table`
    needs : columns physics, needed, why, decided_by
    """

    methods: pd.DataFrame = field(default_factory=_nothing)
    kn_curves: Mapping[str, Any] = field(default_factory=dict)
    errors: pd.DataFrame = field(default_factory=_nothing)
    needs: pd.DataFrame = field(default_factory=_nothing)


def method_table(
    pair: Pair,
    *,
    v_0: float,
    e_n: float,
    law: str = "tsuji",
    end: str = "overlap",
    options: Mapping[str, Any] | None = None,
) -> pd.DataFrame:
    """Calibrate by every method and return one row each.

    ``options`` holds options of any method (fraction, of, t_c, force, factor). A method whose required option is not
    given is left out; one that has no valid result keeps its row, with the reason in ``warnings`` and no numbers.
    """
    import pandas as pd

    frames = []
    for name, result in calibrate_all(pair, v_0=v_0, e_n=e_n, law=law, end=end, options=options or {}).items():
        if isinstance(result, ValidityError):
            frames.append(pd.DataFrame({"method": [name], "warnings": [str(result)]}))
        else:
            frames.append(result.to_frame().assign(warnings="; ".join(str(w) for w in result.warnings)))
    return pd.concat(frames, ignore_index=True)


def kn_curves(
    pair: Pair,
    *,
    v_0: float,
    e_n: float,
    law: str = "tsuji",
    end: str = "overlap",
    methods: Sequence[str] = ("mean_overlap", "max_overlap", "contact_duration", "strain_energy"),
) -> dict[str, Any]:
    """Return k_n of several methods against v_0 (a decade to either side) and against e_n.

    Returns
    -------
    dict with "v_0" (n,) [m/s], "e_n" (n,), "against_v_0" and "against_e_n": method -> k_n (n,) [N/m], and the "chosen"
    (v_0, e_n). Speeds at which the overlap would reach the radius are left out.
    """
    speeds = v_0 * np.logspace(-1.0, 1.0, 41)
    reference = calibrate(pair, v_0=v_0, e_n=e_n, law=law, end=end)
    # delta_max grows as v_0^(4/5): keep the curve below half of the smaller radius
    most = (0.5 * float(pair.R_min) / max(float(reference.delta_max), float(reference.reference.delta_max))) ** 1.25
    speeds = speeds[speeds <= v_0 * max(most, 1.0)]
    restitutions = np.linspace(0.1, 1.0, 46)

    def curve(method: str, v: Array | float, e: Array | float) -> Array:
        return np.asarray(calibrate(pair, v_0=v, e_n=e, law=law, method=method, end=end).k_n)

    return {
        "v_0": speeds,
        "e_n": restitutions,
        "against_v_0": {m: curve(m, speeds, e_n) for m in methods},
        "against_e_n": {m: curve(m, v_0, restitutions) for m in methods},
        "chosen": (v_0, e_n),
    }


def error_table(models: Mapping[str, Plan], steps: Sequence[float] = STEPS) -> pd.DataFrame:
    """Return the predicted discretisation errors of the shortest contact of each model against steps per contact.

    One row per model and N: the time step, the number of steps for the whole run, and the worst relative error of e_n,
    t_c, delta_max and delta_mean over the sub-step phases of first touch.
    """
    import pandas as pd

    rows = []
    for kind, model in models.items():
        contact = min(model.contacts.values(), key=lambda c: c.t_c)
        for n in sorted({*steps, round(contact.t_c / model.dt, 6)}):
            dt = contact.t_c / n
            predicted = predict_error(LAWS.find(contact.law).name, contact.e_n, n, contact.end)
            rows.append(
                {
                    "model": kind,
                    "steps_per_contact": n,
                    "dt": dt,
                    "steps": int(np.ceil(model.t_end / dt)),
                    "run": bool(abs(dt / model.dt - 1.0) < 1e-6),
                    **{f"error_{name}": value for name, value in predicted.worst.items()},
                }
            )
    return pd.DataFrame(rows)


def context_of(models: Mapping[str, Plan]) -> Context:
    """Return the context of the runs of one scene by model; the calibration is that of its first pair."""
    scene = next(iter(models.values())).scene
    a, b = scene.body_pairs()[0]
    numbers = pair_choice(scene, a, b)
    e_n, v_0 = numbers.e_n, numbers.v_0
    errors, needs = error_table(models), decide(scene).to_frame()
    if v_0 is None:
        return Context(errors=errors, needs=needs)
    law, end, pair, options = scene.contact.law, scene.contact.end, pair_of(a, b), scene.contact.options
    methods = method_table(pair, v_0=v_0, e_n=e_n, law=law, end=end, options=options)
    curves = kn_curves(pair, v_0=v_0, e_n=e_n, law=law, end=end)
    return Context(methods=methods, kn_curves=curves, errors=errors, needs=needs)
