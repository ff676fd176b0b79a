"""What a study of stability found: in words, as rows of tables, ready for JSON."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kncal.study.stability.accuracy import NUMBERS, AccuracyEdge
from kncal.study.stability.coupling_edges import BedEdge
from kncal.study.stability.edges import RESOLUTION, Edge
from kncal.study.stability.maps import Cell
from kncal.study.stability.outcome import REFUSED
from kncal.study.stability.probes import Ingredients

if TYPE_CHECKING:
    import pandas as pd

#: Column of `edge_frame` -> its unit.
EDGE_UNITS = {
    "probe": "-", "model": "-", "e_n": "-", "contacts": "-", "size_ratio": "-", "engine": "-", "edge_low": "s",
    "edge_high": "s", "limit": "s", "edge_at_v_0": "s", "advised": "s", "arrangement": "s",
    "safe_by": "-", "off_by": "-", "beyond": "-",
}  # fmt: skip
#: Column of `cell_frame` -> its unit.
CELL_UNITS = {
    "map": "-", "model": "-", "engine": "-", "x": "-", "y": "-", "dt": "s", "outcome": "-", "e_n": "-",
    "e_n_error": "-", "e_n_predicted": "-", "energy_change": "-", "balance_error": "-", "momentum": "-",
    "message": "-",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Stability:
    """Everything that a study found.

    Attributes
    ----------
    given : what the probes were made from
    engines : asked
    edges : of probes at rest
    accuracy : of impacts
    cells : of the maps
    bed : edges of the coupled algorithm, for beds
    """

    given: Ingredients
    engines: tuple[str, ...]
    edges: tuple[Edge, ...]
    accuracy: tuple[AccuracyEdge, ...]
    cells: tuple[Cell, ...]
    bed: tuple[BedEdge, ...] = ()

    @property
    def engine(self) -> str:
        """The engine whose edges count."""
        return self.engines[-1]

    def sentences(self) -> list[str]:
        """Say it in words."""
        return [*self._stability(), *self._accuracy(), *self._agreement(), *(e.sentence for e in self.bed)]

    def _stability(self) -> Iterable[str]:
        seen = [(edge.safe_by(engine), edge) for edge in self.edges if (engine := self.engine_of(edge))]
        low, high = (f(seen, key=lambda item: item[0]) for f in (min, max))
        if low[0] < -RESOLUTION:
            yield f"The advised step limit is UNSAFE by {-100.0 * low[0]:.2g} % for {_what(low[1])}."
        else:
            close = "exact within the resolution of" if low[0] <= RESOLUTION else "safe by"
            number = 100.0 * (RESOLUTION if low[0] <= RESOLUTION else low[0])
            yield (
                f"The advised step limit is safe for all {len(seen)} probes: {close} {number:.2g} % for "
                f"{_what(low[1])}, safe by {100.0 * high[0]:.3g} % for {_what(high[1])}."
            )
        off = max(abs(edge.off_by(engine)) for edge in self.edges for engine in edge.measured)
        yield (
            f"The edges lie where the eigenvalues of each arrangement put them, to {100.0 * off:.2g} % "
            f"(bisection ends at {100.0 * RESOLUTION:g} %)."
        )

    def _accuracy(self) -> Iterable[str]:
        for kind in dict.fromkeys(a.kind for a in self.accuracy):
            ours = [a for a in self.accuracy if a.kind == kind and a.e_n == min(self.given.contact.e_n, 1.0)]
            parts = [f"{a.measured:.3g} for {100.0 * a.error:g} %" for a in ours if a.measured is not None]
            if parts:
                apart = 100.0 * (NUMBERS[1] / NUMBERS[0] - 1.0)
                yield (
                    f"{_name(kind)}, e_n = {ours[0].e_n:g}: steps per contact needed for the restitution: "
                    f"{', '.join(parts)} (numbers {apart:.0f} % apart were tried); the case takes "
                    f"{self.given.steps_per_contact:g}."
                )
        unsafe = [a for a in self.accuracy if a.measured and a.predicted and a.measured > a.predicted]
        undecided = [a for a in self.accuracy if a.measured is None or a.predicted is None]
        text = f"{len(self.accuracy) - len(unsafe) - len(undecided)} of {len(self.accuracy)}"
        also = f" ({len(undecided)} not found)" if undecided else ""
        yield f"The predicted error asks for at least as many steps as measured at {text} accuracy edges{also}."

    def _agreement(self) -> Iterable[str]:
        both: dict[tuple[Any, ...], dict[str, str]] = {}
        for c in self.cells:
            both.setdefault((c.map, c.kind, c.x, c.y), {})[c.engine] = c.outcome.code
        several = [found for found in both.values() if len(found) > 1]
        pairs = [found for found in several if REFUSED not in found.values()]
        if refused := len(several) - len(pairs):
            yield f"{refused} runs of the maps are not compared: kncal refuses them."
        if pairs:
            alike = sum(len(set(found.values())) == 1 for found in pairs)
            yield f"LIGGGHTS and the builtin engine come to the same outcome in {alike} of {len(pairs)} runs of maps."

    def engine_of(self, edge: Edge) -> str:
        """Return the engine whose edge of this probe counts: LIGGGHTS where it could run it."""
        return self.engine if self.engine in edge.measured else "builtin"

    def edge_frame(self) -> pd.DataFrame:
        """One row per edge and engine, SI units (see `EDGE_UNITS`)."""
        import pandas as pd

        rows = [
            (
                e.probe.name.removesuffix(f"-{e.probe.kind}"),
                e.probe.kind,
                e.probe.e_n,
                e.probe.contacts,
                e.probe.size_ratio,
                engine,
                bracket.low,
                bracket.high,
                e.limit,
                e.at_v_0(engine),
                e.advised,
                e.arrangement,
                e.safe_by(engine),
                e.off_by(engine),
                bracket.beyond,
            )
            for e in self.edges
            for engine, bracket in e.measured.items()
        ]
        return pd.DataFrame(rows, columns=list(EDGE_UNITS))

    def cell_frame(self) -> pd.DataFrame:
        """One row per run of the maps (see `CELL_UNITS`)."""
        import pandas as pd

        measured = ("e_n", "e_n_error", "e_n_predicted", "energy_change", "balance_error", "momentum")
        rows = [
            (
                c.map,
                c.kind,
                c.engine,
                c.x,
                c.y,
                c.dt,
                c.outcome.code,
                *(c.outcome.numbers.get(name) for name in measured),
                c.outcome.message,
            )
            for c in self.cells
        ]
        return pd.DataFrame(rows, columns=list(CELL_UNITS))

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        edges = self.edge_frame().to_dict(orient="records")
        cells = [
            {
                "map": c.map,
                "model": c.kind,
                "engine": c.engine,
                "x": c.x,
                "y": c.y,
                "dt": c.dt,
                "outcome": c.outcome.code,
                "numbers": dict(c.outcome.numbers),
            }
            for c in self.cells
        ]
        return {
            "case": self.given.name,
            "v_0": self.given.v_0,
            "radius": self.given.radius,
            "steps_per_contact": self.given.steps_per_contact,
            "engines": list(self.engines),
            "sentences": self.sentences(),
            "notes": list(self.given.notes),
            "edges": edges,
            "accuracy": [vars(a) for a in self.accuracy],
            "bed": [e.to_dict() for e in self.bed],
            "cells": cells,
        }


def _name(kind: str) -> str:
    return {"linear": "Linear", "hertz": "Hertz"}[kind]


def _what(edge: Edge) -> str:
    p = edge.probe
    ratio = f", size ratio {p.size_ratio:g}" if p.size_ratio != 1.0 else ""
    return f"{p.contacts} contact{'s' if p.contacts > 1 else ''} at once{ratio} ({p.kind}, e_n = {p.e_n:g})"
