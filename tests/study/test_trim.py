"""Trimming scenes whose answer is known, by the builtin engine and once by the real solvers."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.core.errors import CaseFileError, InputError
from kncal.scene.case_file import dump_case, load_case
from kncal.study.trim.report import write_trim
from kncal.study.trim.run import TrimOptions, trim
from kncal.study.trim.trim import Trim

pytestmark = pytest.mark.slow

E_N = 0.97
#: Friction takes mu (1 + e_n) v_n of the tangential speed in gross sliding: of the order of what damping takes.
MU = 0.01
OBLIQUE = (
    'contact.law="tsuji"',
    f"contact.e_n={E_N}",
    f"contact.friction={MU!r}",
    "run.steps_per_contact=200",
)


def builtin(case: str, out: Path, *overrides: str, **values: object) -> Trim:
    return trim(case, out, TrimOptions(engine="builtin", rounds=1, overrides=overrides, **values))  # type: ignore[arg-type]


def verdicts(found: Trim) -> dict[str, str]:
    return {r.part.name: r.verdict for r in found.results}


def sizes(found: Trim, metric: str) -> dict[str, float]:
    return {r.part.name: abs(e.difference.value or 0.0) for r in found.results for e in r.effects if e.metric == metric}


def test_friction_of_a_sliding_ball_is_kept_and_its_loss_is_that_of_the_closed_form(tmp_path: Path) -> None:
    """Without friction the impact of a sliding sphere leaves its tangential speed and spin as they were."""
    found = builtin("oblique_impact", tmp_path, parts=("tangential",))
    (result,) = found.results
    assert result.verdict == "keep"
    effects = {e.metric: e for e in result.effects}
    scene = load_case("oblique_impact")
    v_x, _, v_z = scene.spheres[0].velocity
    kept = 1.0 - scene.contact.friction * 2.0 * abs(v_z) / v_x  # e_n = 1
    change = effects["tangential_restitution"]
    assert change.difference.value == pytest.approx(1.0 / kept - 1.0, abs=change.difference.deciding + 1e-4)
    assert effects["spin_out"].difference.value == pytest.approx(-1.0, abs=1e-9)
    assert effects["e_n"].difference.value == 0.0  # the normal motion knows nothing of friction
    assert found.without == ()
    assert found.trimmed.contact == scene.contact


def test_damping_off_gives_back_the_speed_that_it_took(tmp_path: Path) -> None:
    found = builtin("wall_impact", tmp_path, parts=("damping",))
    (result,) = found.results
    e_n = next(e for e in result.effects if e.metric == "e_n")
    given = load_case("wall_impact").contact.e_n
    assert e_n.difference.width is not None
    assert e_n.difference.value == pytest.approx((1.0 - given) / given, abs=e_n.difference.width)
    assert result.verdict == "keep"


def test_effects_that_add_up_are_found_and_the_most_suspicious_part_goes_back(tmp_path: Path) -> None:
    """Friction shifts the path along the wall, damping across it: together they shift it by the hypotenuse."""
    parts = ("tangential", "damping")
    first = builtin("oblique_impact", tmp_path, *OBLIQUE, parts=parts, tolerances={"trajectory": 1.0})
    alone = sizes(first, "trajectory")
    (attempt,) = first.attempts
    assert (attempt.verdict, set(attempt.without)) == ("holds", {"tangential", "damping"})
    (together,) = (abs(e.difference.value or 0.0) for e in attempt.effects if e.metric == "trajectory")
    # but for the friction that the damped contact lacks, a share 1 - e_n of it
    assert together == pytest.approx(math.hypot(*alone.values()), rel=1.0 - E_N)

    limit = 0.5 * (max(alone.values()) + together)
    found = builtin("oblique_impact", tmp_path, *OBLIQUE, parts=parts, tolerances={"trajectory": limit})
    assert verdicts(found) == {"tangential": "leave out", "damping": "leave out"}
    both, one = found.attempts
    assert (both.verdict, both.together, one.verdict) == ("changed", ("trajectory",), "holds")
    assert both.put_back == (max(alone, key=alone.__getitem__),)
    assert set(found.without) == set(alone) - set(both.put_back)
    assert "goes back" in both.sentence


def test_the_trimmed_case_is_a_case_that_leaves_out_what_the_report_says(tmp_path: Path) -> None:
    found = builtin("oblique_impact", tmp_path, *OBLIQUE, parts=("tangential",), tolerances={"e_n": 0.01})
    page = write_trim(found, tmp_path)
    scene = load_case(tmp_path / "case.toml", name="oblique_impact")
    assert scene == found.trimmed
    assert scene.needs == {"tangential": False}
    assert "trimmed: without tangential spring" in scene.title
    full = load_case("oblique_impact", overrides=OBLIQUE)
    assert replace(scene, needs={}, title="") == replace(full, title="")
    text = page.read_text("utf-8")
    assert "leave out" in text
    assert (page.parent / "effect.svg").is_file()
    data = json.loads((tmp_path / "trim.json").read_text("utf-8"))
    assert data["without"] == ["tangential"]
    lines = (tmp_path / "trim.csv").read_text("utf-8").splitlines()
    assert len(lines) == 2 + sum(max(len(r.effects), 1) for r in found.results)


def test_the_same_again_runs_nothing(tmp_path: Path) -> None:
    first = builtin("wall_impact", tmp_path, parts=("damping", "output"))
    stamps = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("result.json")}
    second = builtin("wall_impact", tmp_path, parts=("damping", "output"))
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("result.json")} == stamps
    assert second == first


def test_sparser_recording_makes_the_same_steps_and_smaller_files(tmp_path: Path) -> None:
    found = builtin("falling_particle", tmp_path, parts=("output",))
    (result,) = found.results
    assert result.cost is not None
    assert result.cost.steps == 0.0
    assert result.cost.tried_bytes < result.cost.full_bytes
    assert result.cost.cpu is None  # the builtin engine's CPU time says nothing
    assert result.verdict == "leave out"


def test_without_tolerances_the_step_error_is_the_measure(tmp_path: Path) -> None:
    """What is below the discretisation error is no effect; friction of a sliding ball is far above."""
    overrides = (*(f"tolerances.{name}=none" for name in load_case("oblique_impact").tolerances),)
    found = builtin("oblique_impact", tmp_path, *overrides, parts=("tangential", "contact_model"))
    assert found.tolerances == {}
    assert verdicts(found)["tangential"] == "keep"
    assert verdicts(found)["contact_model"] == "matters"  # t_c differs by 5 %


def test_a_tolerance_for_what_the_scene_has_not_is_told(tmp_path: Path) -> None:
    found = builtin("head_on_collision", tmp_path, parts=("output",), tolerances={"spin_out": 0.01, "e_n": 0.01})
    assert any("spin_out" in text for text in found.verdict.all)
    assert found.without == ("output",)


def test_a_part_that_cannot_run_is_told_and_the_others_are_judged(tmp_path: Path) -> None:
    """The builtin engine knows no rolling friction: forced on, it is refused."""
    found = builtin(
        "head_on_collision",
        tmp_path,
        "contact.friction=0.2",
        "contact.rolling_friction=0.1",
        parts=("rolling", "tangential"),
    )
    assert verdicts(found) == {"tangential": "not needed", "rolling": "cannot run"}
    assert "rolling" in next(r.sentence for r in found.results if r.part.name == "rolling")


def test_a_speed_to_be_measured_is_measured_once_for_all_runs(tmp_path: Path) -> None:
    found = builtin("wall_impact", tmp_path, "contact.v_0=measured", parts=("damping",))
    v_0 = found.trimmed.contact.v_0
    assert v_0 == pytest.approx(3.9, rel=1e-3)  # the sphere's own speed, without gravity
    assert verdicts(found) == {"damping": "keep"}


def test_a_full_scene_that_does_not_run_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(CaseFileError, match="rolling"):
        builtin("oblique_impact", tmp_path, "contact.rolling_friction=0.1")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="folder"):
        builtin("oblique_impact", tmp_path / "file")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            main(["trim", "wall_impact", "--engine", "builtin", "--rounds", "1", *arguments])
        printed = capsys.readouterr()
        return stop.value.code, printed.out, printed.err  # type: ignore[return-value]

    code, out, _ = run("--parts", "damping,contact_model", "--tolerance", "restitution=90%", "--json")
    data = json.loads(out)
    assert code == 0
    assert data["tolerances"] == {"e_n": 0.9}
    assert data["without"] == ["damping"]  # 67 % are allowed here
    assert Path(data["trimmed"]) == Path("runs/wall_impact_trim/case.toml")
    assert Path(data["report"]).is_file()
    code, out, _ = run("--parts", "damping")
    assert code == 0
    assert "keep it" in out
    for arguments, what in (
        (("--parts", "nonsense"), "nonsense"),
        (("--tolerance", "e_n"), "METRIC"),
        (("--transport", "live"), "transport"),
    ):
        code, _, err = run(*arguments)
        assert code == 2
        assert what in err


@pytest.mark.solver
def test_a_bed_without_gas_loses_its_pressure_drop(tmp_path: Path) -> None:
    """A shallow bed for two hundredths of a second: gas is kept, sparser frames change no number to the last bit."""
    scene = load_case("bubbling_bed_mini")
    small = replace(
        scene.with_group(count=300, place="lattice"),
        run=replace(scene.run, until_time=0.02, discard=0.0, frames_every=0.001),
        tolerances={"pressure_drop": 0.05, "kinetic_energy": 0.05},
    )
    path = tmp_path / "small.toml"
    path.write_text(dump_case(small), "utf-8")
    found = trim(path, tmp_path / "out", TrimOptions(parts=("gas", "output", "drag")))
    results = {r.part.name: r for r in found.results}
    assert results["gas"].verdict == "keep"
    assert "pressure_drop" in results["gas"].sentence
    assert {e.difference.value for e in results["output"].effects if e.tolerance is not None} == {0.0}
    assert found.without == ("output",)
    assert found.trimmed.run == replace(small.run, frames_every=0.004)
    assert all(r.cost is not None for r in found.results)
