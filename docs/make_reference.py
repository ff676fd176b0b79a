"""Write the tables of the reference pages anew, from the schema of case files and the registries.

    python docs/make_reference.py            # write the pages
    python docs/make_reference.py --check    # say which are out of date (exit code 1)

In a page, what stands between ``<!-- table: MODULE.NAME -->`` and ``<!-- end -->`` is made from that object: the keys
of a class of the scene, the options of methods, or the metrics of runs that record these things. All else is written by
hand.
"""

from __future__ import annotations

import importlib
import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin

import numpy as np
from annotated_types import MaxLen, MinLen
from pydantic import AfterValidator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from kncal.core.checks import Range
from kncal.physics.material import RANGES
from kncal.physics.methods import METHODS, OPTIONS
from kncal.scene.metrics import METRICS, offered
from kncal.scene.scene import MaterialData

PAGES = ("docs/case-file.md",)
MARKED = re.compile(r"(<!-- table: ([\w.]+) -->\n).*?(<!-- end -->)", re.S)


def table(heads: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown."""
    lines = [f"| {' | '.join(row)} |\n" for row in (heads, *rows)]
    return "".join([lines[0], "|---" * len(heads) + "|\n", *lines[1:]])


def number(value: float) -> str:
    """Return a bound as people write it: 0.5, 1000, 1e6."""
    text = f"{value:.0e}"
    short = float(text) == value and not 1e-2 <= abs(value) < 1e4 and value
    return re.sub(r"e([+-])0*", lambda sign: f"e{sign[1].strip('+')}", text) if short else f"{value:.10g}"


def bounds(low: float, high: float, low_open: bool = False) -> str:
    """Return a range in words."""
    if low_open:
        return f"> {number(low)}" + ("" if np.isinf(high) else f", up to {number(high)}")
    return f"{number(low)} to {number(high)}"


def code(value: object) -> str:
    """Return a value as TOML has it."""
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def ranges(annotation: Any, metadata: Iterable[Any] = ()) -> Iterator[str]:
    """Yield what the values of an annotation are checked for, from the inside out."""
    if get_origin(annotation) is Literal:
        yield ", ".join(code(choice) for choice in get_args(annotation))
    elif get_origin(annotation) in (tuple, dict):
        *_, of = (inside for inside in get_args(annotation) if inside is not Ellipsis)
        inner = [text.removeprefix("each ") for text in ranges(of)]
        yield from (f"each {text}" for text in (", ".join(inner),) if text)
    elif hasattr(annotation, "__metadata__"):
        yield from ranges(annotation.__origin__, annotation.__metadata__)
    elif NoneType in get_args(annotation):
        yield from ranges(next(a for a in get_args(annotation) if a is not NoneType))
    elif annotation is int:
        yield "integer"
    for check in _checks(metadata):
        if isinstance(check, Range):
            yield bounds(check.low, check.high, check.low_open)
    lengths = {type(m): m for m in _checks(metadata) if isinstance(m, MinLen | MaxLen)}
    least = lengths[MinLen].min_length if MinLen in lengths else 0
    if MaxLen in lengths and lengths[MaxLen].max_length > max(least, 3):
        yield f"{least} to {number(lengths[MaxLen].max_length)} of them"
    elif least == 1:
        yield "at least one"


def _checks(metadata: Iterable[Any]) -> Iterator[Any]:
    for item in metadata:
        if isinstance(item, FieldInfo):
            yield from item.metadata
        else:
            yield item.func if isinstance(item, AfterValidator) else item


def default(field: FieldInfo) -> str:
    """Return what a key is if it is not given; nothing where its meaning says it."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value is PydanticUndefined or is_dataclass(value) or value in ("", (), {}):
        return ""
    return f"default {code(value)}"


def keys(schema: Any) -> str:
    """Return the table of the keys of one table of a case file."""
    rows = []
    for key, field in schema.__pydantic_fields__.items():
        inherited = any(key in vars(base).get("__pydantic_fields__", {}) for base in schema.__mro__[1:])
        if key == "name" or (inherited and key not in schema.__annotations__) or not field.description:
            continue  # of the folder, in the table of what all kinds have, or in those of the kinds
        checks = field.metadata if schema is not MaterialData else [RANGES[key]]
        # What the meaning says already is not said again.
        meaning = field.description or ""
        found = [text for text in ranges(field.annotation, checks) if not _said(text.removeprefix("each "), meaning)]
        rows.append((f"`{key}`", meaning, "; ".join(filter(None, (", ".join(found), default(field))))))
    return table(("key", "meaning", "values"), rows)


def _said(choices: str, meaning: str) -> bool:
    return "`" in choices and all(choice in meaning for choice in choices.replace("`", "").split(", "))


def options() -> str:
    """Return the options of the methods for k_n."""
    rows = []
    for method in METHODS.values():
        for key, given in {**dict.fromkeys(method.required), **(method.optional or {})}.items():
            allowed = OPTIONS[key]
            unit = f" [{allowed.unit}]" if isinstance(allowed, Range) and allowed.unit else ""
            words = bounds(allowed.low, allowed.high) if isinstance(allowed, Range) else ", ".join(map(code, allowed))
            words += "; required" if given is None else f"; default {code(given)}"
            rows.append((f"`{method.name}`", f"`{key}`{unit}", words))
    return table(("method", "option", "values"), rows)


def metrics(recorded: Iterable[str]) -> str:
    """Return kncal's own metrics of a run that records ``recorded``."""
    own = (METRICS[name] for name in offered(tuple(recorded)) if not METRICS.source(name))
    return table(("metric", "what"), ((f"`{metric.name}`", f"{metric.text} [{metric.unit}]") for metric in own))


def make(page: Path) -> str:
    """Return the text of a page with its tables made anew."""

    def filled(found: re.Match[str]) -> str:
        module, _, name = found[2].rpartition(".")
        made = getattr(importlib.import_module(module), name)
        text = keys(made) if isinstance(made, type) else options() if made is METHODS else metrics(made)
        return found[1] + text + found[3]

    return MARKED.sub(filled, page.read_text("utf-8"))


def main() -> int:
    """Write the pages, or check them."""
    old = [page for page in map(Path(__file__).parents[1].joinpath, PAGES) if make(page) != page.read_text("utf-8")]
    for page in old:
        if "--check" in sys.argv[1:]:
            print(f"{page} is out of date: run python docs/make_reference.py")
        else:
            page.write_text(make(page), "utf-8")
    return int(bool(old) and "--check" in sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
