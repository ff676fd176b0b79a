"""How text gets into a solver's input and onto a page: templates, filled with checked numbers and names.

A solver executes what its input tells it, so only numbers, and names that can be nothing else, are rendered.

Templates that are not kncal's stand before its own of the same name, where the user says that they are to be trusted.
They see plain values only, and are rendered in a child process (``python -m kncal.core.templating``): nothing else in
Python stops an endless loop, or one expression that takes all memory. What the solvers then do is not bounded.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

from kncal.core.checks import NAME_PATTERN, as_floats, one_of
from kncal.core.child import ChildError, answer, ask
from kncal.core.errors import InputError, ReadError, RenderError
from kncal.core.files import read_limited
from kncal.core.shipped import folder as shipped_folder

#: Of templates from elsewhere: largest one, most in a folder, largest text rendered [bytes].
MOST_BYTES, MOST_FILES, MOST_TEXT = 1024**2, 100, 64 * 1024**2
#: What rendering one of them may take: time [s], memory beyond what Python has taken already [bytes].
SECONDS, MEMORY = 10, 1024**3

#: Relative name -> text of the templates from elsewhere in force: read once, so what is named is what is rendered.
_FOREIGN: ContextVar[Mapping[str, str]] = ContextVar("kncal_foreign_templates", default={})  # noqa: B039 - never changed


def checked_name(value: object) -> str:
    """Return ``value`` if it is a plain name of 1 to 64 letters, digits, ``.``, ``_`` or ``-``.

    Raises
    ------
    RenderError
        For everything else: spaces, control characters, line breaks, quotes, ``$``, ``&``, ``;``, no string.
    """
    if isinstance(value, str) and NAME_PATTERN.fullmatch(value):
        return value
    raise RenderError(
        f"name {value!r}: only names of at most 64 letters (A-Z, a-z), digits, '.', '_' and '-', starting "
        "with a letter or a digit, can be written into solver input; rename it in the case"
    )


def number(value: object) -> str:
    """Return ``repr(float(value))`` of one finite real number: the shortest text that reads back exactly.

    Raises
    ------
    RenderError
        For text, booleans, arrays, NaN, infinity and everything else.
    """
    try:
        checked = as_floats("number", value)  # type: ignore[arg-type]  # as_floats refuses what is not a number
    except (InputError, ValueError, OverflowError) as error:
        raise RenderError(f"{value!r}: only a finite number can be written into solver input ({error})") from error
    if checked.ndim != 0:
        raise RenderError(f"{value!r}: expected one number for solver input, got shape {checked.shape}")
    return repr(float(checked))


def integer(value: object) -> str:
    """Return the digits of one whole number that is not negative (a step, an index, a count).

    Raises
    ------
    RenderError
        For everything that is not an int, and for negative ones.
    """
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise RenderError(f"{value!r}: only a whole number >= 0 can be written here into solver input")
    return str(value)


def _environment(folder: Path, foreign: Mapping[str, str], *, html: bool) -> Any:
    """Make the Jinja2 environment of every template in ``folder``, before which those of ``foreign`` stand.

    Sandboxed, undefined names are errors. Solver input: comments are ``<# ... #>`` (a ``{#`` may occur in it), and the
    filters ``num``, ``whole``, ``name`` refuse what they cannot write safely. ``html``: every text is escaped.
    """
    import jinja2
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    comments = {} if html else {"comment_start_string": "<#", "comment_end_string": "#>"}
    env = ImmutableSandboxedEnvironment(
        loader=jinja2.ChoiceLoader([jinja2.DictLoader(foreign), jinja2.FileSystemLoader(folder)]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=not html,
        autoescape=html,  # solver input is no HTML; there the filters are the defence
        **comments,
    )
    env.filters.update(num=number, whole=integer, name=checked_name)
    return env


@lru_cache(maxsize=16)
def _kept(folder: Path, *, html: bool) -> Any:
    """Return the environment of shipped templates, kept: it holds them compiled, which takes longer than filling."""
    return _environment(folder, {}, html=html)


def render(folder: Path, template: str, context: Mapping[str, object], *, html: bool = False) -> str:
    """Fill ``template`` of ``folder`` with ``context`` (plain str, int, float, bool, lists and dicts only).

    Raises
    ------
    RenderError
        If the template is missing or broken, needs what ``context`` lacks, or breaks a filter's rule; a template from
        elsewhere also if it takes more than `SECONDS` or `MEMORY`, gives more than `MOST_TEXT`, or solver input that
        is not ASCII.
    """
    import jinja2

    start = f"{folder.name}/" if folder.parent == shipped_folder("templates") else "/"
    foreign = {name.removeprefix(start): text for name, text in _FOREIGN.get().items() if name.startswith(start)}
    if foreign:
        return _render_apart(folder, foreign, template, context, html=html)
    try:
        return str(_kept(folder, html=html).get_template(template).render(context))
    except jinja2.TemplateError as error:
        raise RenderError(f"template {template} in {folder}: {type(error).__name__}: {error}") from error


@dataclass(frozen=True)
class Page:
    """A page of ``templates/report``: every text that it is given is escaped."""

    name: str

    def render(self, **context: Any) -> str:
        """Return the page; where templates from elsewhere are in force, it names them among its provenance.

        Raises
        ------
        RenderError
            As `kncal.core.templating.render`.
        """
        if names := foreign_hashes():
            section = {"templates that are not kncal's (--trust-templates), sha256": names}
            context["provenance"] = {**context.get("provenance", {}), **section}
        return render(shipped_folder("templates") / "report", self.name, context, html=True)


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
    before = _FOREIGN.get()
    try:
        yield trust_from_now(folder)
    finally:
        _FOREIGN.set(before)


def trust_from_now(folder: Path | None) -> Mapping[str, str]:
    """As `trust_templates`, to the end of the present context (`contextvars`): for the command line."""
    if folder is not None:
        _FOREIGN.set(_read(folder))
    return foreign_hashes()


def foreign_hashes() -> dict[str, str]:
    """Return relative name -> SHA-256 of the templates from elsewhere in force; empty if there are none."""
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in _FOREIGN.get().items()}


def _read(folder: Path) -> dict[str, str]:
    if not folder.is_dir():
        raise InputError(f"--trust-templates {folder}: not a folder; expected one with templates, e.g. liggghts/...")
    shipped = shipped_folder("templates")
    known = sorted(str(path.relative_to(shipped)) for path in shipped.rglob("*") if path.is_file())
    texts: dict[str, str] = {}
    for count, path in enumerate(islice(folder.rglob("*"), MOST_FILES + 1), 1):
        if path.is_symlink() or count > MOST_FILES:
            raise InputError(f"{path}: a link, or one of more than {MOST_FILES} files: expected plain files")
        if path.is_dir():
            continue
        name = one_of(f"--trust-templates {folder}: template", str(path.relative_to(folder)), known)
        try:
            texts[name] = read_limited(path, MOST_BYTES, "a template").decode("utf-8")
        except (ReadError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: no template ({error}); expected UTF-8 text") from error
    if not texts:
        raise InputError(f"--trust-templates {folder}: no template in it; expected some of {', '.join(known)}")
    return dict(sorted(texts.items()))


def _render_apart(
    folder: Path, foreign: Mapping[str, str], template: str, context: Mapping[str, object], *, html: bool
) -> str:
    """Fill ``template`` in a child process with limits."""
    where = f"template {template} of --trust-templates"
    asked = json.dumps([str(folder), foreign, template, plain(context, template), html, SECONDS])
    try:
        return str(ask("kncal.core.templating", given=asked.encode(), seconds=6 * SECONDS), "utf-8")
    except ChildError as error:
        raise RenderError(f"{where}: {error}") from error


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


def _filled(folder: str, foreign: Mapping[str, str], template: str, context: Mapping[str, Any], html: bool) -> bytes:
    """Fill a template in the child."""
    text = str(_environment(Path(folder), foreign, html=html).get_template(template).render(context))
    if len(text) > MOST_TEXT:
        raise RenderError(f"{len(text)} characters, expected at most {MOST_TEXT}")
    if not (html or text.isascii()):
        raise RenderError("its text is not ASCII, as solvers need it")
    return text.encode("utf-8")


if __name__ == "__main__":
    *_asked, _seconds = json.load(sys.stdin)
    answer(lambda: _filled(*_asked), MEMORY, _seconds)
