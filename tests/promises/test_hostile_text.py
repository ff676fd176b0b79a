"""Text of a stranger's case file never becomes a command: refused, or shown as text, in every file that is rendered."""

from __future__ import annotations

import ast
import json
import os
import pwd
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kncal
from kncal.core.errors import CaseFileError, ReadError, RenderError
from kncal.core.shipped import folder as shipped_folder
from kncal.engines.base import gas_setup
from kncal.engines.dpmfoam.case import install_state, write_case
from kncal.engines.dpmfoam.live import _FUNCTIONS
from kncal.engines.liggghts.deck import bed_deck, deck_text
from kncal.engines.registry import get_engine
from kncal.record.openfoam import refuse_code
from kncal.runs.folder import refuse_links
from kncal.runs.workflow import render_case, run_case
from kncal.scene.case_file import load_case, parse_case, shipped_cases
from kncal.scene.case_text import find_case, toml_value
from kncal.scene.plan import plan
from kncal.scene.scene import Scene

#: What each would do is leave a file called "ran".
HOSTILE = [
    "x\nshell touch ran",
    "x\r\nshell touch ran",
    "x\u2028shell touch ran",
    "x\x0bshell touch ran",
    "x &",
    "x; touch ran",
    'x" touch ran "',
    "x' touch ran '",
    "$(touch ran)",
    "`touch ran`",
    "${steps}",
    '0.02; libs ("evil.so"); xx 1',
    "#calc #{ system(touch ran) #}",
    "{{ cycler.__init__.__globals__.os.system('touch ran') }}",
    "../../ran",
    "/etc/passwd",
    "-in",
    "",
    "x" * 65,
    "é",
    "\u202eabc",
]
SINGLE = find_case("wall_impact").read_text()
BED = find_case("bubbling_bed_mini").read_text()

_SHELL = re.compile(r"^\s*(shell|include|jump|python|plugin|log)\b", re.MULTILINE)
_CODE = re.compile(r"\bcoded|#\s*(calc|codeStream|eval|include|inputMode|remove)|systemCall|dynamicCode|\bcode\w*\b")


def changed(text: str, way: tuple[Any, ...], value: object) -> dict[str, Any]:
    tables = tomllib.loads(text)
    here: Any = tables
    for key in way[:-1]:
        here = here[key]
    here[way[-1]] = value
    return tables


def renamed(text: str, kind: str, name: str) -> dict[str, Any]:
    """The tables of a case whose only group or wall has this name."""
    (one,) = tomllib.loads(text)[kind].values()
    return changed(text, (kind,), {name: one})


def load(text: str, tables: dict[str, Any], name: str = "x") -> Scene:
    return parse_case(text, name=name, tables=tables)


@pytest.mark.parametrize("bad", HOSTILE)
def test_names_and_numbers_refuse_it(bad: str) -> None:
    """Every field of both kinds of case: names of bodies, materials, walls, the case; and every number."""
    for text in (SINGLE, BED):
        tables = tomllib.loads(text)
        with pytest.raises(CaseFileError):
            load(text, tables, name=bad)
        with pytest.raises(CaseFileError):
            load(text, changed(text, ("materials", bad), next(iter(tables["materials"].values()))))
        for kind in ("particles", "walls"):
            with pytest.raises(CaseFileError, match=kind):
                load(text, renamed(text, kind, bad))
    sphere, floor = ("particles", "sphere"), ("walls", "floor")
    beads, column = ("particles", "beads"), ("walls", "column")
    for text, ways in (
        (SINGLE, [(*sphere, "material"), (*floor, "material"), (*floor, "axis"), (*floor, "shape")]),
        (BED, [(*beads, "material"), (*beads, "place"), (*column, "material"), (*column, "shape")]),
        (BED, [("gas", "drag"), ("gas", "walls"), ("layer",)]),
    ):
        for way in ways:
            with pytest.raises(CaseFileError, match=way[-1]):
                load(text, changed(text, way, bad))
    with pytest.raises(CaseFileError, match="periodic"):
        load(BED, changed(BED, ("periodic",), [bad]))
    numbers: list[tuple[str, list[tuple[str | int, ...]]]] = [
        (SINGLE, [(*sphere, "diameter"), ("run", "steps_per_contact"), ("contact", "e_n")]),
        (BED, [("gas", "U_0"), ("gas", "viscosity"), ("run", "coupling"), (*beads, "count"), (*column, "size", 0)]),
    ]
    for text, places in numbers:
        for place in places:
            with pytest.raises(CaseFileError, match=str(place[-1] if place[-1] != 0 else place[-2])):
                load(text, changed(text, place, f"0.02{bad}"))


@pytest.mark.parametrize("bad", [text for text in HOSTILE if text.isprintable()])
def test_titles_are_written_back_as_text(bad: str) -> None:
    """What may stand in a title comes back as it was, and no renderer of solver input ever sees it."""
    tables = tomllib.loads(f"title = {toml_value(bad)}\nsource = {toml_value(bad)}")
    assert tables == {"title": bad, "source": bad}


