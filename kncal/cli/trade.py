"""``kncal trade``: how soft and how coarse a contact may be on this case, and what that saves."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from kncal.cli import show
from kncal.cli.flags import CaseFlags, EngineFlags, Json, Workers, several
from kncal.core.errors import InputError

if TYPE_CHECKING:
    from kncal.study.trade.workflow import TradeResult

_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}


def trade(
    case: str,
    *,
    tolerances: Annotated[
        list[str] | None,
        several("--tolerance", "METRIC=SHARE, e.g. restitution=1%; default: the case's [tolerances]"),
    ] = None,
    reference: Annotated[
        list[str] | None,
        several(
            "--reference",
            "KEY=VALUE: the true value, where the case has a softened material, e.g. materials.soft.young=1e9",
        ),
    ] = None,
    factors: Annotated[
        list[str] | None,
        several("--factor", "factor on k_n and on Young's modulus to try, e.g. 1/30; default 1 to 1/10000"),
    ] = None,
    steps: Annotated[
        list[float] | None,
        several("--steps", "steps per contact to try; default 10, 20, 50 and 100"),
    ] = None,
    rounds: Annotated[int, Parameter(help="how often each run is repeated for its CPU time")] = 3,
    budget: Annotated[str | None, Parameter(help="wall-clock time for everything, e.g. 90s, 10min, 2h")] = None,
    workers: Workers = None,
    at: CaseFlags = CaseFlags(),
    by: EngineFlags = EngineFlags(),
    json: Json = False,
) -> int:
    """Measure how much softer contacts and larger time steps save on CASE; find the cheapest within the tolerances.

    Writes trade.json, trade.csv, a report, and a case.toml with the chosen contact. The same command again continues.
    Exit code 0: one was found; 1: no contact is within the tolerances for certain.

    Parameters
    ----------
    case
        A shipped case's name, a case folder or a case.toml.
    """
    from kncal.observe.tolerances import parse_tolerances
    from kncal.scene.records import records_of
    from kncal.study.trade.trade import FACTORS, STEPS, TradeOptions
    from kncal.study.trade.workflow import run_trade

    scene, folder = at.load(case, "trade")
    by.check(scene)
    options = TradeOptions(
        tolerances=parse_tolerances(tolerances or (), records_of(scene)),
        reference=tuple(reference or ()),
        steps=tuple(steps or STEPS),
        factors=_factors(factors) if factors else FACTORS,
        rounds=rounds,
        budget=None if budget is None else seconds(budget),
        workers=workers,
        engine=by.engine,
        transport=by.transport,
    )
    with show.working("trade"):
        result = run_trade(case, folder, options, show.note, overrides=at.overrides or ())
    if json:
        show.as_json(result.to_dict())
    else:
        _print(result)
    return 0 if result.conclusion.chosen is not None else 1


def seconds(text: str) -> float:
    """Return the seconds of ``90``, ``90s``, ``10min`` or ``2h``.

    Raises
    ------
    InputError
        If it is not of that form, or not above zero.
    """
    found = re.fullmatch(r"([0-9.]+)\s*(s|min|h|)", text.strip())
    try:
        value = float(found[1]) * _SECONDS[found[2]] if found else math.nan
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise InputError(f"--budget {text[:50]!r}: expected a time above 0, e.g. 90s, 10min or 2h")
    return value


def _factors(given: Iterable[str]) -> tuple[float, ...]:
    """Return the factors, 1 among them: the others are judged against it."""
    found = [1.0]
    for text in given:
        over, sign, under = text.partition("/")
        try:
            value = float(over) / (float(under) if sign else 1.0)
        except (ValueError, ZeroDivisionError):
            value = math.nan
        if not 0.0 < value <= 1.0:
            raise InputError(f"--factor {text[:50]!r}: expected a share above 0 and at most 1, e.g. 1/30 or 0.03")
        found.append(value)
    return tuple(sorted(set(found), reverse=True))


def _print(result: TradeResult) -> None:
    from kncal.study.trade.report import NEAR, point_table, shown_points, shown_title

    shown, conclusion, said = result.trade, result.conclusion, result.answer
    near = shown_points(shown, conclusion)
    found = point_table(shown, conclusion, [shown.reference, *near], brief=True)
    show.table(f"{shown.case}: {shown_title(shown)}", found.headings, found.rows, text=found.text)
    if not shown.estimated and (far := len(conclusion.front) - len(near)):
        show.say(f"{far} more points of the front are more than {NEAR:g} times outside a tolerance.")
    show.say(said.sentence)
    for point in said.points:
        show.say(f"- {point}")
    if lost := sum(not point.completed for point in shown.points):
        show.say(f"{lost} of {len(shown.points)} points have no numbers; the report names each with the reason.")
    show.say(f"report, with all details: {result.page}")
    if result.case is not None:
        model = "" if conclusion.chosen is None else conclusion.chosen.candidate.model
        show.say(
            f"case with the chosen contact: {result.case} (kncal run {shlex.quote(str(result.case))} --model {model} "
            f"--out {shlex.quote(str(result.case.parent / 'chosen'))})"
        )
