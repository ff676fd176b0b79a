"""The tables of ``kncal kn``: one pair by every method, or a row for each of many pairs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from kncal.cli import show

if TYPE_CHECKING:
    from kncal.physics.calibration import Calibration
    from kncal.physics.material import Pair

#: More pairs of species than this are printed in one table, with at most so many rows; of texts only a few.
MOST_TABLES, _MOST_ROWS, _MOST_TEXTS = 12, 40, 3
#: Numbers of a linear contact in tables, with their units.
COLUMNS = (
    ("k_n", "N/m"),
    ("eta_n", "N s/m"),
    ("kappa", ""),
    ("t_c", "s"),
    ("delta_max", "m"),
    ("delta_mean", "m"),
)


def print_many(case: str, method: str, result: Mapping[str, dict[str, Any]]) -> None:
    """Print a row for each pair of species, those of the shortest contacts first; by the method of the case."""
    rows, problems, none = [], dict[str, int](), 0
    warnings: dict[str, dict[str, int]] = {}
    for name, data in result.items():
        if not data["methods"]:
            none += 1
            continue
        row = data["methods"][-1]  # the prescribed k_n stands behind the method
        if "problem" in row:
            problems[row["problem"]] = problems.get(row["problem"], 0) + 1
            continue
        rows.append((row["t_c"], [name, str(data["pairs_of_bodies"]), *_cells(row), show.quantity(row["dt"], "s")]))
        for warning in row["warnings"]:
            texts = warnings.setdefault(warning["code"], {})
            texts[warning["message"]] = texts.get(warning["message"], 0) + 1
    rows.sort(key=lambda item: item[0])
    columns = ["pair", "alike", *(c for c, _ in COLUMNS), "dt"]
    title = f"{case}: {len(result)} pairs of unlike bodies, method {method}, the shortest contacts first"
    show.table(title, columns, [cells for _, cells in rows[:_MOST_ROWS]])
    if len(rows) > _MOST_ROWS:
        show.say(f"  and {len(rows) - _MOST_ROWS} more; --json prints all of them")
    prescribed = sum(data["k_n_prescribed"] is not None for data in result.values())
    if prescribed:
        show.say(f"  the case prescribes k_n of {prescribed} of the pairs")
    if none:
        show.say(f"  {none} pairs have no impact speed to calibrate at (contact.v_0 sets one)")
    for problem, number in list(problems.items())[:_MOST_TEXTS]:
        show.say(f"  no result for {number} pairs: {problem}")
    for code, texts in warnings.items():
        one = next(iter(texts))
        more = f" (the first of {len(texts)} such texts; --json prints all)" if len(texts) > 1 else ""
        show.say(f"  {show.kind_of(code)} ({sum(texts.values())} pairs): {one}{more}")


def _cells(row: Mapping[str, Any]) -> list[str]:
    return ["" if row[name] is None else show.quantity(row[name], unit) for name, unit in COLUMNS]


def row_of(c: Calibration, steps: float) -> dict[str, Any]:
    """Return what `kn` tells of one calibration: its numbers, and the time steps at ``steps`` per contact."""
    from kncal.physics.timestep import advise_time_step

    advice = advise_time_step(c, steps)
    return {
        **c.to_dict(),
        "gamma_n": float(c.gamma_n),
        "dt": float(advice.linear),
        "dt_hertz": float(advice.hertz),
        "dt_limit": float(advice.linear_limit),
    }


def kn_data(
    pair: Pair,
    v_0: float | None,
    e_n: float,
    law: str,
    end: Any,
    options: dict[str, Any],
    steps: float,
    only: str | None = None,
) -> dict[str, Any]:
    """Calibrate one pair by every method, or by ``only`` one."""
    from kncal.core.errors import ValidityError
    from kncal.physics.calibration import calibrate_all
    from kncal.physics.methods import METHODS

    rows: list[dict[str, Any]] = []
    reference: dict[str, Any] = {}
    found = {} if v_0 is None else calibrate_all(pair, v_0=v_0, e_n=e_n, law=law, end=end, options=options)
    for name, method in METHODS.items() if v_0 is not None else ():
        if only is not None and name != only:
            continue
        match found.get(name):
            case None:
                missing = next(option for option in method.required if option not in options)
                rows.append({"method": name, "problem": f"needs --{missing.replace('_', '-')}"})
            case ValidityError() as error:
                rows.append({"method": name, "problem": str(error)})
            case calibration:
                rows.append(row_of(calibration, steps))
                reference = rows[-1].pop("reference")
    return {
        "law": law,
        "end": end,
        "v_0": v_0,
        "e_n": e_n,
        "reference": reference,
        "steps_per_contact": steps,
        "step_error": _step_errors(law, e_n, end, steps),
        "methods": rows,
    }


def _step_errors(law: str, e_n: float, end: str, steps: float) -> dict[str, dict[str, float | None]]:
    """Return by contact law the largest predicted error of e_n at N steps, and the N that is advised."""
    from kncal.physics.timestep import advised_steps, restitution_error

    found: dict[str, dict[str, float | None]] = {}
    for each in dict.fromkeys(("linear", law)):
        error = restitution_error(each, e_n, steps, end)
        known = error if error is not None and math.isfinite(error) else None
        found[each] = {"e_n": known, "advised_steps_per_contact": advised_steps(each, e_n, end)}
    return found


def kn_print(name: str, data: dict[str, Any]) -> None:
    """Print the table of one pair, as `kn_data` returns it, and what limits its methods."""
    reference, n = data["reference"], data["steps_per_contact"]
    at = "no v_0" if data["v_0"] is None else f"v_0 = {data['v_0']:g} m/s"
    title = f"{name}: reference {data['law']}, e_n = {data['e_n']:g}, {at}"
    columns = ["method", *(c for c, _ in COLUMNS), f"dt (N={n:g})"]
    rows = []
    warnings: dict[str, list[str]] = {}
    kinds: dict[str, str] = {}
    for row in data["methods"]:
        if "problem" in row:
            rows.append([row["method"], row["problem"]] + [""] * (len(columns) - 2))
            continue
        rows.append([row["method"], *_cells(row), show.quantity(row["dt"], "s")])
        for warning in row["warnings"]:
            warnings.setdefault(warning["message"], []).append(row["method"])
            kinds[warning["message"]] = show.kind_of(warning["code"])
    if reference:
        dt = next(r["dt_hertz"] for r in data["methods"] if "problem" not in r)
        own = dict.fromkeys(name for name, _ in COLUMNS) | reference
        rows.append([f"({data['law']})", *_cells(own), show.quantity(dt, "s")])
    show.table(title, columns, rows)
    valid = sum("problem" not in row for row in data["methods"])
    for message, methods in warnings.items():
        who = "all methods" if len(methods) == valid else ", ".join(methods)
        show.say(f"  {kinds[message]} ({who}): {message}")
    for law, step in data["step_error"].items():
        if (advised := step["advised_steps_per_contact"]) is not None:
            off = "by more than can be predicted" if step["e_n"] is None else f"by up to {100.0 * step['e_n']:.2g} %"
            show.say(
                f"  {law}: the time step changes e_n {off} at N = {n:g}, by at most 1 % at N = {advised:g} or more"
            )
    show.say(
        f"  the contact ends at zero {data['end']}; the paper's three methods are as reconstructed (docs/theory.md)\n"
    )
