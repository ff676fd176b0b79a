"""Templates from elsewhere: only where trusted, rendered within bounds, and named in every record."""

from __future__ import annotations

import contextvars
import hashlib
import json
import shutil
from pathlib import Path

import pytest

from kncal.cli import main
from kncal.core import templating
from kncal.core.errors import InputError, RenderError
from kncal.core.shipped import folder as shipped_folder
from kncal.core.templating import foreign_hashes, plain, trust_templates
from kncal.engines.registry import get_engine
from kncal.observe.compare import compare
from kncal.report.page import page_template
from kncal.runs.folder import read_manifest
from kncal.runs.workflow import complete, load_both, render_case, report_on, run_case
from kncal.scene.case_file import load_case

pytestmark = pytest.mark.slow


@pytest.fixture
def templates(tmp_path: Path) -> Path:
    folder = tmp_path / "templates"
    (folder / "liggghts").mkdir(parents=True)
    return folder


def script(folder: Path, text: str) -> Path:
    path = folder / "liggghts" / "Allrun.j2"
    path.write_text(text, encoding="utf-8")
    return path


def rendered(out: Path) -> str:
    render_case(load_case("wall_impact"), get_engine("liggghts"), out, ["linear"])
    return (out / "linear" / "Allrun").read_text()


def test_they_stand_in_only_where_trusted_and_are_recorded(templates: Path, tmp_path: Path) -> None:
    data = script(templates, "# mine: {{ scene|name }}\n").read_bytes()
    with trust_templates(templates) as hashes:
        assert rendered(tmp_path / "a") == "# mine: wall_impact\n"
    assert hashes == {"liggghts/Allrun.j2": hashlib.sha256(data).hexdigest()}
    assert read_manifest(tmp_path / "a" / "linear")["foreign_templates"] == hashes
    assert not foreign_hashes()
    assert "# mine" not in rendered(tmp_path / "b")
    assert "foreign_templates" not in read_manifest(tmp_path / "b" / "linear")


def test_the_text_that_was_named_is_the_text_that_is_rendered(templates: Path, tmp_path: Path) -> None:
    """A file that is changed after it was read does not change what the manifest vouches for."""
    path = script(templates, "first\n")
    with trust_templates(templates):
        path.write_text("second\n")
        assert rendered(tmp_path / "a") == "first\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{{ ''.__class__.__mro__ }}", "__class__"),
        ("{{ scene.__init__.__globals__ }}", "__init__"),
        ("{{ cycler.__init__.__globals__.os.system('touch ran') }}", "unsafe"),
        ("{{ types.append(1) }}", "append"),
        ("{{ 'x' * 10**11 }}", "MemoryError"),
        ("{{ nothing }}", "nothing"),
        ("{% if %}", "TemplateSyntaxError"),
        ("{% include '../../../etc/passwd' %}", "TemplateNotFound"),
        ("{% include '/etc/passwd' %}", "TemplateNotFound"),
        ("{{ 1 // 0 }}", "ZeroDivisionError"),
        ("é", "not ASCII"),
    ],
)
def test_what_the_sandbox_refuses(templates: Path, tmp_path: Path, text: str, words: str) -> None:
    script(templates, text)
    with trust_templates(templates), pytest.raises(RenderError, match=words) as caught:
        rendered(tmp_path / "out")
    assert "Allrun.j2" in str(caught.value)
    assert not (tmp_path / "out").exists()
    assert not list(tmp_path.rglob("ran"))


def test_endless_rendering_is_stopped(templates: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(templating, "SECONDS", 1)
    loops = "{% for i in range(99999) %}{% for j in range(99999) %}{% endfor %}{% endfor %}"
    script(templates, loops)
    with trust_templates(templates), pytest.raises(RenderError, match=r"stopped|not rendered within"):
        rendered(tmp_path / "out")


def test_only_templates_of_kncals_names_and_no_links(templates: Path, tmp_path: Path) -> None:
    def refused(words: str) -> None:
        with pytest.raises(InputError, match=words), trust_templates(templates):
            pass

    refused("no template in it")
    (templates / "liggghts" / "in.ligggghts.j2").write_text("x")
    refused(r"did you mean 'liggghts/in.liggghts.j2'")
    (templates / "liggghts" / "in.ligggghts.j2").unlink()
    (templates / "liggghts" / "Allrun.j2").symlink_to("/etc/hostname")
    refused("a link")
    (templates / "liggghts" / "Allrun.j2").unlink()
    script(templates, "x" * (templating.MOST_BYTES + 1))
    refused("expected at most")
    (templates / "liggghts" / "Allrun.j2").write_bytes(b"\xff")
    refused("UTF-8")
    with pytest.raises(InputError, match="not a folder"), trust_templates(tmp_path / "none"):
        pass


def test_only_plain_values_are_given() -> None:
    with pytest.raises(RenderError, match="a object cannot"):
        plain({"a": [object()]}, "x")
    assert plain({"a": (1, 2.5, None, Path("x"))}, "x") == {"a": [1, 2.5, None, "x"]}


def test_pages_escape_and_name_the_templates(templates: Path) -> None:
    (templates / "report").mkdir()
    text = "<h1>{{ title }}</h1>{% for name, data in provenance.items() %}{{ name }}{{ data }}{% endfor %}"
    (templates / "report" / "index.html.j2").write_text(text)
    with trust_templates(templates) as hashes:
        page = page_template("index.html.j2").render(title="<script>", provenance={})
    assert "<script>" not in page and "&lt;script&gt;" in page
    assert hashes["report/index.html.j2"] in page
    assert "--trust-templates" in page


def test_kncals_own_pages_are_the_same_by_way_of_the_child(templates: Path, tmp_path: Path) -> None:
    """A copy of kncal's base page, trusted: all values reach it as plain ones, and the page says the same."""
    run_case(load_case("wall_impact"), get_engine("builtin"), tmp_path / "out")
    comparison = compare(*(complete(run) for run in load_both(tmp_path / "out")))
    own = report_on(comparison, tmp_path / "own").read_text("utf-8")
    (templates / "report").mkdir()
    shutil.copy(shipped_folder("templates") / "report" / "base.html.j2", templates / "report")
    with trust_templates(templates):
        theirs = report_on(comparison, tmp_path / "theirs").read_text("utf-8")
    head, _, _ = own.partition("<h2>Provenance</h2>")
    assert theirs.startswith(head)
    assert "--trust-templates" in theirs and "--trust-templates" not in own


def test_command_line(templates: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The whole way: the report of a run from foreign templates names them, also when it is made later without them."""
    script(templates, "# mine\n")
    out = tmp_path / "out"

    def cli(*arguments: object) -> int:
        with pytest.raises(SystemExit) as stop:
            contextvars.copy_context().run(main, [str(a) for a in arguments])
        return int(stop.value.code or 0)

    flags = ("--engine", "liggghts", "--out", out)
    assert cli("render", "wall_impact", *flags, "--trust-templates", templates) == 0
    assert "not kncal's" in " ".join(capsys.readouterr().err.split())
    assert (out / "linear" / "Allrun").read_text() == "# mine\n"
    digest = hashlib.sha256(b"# mine\n").hexdigest()
    assert json.loads((out / "hertz" / "manifest.json").read_text())["foreign_templates"] == {
        "liggghts/Allrun.j2": digest
    }
    assert cli("render", "wall_impact", *flags) == 0
    assert "# mine" not in (out / "linear" / "Allrun").read_text()
    assert cli("render", "wall_impact", *flags, "--trust-templates", tmp_path / "none") == 2
