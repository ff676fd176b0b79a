"""A trade from the case to its files.

OUT/trade.json, trade.csv   everything; one row per point
OUT/report/index.html       the page
OUT/case.toml               the case with the chosen contact; not there if no contact is inside the tolerances
OUT/screening, OUT/start, OUT/runs   the runs, see `kncal.study.trade.resolved` and `kncal.study.trade.averaged`
OUT/case                    the case that was traded, if values were given from outside or the impact speed was measured
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kncal.core.errors import InputError
from kncal.core.files import write_csv, write_json, write_text
from kncal.observe.verdict import Verdict
from kncal.scene.case_file import CASE, copy_files, dump_case, load_case, write_case
from kncal.scene.scene import Scene
from kncal.study.folders import refuse_other
from kncal.study.trade.answer import answer, describe, to_dict, to_frame
from kncal.study.trade.candidates import check_reference
from kncal.study.trade.cost_law import Law, laws
from kncal.study.trade.front import Conclusion, conclude
from kncal.study.trade.run import trade_scene
from kncal.study.trade.trade import Tell, Trade, TradeOptions, TradePoint
from kncal.study.variants import texts

#: Folder of the case that was traded, if it is not as in its file.
START = "case"
#: Says that a folder is a trade's.
RECORD = "trade.json"
_LONGEST_TITLE = 300
#: Keys of [run] that a chosen contact takes along; its end was pinned for the sake of the costs.
_KEPT = ("run.steps_per_contact", "run.dt")


@dataclass(frozen=True, kw_only=True)
class TradeResult:
    """What a trade found, and where it is.

    Attributes
    ----------
    trade, conclusion, laws : the numbers
    answer : in words
    folder : of everything
    page : the report
    case : the case file with the chosen contact, or None
    """

    trade: Trade
    conclusion: Conclusion
    laws: tuple[Law, ...]
    answer: Verdict
    folder: Path
    page: Path
    case: Path | None

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain data."""
        files = {"folder": str(self.folder), "report": str(self.page), "case_file": self.case and str(self.case)}
        return to_dict(self.trade, self.conclusion, self.laws) | files


def run_trade(
    case: str | Path,
    out: Path,
    options: TradeOptions,
    tell: Tell | None = None,
    *,
    overrides: Sequence[str] = (),
) -> TradeResult:
    """Trade speed for accuracy on a case: run, judge, and write the files.

    Parameters
    ----------
    case : a case.toml, a folder holding one, or the name of a shipped case
    out : folder of everything; runs in it are kept, so that the same call again goes on
    options : TradeOptions; without tolerances those of the case count
    tell : told what is done now
    overrides : ``KEY=VALUE`` in place of what the case says, of the reference and of all that is tried

    Raises
    ------
    InputError
        If there is no tolerance to judge by, an option is out of range, or ``out`` holds anything else.
    CaseFileError, RunError
        As `kncal.study.trade.run.trade_scene`.
    """
    scene = load_case(case, overrides=overrides)
    tolerances: Mapping[str, float] = options.tolerances or scene.tolerances
    if not tolerances:
        raise InputError(
            f"{scene.name}: no tolerance to judge by: expected --tolerance METRIC=SHARE (e.g. restitution=1%), or a "
            "table [tolerances] in the case"
        )
    _check(options)
    options = replace(options, tolerances=dict(tolerances))
    told = tell or (lambda _: None)
    refuse_other(out, RECORD, (START, "start", "screening", "runs"), case)
    if overrides or scene.contact.measured is not None:
        case, scene = _written(scene, out, options, told)
    check_reference(case, options.reference)
    return write_trade(case, trade_scene(case, scene, out, options, told), out)


def _written(scene: Scene, out: Path, options: TradeOptions, tell: Tell) -> tuple[Path, Scene]:
    """Write the case that is traded, where it is not as in its file; return it, and its scene.

    An impact speed that is to be measured is measured now.
    """
    from kncal.runs.measure_speed import resolve_measured

    where = out / START / scene.name
    engine, transport = options.engine, options.transport
    found = resolve_measured(scene, where / "speed", engine=engine, transport=transport, tell=tell)
    where.mkdir(parents=True, exist_ok=True)
    write_case(found, where / CASE)
    return where, found


def _check(options: TradeOptions) -> None:
    from kncal.core.checks import in_range

    for name, values, low, high in (
        ("steps per contact", options.steps, 4.0, 1e6),
        ("factor", options.factors, 1e-9, 1.0),
        ("overlap", options.overlaps, 1e-9, 1.0),
    ):
        if not values and name != "overlap":
            raise InputError(f"{name}: expected at least one")
        for value in values:
            in_range(name, value, low, high)
        if len(set(values)) < len(values):
            raise InputError(f"{name}: a value is given twice; expected each once")
    in_range("rounds", options.rounds, 1, 1000)


def write_trade(case: str | Path, trade: Trade, out: Path) -> TradeResult:
    """Draw the conclusions and write ``trade.json``, ``trade.csv``, the report, and the chosen contact's case."""
    from kncal.study.trade.report import write_trade_report

    conclusion, found = conclude(trade), laws(trade)
    out.mkdir(parents=True, exist_ok=True)
    data = to_dict(trade, conclusion, found)
    write_json(out / RECORD, data)
    frame, units = to_frame(trade, conclusion)
    write_csv(out / "trade.csv", frame, units)
    chosen = out / CASE
    if conclusion.chosen is None:
        chosen.unlink(missing_ok=True)  # an earlier trade's would be taken for this one's
    else:
        write_text(chosen, chosen_case(case, conclusion.chosen))
        copy_files(load_case(case), out)
    page = write_trade_report(trade, conclusion, found, out / "report")
    return TradeResult(
        trade=trade,
        conclusion=conclusion,
        laws=found,
        answer=answer(trade, conclusion, found),
        folder=out,
        page=page,
        case=None if conclusion.chosen is None else chosen,
    )


def chosen_case(case: str | Path, point: TradePoint) -> str:
    """Return the text of the case with a point's contact and steps per contact; its title says so."""
    changes = point.candidate.variant.changes
    kept = {key: value for key, value in changes.items() if not key.startswith("run.") or key in _KEPT}
    scene = load_case(case, overrides=texts(kept))
    title = load_case(case).title or scene.name
    note = f" ({describe(point.candidate)}; chosen by kncal trade)"
    return dump_case(replace(scene, title=title[: _LONGEST_TITLE - len(note)] + note))
