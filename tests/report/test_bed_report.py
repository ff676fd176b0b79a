"""The report on beds: complete, self-contained, safe with hostile text, and saying what the comparison says."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from compared_beds import MEANS, SCENE, run_data

from kncal.core.units import plus_minus, quantity
from kncal.observe.compare import Comparison, compare
from kncal.report.comparison import write_report

pytestmark = pytest.mark.slow

HOSTILE = '<img src=x onerror="alert(1)"></script><script>alert(2)</script>'
CASE = replace(SCENE, tolerances={"overlap_mean": 0.05, "z_mean": 0.001, "pressure_drop": 0.5})


def compared(scene=CASE, **options) -> Comparison:
    softer = {"overlap_mean": 2.0 * MEANS["overlap_mean"]}
    options = {"scene": scene, "length": 0.8, "tau": 0.01} | options
    return compare(run_data("linear", 1, means=softer, **options), run_data("hertz", 2, **options))


def write(comparison: Comparison, folder: Path, text: str = "kncal run") -> Path:
    return write_report(
        comparison,
        folder,
        warnings=[f"cell-size: {text}"],
        provenance={"linear": {"command": ["kncal", text], "files_sha256": {text: "ab" * 32}}, text: {"dt": 1e-6}},
    )


class Page(HTMLParser):
    """Tags with attributes, and visible text."""

    def __init__(self, path: Path):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.silent = False
        self.feed(path.read_text(encoding="utf-8"))
        self.text = " ".join(self.text.split())

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.silent = tag == "style"

    def handle_endtag(self, tag):
        self.silent = False

    def handle_data(self, data):
        if not self.silent:
            self.text += data

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def with_impacts(data, particles: float, walls: float):
    """The same run with exponential impact speeds of these means: energy-weighted they are three times that."""
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 100.0, 121)])
    generator, n = np.random.default_rng(3), len(data.series.t)
    v = generator.exponential(np.array([particles, walls])[None, :, None], (n, 2, 100))
    counts = np.array([[np.histogram(pair, edges)[0] for pair in row] for row in v], dtype=np.int32)
    series = replace(
        data.series,
        facts=replace(data.series.facts, impact_edges=tuple(edges)),
        watched=np.full(n, 1e-3),
        impacts=counts,
        impact_sums=np.stack([v.sum(-1), (v**2).sum(-1), (v**3).sum(-1)], axis=-1),
    )
    return replace(data, signals=series)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared()


@pytest.fixture(scope="module")
def report(comparison, tmp_path_factory) -> Path:
    return write(comparison, tmp_path_factory.mktemp("report") / "a new folder")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory) -> Path:
    """Names full of hostile text, beds without bubbles, impact speeds on record: one report: each takes seconds."""
    scene = replace(CASE, title=HOSTILE, source=HOSTILE, tolerances={HOSTILE: 0.1})
    object.__setattr__(scene, "name", HOSTILE)  # which the class itself refuses
    runs = [with_impacts(data, 0.05, 0.5 / 3.0) for data in compared(scene, bubble=False, length=0.3).runs]
    return write(compare(*runs), tmp_path_factory.mktemp("hostile"), HOSTILE)


def test_the_page_carries_the_verdict_first(comparison, report):
    text = Page(report).text
    assert comparison.state == "outside"
    places = [text.index(" ".join(sentence.split())) for sentence in comparison.verdict.all]
    assert places == sorted(places)
    assert places[-1] < text.index("Linear against Hertz")
    assert "overlap_mean" in comparison.verdict.all[0]


def test_every_row_is_on_the_page_with_its_verdict(comparison, report):
    html = report.read_text(encoding="utf-8")
    for row in comparison.rows:
        assert row.metric in html
        if row.reason and not row.seen:
            continue  # listed by the reason, below the table
        line = re.search(rf"<tr class=\"over\"><td>{row.metric}[\u202f<].*?</tr>", html)
        assert line, row.metric
        verdict = re.findall(r">([^<>]*)</td></tr>", line[0])[0]
        assert verdict == ("" if row.verdict == "-" else row.verdict)


def test_every_image_exists_is_local_and_described(report):
    page = Page(report)
    images = page.all("img")
    names = {str(i["src"]) for i in images}
    drawn = ("p_in", "z_mean", "voidage", "overlaps", "spectrum", "bubbles", "velocity")
    assert names == {*(f"{name}.svg" for name in drawn), "animation.gif"}
    for image in images:
        assert image["alt"]
        assert (report.parent / str(image["src"])).stat().st_size > 1000
    for link in page.all("a"):
        assert (report.parent / str(link["href"])).is_file(), link
    from PIL import Image

    with Image.open(report.parent / "animation.gif") as gif:
        assert gif.n_frames > 10


def test_nothing_is_fetched_and_nothing_runs(report, hostile):
    for path in (report, hostile):
        page = Page(path)
        policy = next(m["content"] for m in page.all("meta") if m.get("http-equiv") == "Content-Security-Policy")
        assert policy is not None
        assert policy.startswith("default-src 'none'")
        assert "script" not in policy
        tags = {tag for tag, _ in page.tags}
        assert not tags & {"script", "link", "iframe", "object", "embed", "form"}
        assert "http" not in re.sub(r"http-equiv", "", path.read_text(encoding="utf-8"))


def test_hostile_text_stays_text(hostile):
    page = Page(hostile)
    assert all(image["src"] != "x" for image in page.all("img"))
    assert not any("onerror" in attributes for _, attributes in page.tags)
    assert page.text.count("alert(2)") >= 6  # title, source, verdict, row, warning, provenance


def test_what_the_page_says_about_the_physics(comparison, report):
    text = Page(report).text
    for words in (
        "model B",
        "buoyancy",
        "Tangential stiffness: linear k_t/k_n",
        "Contact end: the overlap is back at zero",
        "ErgunWenYu",
        "live",
        "10 × 2 × 20",
        "at most 1e-10",
        "cell-size: kncal run",
    ):
        assert words in text, words
    split = [f"{c.cpu_seconds:.3g} s ({c.cpu_seconds / c.total:.0%})" for c in comparison.costs]
    assert all(part in text for part in split)


def test_the_files_beside_hold_the_same_numbers(comparison, report):
    data = json.loads((report.parent / "comparison.json").read_text(encoding="utf-8"))
    assert [data["verdict"], *data["points"], *data["details"]] == list(comparison.verdict.all)
    assert data["provenance"]["linear"]["command"] == ["kncal", "kncal run"]
    table = pd.read_csv(report.parent / "metrics.csv", comment="#").set_index("metric")
    for row in comparison.rows:
        if row.difference.value is not None:
            assert table.loc[row.metric, "difference"] == row.difference.value
    for run in comparison.runs:
        written = pd.read_csv(report.parent / f"{run.model.kind}.csv", comment="#")
        assert (written["p_in"] == run.series.p_in).all()


def test_a_bed_without_bubbles_is_reported_without_their_figure(hostile):
    names = {str(i["src"]) for i in Page(hostile).all("img")}
    assert "bubbles.svg" not in names
    assert "p_in.svg" in names


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (105.34, 1.23, "105.3 ± 1.2"),
        (105.34, 123.0, "105 ± 123"),
        (0.0123456, 0.00012, "0.01235 ± 0.00012"),
        (-3.0, 0.5, "-3.00 ± 0.50"),
        (2.0, 0.0, "2 ± 0"),
    ],
)
def test_numbers_are_shown_to_the_digits_of_their_uncertainty(value, uncertainty, text):
    assert plus_minus(value, uncertainty) == text


def test_value_and_uncertainty_share_a_unit():
    assert quantity(0.01002, "m", width=0.00021) == "10.02 ± 0.21 mm"
    assert quantity(0.5, "–", width=0.01) == "0.500 ± 0.010"
    assert quantity(0.0099, "m²/s²", width=0.0001) == "0.00990 ± 0.00010 m²/s²"
    assert quantity(None, "Pa") == "–"


def test_impact_speeds_stand_beside_the_one_calibrated_at(hostile):
    """v_0 is 0.5 m/s: far above the particles' energy-weighted 0.15 m/s, just that of the walls."""
    page = Page(hostile)
    html = hostile.read_text(encoding="utf-8")
    assert (html.count("<td>above</td>"), html.count("<td>within</td>")) == (2, 2)
    assert "kn --from-run" in page.text
    pictures = {image["src"] for image in page.all("img")}
    assert {"impact_speeds_linear.svg", "impact_speeds_hertz.svg"} <= pictures
    assert all((hostile.parent / name).stat().st_size for name in pictures)


def test_runs_in_which_nothing_meets_have_no_impact_speeds(report):
    assert "Impact speeds" not in Page(report).text
    assert not list(report.parent.glob("impact_speeds*"))
