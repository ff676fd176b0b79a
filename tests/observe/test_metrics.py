"""The registry of metrics: each is offered where what it needs is recorded, and packages can add to it."""

from __future__ import annotations

import sys

import comparisons
import numpy as np
import pytest
from compared_beds import run_data

from kncal.core.errors import InputError
from kncal.observe import averages
from kncal.observe.compare import compare
from kncal.observe.difference import FIELDS
from kncal.observe.grain_metrics import GRAIN_METRICS
from kncal.observe.tolerances import parse_tolerances
from kncal.scene.metrics import COUPLED, DIFFERENCES, FEW_PARTICLES, KINDS_OF_BEDS, METRICS, RECORDS, offered

CODE = """
from kncal.observe import averages
from kncal.observe.difference import FIELDS
from kncal.observe.grain_metrics import GRAIN_METRICS
from kncal.scene.metrics import Metric
p_range = Metric(
    "p_range", "Pa", "range of the pressure", ("series:pressure",),
    function=lambda run: run.series.p_in.max() - run.series.p_in.min(),
)
top_speed = Metric(
    "top_speed", "m/s", "largest speed", ("contacts",), function=lambda run: abs(run.trajectory.v).max()
)
"""


@pytest.fixture
def plug_in(tmp_path, monkeypatch):
    """An installed package that adds two metrics."""
    info = tmp_path / "extra-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: extra\nVersion: 1.0\n", encoding="utf-8")
    names = "p_range = extra:p_range\ntop_speed = extra:top_speed\n"
    (info / "entry_points.txt").write_text(f"[kncal.metrics]\n{names}", encoding="utf-8")
    (tmp_path / "extra.py").write_text(CODE.replace(".p_in.ptp()", ".p_in.max() - run.series.p_in.min()"), "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    METRICS.__dict__.pop("_added", None)
    yield
    METRICS.__dict__.pop("_added", None)
    METRICS._loaded.clear()
    sys.modules.pop("extra", None)


def test_every_metric_says_what_it_is_and_needs():
    for metric in METRICS.values():
        assert metric.unit and metric.text and metric.needs
        assert set(metric.needs) <= set(RECORDS)
        assert set(metric.of) <= set(KINDS_OF_BEDS)
        assert metric.difference in DIFFERENCES
    assert not set(offered(FEW_PARTICLES)) & set(offered(COUPLED))
    assert {*offered(FEW_PARTICLES), *offered(COUPLED)} == set(METRICS)
    assert {*averages._METRICS, *GRAIN_METRICS, *FIELDS} == set(offered(COUPLED)), "each has its function"


def test_an_added_metric_is_compared_where_what_it_needs_is_recorded(plug_in):
    assert "p_range" in offered(COUPLED) and "top_speed" in offered(FEW_PARTICLES)
    assert parse_tolerances(["p_range=20%"], COUPLED) == {"p_range": 0.2}
    with pytest.raises(InputError, match="expected one of"):
        parse_tolerances(["p_range=20%"], FEW_PARTICLES)
    beds = run_data("linear", 1), run_data("hertz", 2)
    found = compare(*beds, {"p_range": 10.0})
    ranges = [np.ptp(run.series.p_in) for run in beds]
    row = found.row("p_range")
    assert (row.run.value, row.reference.value, row.verdict, row.unit) == (*ranges, "ok", "Pa")
    assert "top_speed" not in {r.metric for r in found.rows}
    few = compare(comparisons.run_data("linear", {}), comparisons.run_data("hertz", {}), {"top_speed": 0.0})
    assert few.row("top_speed").run.value == 1.0
    assert few.within
    assert "p_range" not in {r.metric for r in few.rows}


def test_rows_of_all_kinds_of_runs_have_the_same_keys():
    bed = run_data("hertz", 3)
    one = comparisons.run_data("hertz", {"e_n": 0.9})
    documents = [compare(run, run, {}).to_dict() for run in (bed, one)]
    assert documents[0].keys() == documents[1].keys()
    assert documents[0]["rows"][0].keys() == documents[1]["rows"][0].keys()
