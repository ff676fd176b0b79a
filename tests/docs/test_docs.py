"""What the pages promise: examples run and print what is shown, cases load, commands exist, tables are complete."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
import shlex
import tomllib
from contextlib import redirect_stdout
from dataclasses import fields
from inspect import signature
from io import StringIO
from pathlib import Path
from typing import Any, get_args

import pytest

import kncal
from kncal import cli
from kncal.physics.laws import LAWS
from kncal.physics.methods import METHODS
from kncal.scene.case_file import load_case, parse_case, shipped_cases
from kncal.scene.limits import check
from kncal.scene.needs import OVERRULABLE
from kncal.scene.plan import plan
from kncal.scene.scene import Scene
from kncal.scene.walls import AnyMotion, WallKeys
from kncal.study import Settings, combine, design, grid_axis
from kncal.study.trim.parts import PARTS

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("cases/*/README.md")])
WORKFLOW = ROOT / "docs/ci/github-actions.yml"
CASE_FILE, THEORY = ROOT / "docs/case-file.md", ROOT / "docs/theory.md"

_BLOCK = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.S | re.M)
#: code, and what it prints if that stands right below
_PYTHON = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?", re.S | re.M)
_COMMAND = re.compile(r"^(?: {4})?\s*(?:\$ |- run: |run: )?(?:[\w./-]*/)?kncal(\s.*)?$")
_OPERATOR = re.compile(r"[();<>|&]+")


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def _blocks(page: Path) -> list[tuple[str, str]]:
    """(language, text) of the fenced blocks, in order."""
    return _BLOCK.findall(page.read_text("utf-8"))


def _with(language: str) -> list[Path]:
    return [page for page in PAGES if any(kind == language for kind, _ in _blocks(page))]


def _section(page: Path, heading: str) -> str:
    """Text below a heading, up to the next one of any level."""
    text = page.read_text("utf-8")
    found = re.search(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#+ |\Z)", text, re.S | re.M)
    assert found, f"{_name(page)} has no heading {heading!r}"
    return found[1]


def _rows(section: str) -> list[list[str]]:
    """Cells of the tables of a section, without headings and rules."""
    rows = [[c.strip() for c in line.strip().strip("|").split("|")] for line in section.splitlines() if "|" in line]
    rules = [i for i, row in enumerate(rows) if all(set(cell) <= {"-", ":"} for cell in row)]
    return [row for i, row in enumerate(rows) if i not in rules and i + 1 not in rules]


def _commands(page: Path) -> list[list[str]]:
    """Arguments of every kncal command in shell blocks (and in indented ones), and in the workflow."""
    whole = page.read_text("utf-8")
    fenced = "\n".join(text for kind, text in _blocks(page) if kind in ("", "sh", "bash", "console"))
    fenced += whole if page == WORKFLOW else ""
    rest = _BLOCK.sub("", whole)
    indented = "\n".join(line for line in rest.splitlines() if line.startswith("    kncal "))
    commands = []
    for line in f"{fenced}\n{indented}".replace("\\\n", " ").splitlines():
        if found := _COMMAND.match(line):
            words = shlex.shlex(found[1] or "", posix=True, punctuation_chars=True)
            words.whitespace_split = True
            arguments: list[str] = []
            for word in words:
                if _OPERATOR.fullmatch(word):
                    break
                arguments.append(word)
            commands.append(arguments)
    return commands


# --- examples -----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("page", _with("python"), ids=_name)
def test_python_blocks_run_and_print_what_is_shown(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "docs"}
    for code, shown in _PYTHON.findall(page.read_text("utf-8")):
        printed = StringIO()
        with redirect_stdout(printed):
            exec(compile(code, _name(page), "exec"), names)  # noqa: S102 - the project's own pages
        if shown:
            assert printed.getvalue().split() == shown.split(), f"now it prints:\n{printed.getvalue()}"


def _complete(page: Path) -> list[str]:
    return [text for kind, text in _blocks(page) if kind == "toml" and "[particles." in text]


@pytest.mark.parametrize("page", _with("toml"), ids=_name)
def test_case_examples_load(page: Path) -> None:
    """Whole cases load and can be planned; a few lines of one fit into the reference's case of a few bodies."""
    for text in _complete(page):
        for made in plan(parse_case(text, name="example")).values():
            assert made.n_steps > 0
            assert not [finding for finding in check(made) if finding.level == "refuse"]
    base = tomllib.loads(_complete(CASE_FILE)[0])
    for kind, text in _blocks(page):
        if kind == "toml" and text not in _complete(page):
            parse_case(text, name="example", tables=base | tomllib.loads(text))


