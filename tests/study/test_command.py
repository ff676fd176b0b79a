"""The command: its table, files and page; what it says is what it measured."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.scene.case_file import load_case
from kncal.scene.load import settled_height
from kncal.study.stability import accuracy, maps, workflow
from kncal.study.stability.accuracy import AccuracyEdge
from kncal.study.stability.coupling_edges import BedEdge, BedPoint, reduced
from kncal.study.stability.edges import Bracket, Edge
from kncal.study.stability.probes import ingredients, pressed
from kncal.study.stability.results import Stability


def command(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    return int(stop.value.code or 0)


@pytest.mark.slow
def test_the_command_writes_what_it_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # fewer runs, the same work
    monkeypatch.setattr(maps, "STEPS_QUICK", (0.02, 0.8, 2.0))
    monkeypatch.setattr(accuracy, "NUMBERS", (6.0, 12.0, 24.0, 48.0, 96.0, 192.0))
    out = tmp_path / "out"
    assert command(["stability", "wall_impact", "--engine", "builtin", "--quick", "--json", "--out", str(out)]) == 0
    printed = json.loads(capsys.readouterr().out)
    kept = json.loads((out / "stability.json").read_text())
    assert printed == kept | {"report": str(out / "report" / "index.html")}
    assert "safe for all" in kept["sentences"][0]
    with (out / "stability.csv").open() as file:
        assert file.readline().startswith("# units:")
        rows = list(csv.DictReader(file))
    assert len(rows) == len(kept["edges"]) > 10
    assert {row["model"] for row in rows} == {"linear", "hertz"}
    for row in rows:
        assert float(row["edge_low"]) < float(row["edge_high"])
    with (out / "map.csv").open() as file:
        file.readline()
        assert len(list(csv.DictReader(file))) == len(kept["cells"])
    assert {c["outcome"] for c in kept["cells"]} >= {"stable", "wrong-restitution", "energy-gain", "refused"}
    page = (out / "report" / "index.html").read_text()
    assert kept["sentences"][0] in page
    for name in ("edges", "map-e_n", "map-contacts", "map-size_ratio", "map-k_n"):
        assert (out / "report" / f"{name}.png").stat().st_size > 0
        assert f'src="{name}.svg"' in page


def edge(measured: float, advised: float) -> Edge:
    probe = pressed(ingredients(load_case("wall_impact")), "linear", 0.6, 2)
    bracket = Bracket(low=0.999 * measured, high=1.001 * measured, beyond="energy-gain")
    return Edge(probe=probe, advised=advised, limit=advised, arrangement=measured, measured={"builtin": bracket})


def test_unsafe_advice_is_called_so() -> None:
    few = AccuracyEdge(kind="linear", e_n=0.6, error=0.01, measured=20, predicted=10, confirmed=None, dt=1e-7)
    given = ingredients(load_case("wall_impact"))

    def say(advised: float) -> str:
        found = Stability(given=given, engines=("builtin",), edges=(edge(1e-6, advised),), accuracy=(few,), cells=())
        return " ".join(found.sentences())

    assert "UNSAFE by 20 %" in say(1.25e-6)
    assert "UNSAFE" not in say(1e-6)
    assert "margin: 100 %" in say(0.5e-6)
    assert "in 0 of 1 such cases" in say(1e-6)


def point(value: float, level: str, outcome: str) -> BedPoint:
    return BedPoint(edge="x", value=value, setting=value, unit="s", level=level, outcome=outcome, evidence="e")


def test_a_wrong_bed_that_nothing_warns_of_is_called_unsafe() -> None:
    fine = point(0.1, "ok", "right")
    loud = BedEdge(name="x", runs=(fine, point(1.0, "warn: a", "off"), point(2.0, "refuse: a", "not-finite")))
    silent = BedEdge(name="x", runs=(fine, point(1.0, "ok", "off"), point(2.0, "refuse: a", "off")))
    assert "UNSAFE" not in loud.sentence
    assert "refuses from 2" in loud.sentence
    assert "UNSAFE: 1 passes" in silent.sentence
    assert "no run went wrong" in BedEdge(name="x", runs=(fine, point(1.0, "warn: a", "right"))).sentence


@pytest.mark.parametrize("name", ["bubbling_bed_mini", "bubbling_bed", "bubbling_bed_goldschmidt"])
def test_a_reduced_bed_has_the_same_particles_cells_and_gas(name: str) -> None:
    scene = load_case(name)
    small = reduced(scene)
    for axis in range(3):
        edges = [s.box.size[axis] / s.gas.cells[axis] for s in (scene, small)]
        assert edges[1] == pytest.approx(edges[0], rel=1e-12)
    assert small.number <= 600
    assert small.run.until_time <= 0.05
    assert (small.diameter, small.contact) == (scene.diameter, scene.contact)
    assert small.box.height > 2.0 * settled_height(small)


def test_elastic_hertz_is_probed_without_damping() -> None:
    """The law "hertz" has no dashpot: a probe with one could not be planned."""
    scene = load_case("wall_impact")
    given = ingredients(replace(scene, contact=replace(scene.contact, law="hertz", e_n=1.0)))
    probes = workflow._probes(given, [1.0], quick=True)
    assert {p.e_n for p in probes} == {1.0}
