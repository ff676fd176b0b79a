"""The report: complete, self-contained, safe with hostile text, and saying what the comparison says."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest
from comparisons import run_data
from models import model, on_wall

from kncal.engines.builtin.integrator import integrate
from kncal.observe.compare import Comparison, compare
from kncal.observe.contacts import observe
from kncal.observe.run_data import RunData
from kncal.physics.calibration import calibrate
from kncal.report.comparison import write_report
from kncal.report.overview import Context, error_table, kn_curves, method_table
from kncal.scene.contact import ContactChoice
from kncal.scene.exact import solve
from kncal.scene.needs import decide
from kncal.scene.plan import pair_of
from kncal.scene.scene import Scene

pytestmark = pytest.mark.slow

HOSTILE = '<img src=x onerror="alert(1)"></script><script>alert(2)</script>'
CASE = replace(
    on_wall(velocity=(0.0, 0.0, -1.0)),
    title="A bead hits a floor",
    contact=ContactChoice(e_n=0.9, v_0=1.0),
    tolerances={"e_n": 0.02, "delta_max": 0.05},
)


def compared(scene: Scene, exact: bool = True) -> Comparison:
    """Both models run by the small integrator, the linear one calibrated."""
    k_n = float(calibrate(pair_of(*scene.body_pairs()[0]), v_0=1.0, e_n=0.9).k_n)
    runs = {}
    for kind in ("linear", "hertz"):
        planned = model(scene, kind, t_end=4e-4, e_n=0.9, k_n=k_n)
        frames = integrate(planned)
        data = run_data(kind, {}, scene=scene)
        runs[kind] = RunData(
            model=planned,
            result=replace(data.result, dt=planned.dt, steps=planned.n_steps),
            frames=frames,
            contacts=observe(planned, frames),
            motion=solve(planned, planned.t_end) if exact else None,
        )
    return compare(runs["linear"], runs["hertz"])


def write(comparison: Comparison, folder: Path, text: str = "liggghts -in in.liggghts") -> Path:
    scene = comparison.reference.model.scene
    pair = pair_of(*scene.body_pairs()[0])
    return write_report(
        comparison,
        folder,
        context=Context(
            methods=method_table(pair, v_0=1.0, e_n=0.9),
            kn_curves=kn_curves(pair, v_0=1.0, e_n=0.9),
            errors=error_table({"linear": comparison.run.model, "hertz": comparison.reference.model}),
            needs=decide(scene).to_frame(),
        ),
        provenance={"linear": {"command": ["stdbuf", text], "files_sha256": {text: "ab" * 32}}, text: {"dt": 1e-6}},
    )


class Page(HTMLParser):
    """Tags with attributes, visible text, and what was seen first."""

    def __init__(self, path: Path):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.silent = False
        self.feed(path.read_text(encoding="utf-8"))

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


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(CASE)


@pytest.fixture(scope="module")
def report(comparison: Comparison, tmp_path_factory) -> Path:
    return write(comparison, tmp_path_factory.mktemp("report") / "a new folder")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory) -> Path:
    scene = replace(CASE, title=HOSTILE, source=HOSTILE, tolerances={HOSTILE: 0.1})
    ball = replace(scene.spheres[0], name=HOSTILE, group=HOSTILE)
    # names that the classes themselves refuse
    for field, value in (("name", HOSTILE), ("particles", {HOSTILE: scene.particles["bead"]}), ("spheres", (ball,))):
        object.__setattr__(scene, field, value)
    return write(compared(scene, exact=False), tmp_path_factory.mktemp("hostile"), HOSTILE)


def test_the_page_carries_the_verdict_first(comparison, report):
    assert report.name == "index.html"
    page = Page(report)
    text = " ".join(page.text.split())
    assert comparison.within
    places = [text.index(" ".join(sentence.split())) for sentence in comparison.verdict.all]
    assert places == sorted(places)
    assert places[-1] < text.index("Linear against Hertz")
    assert "A bead hits a floor" in text
    tags = [tag for tag, _ in page.tags]
    assert tags.index("section") < tags.index("table")


def test_the_order_of_the_sections(report):
    text = report.read_text(encoding="utf-8")
    headings = re.findall(r"<h2>(.*?)</h2>", text)
    assert headings == [
        "Linear against Hertz",
        "Figures",
        "Linear stiffness by every method",
        "Speed against accuracy",
        "Physics that this case needs",
        "Conventions",
        "Provenance",
    ]
    assert "by the paper&#39;s method as reconstructed" in text
    assert "Contact end: the overlap is back at zero" in text


def test_every_row_is_in_the_page(comparison, report):
    text = Page(report).text
    for row in comparison.rows:
        assert row.metric in text
    for name in ("max_overlap", "contact_duration", "strain_energy", "stdbuf", "ab" * 32):
        assert name in text


@pytest.mark.parametrize("which", ["report", "hostile"])
def test_nothing_is_loaded_from_elsewhere_and_nothing_runs(which, request):
    path = request.getfixturevalue(which)
    page = Page(path)
    (policy,) = [m["content"] for m in page.all("meta") if m.get("http-equiv") == "Content-Security-Policy"]
    rules = {rule.split()[0]: rule.split()[1:] for rule in policy.split(";")}
    assert rules["default-src"] == ["'none'"]
    assert rules["img-src"] == ["'self'", "data:"]
    assert rules["style-src"] == ["'unsafe-inline'"]
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "embed", "base", "form"}
    assert not [name for _, attributes in page.tags for name in attributes if name.startswith("on")]
    assert not re.search(r"https?://", path.read_text(encoding="utf-8"))
    for svg in path.parent.glob("*.svg"):
        assert "<script" not in svg.read_text(encoding="utf-8").lower()


@pytest.mark.parametrize("which", ["report", "hostile"])
def test_every_picture_and_file_is_there(which, request):
    path = request.getfixturevalue(which)
    page = Page(path)
    pictures = page.all("img")
    assert len(pictures) == 6
    signatures = {".png": b"\x89PNG\r\n", ".svg": b"<?xml"}
    for picture in pictures:
        assert picture["alt"]
        svg = path.parent / picture["src"]
        for file in (svg, svg.with_suffix(".png")):
            assert file.read_bytes().startswith(signatures[file.suffix])
    links = [a["href"] for a in page.all("a")]
    assert len(links) == len(set(links)) == 6 + 4
    assert all((path.parent / link).stat().st_size > 0 for link in links)


def test_hostile_text_is_shown_not_obeyed(hostile):
    assert HOSTILE in Page(hostile).text
    raw = hostile.read_text(encoding="utf-8")
    assert "<img src=x" not in raw
    assert "<script" not in raw
    assert raw.count("</html>") == 1
    assert "could not be computed" in raw


def test_the_numbers_beside_the_page_are_those_of_the_comparison(comparison, report):
    data = json.loads((report.parent / "comparison.json").read_text(encoding="utf-8"))
    assert data.pop("provenance")["linear"]["command"][0] == "stdbuf"
    assert data.pop("warnings") == []
    assert data == json.loads(json.dumps(comparison.to_dict()))
    metrics = pd.read_csv(report.parent / "metrics.csv", comment="#").set_index("metric")
    for row in comparison.rows:
        assert metrics.loc[row.metric, "difference"] == row.difference.value
    accuracy = pd.read_csv(report.parent / "speed_accuracy.csv", comment="#")
    # the CPU time stands where a run was made, and nowhere else
    assert (accuracy["cpu_seconds"].notna() == accuracy["run"]).all()
    assert accuracy["run"].sum() == 2
    first = (report.parent / "calibration.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "k_n [N/m]" in first and "reference_t_c [s]" in first and "v_0 [m/s]" in first


def test_writing_again_replaces_an_old_page_by_the_same_one(comparison, report, tmp_path):
    (tmp_path / "index.html").write_text("old", encoding="utf-8")
    again = write(comparison, tmp_path)
    for file in report.parent.iterdir():
        assert (again.parent / file.name).read_bytes() == file.read_bytes()


def test_a_bare_comparison_still_has_a_report(tmp_path):
    bare = compare(run_data("linear", {"e_n": 0.5}), run_data("hertz", {"e_n": 0.9}), {"e_n": 0.1})
    page = Page(write_report(bare, tmp_path, provenance={}))
    assert "Outside tolerance" in page.text
    assert [picture["src"] for picture in page.all("img")] == ["motion.svg"]
    assert sorted(p.name for p in tmp_path.glob("*.csv")) == ["metrics.csv"]
