"""``kncal cases``, ``new``, ``needs``, ``doctor``, ``laws``: what there is, and what a scene requires."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import Case, Json
from kncal.core.errors import InputError


def cases(*, json: Json = False) -> None:
    """List the shipped cases."""
    from kncal.scene.case_file import load_case, shipped_cases

    scenes = [load_case(name) for name in shipped_cases()]
    if json:
        show.as_json([{"name": s.name, "title": s.title, "source": s.source} for s in scenes])
        return
    show.words(
        "Shipped cases", ["case", "what it is", "parameters from"], [[s.name, s.title, s.source] for s in scenes]
    )
    show.say("Run one: kncal compare NAME.  Make your own from one: kncal new NAME FOLDER")


def new(
    case: Annotated[str, Parameter(help="name of a shipped case, see `kncal cases`")],
    folder: Annotated[Path, Parameter(help="a folder that does not exist yet")],
) -> None:
    """Copy a shipped case as the start of your own."""
    from kncal.core.checks import one_of, plain_name
    from kncal.core.shipped import folder as resource
    from kncal.scene.case_file import load_case, shipped_cases

    one_of("case", case, shipped_cases())
    if folder.exists():
        raise InputError(f"{folder}: exists already; expected a new folder, nothing was changed")
    name = folder.resolve().name
    try:
        plain_name("name of a case", name)
    except InputError as error:
        raise InputError(f"{folder}: a case has the name of its folder; {error}; nothing was written") from error
    source = resource("cases") / case / "case.toml"
    text = _changed_from(case, source.read_text("utf-8"))
    folder.mkdir(parents=True)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    for name in load_case(case).files:  # meshes and tables that it names
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((resource("cases") / case / name).read_bytes())
    show.say(f"{folder / 'case.toml'} written: edit it, then: kncal compare {folder}")


def _changed_from(case: str, text: str) -> str:
    """Return the text of a shipped case with a source that will be true of what a user makes of it."""
    from kncal.scene.case_text import parse_toml, toml_value

    source = f"changed from {case}: {parse_toml(text, case)['source']}"
    return re.sub(r"(?m)^source = .*$", lambda _: f"source = {toml_value(source[:300])}", text, count=1)


def needs(case: Case, *, json: Json = False) -> None:
    """Show which parts of the physics CASE needs, and why."""
    from kncal.scene.case_file import load_case
    from kncal.scene.needs import decide

    scene = load_case(case)
    frame = decide(scene).to_frame()
    if json:
        show.as_json(frame.to_dict(orient="records"))
        return
    rows = [[str(cell) for cell in row] for row in frame.itertuples(index=False)]
    show.words(f"What {case} needs", list(frame.columns), rows)
    show.say("To decide it yourself, write in the case file: [needs] tangential = true or false (or rolling)")


def doctor(*, json: Json = False) -> int:
    """Check this machine: solvers, versions, pictures without a screen, disk; exit code 4 if LIGGGHTS is missing."""
    from kncal.cli.machine import examine

    findings = examine()
    if json:
        show.as_json([asdict(f) | {"ok": f.ok} for f in findings])
    else:
        rows = [[f.name, "ok" if f.ok else "NO", f.found, f.needed_for, f.hint] for f in findings]
        show.words("This machine", ["what", "", "found", "needed for", "what to do"], rows)
    return 4 if any(not f.ok and f.name.lower().startswith("liggghts") for f in findings) else 0


def laws(*, json: Json = False) -> None:
    """List the contact laws, the methods for k_n and the drag laws, with sources and limits."""
    from kncal.physics.drag import DRAGS
    from kncal.physics.laws import LAWS
    from kncal.physics.methods import METHODS

    lists: tuple[tuple[Any, str, dict[str, str]], ...] = (
        (
            LAWS,
            "Contact laws",
            {
                "name": "law",
                "title": "what it is",
                "liggghts": "in LIGGGHTS",
                "source": "source",
                "note": "note",
            },
        ),
        (
            METHODS,
            "Methods for k_n",
            {"name": "method", "keeps": "keeps equal", "loses": "does not keep", "avoid": "not for"},
        ),
        (DRAGS, "Drag laws", {"name": "drag", "title": "what it is", "source": "source"}),
    )
    if json:
        found = {}
        for entries, _, columns in lists:
            keys = dict.fromkeys(("name", "title", "source", *columns))
            found[f"{entries.what}s"] = [
                {key: getattr(entry, key) for key in keys} | {"package": entries.source(name)}
                for name, entry in entries.items()
            ]
        show.as_json(found)
        return
    for entries, title, columns in lists:
        rows = [[getattr(entry, key) for key in columns] for entry in entries.values()]
        show.words(title, list(columns.values()), rows)
