"""What a study of stability found: in words, as rows of tables, ready for JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kncal.report.style import model_name
from kncal.study.stability.accuracy import NUMBERS, AccuracyEdge
from kncal.study.stability.coupling_edges import BedEdge
from kncal.study.stability.edges import RESOLUTION, Edge
from kncal.study.stability.maps import Cell
from kncal.study.stability.outcome import REFUSED
from kncal.study.stability.probes import Ingredients

if TYPE_CHECKING:
    import pandas as pd

#: Column of stability.csv -> (its unit, its value for an edge that an engine measured).
EDGE_COLUMNS: Mapping[str, tuple[str, Callable[[Edge, str], Any]]] = {
    "probe": ("-", lambda e, _: probe_name(e)),
    "model": ("-", lambda e, _: e.probe.kind),
    "e_n": ("-", lambda e, _: e.probe.e_n),
    "contacts": ("-", lambda e, _: e.probe.contacts),
    "size_ratio": ("-", lambda e, _: e.probe.size_ratio),
    "engine": ("-", lambda _, by: by),
    "edge_low": ("s", lambda e, by: e.measured[by].low),
    "edge_high": ("s", lambda e, by: e.measured[by].high),
    "limit": ("s", lambda e, _: e.limit),
    "edge_at_v_0": ("s", lambda e, by: e.at_v_0(by)),
    "advised": ("s", lambda e, _: e.advised),
    "arrangement": ("s", lambda e, _: e.arrangement),
    "safe_by": ("-", lambda e, by: e.safe_by(by)),
    "off_by": ("-", lambda e, by: e.off_by(by)),
    "beyond": ("-", lambda e, by: e.measured[by].beyond),
}
_MEASURED = ("e_n", "e_n_error", "e_n_predicted", "energy_change", "balance_error", "momentum")
#: Column of map.csv -> its unit.
CELL_UNITS = dict.fromkeys(("map", "model", "engine", "x", "y", "dt", "outcome", *_MEASURED, "message"), "-") | {
    "dt": "s"
}


def probe_name(edge: Edge) -> str:
    """Return the name of an edge's probe without its model."""
    return edge.probe.name.removesuffix(f"-{edge.probe.kind}")


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
    coupling : edges of the exchange with the gas, where there is one
    """

    given: Ingredients
    engines: tuple[str, ...]
    edges: tuple[Edge, ...]
    accuracy: tuple[AccuracyEdge, ...]
    cells: tuple[Cell, ...]
    coupling: tuple[BedEdge, ...] = ()

    @property
    def engine(self) -> str:
        """The engine whose edges count."""
        return self.engines[-1]

    def sentences(self) -> list[str]:
        """Say it in words."""
        return [*self._stability(), *self._accuracy(), *self._agreement(), *(e.sentence for e in self.coupling)]

    def _stability(self) -> Iterable[str]:
        seen = [(edge.safe_by(engine), edge) for edge in self.edges if (engine := self.engine_of(edge))]
        low, high = (f(seen, key=lambda item: item[0]) for f in (min, max))
        if low[0] < -RESOLUTION:
            yield f"The advised step limit is UNSAFE by {-100.0 * low[0]:.2g} % for {_what(low[1])}."
        else:
            smallest = "none" if low[0] <= RESOLUTION else f"{100.0 * low[0]:.3g} %"
            yield (
                f"The advised step limit is safe for all {len(seen)} probes. Smallest margin: {smallest}, for"
                f" {_what(low[1])}; largest: {100.0 * high[0]:.3g} %, for {_what(high[1])}."
            )
        off = max(abs(edge.off_by(engine)) for edge in self.edges for engine in edge.measured)
        yield (
            f"Measured edges and eigenvalues of each arrangement agree to {100.0 * off:.2g} % (bisection ends at"
            f" {100.0 * RESOLUTION:g} %)."
        )

    def _accuracy(self) -> Iterable[str]:
        for kind in dict.fromkeys(a.kind for a in self.accuracy):
            ours = [a for a in self.accuracy if a.kind == kind and a.e_n == min(self.given.contact.e_n, 1.0)]
            parts = [f"{a.measured:.3g} for {100.0 * a.error:g} %" for a in ours if a.measured is not None]
            if parts:
                yield (
                    f"{model_name(kind).capitalize()}, e_n = {ours[0].e_n:g}: steps per contact that an error of e_n"
                    f" needs: {', '.join(parts)}. The case takes {self.given.steps_per_contact:g}."
                )
        known = [(a.measured, a.predicted) for a in self.accuracy if a.measured is not None and a.predicted is not None]
        unknown = len(self.accuracy) - len(known)
        also = f" ({unknown} not found)" if unknown else ""
        apart = 100.0 * (NUMBERS[1] / NUMBERS[0] - 1.0)
        yield (
            f"The prediction asks for enough steps in {sum(found <= asked for found, asked in known)} of"
            f" {len(self.accuracy)} such cases{also}; numbers {apart:.0f} % apart were tried."
        )

    def _agreement(self) -> Iterable[str]:
        both: dict[tuple[Any, ...], dict[str, str]] = {}
        for c in self.cells:
            both.setdefault((c.map, c.kind, c.x, c.y), {})[c.engine] = c.outcome.code
        several = [found for found in both.values() if len(found) > 1]
        pairs = [found for found in several if REFUSED not in found.values()]
        if pairs:
            alike = sum(len(set(found.values())) == 1 for found in pairs)
            yield f"LIGGGHTS and the builtin engine come to the same outcome in {alike} of {len(pairs)} runs of maps."
        if refused := len(several) - len(pairs):
            yield f"{refused} runs of maps are not compared: kncal refuses them."

    def engine_of(self, edge: Edge) -> str:
        """Return the engine whose edge of this probe counts: LIGGGHTS where it could run it."""
        return self.engine if self.engine in edge.measured else "builtin"

    def edge_frame(self) -> pd.DataFrame:
        """One row per edge and engine, SI units (see `EDGE_COLUMNS`)."""
        import pandas as pd

        found = [(edge, engine) for edge in self.edges for engine in edge.measured]
        return pd.DataFrame({name: [value(*one) for one in found] for name, (_, value) in EDGE_COLUMNS.items()})

    def cell_frame(self) -> pd.DataFrame:
        """One row per run of the maps (see `CELL_UNITS`)."""
        import pandas as pd

        numbers = [{name: c.outcome.numbers.get(name) for name in _MEASURED} for c in self.cells]
        rows = [_cell(c) | of_it | {"message": c.outcome.message} for c, of_it in zip(self.cells, numbers, strict=True)]
        return pd.DataFrame(rows, columns=list(CELL_UNITS))

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "case": self.given.name,
            "v_0": self.given.v_0,
            "radius": self.given.radius,
            "steps_per_contact": self.given.steps_per_contact,
            "engines": list(self.engines),
            "sentences": self.sentences(),
            "notes": list(self.given.notes),
            "edges": self.edge_frame().to_dict(orient="records"),
            "accuracy": [vars(a) for a in self.accuracy],
            "coupling": [e.to_dict() for e in self.coupling],
            "cells": [{**_cell(c), "numbers": dict(c.outcome.numbers)} for c in self.cells],
        }


def _cell(c: Cell) -> dict[str, Any]:
    return {
        "map": c.map,
        "model": c.kind,
        "engine": c.engine,
        "x": c.x,
        "y": c.y,
        "dt": c.dt,
        "outcome": c.outcome.code,
    }


def _what(edge: Edge) -> str:
    p = edge.probe
    ratio = f", size ratio {p.size_ratio:g}" if p.size_ratio != 1.0 else ""
    return f"{p.contacts} contact{'s' if p.contacts > 1 else ''} at once{ratio} ({p.kind}, e_n = {p.e_n:g})"