@pytest.mark.parametrize("bad", [text for text in HOSTILE if not text.isprintable()])
def test_titles_refuse_control_characters(bad: str) -> None:
    for text in (SINGLE, BED):
        with pytest.raises(CaseFileError, match="title"):
            load(text, changed(text, ("title",), bad))


def check_rendered(folder: Path, library: bool = False) -> None:
    texts = {path: path.read_bytes().decode("ascii") for path in folder.rglob("*") if path.is_file()}
    assert texts
    for path, text in texts.items():
        bare = re.sub(r"//[^\n]*", "", text)
        assert not _CODE.search(bare), path
        if path.name != "Allrun":
            assert not _SHELL.search(text), path
            assert "HOSTILE" not in text, path
        libraries = re.findall(r"\blibs\b[^;]*;", bare)
        assert libraries == ([_FUNCTIONS.split("\n")[0]] if library and path.name == "controlDict" else []), path
        assert path.stat().st_mode & 0o022 == 0, path


@pytest.mark.parametrize("name", shipped_cases())
def test_what_is_rendered_for_every_shipped_case_holds_no_code(name: str, tmp_path: Path) -> None:
    text = find_case(name).read_text()
    tables = changed(text, ("title",), "HOSTILE; shell touch ran; #calc")
    scene = parse_case(text, name=name, tables=tables, folder=find_case(name).parent)
    if scene.coupled:
        for kind, model in plan(scene).items():
            if model.contacts:
                (tmp_path / f"{kind}.in").write_text(deck_text(bed_deck(model)))
            if (setup := gas_setup(model)) is not None:
                for functions in (None, _FUNCTIONS):
                    folder = tmp_path / f"{kind}-{'live' if functions else 'gas'}"
                    write_case(setup, folder, end_time=0.1, functions=functions)
                    check_rendered(folder, library=functions is not None)
                    shutil.rmtree(folder)
        if list(tmp_path.iterdir()):
            check_rendered(tmp_path)
    else:
        render_case(scene, get_engine("liggghts"), tmp_path / "out")
        for kind in ("linear", "hertz"):
            for path in (tmp_path / "out" / kind).iterdir():
                if path.name == "manifest.json":
                    path.unlink()
            check_rendered(tmp_path / "out" / kind)


