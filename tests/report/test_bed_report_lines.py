"""The table of a bed report: short lines, every doubt once below, nothing empty for beds that have little to show."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compared_beds import SCENE, run_data

from kncal.observe.compare import Comparison, compare
from kncal.report.comparison import write_report
from kncal.report.page import marks
from kncal.report.rows import split_reason, table_of


@pytest.mark.parametrize(
    ("reason", "notes"),
    [
        ("", []),
        ("5 frames", ["5 frames"]),
        ("a; b", ["a", "b"]),
        ("linear: a; b; hertz: b; c", ["linear: a", "b", "hertz: c"]),
        ("hertz: only 5 samples: too few", ["hertz: only 5 samples: too few"]),
        ("start-up: none; linear: a", ["start-up: none", "linear: a"]),
    ],
)
def test_a_reason_is_split_into_statements_with_their_run(reason, notes):
    assert split_reason(reason) == notes


@pytest.fixture(scope="module")
def short() -> Comparison:
    scene = replace(SCENE, tolerances={"z_mean": 0.01, "bed_height": 0.01})
    return compare(*(run_data(kind, n, scene=scene, length=0.3) for n, kind in enumerate(("linear", "hertz"))))


def test_every_row_is_in_the_table_or_named_below_it(short):
    rows = table_of(short.rows)
    unseen = {name for line in rows.unseen for name in line.partition(":")[0].split(", ")}
    shown = [cells[0].split("\u202f")[0] for cells in rows.table.rows]
    assert len(shown) == len(set(shown))
    assert set(shown) | unseen == {row.metric for row in short.rows}
    assert not set(shown) & unseen
    assert {"z_mean", "bed_height"} <= set(shown)  # what is to be judged stands in the table, seen or not
    for row in short.rows:
        assert (row.metric in unseen) == (not row.seen and row.tolerance is None)


def test_notes_are_numbered_once_and_say_what_the_rows_say(short):
    rows = table_of(short.rows)
    assert len(set(rows.notes)) == len(rows.notes) > 0
    reasons = {r.metric: [] if r.difference.reliable else split_reason(r.reason) for r in short.rows}
    numbers = {note: number for number, note in enumerate(rows.notes, 1)}
    for name, *_ in rows.table.rows:
        metric = name.split("\u202f")[0]
        assert name == metric + marks(sorted(numbers[note] for note in reasons[metric]))
    used = {note for name, *_ in rows.table.rows for note in reasons[name.split("\u202f")[0]]}
    assert used == set(rows.notes)


def report(comparison: Comparison, folder: Path) -> str:
    return write_report(comparison, folder, provenance={}).read_text(encoding="utf-8")


def without_dem(scene, **arrays):
    """Both runs of a bed in which LIGGGHTS had nothing to do: its signals are not there."""
    runs = []
    for number, kind in enumerate(("linear", "hertz")):
        data = run_data(kind, number, scene=scene, length=1.0, cpu=(0.0, 5.0, 1.0), bubble=False)
        arrays["U"] = np.broadcast_to(np.float32([0.0, 0.0, 1.6]), data.series.U.shape)
        nothing = dict.fromkeys(("floor", "walls", "overlap_max", "overlap_mean", "contacts"), np.full(200, np.nan))
        series = replace(data.series, **(nothing | {"histogram": np.zeros_like(data.series.histogram)} | arrays))
        runs.append(replace(data, signals=series))
    return compare(*runs)


def test_a_frozen_bed_shows_nothing_that_moves(tmp_path):
    scene = SCENE.with_group(frozen=True)
    page = report(without_dem(scene, kinetic_energy=np.zeros(200)), tmp_path)
    images = set(re.findall(r'<img src="([^"]+)"', page))
    assert {"p_in.svg", "voidage.svg"} <= images
    assert not images & {"z_mean.svg", "animation.gif", "overlaps.svg", "bubbles.svg"}
    for words in ("DEM step", "chaotic", "Bubbles are", "overlap_share counts", "bed height is"):
        assert words not in page, words
    assert not re.search(r"<h[23]>[^<]*</h[23]>\s*</section>", page)
    assert not re.search(r"<tbody>\s*</tbody>", page)


def test_a_single_particle_is_no_bed(tmp_path):
    scene = SCENE.with_group(count=1)
    runs = [run_data(kind, n, scene=scene, length=1.0, bubble=False) for n, kind in enumerate(("linear", "hertz"))]
    page = report(compare(*runs), tmp_path)
    assert "Height of the particle." in page
    assert "animation.gif" not in page
    assert "Bubbles are" not in page
    assert not re.search(r"<tbody>\s*</tbody>", page)
