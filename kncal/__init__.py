"""kncal: how stiff must a linear DEM spring be, what does it buy, and what does it cost?

The names below are the public API; each is loaded when it is first used, so that ``import kncal`` stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from kncal.calibration import Calibration, calibrate
    from kncal.case_file import load_case
    from kncal.errors import (
        CaseFileError,
        InputError,
        KncalError,
        ReadError,
        RenderError,
        RunError,
        SolverMissingError,
        ValidityError,
    )
    from kncal.impact import DimensionlessImpact, dimensionless_impact
    from kncal.material import Material, Pair, pair, wall_pair
    from kncal.matrix import PairMatrix, calibrate_matrix
    from kncal.timestep import (
        TimeStepAdvice,
        advise_time_step,
        advised_steps,
        contact_time,
        hertz_time,
        predict_error,
        rayleigh_time,
        smallest_restitution,
        verlet_limit,
    )
    from kncal.uncertainty import Propagation, propagate

_HOME = {
    "kncal.calibration": ("Calibration", "calibrate"),
    "kncal.case_file": ("load_case",),
    "kncal.errors": (
        "CaseFileError",
        "InputError",
        "KncalError",
        "ReadError",
        "RenderError",
        "RunError",
        "SolverMissingError",
        "ValidityError",
    ),
    "kncal.impact": ("DimensionlessImpact", "dimensionless_impact"),
    "kncal.material": ("Material", "Pair", "pair", "wall_pair"),
    "kncal.matrix": ("PairMatrix", "calibrate_matrix"),
    "kncal.timestep": (
        "TimeStepAdvice",
        "advise_time_step",
        "advised_steps",
        "contact_time",
        "hertz_time",
        "predict_error",
        "rayleigh_time",
        "smallest_restitution",
        "verlet_limit",
    ),
    "kncal.uncertainty": ("Propagation", "propagate"),
}
_WHERE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "Calibration",
    "CaseFileError",
    "DimensionlessImpact",
    "InputError",
    "KncalError",
    "Material",
    "Pair",
    "PairMatrix",
    "Propagation",
    "ReadError",
    "RenderError",
    "RunError",
    "SolverMissingError",
    "TimeStepAdvice",
    "ValidityError",
    "__version__",
    "advise_time_step",
    "advised_steps",
    "calibrate",
    "calibrate_matrix",
    "contact_time",
    "dimensionless_impact",
    "hertz_time",
    "load_case",
    "pair",
    "predict_error",
    "propagate",
    "rayleigh_time",
    "smallest_restitution",
    "verlet_limit",
    "wall_pair",
]


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        return getattr(import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'kncal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
