"""Make the numbers and figures of the studies: `make studies`, or `python docs/studies/make.py [STUDY ...]`.

Runs the commands that stand in a page's ``sh`` block (what is in runs/studies already is not run again: kncal keeps its
runs), puts tables between the ``<!-- begin NAME -->`` and ``<!-- end NAME -->`` of the page, and its figures beside it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import re
import shlex
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from kncal.core.units import quantity
from kncal.observe.estimate import DOUBT
from kncal.study.trade.answer import MOST_POINTS

HERE = Path(__file__).resolve().parent
RUNS = Path("runs/studies")
_SH = re.compile(r"^```sh\n(.*?)^```$", re.S | re.M)
#: A loop of the shell over words.
_FOR = re.compile(r"for (\w+) in (.*?); do")

Rows = Sequence[Sequence[str]]


def commands(page: Path) -> list[list[str]]:
    """Return the kncal commands of a page's first ``sh`` block, its loops written out."""
    found = _SH.search(page.read_text("utf-8"))
    script = "" if found is None else found[1]
    loops = [[(name, value) for value in values.split()] for name, values in _FOR.findall(script)]
    lines = [line.strip() for line in script.splitlines() if line.lstrip().startswith("kncal ")]
    return [
        shlex.split(re.sub(r"\$\{?([a-z]+)}?", lambda name, values=values: values[name[1]], line))
        for values in map(dict, itertools.product(*loops))
        for line in lines
    ]


def run(words: list[str]) -> None:
    """Run one command of kncal here; exit code 1 (nothing inside the tolerances) is an answer, too."""
    kncal = Path(sys.executable).parent / "kncal"
    print("$", shlex.join(words), flush=True)
    code = subprocess.run([kncal, *words[1:]], check=False).returncode  # noqa: S603 - our own page's command
    if code not in (0, 1):
        raise SystemExit(f"{shlex.join(words)}: exit code {code}")


def fill(page: Path, name: str, text: str) -> None:
    """Put ``text`` between the marks called ``name`` of a page."""
    before = page.read_text("utf-8")
    marks = re.compile(rf"(<!-- begin {name} -->\n).*?(<!-- end {name} -->)", re.S)
    if not marks.search(before):
        raise SystemExit(f"{page}: no marks '<!-- begin {name} -->' ... '<!-- end {name} -->'")
    page.write_text(marks.sub(lambda m: f"{m[1]}\n{text}\n\n{m[2]}", before), "utf-8")


def table(head: Sequence[str], rows: Rows) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(row) + " |" for row in [head, *rows]]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])


def read(folder: str) -> dict[str, Any]:
    """Return the trade.json of a study's folder."""
    found: dict[str, Any] = json.loads((RUNS / folder / "trade.json").read_text("utf-8"))
    return found


def error(point: dict[str, Any], metric: str) -> tuple[float, float] | None:
    """Return the error of a point in a metric and its uncertainty, None where it has none."""
    found = point["errors"].get(metric)
    if found is None or found["difference"] is None:
        return None
    doubt = 1.0 if found["reliable"] else DOUBT
    return found["difference"], doubt * (found["difference_width"] or 0.0)


def share(found: tuple[float, float] | None) -> str:
    """Return an error with its uncertainty [%], with as many digits as the uncertainty leaves."""
    if found is None:
        return "–"
    value, width = 100 * found[0], 100 * found[1]
    digits = 2 if width == 0.0 else min(max(1 - math.floor(math.log10(width)), 0), 3)
    return f"{value:+.{digits}f}±{width:.{digits}f}"


def three(value: float, sign: str = "-") -> str:
    """Return a number with three digits, without an exponent."""
    return f"{float(f'{value:.3g}'):{sign},.10g}"


def span(found: Sequence[tuple[float, float] | None]) -> str:
    """Return from where to where several errors reach [%], their uncertainties included."""
    known = [one for one in found if one is not None]
    low, high = (100 * f(value + sign * width for value, width in known) for f, sign in ((min, -1), (max, 1)))
    return f"{three(low, '+')} to {three(high, '+')}"


def contact(candidate: dict[str, Any]) -> str:
    """Return a contact in words."""
    factor, how = candidate["factor"] or 1.0, candidate["how"]
    if candidate["variant"]["model"] == "hertz":
        return "Hertz" if factor == 1.0 else f"Hertz, E / {_fold(factor)}"
    if how == "limited_overlap":
        return f"linear, overlap {candidate['name'].split('-')[2].replace('pct', ' % of d')}"
    return f"linear, k_n / {_fold(factor)}" if how == "softened" else f"linear, {how}"


def _fold(factor: float) -> str:
    return f"{1 / factor:,.0f}"


def stiffness(point: dict[str, Any]) -> str:
    """Return the stiffness of a point."""
    return "–" if point["k_n"] is None else quantity(point["k_n"], "N/m", 3)


