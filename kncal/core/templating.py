"""How text gets into a solver's input: templates of the package, filled with checked numbers and names.

A solver executes what its input tells it, so only numbers, and names that can be nothing else, are rendered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from kncal.core.checks import NAME_PATTERN, as_floats
from kncal.core.errors import InputError, RenderError
from kncal.core.foreign_templates import foreign_hashes, in_force, render_apart
from kncal.core.shipped import folder as shipped_folder


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


def environment(folder: Path, *, foreign: Mapping[str, str] = MappingProxyType({}), html: bool = False) -> Any:
    """Make the Jinja2 environment of every template in ``folder``; ``foreign`` texts stand in for those of their name.

    Sandboxed, undefined names are errors. Solver input: comments are ``<# ... #>`` (a ``{#`` may occur in it), and the
    filters ``num``, ``whole``, ``name`` refuse what they cannot write safely. ``html``: every text is escaped.
    """
    import jinja2
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    comments = {} if html else {"comment_start_string": "<#", "comment_end_string": "#>"}
    env = ImmutableSandboxedEnvironment(
        loader=jinja2.ChoiceLoader([jinja2.DictLoader(dict(foreign)), jinja2.FileSystemLoader(folder)]),
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
def _kept(folder: Path) -> Any:
    """Return the environment of shipped templates, kept: it holds them compiled, which takes longer than filling."""
    return environment(folder)


def render(folder: Path, template: str, context: Mapping[str, object]) -> str:
    """Fill ``template`` of ``folder`` with ``context`` (plain str, int, float, bool, lists and dicts only).

    Raises
    ------
    RenderError
        If the template is missing or broken, needs what ``context`` lacks, or breaks a filter's rule; a template from
        elsewhere (see `kncal.core.foreign_templates`) also if it takes too long, or its text is not ASCII.
    """
    import jinja2

    if foreign := in_force(folder):
        text = render_apart(folder, foreign, template, context, html=False)
        if not text.isascii():
            raise RenderError(f"template {template} of --trust-templates: its text is not ASCII, as solvers need it")
        return text
    try:
        return str(_kept(folder).get_template(template).render(context))
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
        import jinja2

        folder = shipped_folder("templates") / "report"
        if names := foreign_hashes():
            section = {"templates that are not kncal's (--trust-templates), sha256": names}
            context["provenance"] = {**context.get("provenance", {}), **section}
        if foreign := in_force(folder):
            return render_apart(folder, foreign, self.name, context, html=True)
        try:
            return str(environment(folder, html=True).get_template(self.name).render(**context))
        except jinja2.TemplateError as error:
            raise RenderError(f"template {self.name} in {folder}: {type(error).__name__}: {error}") from error
