"""How text gets into a solver's input: templates of the package, filled with checked numbers and names.

A solver executes what its input tells it, so only numbers, and names that can be nothing else, are rendered.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from kncal.checks import NAME_PATTERN, as_floats
from kncal.errors import InputError, RenderError

if TYPE_CHECKING:
    from jinja2.sandbox import SandboxedEnvironment


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


def environment(folder: Path) -> SandboxedEnvironment:
    """Make the Jinja2 environment of every solver template in ``folder``.

    Sandboxed, undefined names are errors, comments are ``<# ... #>`` (a ``{#`` may occur in solver input).
    Filters: ``num``, ``whole``, ``name``; they refuse what they cannot write safely.
    """
    import jinja2
    from jinja2.sandbox import SandboxedEnvironment

    env = SandboxedEnvironment(
        loader=jinja2.FileSystemLoader(folder),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        comment_start_string="<#",
        comment_end_string="#>",
        autoescape=False,  # solver input, not HTML; the filters are the defence
    )
    env.filters.update(num=number, whole=integer, name=checked_name)
    return env


def render(folder: Path, template: str, context: Mapping[str, object]) -> str:
    """Fill ``template`` of ``folder`` with ``context`` (plain str, int, float, bool, lists and dicts only).

    Raises
    ------
    RenderError
        If the template is missing or broken, needs what ``context`` lacks, or breaks a filter's rule.
    """
    import jinja2

    try:
        return environment(folder).get_template(template).render(context)
    except jinja2.TemplateError as error:
        raise RenderError(f"template {template} in {folder}: {type(error).__name__}: {error}") from error