def cost(point: dict[str, Any]) -> str:
    """Return the CPU time [s] of a point with its range."""
    seconds = sorted(point["cpu_seconds"])
    if not seconds:
        return "–"
    return f"{statistics.median(seconds):.3g}" + (f" ({seconds[0]:.3g}–{seconds[-1]:.3g})" if len(seconds) > 1 else "")


def cheapest(trade: dict[str, Any], tolerance: float, metrics: Sequence[str]) -> dict[str, Any] | None:
    """Return the cheapest point whose errors are within ``tolerance`` with their whole interval."""
    by_cpu = trade["cost"] == "cpu_seconds"

    def price(point: dict[str, Any]) -> float:
        return float(statistics.median(point["cpu_seconds"]) if by_cpu else point["steps"])

    def sure(point: dict[str, Any]) -> bool:
        found = [error(point, metric) for metric in metrics]
        return all(one is not None and abs(one[0]) + one[1] <= tolerance for one in found)

    inside = [p for p in trade["points"] if p["status"] == "completed" and (p["cpu_seconds"] or not by_cpu) and sure(p)]
    return min(inside, key=price, default=None)


def _none(trade: dict[str, Any], tolerance: float, metrics: Sequence[str]) -> str:
    """Return that nothing is surely inside, and how many may be."""

    def out(point: dict[str, Any]) -> bool:
        found = [error(point, metric) for metric in metrics]
        return any(one is None or abs(one[0]) - one[1] > tolerance for one in found)

    done = [point for point in trade["points"] if point["status"] == "completed"]
    return f"none is surely inside; {sum(not out(p) for p in done)} of {len(done)} are undecided"


def savings(trade: dict[str, Any], metrics: Sequence[str]) -> Iterator[list[str]]:
    """Yield, for 1 % and 5 %, the cheapest contact and what it saves over the reference and over Hertz at N = 50."""
    usual = next((p for p in trade["points"] if contact(p["candidate"]) == "Hertz" and _n(p) == 50), None)
    for tolerance in (0.01, 0.05):
        best = cheapest(trade, tolerance, metrics)
        if best is None:
            yield [f"{100 * tolerance:g} %", _none(trade, tolerance, metrics), *[""] * 4]
            continue
        yield [
            f"{100 * tolerance:g} %",
            f"{contact(best['candidate'])}, N = {_n(best):g}",
            stiffness(best),
            _times(trade["reference"], best),
            "–" if usual is None else _times(usual, best),
            changed(best),
        ]


def _n(point: dict[str, Any]) -> float:
    return float(point["candidate"]["steps_per_contact"])


def _times(dear: dict[str, Any], cheap: dict[str, Any]) -> str:
    """Return the saving in steps, and in CPU time round by round where it was measured in more than one."""
    ratio = dear["steps"] / cheap["steps"]
    text = f"{three(ratio)} × fewer steps" if ratio > 1.0 else f"{three(1 / ratio)} × more steps"
    rounds = [a / b for a, b in zip(dear["cpu_seconds"], cheap["cpu_seconds"], strict=False) if b > 0]
    if ratio == 1.0:
        return "itself"
    if len(rounds) < 2:
        return text
    middle = statistics.median(rounds)
    if min(rounds) <= 1.0 <= max(rounds):
        return f"{text}, CPU equal ({min(rounds):.3g}–{max(rounds):.3g})"
    if middle < 1.0:
        rounds, middle, what = [1 / x for x in rounds], 1 / middle, "as much CPU"
    else:
        what = "less CPU"
    return f"{text}, {middle:.3g} × {what} ({min(rounds):.3g}–{max(rounds):.3g})"


def softened(trade: dict[str, Any], steps: float, metrics: Sequence[str], with_cpu: bool) -> str:
    """Return the table of the softened contacts at N = ``steps``, unsoftened ones first, and those without a run."""
    rows: list[list[str]] = []
    without: dict[str, list[str]] = {}
    for point in trade["points"]:
        candidate = point["candidate"]
        plain = candidate["how"] in ("softened", "reduced_modulus") or candidate["factor"] == 1.0
        if not plain or _n(point) != steps or not _power_of_ten(candidate["factor"]):
            continue
        if point["status"] != "completed":
            reason = f"{point['status']} ({point['message'].partition(',')[0]})"
            without.setdefault(reason, []).append(contact(candidate))
            continue
        numbers = [stiffness(point), f"{point['steps']:,}", *([cost(point)] if with_cpu else [])]
        rows.append([contact(candidate), *numbers, *(share(error(point, m)) for m in metrics), changed(point)])
    heads = [*(["CPU [s]"] if with_cpu else []), *(f"{metric} [%]" for metric in metrics), "what softness changed"]
    text = table(["contact", "k_n", "steps", *heads], rows)
    return "\n\n".join([text, *(f"Not in the table: {'; '.join(names)}: {why}." for why, names in without.items())])


def _power_of_ten(factor: float | None) -> bool:
    return math.isclose(power := math.log10(factor or 1.0), round(power), abs_tol=1e-9)


def changed(point: dict[str, Any]) -> str:
    """Return the names of the signs of softness of a point."""
    return ", ".join(sign["name"] for sign in point["signs"] if sign["changed"])


