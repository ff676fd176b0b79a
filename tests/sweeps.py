"""Sweeps of a small case by the builtin engine."""

from __future__ import annotations

from pathlib import Path

from kncal.study import Settings, ThreadExecutor, combine, design, grid_axis, run_sweep

SETTINGS = Settings(engine="builtin")
GRID = ("contact.v_0=0.5,1.0", "run.steps_per_contact=20,30")


def designed(case: Path, *axes: str, settings: Settings = SETTINGS):
    return design(case, combine([grid_axis(text) for text in axes or GRID]), settings)


def swept(case: Path, folder: Path, *axes: str, settings: Settings = SETTINGS):
    made, text = designed(case, *axes, settings=settings)
    return run_sweep(made, text, folder, ThreadExecutor(2))


def results(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.glob("runs/*/*/result.json")}
