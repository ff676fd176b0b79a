"""Data flows one way: a room imports only from the rooms above it, and modules form no circle of imports."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: From the ground up: a room imports only from those before it.
ROOMS = ("core", "physics", "scene", "record", "engines", "observe", "report", "runs", "exchange", "study", "cli")
#: Beyond that: what observes and reports knows no engine; studies take whatever can be run.
FORBIDDEN = {("observe", "engines"), ("report", "engines"), ("study", "exchange")}
#: Imports that still point the wrong way; the list only gets shorter.
TODAY: set[tuple[str, str]] = set()


def modules() -> dict[str, Path]:
    found = {}
    for path in sorted((ROOT / "kncal").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of kncal that a file imports anywhere: at its top, inside functions, for type checking only."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in known else str(node.module) for name in names}
    return found & known.keys()


def room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ROOMS else ""


def edges() -> list[tuple[str, str]]:
    known = modules()
    return [(name, other) for name, path in known.items() for other in imports(path, known) if other != name]


def test_every_module_has_a_room():
    assert {name for name in modules() if not room(name)} == {"kncal", "kncal.__main__"}


def test_imports_point_up():
    wrong = set()
    for name, other in edges():
        here, there = room(name), room(other)
        if here and there and (ROOMS.index(there) > ROOMS.index(here) or (here, there) in FORBIDDEN):
            wrong.add((name.removeprefix("kncal."), other.removeprefix("kncal.")))
    assert wrong == TODAY, f"new: {sorted(wrong - TODAY)}; no longer there: {sorted(TODAY - wrong)}"


def test_no_circle_of_imports():
    graph: dict[str, set[str]] = {}
    for name, other in edges():
        if "kncal" not in (name, other):
            graph.setdefault(name.removeprefix("kncal."), set()).add(other.removeprefix("kncal."))
    list(graphlib.TopologicalSorter(graph).static_order())  # CycleError names the circle