@pytest.mark.solver
def test_a_hostile_title_runs_nothing_on_the_real_solver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a normal user where the tests run as root: there OpenFOAM and Open MPI behave differently."""
    bad = "shell touch ran; $(touch ran) `touch ran` &"
    case = tmp_path / "bad" / "case.toml"
    case.parent.mkdir()
    text = "\n".join(line for line in SINGLE.splitlines() if not re.match(r"\s*(title|source)\s*=", line))
    case.write_text(f"title = {toml_value(bad)}\nsource = {toml_value(bad)}\n{text}")
    out = tmp_path / "out"
    monkeypatch.chdir(tmp_path)
    results = run_case(load_case(case), get_engine("liggghts"), out)
    assert {result.status for result in results.values()} == {"completed"}
    assert not list(tmp_path.rglob("ran"))
    if os.getuid() == 0:
        user = pwd.getpwnam("nobody")
        done = subprocess.run(
            ["sh", out / "linear" / "Allrun"],
            cwd=_owned(out / "linear", user),
            user=user.pw_uid,
            group=user.pw_gid,
            env={"PATH": os.environ["PATH"], "HOME": str(tmp_path)},
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0 or b"ermission denied" in done.stderr, done.stderr
        assert not list(tmp_path.rglob("ran"))


def _owned(folder: Path, user: pwd.struct_passwd) -> Path:
    for path in (folder, *folder.iterdir()):
        os.chown(path, user.pw_uid, user.pw_gid)
    return folder


HEAD = b"FoamFile { version 2.0; format binary; class volScalarField; object p; }\n"
STATE = (
    b"dimensions [0 1 -1 0 0 0 0];\ninternalField uniform 1;\nboundaryField\n{\n"
    b"    inlet { type fixedValue; value uniform 1; }\n    outlet { %s }\n}\n"
)


@pytest.mark.parametrize(
    "text",
    [
        HEAD + STATE % b'type fixedValue; libs ("evil.so"); value uniform 1;',
        HEAD + STATE % b"type codedFixedValue; value uniform 1;",
        HEAD + STATE % b"type fixedValue; value #calc 1;",
        HEAD + STATE % b"type fixedValue; value $x;",
        HEAD + STATE % b'type fixedValue; #include "/etc/passwd"; value uniform 1;',
        HEAD + STATE % b"type uniformFixedValue; uniformValue coded;",
        HEAD + b'libs ("evil.so");\n' + STATE % b"type slip;",
        b'libs ("evil.so");\n' + HEAD + STATE % b"type slip;",
        b'#include "x"\n' + HEAD + STATE % b"type slip;",
        HEAD.replace(b"object p;", b"object #calc x;") + STATE % b"type slip;",
    ],
)
def test_a_saved_gas_state_holds_numbers_only(tmp_path: Path, text: bytes) -> None:
    """The solver obeys what is in a field; the state of a run folder from elsewhere is copied into the case."""
    (tmp_path / "p").write_bytes(HEAD + STATE % b"type slip;")
    refuse_code(tmp_path / "p")
    for name in ("U.air", "p", "phi.air"):
        (tmp_path / name).write_bytes(text)
    with pytest.raises(ReadError):
        refuse_code(tmp_path / "p")
    target = tmp_path / "case"
    (target / "0").mkdir(parents=True)
    with pytest.raises(ReadError):
        install_state(tmp_path, target, 1)
    assert not list((target / "0").iterdir())


def test_links_on_output_are_not_followed(tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.mkdir()
    (tmp_path / "out").symlink_to(target)
    with pytest.raises(RenderError):
        render_case(load_case("wall_impact"), get_engine("builtin"), tmp_path / "out")
    inside = tmp_path / "run"
    (inside / "linear").mkdir(parents=True)
    refuse_links(inside)
    (inside / "linear" / "series").symlink_to(target)
    with pytest.raises(RenderError, match="series"):
        refuse_links(inside)
    assert not list(target.iterdir())


@pytest.mark.parametrize(
    ("key", "name"),
    [
        *(("log", name) for name in ("../secret", "/etc/passwd", "a/b")),
        *(("files_sha256", name) for name in ("../secret", "/etc/passwd", "series/../../secret", "series//etc", "./a")),
    ],
)
def test_a_record_names_no_file_outside_its_folder(tmp_path: Path, key: str, name: str) -> None:
    from kncal.runs.folder import read_result

    run_case(load_case("wall_impact"), get_engine("builtin"), tmp_path / "out", ["linear"])
    path = tmp_path / "out" / "linear" / "result.json"
    data = json.loads(path.read_text())
    data[key] = name if key == "log" else {name: "0" * 64}
    path.write_text(json.dumps(data))
    with pytest.raises(ReadError, match="name of a file"):
        read_result(path.parent)


# --- the source ------------------------------------------------------------------------------------------------------

SOURCES = sorted(Path(kncal.__file__).parent.rglob("*.py"))
_MODULES = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml"}
_CALLS = {"eval", "exec", "system", "popen", "read_pickle", "to_pickle", "getoutput", "check_output"}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(SOURCES[0].parent)))
def test_the_source_loads_and_starts_nothing_unsafe(path: Path) -> None:
    """No pickle, no YAML, no eval, no shell; numpy reads no objects."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name.partition(".")[0] for alias in node.names} if isinstance(node, ast.Import) else set()
            names |= {(node.module or "").partition(".")[0]} if isinstance(node, ast.ImportFrom) else set()
            assert not names & _MODULES, node.lineno
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            given = {word.arg: getattr(word.value, "value", None) for word in node.keywords}
            assert called not in _CALLS, node.lineno
            assert not given.get("shell"), node.lineno
            if called == "load" and isinstance(node.func, ast.Attribute) and getattr(node.func.value, "id", "") == "np":
                assert given.get("allow_pickle") is False, node.lineno


def test_pages_forbid_scripts_and_the_network() -> None:
    for path in (shipped_folder("templates") / "report").iterdir():
        text = path.read_text("utf-8")
        assert "<script" not in text and "|safe" not in text and "autoescape" not in text, path
        assert not re.search(r"(src|href)\s*=\s*[\"']?\s*(https?:)?//", text), path
        if "<html" in text:
            policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
            assert policy is not None
            assert "default-src 'none'" in policy[1] and "script-src" not in policy[1]


def test_pickled_arrays_are_never_unpickled(tmp_path: Path) -> None:
    from kncal.core.arrays import read_npz

    class Run:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.system, (f"touch {tmp_path}/ran",)

    np.savez(tmp_path / "a.npz", positions=np.array([Run()], dtype=object))
    with pytest.raises(ReadError, match="not plain numbers"):
        read_npz(tmp_path / "a.npz", 10**6)
    assert not (tmp_path / "ran").exists()


@pytest.mark.slow
def test_modules_in_the_working_folder_are_not_imported(tmp_path: Path) -> None:
    """A stranger's folder with a numpy.py or a kncal/ in it: children of kncal do not look there."""
    (tmp_path / "numpy.py").write_text("open('ran', 'w')")
    (tmp_path / "templates" / "liggghts").mkdir(parents=True)
    (tmp_path / "templates" / "liggghts" / "Allrun.j2").write_text("x\n")
    flags = ["render", "wall_impact", "--out", "out", "--trust-templates", "templates"]
    done = subprocess.run(
        [Path(sys.executable).with_name("kncal"), *flags], cwd=tmp_path, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "ran").exists()
