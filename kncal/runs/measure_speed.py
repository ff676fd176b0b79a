"""The impact speed of a scene, measured: run it with the linear contact, see how fast things meet, calibrate again.

A softer or stiffer spring changes the motion a little, so the speed is measured until k_n no longer changes by more
than the tolerance or its own uncertainty. OUT/measuring/round-1, round-2 ... are ordinary run folders, so a second
start keeps what is there; OUT/measuring/measured.json says what each round found.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from kncal.core.errors import CaseFileError, RunError
from kncal.core.files import write_json
from kncal.core.units import quantity
from kncal.engines.base import Tell
from kncal.engines.registry import engine_for
from kncal.observe.impact_speeds import STATISTICS, ImpactSpeeds, StiffnessAt
from kncal.report.speeds import plot_impact_speeds
from kncal.runs.folder import MEASURING, refuse_foreign
from kncal.runs.impact_speeds import RunSpeeds, run_speeds
from kncal.runs.workflow import require_completed, run_case
from kncal.scene.contact import MeasuredSpeed
from kncal.scene.pair_contact import calibration_for
from kncal.scene.plan import first_impact_speed
from kncal.scene.scene import Scene

RECORD, PICTURE = "measured.json", "impact_speeds.png"
_LONGEST_TITLE = 300


@dataclass(frozen=True, kw_only=True)
class Round:
    """One round of measuring.

    Attributes
    ----------
    number : from 1; folder : its run folder
    v_0, k_n : the round was run with [m/s], [N/m]
    found : the speed that was measured, and k_n at it
    change : relative change of k_n; allowed : the change below which it has settled [-]
    """

    number: int
    folder: str
    v_0: float
    k_n: float
    found: StiffnessAt
    change: float
    allowed: float

    @property
    def settled(self) -> bool:
        """Whether k_n no longer changed."""
        return abs(self.change) < self.allowed


def resolve_measured(
    scene: Scene,
    out: Path,
    *,
    engine: str = "liggghts",
    transport: str = "auto",
    timeout: float | None = None,
    tell: Tell | None = None,
) -> Scene:
    """Return the scene with a number for the impact speed that it asks to be measured; any other scene as it is.

    Of a bed the impacts of two particles count (of a single particle those with walls), of single contacts
    those of the pair that met first, and of pairs like it.

    Parameters
    ----------
    scene : Scene or Scene
    out : run folder of the case; the rounds are in its folder ``measuring``
    engine : of single contacts; transport : of beds
    timeout : wall-clock limit of each round [s]
    tell : called with a sentence about each round

    Raises
    ------
    CaseFileError
        If there is no speed to start at, or the pair to measure at has a v_0 of its own.
    RunError
        If a round fails, if nothing met, or if k_n has not settled after the most rounds.
    """
    asked = scene.contact.measured
    if asked is None:
        return scene
    refuse_foreign(out)
    v_0 = _start(scene, asked)
    rounds: list[Round] = []
    for number in range(1, asked.rounds + 1):
        folder = out / MEASURING / f"round-{number}"
        short = _trial(scene, v_0, asked.run_time)
        solver = engine_for(scene, engine, transport)
        require_completed(run_case(short, solver, folder, ("linear",), timeout=timeout, tell=tell).values())
        seen = run_speeds(folder / "linear")
        rounds.append(_judge(short, asked, number, v_0, seen, folder))
        settled = rounds[-1].settled
        _record(scene, asked, rounds, seen, out / MEASURING)
        last = rounds[-1].found.v_0
        if tell:
            tell(_told(rounds[-1], seen.speeds[seen.main], asked))
        if settled:
            return _resolved(scene, _rounded(last.value), number)
        v_0 = _rounded(last.value)
    tried = ", ".join(f"{r.k_n:.4g} N/m at {r.v_0:.4g} m/s" for r in rounds)
    last_round = rounds[-1]
    raise RunError(
        f"{scene.name}: k_n has not settled in {len(rounds)} rounds of measuring the impact speed: {tried}; the last "
        f"found {last_round.found.v_0.value:.4g} m/s, a change of {100.0 * last_round.change:+.3g} % where "
        f"{100.0 * last_round.allowed:.3g} % would do: expected a longer contact.measured.run_time, more rounds or a "
        f"larger tolerance; or give contact.v_0 a number. All rounds: {out / MEASURING / RECORD}",
        "bad-input",
    )


def _trial(scene: Scene, v_0: float, time: float | None) -> Scene:
    """Return the scene calibrated at ``v_0`` [m/s], which ends at ``time`` [s] (None: as it did)."""
    run, end = scene.run, scene.run.until_time if time is None else time
    if time is not None:
        run = replace(run, until_time=time, until_bounces=None)
    if scene.coupled and end is not None:
        kept = run.discard if run.discard is not None and run.discard < 0.5 * end else None
        run = replace(run, discard=kept, frames_every=end)
    return replace(scene, contact=replace(scene.contact, v_0=v_0, measured=None), run=run)


def _start(scene: Scene, asked: MeasuredSpeed) -> float:
    if asked.start is not None:
        return asked.start
    speed = first_impact_speed(scene)
    if speed is None:
        raise CaseFileError(
            f"{scene.name}: nothing moves towards anything at the start: expected contact.measured.start [m/s], a "
            "first guess of the impact speed"
        )
    return _rounded(speed)


def _judge(scene: Scene, asked: MeasuredSpeed, number: int, v_0: float, seen: RunSpeeds, folder: Path) -> Round:
    if not seen.speeds[seen.main].count:
        raise RunError(
            f"{scene.name}: nothing met anything in round {number} of measuring the impact speed ({folder}): expected "
            "a longer contact.measured.run_time",
            "bad-input",
        )
    pair = seen.pairs[seen.main]
    if pair.numbers.v_0 != v_0:
        raise CaseFileError(
            f"{scene.name}: contact.v_0 is to be measured, but the pair that it is measured at, "
            f"{'–'.join(pair.names)}, has a v_0 of its own, {pair.numbers.v_0} m/s, in contact.pairs: "
            "expected one of the two"
        )
    calibration = calibration_for(scene.contact, pair.both, pair.numbers._replace(v_0=v_0, k_n=None))
    found = next(row for row in seen.stiffness(seen.main) if row.statistic == asked.statistic)
    if calibration is None or found.k_n is None:
        raise RunError(f"{scene.name}: round {number} of measuring the impact speed: {found.problem}", "bad-input")
    k_n = float(calibration.k_n)
    return Round(
        number=number,
        folder=folder.name,
        v_0=v_0,
        k_n=k_n,
        found=found,
        change=found.k_n.value / k_n - 1.0,
        allowed=max(asked.tolerance, found.k_n.uncertainty),
    )


def _told(last: Round, main: ImpactSpeeds, asked: MeasuredSpeed) -> str:
    found, k_n = last.found.v_0, last.found.k_n
    width = f" (95 %: {found.low:.3g} to {found.high:.3g})" if found.high > found.low else ""
    doubt = f"; uncertain: {found.why}" if found.why else ""
    stiff = "" if k_n is None else f", k_n = {quantity(k_n.value, 'N/m')}, {100.0 * last.change:+.2g} %"
    end = f"settled in {last.number} round{'s' if last.number > 1 else ''}" if last.settled else "not settled yet"
    return (
        f"measuring v_0, round {last.number} at {last.v_0:.4g} m/s: {STATISTICS[asked.statistic]} of {main.count} "
        f"impacts {found.value:.4g} m/s{width}{stiff} ({100.0 * last.allowed:.2g} % allowed): {end}{doubt}"
    )


def _record(scene: Scene, asked: MeasuredSpeed, rounds: list[Round], seen: RunSpeeds, folder: Path) -> None:
    """Write ``measured.json``, and a picture of the last round."""
    data: dict[str, Any] = {
        "case": scene.name,
        "asked": {key: value for key, value in asdict(asked).items() if value is not None},
        "settled": rounds[-1].settled,
        "v_0": _rounded(rounds[-1].found.v_0.value) if rounds[-1].settled else None,
        "rounds": [asdict(r) | {"settled": r.settled} for r in rounds],
        "last_round": {kind: speeds.to_dict() for kind, speeds in seen.speeds.items()},
    }
    write_json(folder / RECORD, data)
    plot_impact_speeds(seen.speeds, folder / PICTURE, f"{scene.name}: impact speeds of round {len(rounds)}")


def _resolved(scene: Scene, v_0: float, rounds: int) -> Scene:
    told = f"(contact.v_0 = {v_0:.4g} m/s, measured in {rounds} round{'s' if rounds > 1 else ''})"
    title = f"{scene.title[: _LONGEST_TITLE - len(told) - 1]} {told}".strip()
    return replace(scene, contact=replace(scene.contact, v_0=v_0, measured=None), title=title)


def _rounded(v_0: float) -> float:
    """Return the speed with four digits: more say nothing, and fewer files differ between machines."""
    return float(f"{v_0:.4g}")
