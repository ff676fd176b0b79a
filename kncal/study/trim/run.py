"""Trimming a scene: each part by itself, then everything that may go at once, then the trimmed case and its report.

OUT/<case>.toml      the full scene as it was run (with the values of --set)
OUT/speed/           the rounds that measure the impact speed, where the case asks for it
OUT/runs/            the runs, as rounds of sweeps (see `kncal.study`); the same command again continues
OUT/trim.json, trim.csv, report/index.html, case.toml
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from kncal.core.checks import in_range, one_of
from kncal.core.errors import CaseFileError, InputError, RunError
from kncal.observe.difference import FIELDS, PATHS
from kncal.observe.row import Row
from kncal.observe.run_data import RunData
from kncal.observe.verdict import Verdict
from kncal.runs.measure_speed import resolve_measured
from kncal.scene.case_file import load_case, write_case
from kncal.scene.model import KINDS
from kncal.scene.scene import Scene
from kncal.study import Variant, VariantRun, run_variants
from kncal.study.folders import refuse_other
from kncal.study.runs import REFUSED, OnStudyProgress
from kncal.study.trim.effects import cost_change, effects, resolution_of, see
from kncal.study.trim.judgement import cannot_run, cost_text, describe, judge_part
from kncal.study.trim.parts import parts_of
from kncal.study.trim.trim import (
    CANNOT_RUN,
    DOES_NOT_APPLY,
    LEAVE_OUT,
    MATTERS,
    RECORD,
    UNDECIDED,
    Attempt,
    Part,
    PartResult,
    Tell,
    Trim,
    share,
)
from kncal.study.variants import texts

FULL, FINE, RUNS = "full", "fine", "runs"
MEASURED = "speed"
#: Rounds of single contacts, which take no time.
ROUNDS = 3
#: So often something is put back before the full scene is left as it is.
MOST_ATTEMPTS = 6
_LONGEST_TITLE = 300


@dataclass(frozen=True, kw_only=True)
class TrimOptions:
    """What is asked of a trim.

    Attributes
    ----------
    model : contact model of the full scene
    overrides : ``KEY=VALUE`` in place of what the case says
    tolerances : metric -> largest allowed abs(change) [-]; empty: those of the case
    parts : names of `kncal.study.trim.parts.PARTS`; None: all
    rounds : how often everything is run, for the spread of CPU times; None: `ROUNDS`, with gas once
    engine, transport, workers, timeout : see `kncal.study.run_variants`
    """

    model: str = "linear"
    overrides: tuple[str, ...] = ()
    tolerances: Mapping[str, float] = field(default_factory=dict)
    parts: tuple[str, ...] | None = None
    rounds: int | None = None
    engine: str = "liggghts"
    transport: str = "auto"
    workers: int | None = None
    timeout: float | None = None


def trim(
    case: str | Path,
    out: Path,
    options: TrimOptions,
    *,
    on_progress: OnStudyProgress | None = None,
    tell: Tell | None = None,
) -> Trim:
    """Run ``case`` with and without each of its optional parts, and find what it can do without.

    Runs that ``out`` holds already are kept. Writes everything but the report; see
    `kncal.study.trim.report.write_trim`.

    Raises
    ------
    CaseFileError, InputError
        If the case, an override, a tolerance or a part is not valid.
    RunError
        If the full scene does not run.
    SolverMissingError, InterruptedRunError
        As `kncal.study.run_variants`.
    """
    one_of("model", options.model, KINDS)
    scene = load_case(case, overrides=options.overrides)
    parts_of(scene, options.model, options.parts)  # refuses an unknown one before anything runs
    path = out / f"{scene.name}.toml"
    refuse_other(out, RECORD, (path.name, RUNS, MEASURED), case)
    in_range("rounds", ROUNDS if options.rounds is None else options.rounds, 1, 1000)
    scene = resolve_measured(
        scene, out / MEASURED, engine=options.engine, transport=options.transport, timeout=options.timeout, tell=tell
    )
    parts = parts_of(scene, options.model, options.parts)
    out.mkdir(parents=True, exist_ok=True)
    write_case(scene, path)
    study = _Study(path, scene, out / RUNS, options, on_progress)
    study.run([_variant(part, options.model) for part in parts if not part.why_not])
    return _together(study, [study.result(part) for part in parts], tell)


class _Study:
    """The runs of one trim: what was run, and the effects against the full scene."""

    def __init__(
        self, path: Path, scene: Scene, folder: Path, options: TrimOptions, on_progress: OnStudyProgress | None
    ) -> None:
        self.scene, self.options, self.path, self.folder = scene, options, path, folder
        self.tolerances: Mapping[str, float] = dict(options.tolerances or scene.tolerances)
        self.runs: dict[str, VariantRun] = {}
        self.full: RunData | None = None
        self._told = on_progress
        self._resolution: dict[str, float] = {}
        # of a coupled scene averages are compared, whose intervals the runs tell themselves, and a run takes long
        self._rounds = options.rounds or (1 if scene.coupled else ROUNDS)

    def run(self, variants: Sequence[Variant]) -> None:
        """Run ``variants``, and the full scene unless it is there, in the same rounds."""
        first = [] if FULL in self.runs else self._first()
        self.runs |= run_variants(
            self.path,
            [*first, *variants],
            self.folder,
            rounds=self._rounds,
            engine=self.options.engine,
            transport=self.options.transport,
            workers=self.options.workers,
            timeout=self.options.timeout,
            on_progress=self._told,
        )
        if first:
            self._see_full()

    def _first(self) -> list[Variant]:
        model, run = self.options.model, self.scene.run
        full = Variant(name=FULL, model=model)
        if self.scene.coupled:
            return [full]
        finer = {"run.dt": 0.5 * run.dt} if run.dt else {"run.steps_per_contact": 2.0 * run.steps_per_contact}
        return [full, Variant(name=FINE, model=model, changes=finer)]

    def _see_full(self) -> None:
        full = self.runs[FULL]
        if full.status == REFUSED:
            raise CaseFileError(f"the full scene cannot be run: {full.message}")
        if not full.completed:
            raise RunError(f"the full scene ended as {full.status!r}: {full.message}")
        self.full = see(full)
        if (fine := self.runs.get(FINE)) is not None and fine.completed:
            self._resolution = resolution_of(self.full, see(fine))

    def effects(self, name: str, parts: Sequence[Part]) -> tuple[Row, ...]:
        """Return the effects of the completed variant ``name``, by which ``parts`` are tried at once."""
        if self.full is None:
            raise InputError("the full scene was not run")
        return effects(
            see(self.runs[name]),
            self.full,
            self.tolerances,
            lost={metric: why for part in parts for metric, why in part.lost.items()},
            resolution=self._resolution,
            recorded=len(parts) == 1 and parts[0].output,
        )

    def result(self, part: Part) -> PartResult:
        """Judge one part."""
        if part.why_not:
            sentence = f"{part.text} is not tried: {part.why_not}."
            return PartResult(part=part, verdict=DOES_NOT_APPLY, sentence=sentence)
        run = self.runs[part.name]
        if not run.completed:
            return cannot_run(part, run.status, run.message)
        cost = cost_change(part, run, self.runs[FULL], self.options.engine)
        return judge_part(part, self.effects(part.name, [part]), cost)


def _variant(part: Part, model: str) -> Variant:
    return Variant(name=part.name, model=part.model or model, changes=part.changes)


def _together(study: _Study, results: Sequence[PartResult], tell: Tell | None) -> Trim:
    """Run without everything that may go, and put back what must not go together with the rest."""
    scene = study.scene
    going, clashing = _compatible([r for r in results if r.verdict == LEAVE_OUT])
    attempts: list[Attempt] = []
    while going:
        attempt = _attempt(study, going, len(attempts) + 1)
        if attempt.verdict != "holds" and len(attempts) + 1 == MOST_ATTEMPTS:
            attempt = replace(attempt, put_back=attempt.without)
        attempts.append(attempt)
        if tell:
            tell(attempt.sentence)
        going = [r for r in going if r.part.name not in attempt.put_back]
        if attempt.verdict == "holds":
            break
    without = tuple(r.part for r in going)
    return Trim(
        case=scene.name,
        title=scene.title,
        model=study.options.model,
        tolerances=study.tolerances,
        results=tuple(results),
        attempts=tuple(attempts),
        without=tuple(part.name for part in without),
        trimmed=_trimmed(study, without),
        trimmed_model=_model_of(without, study.options.model),
        verdict=_verdict(study, results, attempts, without, clashing),
    )


def _compatible(results: Sequence[PartResult]) -> tuple[list[PartResult], list[PartResult]]:
    """Return what can be left out at once, and what cannot because it sets the same values; dearest first."""
    ordered = sorted(results, key=lambda r: -_saving(r))
    going: list[PartResult] = []
    for result in ordered:
        if not any(_clash(result.part, other.part) for other in going):
            going.append(result)
    names = {r.part.name for r in going}
    return [r for r in results if r.part.name in names], [r for r in results if r.part.name not in names]


def _saving(result: PartResult) -> float:
    cost = result.cost
    return 0.0 if cost is None else cost.cpu if cost.cpu is not None else cost.steps


def _clash(one: Part, two: Part) -> bool:
    keys = [{tuple(key.split(".")) for key in part.changes} for part in (one, two)]
    return any(a[: len(b)] == b or b[: len(a)] == a for a in keys[0] for b in keys[1])


def _attempt(study: _Study, going: Sequence[PartResult], number: int) -> Attempt:
    parts = [r.part for r in going]
    name = f"trimmed-{number}"
    study.run([_all_of(name, parts, study.options.model)])
    without = tuple(part.name for part in parts)
    listed = ", ".join(part.text for part in parts)
    run = study.runs[name]
    if not run.completed:
        back = (max(going, key=_suspicion(())).part.name,)
        sentence = f"Without {listed} at once the scene ended as {run.status!r}: {run.message}. {back[0]} goes back."
        return Attempt(without=without, verdict=CANNOT_RUN, sentence=sentence, put_back=back)
    rows = study.effects(name, parts)
    cost = cost_change(None, run, study.runs[FULL], study.options.engine)
    outcome, found = describe(rows)
    price = f"Without {listed} at once (cost: {cost_text(cost)})"
    if outcome == "free":
        return Attempt(without=without, verdict="holds", sentence=f"{price}: {found}.", cost=cost, effects=rows)
    bad = tuple(row.metric for row in rows if row.verdict == {"changed": "outside"}.get(outcome, outcome))
    alone = "which no part does alone" if len(parts) > 1 else "as by itself"
    back = (max(going, key=_suspicion(bad)).part.name,)
    sentence = f"{price}: {found}, {alone}. {back[0]} goes back."
    return Attempt(
        without=without,
        verdict=outcome,
        sentence=sentence,
        together=bad,
        put_back=back,
        cost=cost,
        effects=rows,
    )


def _suspicion(metrics: Sequence[str]) -> Callable[[PartResult], float]:
    """Return what a part's own effects use of the limits of ``metrics`` (none given: of all): a key to sort by."""

    def used(result: PartResult) -> float:
        shares = [share(row) for row in result.effects if not metrics or row.metric in metrics]
        return max((sum(s) for s in shares if s is not None), default=0.0)

    return used