def figures(page: Path, folder: str, names: Sequence[str]) -> None:
    """Copy pictures of a trade's report beside the page."""
    (HERE / "img").mkdir(exist_ok=True)
    for name in names:
        shutil.copyfile(RUNS / folder / "report" / name, HERE / "img" / f"{page.stem}_{name}")


def answer(trade: dict[str, Any]) -> str:
    """Return the points of a trade that its tables do not show, and the law of cost of its first contacts."""
    laws = [sentence for law in trade["laws"] for sentence in law["sentences"]]
    points = itertools.takewhile(lambda sentence: sentence not in laws, trade["verdict"][1 : 1 + MOST_POINTS])
    said = [sentence for sentence in points if not sentence.startswith("Speed-up")]
    return "\n".join(f"- {sentence}" for sentence in (*said, *laws[:2]))


#: What the motion is, and what the contact is.
MOTION, CONTACT = ("e_n", "rebound_height", "trajectory"), ("delta_max", "t_c")


def falling_particle(page: Path) -> None:
    """Fill the page of the falling particle."""
    trade = read(page.stem)
    both = [["motion", *row] for row in savings(trade, MOTION)] + [["contact", *row] for row in savings(trade, CONTACT)]
    fill(page, "savings", table(["what", *SAVINGS], both))
    fill(page, "softened", softened(trade, 50, ("e_n", "trajectory", *CONTACT), with_cpu=False))
    fill(page, "answer", answer(trade))
    figures(page, page.stem, ("front.png", "split.png", "law.png"))


def wall_impact(page: Path) -> None:
    """Fill the page of the wall impact over e_n and v_0."""
    rows: list[list[str]] = []
    each: dict[str, None] = {}
    same: dict[str, dict[tuple[str, str], dict[str, Any]]] = {}
    for words in commands(page):
        values = dict(words[i + 1].split("=") for i, word in enumerate(words) if word == "--set")
        trade = read(Path(words[words.index("--out") + 1]).name)
        e_n, v_0 = values["contact.e_n"], values[VELOCITY].strip("[]").split(",")[2].lstrip("- ")
        each[e_n] = None
        rows.append([e_n, v_0])
        for _, found, _, _, over_usual, softness in savings(trade, ("e_n",)):
            rows[-1] += [f"{found}{' *' if softness else ''}", over_usual]
        for point in trade["points"]:
            plain = point["candidate"]["how"] in ("mean_overlap", "softened") and point["status"] == "completed"
            if plain and _n(point) == 50:
                same.setdefault(contact(point["candidate"]), {})[e_n, v_0] = point
    fill(page, "savings", table(["e_n", "v_0 [m/s]", "inside 1 %", "steps", "inside 5 %", "steps"], rows))
    soft = []
    for name, points in same.items():
        spans = [span([error(p, "e_n") for key, p in points.items() if key[0] == e_n]) for e_n in each]
        spans += [span([error(p, metric) for p in points.values()]) for metric in ("delta_max", "t_c")]
        signs = {v_0: text for (_, v_0), point in points.items() if (text := changed(point))}
        soft.append([name, *spans, "; ".join(f"{text} at {v_0} m/s" for v_0, text in signs.items())])
    heads = [*(f"e_n = {e_n} [%]" for e_n in each), "delta_max [%]", "t_c [%]", "what softness changed"]
    fill(page, "softened", table(["contact", *heads], soft))


def averaged(page: Path) -> None:
    """Fill a page of many particles, of which averages are compared."""
    trade = read(page.stem)
    metrics = tuple(trade["tolerances"])
    fill(page, "savings", table(SAVINGS, list(savings(trade, metrics))))
    fill(page, "softened", softened(trade, min(_n(p) for p in trade["points"]), metrics, with_cpu=True))
    fill(page, "answer", answer(trade))
    figures(page, page.stem, ("front.png",))


SAVINGS = (
    "tolerance",
    "cheapest contact inside",
    "k_n",
    "over the reference",
    "over Hertz, N = 50",
    "what softness changed",
)
VELOCITY = "particles.sphere.velocity"
STUDIES: dict[str, Callable[[Path], None]] = {
    "falling_particle": falling_particle,
    "wall_impact": wall_impact,
    "bubbling_bed_mini": averaged,
    "hopper": averaged,
}


def main() -> None:
    """Make the studies asked for, or all."""
    parser = argparse.ArgumentParser(description="Make the numbers and figures of the studies.")
    parser.add_argument("study", nargs="*", choices=[*STUDIES, []], help="default: all")
    parser.add_argument("--fill-only", action="store_true", help="run nothing, take the results that are there")
    given = parser.parse_args()
    for name in given.study or STUDIES:
        page = HERE / f"{name}.md"
        if not given.fill_only:
            RUNS.mkdir(parents=True, exist_ok=True)
            for words in commands(page):
                run(words)
        STUDIES[name](page)
        print(f"{page.name}: filled")


if __name__ == "__main__":
    main()
