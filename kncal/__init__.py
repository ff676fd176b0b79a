"""kncal: how stiff must a linear DEM spring be, what does it buy, and what does it cost?

The names below are the public API; each is loaded when it is first used, so that ``import kncal`` stays cheap.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from kncal.core.errors import (
        CaseFileError,
        InputError,
        KncalError,
        ReadError,
        RenderError,
        RunError,
        SolverMissingError,
        ValidityError,
    )
    from kncal.engines.liggghts.deck_block import matrix_block
    from kncal.physics.calibration import Calibration, calibrate
    from kncal.physics.impact import DimensionlessImpact, dimensionless_impact
    from kncal.physics.material import Material, Pair, pair, wall_pair
    from kncal.physics.matrix import PairMatrix, calibrate_matrix
    from kncal.physics.timestep import (
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
    from kncal.physics.uncertainty import Propagation, propagate
    from kncal.scene.case_file import load_case

_HOME = {
    "kncal.engines.liggghts.deck_block": ("matrix_block",),
    "kncal.physics.calibration": ("Calibration", "calibrate"),
    "kncal.scene.case_file": ("load_case",),
    "kncal.core.errors": (
        "CaseFileError",
        "InputError",
        "KncalError",
        "ReadError",
        "RenderError",
        "RunError",
        "SolverMissingError",
        "ValidityError",
    ),
    "kncal.physics.impact": ("DimensionlessImpact", "dimensionless_impact"),
    "kncal.physics.material": ("Material", "Pair", "pair", "wall_pair"),
    "kncal.physics.matrix": ("PairMatrix", "calibrate_matrix"),
    "kncal.physics.timestep": (
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
    "kncal.physics.uncertainty": ("Propagation", "propagate"),
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
    "matrix_block",
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
