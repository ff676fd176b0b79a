"""Templates that are not kncal's, in force only where the user says that they are to be trusted.

What is rendered from them is run by the solvers, which obey every command in it. The rendering itself is bounded: a
sandbox, plain values only, in a child process with limits of time and memory; and every run and report names the
templates with their SHA-256.

``python -m kncal.core.foreign_templates`` is that child.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from kncal.core.awake import run_within
from kncal.core.errors import InputError, ReadError, RenderError
from kncal.core.files import decode_line, read_limited
from kncal.core.shipped import folder as shipped_folder

#: Largest template, most files in the folder, largest text rendered [bytes].
MOST_BYTES, MOST_FILES, MOST_TEXT = 1024**2, 100, 64 * 1024**2
#: What rendering one template may take: time [s], memory beyond what Python has taken already [bytes].
SECONDS, MEMORY = 10, 1024**3

_DONE, _REFUSED = 0, 9


@dataclass(frozen=True)
class _Foreign:
    """Relative name -> text, and -> SHA-256: read once, so what is named is what is rendered."""

    texts: Mapping[str, str]
    hashes: Mapping[str, str]


_IN_FORCE: ContextVar[_Foreign | None] = ContextVar("kncal_foreign_templates", default=None)


@contextmanager
def trust_templates(folder: Path | None) -> Iterator[Mapping[str, str]]:
    """Put the templates in ``folder`` in the place of kncal's of the same relative name, inside a ``with`` block.

    E.g. ``folder/liggghts/in.liggghts.j2``. Holds for what this thread renders. None: nothing changes.

    Yields
    ------
    Mapping
        Relative name -> SHA-256 of each template in force.

    Raises
    ------
    InputError
        If ``folder`` is not a folder, is empty, or holds anything but templates of kncal's names: no links, at most
        `MOST_FILES` files of `MOST_BYTES`, UTF-8.
    """
    if folder is None:
        yield foreign_hashes()
        return
    token = _IN_FORCE.set(_read(folder))
    try:
        yield foreign_hashes()
    finally:
        _IN_FORCE.reset(token)


def trust_from_now(folder: Path | None) -> Mapping[str, str]:
    """As `trust_templates`, to the end of the present context (`contextvars`): for the command line."""
    if folder is not None:
        _IN_FORCE.set(_read(folder))
    return foreign_hashes()


def foreign_hashes() -> Mapping[str, str]:
    """Return relative name -> SHA-256 of the foreign templates in force; empty if there are none."""
    foreign = _IN_FORCE.get()
    return MappingProxyType({}) if foreign is None else foreign.hashes


def in_force(folder: Path) -> dict[str, str]:
    """Return name -> text of the foreign templates in force for one folder of shipped templates."""
    foreign = _IN_FORCE.get()
    if foreign is None or folder.parent != shipped_folder("templates"):
        return {}
    start = f"{folder.name}/"
    return {name.removeprefix(start): text for name, text in foreign.texts.items() if name.startswith(start)}


def _read(folder: Path) -> _Foreign:
    if not folder.is_dir():
        raise InputError(f"--trust-templates {folder}: not a folder; expected one with templates, e.g. liggghts/...")
    shipped = shipped_folder("templates")
    known = sorted(str(path.relative_to(shipped)) for path in shipped.rglob("*") if path.is_file())
    texts: dict[str, str] = {}
    hashes: dict[str, str] = {}
    for path in _walk(folder):
        name = str(path.relative_to(folder))
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"{path}: kncal has no template {name!r}: expected one of {', '.join(known)}{hint}")
        try:
            data = read_limited(path, MOST_BYTES, "a template")
            texts[name] = data.decode("utf-8")
        except (ReadError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: no template ({error}); expected UTF-8 text") from error
        hashes[name] = hashlib.sha256(data).hexdigest()
    if not texts:
        raise InputError(f"--trust-templates {folder}: no template in it; expected some of {', '.join(known)}")
    return _Foreign(texts, hashes)


def _walk(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder, sorted; refuse links and more files than a set of templates has."""
    count = 0
    for place, folders, files in os.walk(folder, followlinks=False):
        folders.sort()
        for name in sorted((*folders, *files)):
            path = Path(place, name)
            count += 1
            if path.is_symlink() or count > MOST_FILES:
                raise InputError(f"{path}: a link, or one of more than {MOST_FILES} files: expected plain files")
            if name in files:
                yield path


def render_apart(
    folder: Path, foreign: Mapping[str, str], template: str, context: Mapping[str, object], *, html: bool
) -> str:
    """Fill ``template`` in a child process; ``foreign`` texts stand in for those of their name in ``folder``.

    Raises
    ------
    RenderError
        If it cannot be filled, or takes more than `SECONDS` or `MEMORY`, or gives more than `MOST_TEXT`.
    """
    asked = {
        "folder": str(folder),
        "foreign": dict(foreign),
        "template": template,
        "context": plain(context, template),
        "html": html,
        "seconds": SECONDS,
    }
    where = f"template {template} of --trust-templates"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    try:
        command = (sys.executable, "-P", "-m", "kncal.core.foreign_templates")
        done = run_within(6 * SECONDS, command, input=json.dumps(asked).encode(), env=environment)
    except subprocess.TimeoutExpired as error:
        raise RenderError(f"{where}: not rendered within {6 * SECONDS} s") from error
    if done.returncode == _DONE:
        return str(done.stdout, "utf-8")
    lines = [text for line in done.stderr[-8192:].splitlines() if (text := decode_line(line).strip())]
    if done.returncode == _REFUSED and lines:
        raise RenderError(f"{where}: {lines[-1]}")
    raise RenderError(
        f"{where}: rendering was stopped (exit code {done.returncode}): expected it to take at most {SECONDS} s of "
        f"processor time and {MEMORY // 1024**2} MiB"
    )


def plain(value: object, where: str) -> Any:
    """Return a value as text, numbers, lists and dicts: objects have methods that a template could call.

    Raises
    ------
    RenderError
        For anything else.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name), where) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item, where) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, where) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):  # numpy
        return plain(value.tolist(), where)
    raise RenderError(f"template {where}: a {type(value).__name__} cannot be given to a template from elsewhere")


def main() -> int:
    """Render what standard input asks for to standard output; exit code 9 and a line of text if it cannot be."""
    import jinja2

    from kncal.core.templating import environment

    asked = json.load(sys.stdin)
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    for what, most in (
        (resource.RLIMIT_AS, used + MEMORY),
        (resource.RLIMIT_CPU, asked["seconds"] + int(sum(os.times()[:2]))),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    try:
        env = environment(Path(asked["folder"]), foreign=asked["foreign"], html=asked["html"])
        text = str(env.get_template(asked["template"]).render(asked["context"]))
        data = text.encode("utf-8")
        if len(data) > MOST_TEXT:
            raise RenderError(f"{len(data)} bytes of text, expected at most {MOST_TEXT}")
    # a foreign template may raise anything; whatever it is, it is the template's fault and said so
    except Exception as error:
        name = "" if isinstance(error, RenderError) else f"{type(error).__name__}: "
        line = f" (line {error.lineno})" if isinstance(error, jinja2.TemplateSyntaxError) else ""
        print(f"\n{name}{' '.join(str(error).split())[:500]}{line}", file=sys.stderr)
        return _REFUSED
    sys.stdout.buffer.write(data)
    return _DONE


if __name__ == "__main__":
    sys.exit(main())
