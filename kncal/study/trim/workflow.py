"""Trimming a scene: each part by itself, then everything that may go at once, then the trimmed case and its report.

OUT/<case>.toml      the full scene as it was run (with the values of --set)
OUT/speed/           the rounds that measure the impact speed, where the case asks for it
OUT/runs/            the runs, as rounds of sweeps (see `kncal.study`); the same command again goes on
OUT/trim.json, trim.csv, report/index.html, case.toml
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from kncal.core.checks import in_range, one_of
from kncal.core.errors import CaseFileError, InputError, RunError
from kncal.core.files import write_text
from kncal.observe.run_data import RunData
from kncal.runs.measure_speed import resolve_measured
from kncal.scene.bed_scene import BedScene
from kncal.scene.case_file import dump_case, load_case
from kncal.scene.model import KINDS
from kncal.scene.scene import Scene
from kncal.study import Variant, VariantRun, run_variants
from kncal.study.folders import refuse_other
from kncal.study.runs import REFUSED, OnStudyProgress
from kncal.study.trim.base import (
    CANNOT_RUN,
    DOES_NOT_APPLY,
    LEAVE_OUT,
    MATTERS,
    RECORD,
    UNDECIDED,
    Attempt,
    Effect,
    Part,
    PartResult,
    Tell,
    Trim,
)
from kncal.study.trim.effect import (
    bed_effects,
    contact_effects,
    cost_change,
    resolution_of,
    see_bed,
    see_contacts,
)
from kncal.study.trim.judgement import cannot_run, cost_text, describe, judge_part
from kncal.study.trim.parts import parts_of
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
    parts : groups of `kncal.study.trim.parts.GROUPS`; None: all
    rounds : how often everything is run, for the spread of CPU times; None: `ROUNDS`, of beds once
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
    rounds = options.rounds if options.rounds is not None else 1 if isinstance(scene, BedScene) else ROUNDS
    in_range("rounds", rounds, 1, 1000)
    parts_of(scene, options.model, options.parts)  # refuses an unknown one before anything runs
    path = out / f"{scene.name}.toml"
    refuse_other(out, RECORD, (path.name, RUNS, MEASURED), case)
    scene = resolve_measured(
        scene, out / MEASURED, engine=options.engine, transport=options.transport, timeout=options.timeout, tell=tell
    )
    tolerances = _tolerances(scene, options)
    parts = parts_of(scene, options.model, options.parts)
    out.mkdir(parents=True, exist_ok=True)
    write_text(path, dump_case(scene))
    study = _Study(path, scene, out / RUNS, options, rounds, on_progress, tolerances)
    tried = [part for part in parts if not part.why_not]
    study.run([*(_variant(part, options.model) for part in tried)])
    results = [
        PartResult(part=part, verdict=DOES_NOT_APPLY, sentence=f"{part.text} is not tried: {part.why_not}.")
        if part.why_not
        else study.result(part)
        for part in parts
    ]
    return _together(scene, study, results, tell)


class _Study:
    """The runs of one trim: what was run, and the effects against the full scene."""

    def __init__(
        self,
        path: Path,
        scene: Scene | BedScene,
        folder: Path,
        options: TrimOptions,
        rounds: int,
        on_progress: OnStudyProgress | None,
        tolerances: Mapping[str, float],
    ) -> None:
        self.scene, self.options, self.tolerances, self.rounds = scene, options, tolerances, rounds
        self.path, self._folder, self._on_progress = path, folder, on_progress
        self.runs: dict[str, VariantRun] = {}
        self._full: RunData | None = None
        self._resolution: dict[str, float] = {}

    def run(self, variants: Sequence[Variant]) -> None:
        """Run ``variants``, and the full scene unless it is there, in the same rounds."""
        first = [] if FULL in self.runs else self._first()
        found = run_variants(
            self.path,
            [*first, *variants],
            self._folder,
            rounds=self.rounds,
            engine=self.options.engine,
            transport=self.options.transport,
            workers=self.options.workers,
            timeout=self.options.timeout,
            on_progress=self._on_progress,
        )
        self.runs |= found
        if first:
            self._see_full()

    def _first(self) -> list[Variant]:
        variants = [Variant(name=FULL, model=self.options.model)]
        if not isinstance(self.scene, BedScene):
            run = self.scene.run
            finer = {"run.dt": 0.5 * run.dt} if run.dt else {"run.steps_per_contact": 2.0 * run.steps_per_contact}
            variants.append(Variant(name=FINE, model=self.options.model, changes=finer))
        return variants

    def _see_full(self) -> None:
        full = self.runs[FULL]
        if full.status == REFUSED:
            raise CaseFileError(f"the full scene cannot be run: {full.message}")
        if not full.completed:
            raise RunError(f"the full scene ended as {full.status!r}: {full.message}")
        if isinstance(self.scene, BedScene):
            self._full = see_bed(full)
            return
        self._full = see_contacts(full)
        fine = self.runs[FINE]
        if fine.completed:
            self._resolution = resolution_of(self._full, see_contacts(fine))

    def effects(self, name: str, lost: Mapping[str, str], part: Part | None = None) -> tuple[Effect, ...]:
        """Return the effects of the completed variant ``name``, by which ``part`` (None: several) is tried."""
        run = self.runs[name]
        if self._full is None:
            raise InputError("the full scene was not run")
        if self._full.signals is not None:
            return bed_effects(see_bed(run), self._full, self.tolerances, lost)
        return contact_effects(part, see_contacts(run), self._full, self.tolerances, self._resolution)

    def result(self, part: Part) -> PartResult:
        """Judge one part."""
        run = self.runs[part.name]
        if not run.completed:
            return cannot_run(part, run.status, run.message)
        cost = cost_change(part, run, self.runs[FULL], self.options.engine)
        return judge_part(part, self.effects(part.name, part.lost, part), cost)


def _tolerances(scene: Scene | BedScene, options: TrimOptions) -> dict[str, float]:
    return dict(options.tolerances or scene.tolerances)


def _variant(part: Part, model: str) -> Variant:
    return Variant(name=part.name, model=part.model or model, changes=part.changes)


def _together(scene: Scene | BedScene, study: _Study, results: Sequence[PartResult], tell: Tell | None) -> Trim:
    """Run without everything that may go, and put back what must not go together with the rest."""
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
    trimmed = _trimmed(scene, study, without)
    return Trim(
        case=scene.name,
        title=scene.title,
        model=study.options.model,
        bed=isinstance(scene, BedScene),
        tolerances=study.tolerances,
        results=tuple(results),
        attempts=tuple(attempts),
        without=tuple(part.name for part in without),
        trimmed=trimmed,
        trimmed_model=_model_of(without, study.options.model),
        sentences=_sentences(scene, study, results, attempts, without, clashing),
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
        sentence = f"Without {listed} at once the scene ended as {run.status!r}: {run.message}: {back[0]} goes back."
        return Attempt(without=without, verdict=CANNOT_RUN, sentence=sentence, put_back=back)
    lost = {metric: why for part in parts for metric, why in part.lost.items()}
    effects = study.effects(name, lost, parts[0] if len(parts) == 1 else None)
    cost = cost_change(None, run, study.runs[FULL], study.options.engine)
    outcome, found = describe(effects)
    price = f"Without {listed} at once (the full scene costs {cost_text(cost)})"
    if outcome == "free":
        return Attempt(without=without, verdict="holds", sentence=f"{price}: {found}.", cost=cost, effects=effects)
    bad = tuple(e.metric for e in effects if e.verdict == outcome)
    alone = "which no part does alone" if len(parts) > 1 else "as by itself"
    back = (max(going, key=_suspicion(bad)).part.name,)
    sentence = f"{price}: {found}, {alone}: {back[0]} goes back."
    return Attempt(
        without=without,
        verdict=outcome,
        sentence=sentence,
        together=bad,
        put_back=back,
        cost=cost,
        effects=effects,
    )


def _suspicion(metrics: Sequence[str]) -> Callable[[PartResult], float]:
    """Return what a part's own effects use of the limits of ``metrics`` (none given: of all): a key to sort by."""

    def share(result: PartResult) -> float:
        shares = [e.share for e in result.effects if not metrics or e.metric in metrics]
        return max((sum(s) for s in shares if s is not None), default=0.0)

    return share


