"""Many runs of one case: a design of points, run folders with stable names, one table."""

from __future__ import annotations

from kncal.sweep.dask_runs import DaskExecutor, dask_executor
from kncal.sweep.design import Settings, Sweep, design, read_design
from kncal.sweep.execute import Executor, ThreadExecutor, execute_run
from kncal.sweep.points import combine, grid_axis, parse_range, read_points, sample
from kncal.sweep.slurm_script import SlurmOptions, array_script
from kncal.sweep.states import SweepStatus, sweep_status
from kncal.sweep.table import read_sweep
from kncal.sweep.workflow import SweepProgress, SweepResult, prepare_sweep, run_sweep

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
    "run_sweep",
    "sample",
    "sweep_status",
]
