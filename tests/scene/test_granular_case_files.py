"""The shipped cases of many particles without gas: promises of form. Whether their numbers come out is tested where
they are run."""

from __future__ import annotations

import json

import pytest
from shipped import GRANULAR

from kncal.core.shipped import folder
from kncal.scene.case_file import dump_case, load_case, parse_case
from kncal.scene.finding import require_possible
from kncal.scene.limits import check
from kncal.scene.metrics import COUPLED, offered
from kncal.scene.model import KINDS
from kncal.scene.plan import plan

#: What a shipped case may be warned of: soft beads on a usual step, a fall that only happens while they settle, and
#: beads that touch two triangles of a drum at once.
KNOWN = {"dem-step", "fast-impact", "wall-edges"}


@pytest.mark.parametrize("name", GRANULAR)
def test_shipped_cases_say_what_they_are(name: str) -> None:
    home, scene = folder("cases") / name, load_case(name)
    lines = (home / "case.toml").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ")
    assert lines[0].endswith("SI units.")
    assert len(lines) <= 90
    assert scene.title
    assert scene.source
    assert scene.tolerances, "a comparison needs tolerances for a verdict"
    assert parse_case(dump_case(scene), name=name, folder=scene.folder) == scene
    readme = (home / "README.md").read_text(encoding="utf-8")
    assert readme.startswith(f"# {scene.title}")
    assert f"    kncal compare {name}\n" in readme
    expected = json.loads((home / "expected.json").read_text(encoding="utf-8"))
    assert set(expected) == {"note", "metrics"}
    assert set(expected["metrics"]) == set(KINDS)
    for metrics in expected["metrics"].values():
        assert metrics
        for metric, entry in metrics.items():
            assert metric in offered(COUPLED)
            assert set(entry) == {"value", "rel_tol", "source"}
            assert entry["rel_tol"] > 0.0


@pytest.mark.parametrize("name", GRANULAR)
def test_shipped_cases_are_possible(name: str) -> None:
    models = plan(load_case(name))
    assert tuple(models) == KINDS
    for model in models.values():
        findings = check(model)
        assert {f.code for f in findings if f.level == "warn"} <= KNOWN
        require_possible(findings)