def _all_of(name: str, parts: Iterable[Part], model: str) -> Variant:
    return Variant(name=name, model=_model_of(parts, model), changes=_changes(parts))


def _changes(parts: Iterable[Part]) -> dict[str, Any]:
    return {key: value for part in parts for key, value in part.changes.items()}


def _model_of(parts: Iterable[Part], model: str) -> str:
    return next((part.model for part in parts if part.model), model)


def _trimmed(scene: Scene | BedScene, study: _Study, without: Sequence[Part]) -> Scene | BedScene:
    changes = _changes(without)
    trimmed = load_case(study.path, overrides=texts(changes)) if changes else scene
    said = f"trimmed: without {', '.join(part.text for part in without)}" if without else "trimmed: nothing left out"
    title = f"{scene.title}, {said}" if scene.title else said.capitalize()
    return replace(trimmed, name=scene.name, title=title[:_LONGEST_TITLE])


def _sentences(
    scene: Scene | BedScene,
    study: _Study,
    results: Sequence[PartResult],
    attempts: Sequence[Attempt],
    without: Sequence[Part],
    clashing: Sequence[PartResult],
) -> tuple[str, ...]:
    texts = [_outcome(scene, attempts, without)]
    for verdict, how in ((MATTERS, "Not in the case, or of another kind, and it matters"), (UNDECIDED, "Undecided")):
        if names := [r.part.name for r in results if r.verdict == verdict]:
            texts.append(f"{how}: {', '.join(names)}.")
    texts += [f"{r.part.name}: not left out together with a part that sets the same values." for r in clashing]
    texts += [a.sentence for a in attempts if a.verdict != "holds"]
    if not study.tolerances:
        texts.append(
            "No tolerance is given: "
            + (
                "of a bed nothing but equality to the last bit shows that a part has no effect."
                if isinstance(scene, BedScene)
                else "what is smaller than the discretisation error counts as no effect."
            )
        )
    elif any(e.verdict == "-" for r in results for e in r.effects):
        texts.append(f"Judged by the tolerances of {', '.join(study.tolerances)}; other metrics are told, not judged.")
    texts += _not_there(results)
    called = [e for r in results for e in r.effects if e.verdict == "-" and e.change and e.significant is not None]
    if isinstance(scene, BedScene) and called:
        texts.append(
            f"{len(called)} changes are told, not judged. Expect {0.05 * len(called):.1f} of them to be larger"
            " than their uncertainty although nothing has changed."
        )
    texts += dict.fromkeys(f"CPU times: {r.cost.caveat}." for r in results if r.cost is not None and r.cost.caveat)
    return tuple(texts)


def _not_there(results: Sequence[PartResult]) -> list[str]:
    """Say which tolerances are for metrics that the full scene has not."""
    names = dict.fromkeys(e.metric for r in results for e in r.effects if e.tolerance is not None and e.full is None)
    fields = ("eps_g", "trajectory", "trajectory_rms")  # differences from the start
    missing = [name for name in names if name not in fields]
    return [f"Not judged, since the full scene has none: {', '.join(missing)}."] if missing else []


def _outcome(scene: Scene | BedScene, attempts: Sequence[Attempt], without: Sequence[Part]) -> str:
    if not without:
        return f"{scene.name}: nothing was found that the scene can do without for certain."
    listed = ", ".join(part.text for part in without)
    last = attempts[-1]
    price = "" if last.cost is None else f"; to have it costs {cost_text(last.cost)}"
    return f"{scene.name} can do without {listed}{price}. All at once, {describe(last.effects)[1]}."
