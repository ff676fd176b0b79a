"""Many runs of one case: a design of points or variants, run folders with stable names, one table."""

from __future__ import annotations

from kncal.study.dask_executor import DaskExecutor, dask_executor
from kncal.study.design import Settings, Sweep, design, read_design
from kncal.study.execute import Executor, ThreadExecutor, execute_run
from kncal.study.points import combine, grid_axis, parse_range, read_points, sample
from kncal.study.runs import VariantRun, run_variants
from kncal.study.slurm_script import SlurmOptions, array_script
from kncal.study.states import SweepStatus, sweep_status
from kncal.study.sweep import SweepProgress, SweepResult, prepare_sweep, run_sweep
from kncal.study.table import read_sweep
from kncal.study.variants import Variant, removing

__all__ = [
    "DaskExecutor",
    "Executor",
    "Settings",
    "SlurmOptions",
    "Sweep",
    "SweepProgress",
    "SweepResult",
    "SweepStatus",
    "ThreadExecutor",
    "Variant",
    "VariantRun",
    "array_script",
    "combine",
    "dask_executor",
    "design",
    "execute_run",
    "grid_axis",
    "parse_range",
    "prepare_sweep",
    "read_design",
    "read_points",
    "read_sweep",
    "removing",
    "run_sweep",
    "run_variants",
    "sample",
    "sweep_status",
]