def test_there_are_complete_examples() -> None:
    """A case of a few bodies, a bed and a hopper; together they use every table of a case file, but a layer."""
    single, bed, hopper = (tomllib.loads(text) for text in _complete(CASE_FILE))
    assert set(single) | set(bed) | set(hopper) == {field.name for field in fields(Scene)} - {"name", "folder", "layer"}
    assert single["contact"]["pairs"]
    assert bed["gas"]["jet"]


@pytest.mark.parametrize("page", [page for page in [*PAGES, WORKFLOW] if _commands(page)], ids=_name)
def test_commands_parse(page: Path) -> None:
    """Every command line has known commands and flags, and cases that exist or were made on the page."""
    commands = _commands(page)
    cases = {*shipped_cases(), *(words[2] for words in commands if words[:1] == ["new"] and len(words) > 2)}
    for words in commands:
        function, bound, _ = cli.app.parse_args(words, exit_on_error=False, print_error=False)
        given = {**bound.arguments}
        case = given.get("case") or (given.get("first") if given.get("second") is None else None)
        if case is not None and "case" in (*signature(function).parameters, "first") and not case.isupper():
            assert case in cases or "/" in case, f"kncal {shlex.join(words)}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [page for page in PAGES if any("--set" in words for words in _commands(page))], ids=_name
)
def test_values_from_outside_fit_their_cases(page: Path) -> None:
    """What a command sets is a key of its case with a value that it may have; of a sweep every point is tried."""
    commands = [words for words in _commands(page) if words]
    copied = {words[2]: words[1] for words in commands if words[0] == "new"}
    for words in commands:
        given = [words[i + 1] for i, word in enumerate(words) if word == "--set" and "$" not in words[i + 1]]
        case = copied.get(words[1], words[1]) if given else ""
        if words[0] == "sweep" and given:
            design(case, combine([grid_axis(text) for text in given]), Settings())
        elif given:
            load_case(case, overrides=given)


def test_the_extractor_sees_commands() -> None:
    """The how-to for CI has commands in shell blocks, the workflow in its steps; both kinds are found."""
    commands = _commands(ROOT / "docs/how-to/compare-two-runs-in-ci.md")
    assert ["new", "wall_impact", "my_case"] in commands
    assert ["compare", "my_case", "--engine", "builtin", "--json"] in commands  # "> comparison.json" is the shell's
    assert ["doctor"] in _commands(WORKFLOW)


# --- links --------------------------------------------------------------------------------------------------


