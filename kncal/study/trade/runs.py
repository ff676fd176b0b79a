"""Runs of candidates by one engine, kept and read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from kncal.observe.compare import RunData
from kncal.runs.workflow import load_run
from kncal.study import VariantRun, run_variants
from kncal.study.trade.base import Candidate


@dataclass(kw_only=True)
class Runs:
    """What was run by one engine.

    Attributes
    ----------
    case, folder, engine, workers : as of `kncal.study.run_variants`
    ended : name of a candidate -> how its run ended
    data : name -> what was read, of those that completed
    """

    case: str | Path
    folder: Path
    engine: str
    workers: int | None
    ended: dict[str, VariantRun] = field(default_factory=dict)
    data: dict[str, RunData] = field(default_factory=dict)

    def run(self, candidates: Iterable[Candidate], rounds: int = 1, timeout: float | None = None) -> None:
        """Run candidates, each ``rounds`` times, and read those that completed."""
        found = run_variants(
            self.case,
            [candidate.variant for candidate in candidates],
            self.folder,
            rounds=rounds,
            engine=self.engine,
            workers=self.workers,
            timeout=timeout,
        )
        self.ended |= found
        for name, run in found.items():
            if run.completed and run.folder is not None:
                self.data[name] = load_run(run.folder)