def _all_of(name: str, parts: Iterable[Part], model: str) -> Variant:
    return Variant(name=name, model=_model_of(parts, model), changes=_changes(parts))


def _changes(parts: Iterable[Part]) -> dict[str, Any]:
    return {key: value for part in parts for key, value in part.changes.items()}


def _model_of(parts: Iterable[Part], model: str) -> str:
    return next((part.model for part in parts if part.model), model)


def _trimmed(study: _Study, without: Sequence[Part]) -> Scene:
    scene, changes = study.scene, _changes(without)
    trimmed = load_case(study.path, overrides=texts(changes)) if changes else scene
    said = f"trimmed: without {', '.join(part.text for part in without)}" if without else "trimmed: nothing left out"
    title = f"{scene.title}, {said}" if scene.title else said.capitalize()
    return replace(trimmed, name=scene.name, title=title[:_LONGEST_TITLE])


def _verdict(
    study: _Study,
    results: Sequence[PartResult],
    attempts: Sequence[Attempt],
    without: Sequence[Part],
    clashing: Sequence[PartResult],
) -> Verdict:
    name, last = study.scene.name, attempts[-1] if without else None
    if last is None:
        texts = [f"{name}: nothing was found that the scene can surely do without."]
    else:
        price = "" if last.cost is None else f" (cost: {cost_text(last.cost)})"
        texts = [f"{name} can do without {', '.join(part.text for part in without)}{price}."]
        texts.append(f"All at once: {describe(last.effects)[1]}.")
    for verdict, how in ((MATTERS, "It matters, and the case does not have it"), (UNDECIDED, "Undecided")):
        if names := [r.part.name for r in results if r.verdict == verdict]:
            texts.append(f"{how}: {', '.join(names)}.")
    points = len(texts) - 1
    texts += [f"{r.part.name}: not left out together with a part that sets the same values." for r in clashing]
    texts += [a.sentence for a in attempts if a.verdict != "holds"]
    rows = [row for r in results for row in r.effects]
    averaged = any(row.difference.chance for row in rows)
    if not study.tolerances:
        no_effect = "equality to the last bit" if averaged else "a change below the discretisation error"
        texts.append(f"No tolerance is given: only {no_effect} counts as no effect.")
    elif any(row.verdict == "-" for row in rows):
        texts.append(f"Judged: {', '.join(study.tolerances)}. Other metrics are shown, not judged.")
    texts += _not_there(rows)
    called = [
        row for row in rows if row.verdict == "-" and row.difference.value and row.difference.significant is not None
    ]
    if averaged and called:
        texts.append(
            f"{len(called)} changes are shown, not judged. About {0.05 * len(called):.1f} of them are larger than their"
            " uncertainty by chance alone."
        )
    texts += dict.fromkeys(f"CPU times: {r.cost.caveat}." for r in results if r.cost is not None and r.cost.caveat)
    return Verdict.of("within" if without else "open", texts, points)


def _not_there(rows: Iterable[Row]) -> list[str]:
    """Say which tolerances are for metrics that the full scene has not."""
    judged = [row for row in rows if row.tolerance is not None and row.reference.value is None]
    missing = dict.fromkeys(row.metric for row in judged if row.metric not in (*FIELDS, *PATHS))
    return [f"Not judged, since the full scene has none: {', '.join(missing)}."] if missing else []
