"""What frames too far apart hide, and what no tolerance judges, is said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.scene.case_file import load_case
from kncal.scene.contact_limits import FEWEST_FRAMES
from kncal.scene.limits import check
from kncal.scene.plan import plan

pytestmark = pytest.mark.slow

QUICK = ["--engine", "builtin", "--out"]


def kncal(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main([*arguments])
    printed = capsys.readouterr()
    return int(stop.value.code or 0), " ".join(printed.out.split()), printed.err


def messages(case: str, *changes: str) -> dict[str, list[str]]:
    """Kind -> what is said of its recording."""
    scene = load_case(case, overrides=changes)
    return {kind: [f.message for f in check(model) if f.code == "not-recorded"] for kind, model in plan(scene).items()}


def test_a_contact_that_passes_between_two_frames_is_told_before_the_run_and_after(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = ["--set", "run.record_every=1000", *QUICK, str(tmp_path / "run")]
    code, out, err = kncal(capsys, "run", "wall_impact", *far)
    assert code == 0
    assert "e_n" not in out.split("warning")[0].split("dt")[0]  # nothing was seen of the contact
    for text in (out, err):
        assert "a frame every 1000 steps" in text
        assert "run.record_every = 20 at most" in text  # of 100 steps per contact
    code, out, err = kncal(capsys, "compare", "wall_impact", *far)
    assert code == 1
    assert "no contact was recorded" in out
    assert "no contact happened" not in out
    assert "run.record_every = 20 at most" in err


def test_a_run_that_ends_before_its_contact_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    until = ["--set", "run.until_bounces=none", "--set", "run.until_time=1e-9"]
    _, out, err = kncal(capsys, "run", "wall_impact", *until, *QUICK, str(tmp_path / "run"))
    assert "run.until_time" in out
    assert "record_every" not in out + err


def test_frames_of_a_contact_are_counted_for_the_shortest_contact() -> None:
    n = 100
    for kind, texts in messages("wall_impact", f"run.record_every={n // FEWEST_FRAMES}").items():
        assert not texts, kind
    for kind, texts in messages("wall_impact", f"run.record_every={n // FEWEST_FRAMES + 1}").items():
        assert texts, kind
        allowed = float(texts[0].split("run.record_every = ")[1].split()[0])
        assert allowed == n // FEWEST_FRAMES
    assert not any(messages("sliding_particle").values())
    assert not any(messages("wall_impact", "run.steps_per_contact=4").values())


def test_the_verdict_names_the_largest_difference_that_nobody_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A spring 34 times too soft keeps e_n, and lasts sqrt(34) times as long: "within tolerance", but of e_n alone."""
    scene = load_case("wall_impact")
    k_n = plan(scene)["linear"].between("sphere", "floor").k / 34.0
    changes = [f"contact.k_n={k_n!r}", "contact.method=none", "tolerances={e_n=0.05}"]
    sets = [part for change in changes for part in ("--set", change)]
    code, out, _ = kncal(capsys, "compare", "wall_impact", *sets, *QUICK, str(tmp_path / "run"), "--json")
    data = json.loads(out)
    assert code == 0
    assert data["within"] is True
    open_rows = {r["metric"]: r["difference"] for r in data["rows"] if r["tolerance"] is None and r["difference"]}
    assert open_rows["t_c"] > 4.0
    worst = max(open_rows, key=lambda name: abs(open_rows[name]))
    (said,) = (text for text in data["points"] if worst in text)
    page = (tmp_path / "run" / "report" / "index.html").read_text()
    assert said[:40] in page
