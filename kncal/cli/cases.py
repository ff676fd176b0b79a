"""``kncal cases``, ``new``, ``needs``, ``doctor``, ``laws``: what there is, and what a scene requires."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from kncal.cli import show
from kncal.core.errors import InputError

Json = Annotated[bool, Parameter(name="--json", negative="", help="print data for machines")]


def cases(*, json: Json = False) -> None:
    """List the shipped cases."""
    from kncal.scene.case_file import load_case, shipped_cases

    scenes = [load_case(name) for name in shipped_cases()]
    if json:
        show.as_json([{"name": s.name, "title": s.title, "source": s.source} for s in scenes])
        return
    show.table(
        "Shipped cases",
        ["case", "what it is", "parameters from"],
        [[s.name, s.title, s.source] for s in scenes],
        text=(0, 1, 2),
        fold=True,
    )
    show.say("Run one: kncal compare NAME.  Make your own from one: kncal new NAME FOLDER")


def new(case: str, folder: Path) -> None:
    """Copy a shipped CASE to FOLDER as the start of your own.

    Parameters
    ----------
    case
        Name of a shipped case, see `kncal cases`.
    folder
        A folder that does not exist yet.
    """
    from kncal.core.checks import one_of, plain_name
    from kncal.core.shipped import folder as resource
    from kncal.scene.case_file import shipped_cases

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
    show.say(f"{folder / 'case.toml'} written: edit it, then: kncal compare {folder}")


def _changed_from(case: str, text: str) -> str:
    """Return the text of a shipped case with a source that will be true of what a user makes of it."""
    from kncal.scene.case_text import parse_toml, toml_value

    source = f"changed from {case}: {parse_toml(text, case)['source']}"
    return re.sub(r"(?m)^source = .*$", lambda _: f"source = {toml_value(source[:300])}", text, count=1)


def needs(case: str, *, json: Json = False) -> None:
    """Show which parts of the physics CASE needs, and why.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.scene.case_file import load_case
    from kncal.scene.needs import decide

    scene = load_case(case)
    frame = decide(scene).to_frame()
    if json:
        show.as_json(frame.to_dict(orient="records"))
        return
    show.table(
        f"What {case} needs",
        list(frame.columns),
        [[str(cell) for cell in row] for row in frame.itertuples(index=False)],
        text=tuple(range(len(frame.columns))),
        fold=True,
    )
    show.say("To decide it yourself, write in the case file: [needs] tangential = true or false (or rolling)")


def doctor(*, json: Json = False) -> int:
    """Check this machine: solvers, versions, pictures without a screen, disk; exit code 4 if LIGGGHTS is missing."""
    from kncal.cli.machine import examine

    findings = examine()
    if json:
        show.as_json([asdict(f) for f in findings])
    else:
        show.table(
            "This machine",
            ["what", "", "found", "needed for", "what to do"],
            [[f.name, "ok" if f.ok else "NO", f.found, f.needed_for, "" if f.ok else f.hint] for f in findings],
            text=(0, 1, 2, 3, 4),
            fold=True,
        )
    return 4 if any(not f.ok and f.name.lower().startswith("liggghts") for f in findings) else 0


def laws(*, json: Json = False) -> None:
    """List the contact laws, the methods for k_n and the drag laws, with sources and limits."""
    from kncal.core.registry import Registry
    from kncal.physics.drag import DRAGS
    from kncal.physics.laws import LAWS
    from kncal.physics.methods import METHODS

    if json:
        keys: tuple[tuple[Registry[Any], tuple[str, ...]], ...] = (
            (LAWS, ("name", "title", "source", "note")),
            (METHODS, ("name", "title", "source", "keeps", "loses", "avoid")),
            (DRAGS, ("name", "title", "source")),
        )
        show.as_json(
            {
                f"{found.what}s": [
                    {key: getattr(entry, key) for key in wanted} | {"package": found.source(name)}
                    for name, entry in found.items()
                ]
                for found, wanted in keys
            }
        )
        return
    show.table(
        "Contact laws",
        ["law", "what it is", "source"],
        [[w.name, f"{w.title}. {w.note}", w.source] for w in LAWS.values()],
        text=(0, 1, 2),
        fold=True,
    )
    show.table(
        "Methods for k_n",
        ["method", "keeps equal", "does not keep", "not for"],
        [[m.name, m.keeps, m.loses, m.avoid] for m in METHODS.values()],
        text=(0, 1, 2, 3),
        fold=True,
    )
    show.table(
        "Drag laws",
        ["drag", "what it is", "source"],
        [[d.name, d.title, d.source] for d in DRAGS.values()],
        text=(0, 1, 2),
        fold=True,
    )