def _anchors(page: Path) -> set[str]:
    titles = re.findall(r"^#+ (.+)$", _BLOCK.sub("", page.read_text("utf-8")), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", _BLOCK.sub("", page.read_text("utf-8"))):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        assert not anchor or anchor in _anchors(file), target


_ENTRY_POINTS = {"kncal.laws", "kncal.methods", "kncal.drags", "kncal.metrics"}
_DOTTED = re.compile(r"\bkncal(?:\.[A-Za-z_]\w*)+")


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_files_and_names_of_the_code_are_there(page: Path) -> None:
    text = page.read_text("utf-8")
    for path in re.findall(r"\b(?:kncal|tests|docs|cases)/[\w/]+\.(?:py|md|toml)\b", text):
        assert (ROOT / path).exists() or (page.parent / path).exists(), path
    for dotted in set(_DOTTED.findall(text)) - _ENTRY_POINTS:
        assert pkgutil.resolve_name(dotted) is not None, dotted


# --- completeness -------------------------------------------------------------------------------------------


def _generator() -> Any:
    spec = importlib.util.spec_from_file_location("make_reference", ROOT / "docs/make_reference.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_of_the_reference_are_as_the_schema_is_now(tmp_path: Path) -> None:
    """Made anew from empty tables the page is the same; else run python docs/make_reference.py."""
    emptied = tmp_path / CASE_FILE.name
    text = CASE_FILE.read_text("utf-8")
    emptied.write_text(re.sub(r"(<!-- table: .*? -->\n).*?(<!-- end -->)", r"\1\2", text, flags=re.S))
    assert emptied.read_text("utf-8") != text
    assert _generator().make(emptied) == text


def _tables(made: Any) -> set[Any]:
    """A class of a scene, and those of its fields."""
    keys = getattr(made, "__pydantic_fields__", None)
    if keys is None:
        return {table for part in get_args(made) for table in _tables(part)}
    return {made}.union(*(_tables(key.annotation) for key in keys.values()))


def test_every_table_of_the_schema_and_every_registry_stands_in_the_reference() -> None:
    tables = _tables(Scene) | {WallKeys, AnyMotion}
    wanted = {f"{table.__module__}.{table.__name__}" for table in tables}
    wanted |= {"kncal.physics.methods.METHODS", "kncal.scene.metrics.FEW_PARTICLES", "kncal.scene.metrics.COUPLED"}
    assert set(re.findall(r"<!-- table: (.*?) -->", CASE_FILE.read_text("utf-8"))) == wanted
    assert {row[0].strip("`") for row in _rows(_section(CASE_FILE, "`[needs]`"))} == set(OVERRULABLE)


def test_theory_names_every_law_and_method_and_every_methods_kappa() -> None:
    """kappa at e_n = 1 as printed on the page; from the closed forms: (4/5)^(4/5) and (5/4)^(1/5)."""
    laws = {row[0].strip("`") for row in _rows(_section(THEORY, "3 Contact laws")) if "`" in row[0]}
    assert set(LAWS) <= laws
    section = _section(THEORY, "6 Methods for k_n")
    methods = {row[0].split("`")[1] for row in _rows(_BLOCK.sub("", section)) if row[0].startswith("`")}
    assert methods == set(METHODS)
    assert f"strain_energy        1.0   {0.8**0.8:.4f}" in section
    assert f"max_overlap_secant   1.0   {1.25**0.2:.4f}" in section


def test_theory_names_every_warning() -> None:
    """Impacts that ask for trouble raise exactly the codes of the page's table."""
    soft = kncal.Material(young=1e6, poisson=0.3, density=2500, yield_strength=1e3)
    beads, unequal = kncal.pair(soft, 1e-3), kncal.pair(soft, 1e-3, soft, 4e-3)
    seen = [
        kncal.calibrate(beads, v_0=1.5, e_n=0.5),
        kncal.calibrate(kncal.pair(kncal.Material(young=70e9, poisson=0.22, density=2500), 1.0), v_0=0.5, e_n=0.9),
        kncal.calibrate(beads, v_0=0.1, e_n=0.05),
        kncal.calibrate(beads, v_0=1e-5, e_n=0.9, law="hertz"),
        kncal.calibrate(beads, v_0=0.1, e_n=0.1, end="force"),
        kncal.calibrate(unequal, v_0=0.1, e_n=0.9, law="kuwabara_kono"),
    ]
    codes = {w.code for c in seen for w in c.warnings}
    shown = {row[0].strip("`") for row in _rows(_section(THEORY, "8 Validity limits"))}
    assert shown == {"(error)", *codes}


def test_exit_codes_and_errors_stand_in_their_pages() -> None:
    rows = _rows(_BLOCK.sub("", _section(ROOT / "docs/how-to/compare-two-runs-in-ci.md", "2 Run and judge")))
    names = ("OK", "OUTSIDE", "USAGE", "FAILED", "MISSING", "UNEXPECTED", "INTERRUPTED")
    codes = {getattr(cli.failures, name) for name in names}
    assert {int(row[0]) for row in rows} == codes
    errors = {name for name in kncal.__all__ if name.endswith("Error")} - {"KncalError"}
    rows = _rows(_section(ROOT / "docs/how-to/use-the-python-api.md", "Errors"))
    assert set(re.findall(r"`(\w+Error)`", " ".join(row[0] for row in rows))) == errors


def test_every_part_that_trim_tries_stands_in_its_page() -> None:
    shown = {row[0].strip("`") for row in _rows(_section(ROOT / "docs/how-to/trim-a-scene.md", "Trim a scene"))}
    assert shown == set(PARTS)
