"""The trade of a coupled bed: which runs, for how long, in which order; and what they tell.

Bed runs are dear and their averages uncertain, so time is spent by a plan that is made anew whenever a run has
stopped: see `kncal.study.trade.budget.allocate` (how long) and `bisection_order` (which softness next).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from kncal.core.awake import awake
from kncal.core.errors import CaseFileError, InputError, InterruptedRunError, KncalError
from kncal.core.mpi import check_fit
from kncal.observe.bed_compare import ObservedRun, observed
from kncal.observe.softness import model_signs, signs
from kncal.scene.bed_scene import BedScene
from kncal.scene.case_file import load_case
from kncal.scene.case_text import read_case
from kncal.scene.plan import plan
from kncal.study.trade.base import Candidate, Tell, Trade, TradeOptions, TradePoint
from kncal.study.trade.bed_errors import Judged, bed_errors, bed_splits
from kncal.study.trade.bed_points import bed_contacts, reference_steps, shared_case
from kncal.study.trade.bed_result import caveats, planned, refused_by
from kncal.study.trade.bed_runs import STOPPED, WAITING, Lanes, Track, key_of, load_part, measured_rates, rate_of
from kncal.study.trade.budget import Budget, Work, affordable, allocate, bisection_order, weighted
from kncal.study.trade.points import Contact

#: A candidate is begun if it can come to this share of the case's time, beside those before it ...
WORTH = 0.5
#: ... but so many runs are begun in any case: the reference, the unsoftened spring, and a softened one.
FEWEST = 3
#: ... and others while all of them together take no more than this share of what is left: soft ones are cheap.
EXTRA = 1.0 / 3.0
#: From this share of its time on the face value of an average decides what is tried next.
TOLD = 0.25
#: Largest share of the budget for one part of a run, the first ones and the others; none is shorter than the last [s].
FIRST_SHARE, PART_SHARE, SHORTEST = 0.05, 0.1, 5.0
#: A part may take so many times what starting and stopping it take.
WORTHWHILE = 5.0
#: Kept for what follows the runs (files, pictures): share of the budget, and at least [s]; longer on a busy machine, by
#: the wall-clock over the CPU time of runs, up to so many times.
REST_SHARE, REST, SLOWEST = 0.02, 3.0, 6.0
#: Between two looks at what runs [s].
_TICK = 0.5


def trade_bed(case: str | Path, scene: BedScene, folder: Path, options: TradeOptions, tell: Tell) -> Trade:
    """Trade speed for accuracy in a bed; what ``folder`` holds already is used, and goes on where it stopped.

    Every run has the case's end time. Without a budget all come to it. With one, runs are stopped by the clock: then
    averages are over the time that was simulated, with the wider intervals of that, and CPU times are those of the
    parts that ran, extrapolated to the whole time.

    Parameters
    ----------
    case, scene : the case, and what it describes
    folder : of the runs
    options : ``rounds`` and ``engine`` are of single contacts; the parts of each run take the place of rounds
    tell : told what is done now

    Raises
    ------
    CaseFileError, InputError
        If the case cannot be planned or has no contacts.
    RunError
        If the packing fails.
    InterruptedRunError
        After Ctrl-C; the same call again goes on.
    """
    budget, load = Budget(options.budget), os.getloadavg()[0]
    if not options.tolerances:
        options = replace(options, tolerances=dict(scene.tolerances))
    session = _Session(case, scene, folder, options, budget, tell)
    try:
        session.run()
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted; run the same command again to go on") from None
    return session.trade(load)


@dataclass
class _Session:
    """One start of a trade."""

    case: str | Path
    scene: BedScene
    folder: Path
    options: TradeOptions
    budget: Budget
    tell: Tell
    tracks: dict[str, Track] = field(default_factory=dict)
    refused: dict[str, TradePoint] = field(default_factory=dict)
    seen: dict[str, tuple[int, ObservedRun | None]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    judged: dict[tuple[str, int, int], bool | None] = field(default_factory=dict)
    looking: float = 0.5  # longest time that reading and observing a run took [s]

    @property
    def workers(self) -> int:
        """Runs at a time."""
        return check_fit(self.options.workers, 1)

    @property
    def reference(self) -> Track:
        """The run that all are compared with."""
        return self.tracks[self.top.at(self.steps).name]

    def run(self) -> None:
        """Run what there is time for."""
        self.tell("one start for all runs")
        self.shared, notes = shared_case(self.case, self.scene, self.folder)
        self.notes += notes
        smallest = min(self.options.tolerances.values(), default=0.05)
        self.steps, self.left = reference_steps(self.scene, self.options.steps, smallest)
        self.text = read_case(self.shared).text
        self.top, self.groups = bed_contacts(self.case, self.options)
        if self._add(self.top, self.steps) is None:
            raise CaseFileError(f"the reference: {self.refused[self.top.at(self.steps).name].message}")
        if not self.reference.model.contacts:
            raise CaseFileError(f"{self.scene.name}: no particle moves, so there is no contact to trade")
        with Lanes(self.shared, self.options.transport, self.workers) as lanes:
            while True:
                while lanes.free and self._start_one(lanes):
                    pass
                if not lanes.going:
                    return
                for track in lanes.ended(_TICK):
                    self._told(track)
                    self._observed(track.name)  # before it goes on

    # --- the plan -------------------------------------------------------------

    def _start_one(self, lanes: Lanes) -> bool:
        """Start the part of a run that tells most now; False if there is none, or no time."""
        left = self.budget.left() - self._rest() - lanes.overhead
        shortest = max(SHORTEST, lanes.overhead)
        if left < shortest:
            return False
        going = lanes.going
        tracks = [track for track in self._worth(left, lanes) if track.open]
        waiting = [track for track in tracks if track.name not in going]
        if not waiting:
            return False
        if self.budget.seconds is None:
            self._start(lanes, waiting[0], None)
            return True
        rates = measured_rates(list(self.tracks.values()))
        if rates is None:  # one short part of each model calibrates the rest
            limit = max(FIRST_SHARE * self.budget.seconds, shortest)
            self._start(lanes, waiting[0], min(limit, left))
            return True
        capacity = lanes.workers * left - sum(max(end - awake(), 0.0) for end in going.values())
        works = [Work(name=t.name, rate=rate_of(t, rates), done=t.done) for t in tracks]
        length = self.reference.length
        targets = allocate(weighted(works) if tracks[0] is self.reference else works, max(capacity, 0.0), length)
        # the one that lacks most of what it is to have; those before it in the order go first among equals
        track = max(waiting, key=lambda t: (targets[t.name] - t.done) / max(targets[t.name], 1e-12))
        needed = (targets[track.name] - track.done) * rate_of(track, rates)
        longest = max(PART_SHARE * self.budget.seconds, WORTHWHILE * shortest)
        limit = min(max(needed, 0.5 * longest), longest)
        if left - limit < shortest + lanes.overhead:  # too little would be left for another part
            limit = left
        self._start(lanes, track, limit)
        return True

    def _start(self, lanes: Lanes, track: Track, limit: float | None) -> None:
        share = track.done / track.length
        for_how_long = "to its end" if limit is None else f"for {limit:.0f} s"
        self.tell(f"{track.name}: from {100.0 * share:.0f} % of its time on, {for_how_long}")
        lanes.start(track, limit)

    def _rest(self) -> float:
        """Time to keep for what follows the runs [s]."""
        if self.budget.seconds is None:
            return 0.0
        rates = measured_rates(list(self.tracks.values()))
        slow = 1.0 if rates is None else min(max(rates.wall, 1.0), SLOWEST)
        # runs that end last are looked at once more; files and pictures take longer on a busy machine
        return max(REST_SHARE * self.budget.seconds, REST * slow) + (self.workers + 1) * self.looking

    def _worth(self, left: float, lanes: Lanes) -> list[Track]:
        """Return the runs to spend what is left on, in the order of what they tell."""
        rates = measured_rates(list(self.tracks.values()))
        chosen: list[Track] = []
        names: set[str] = set()
        capacity = lanes.workers * left
        length = self.reference.length
        for contact, steps in self._order():
            track = self._add(contact, steps)
            if track is None or track.name in names:
                continue
            names.add(track.name)
            tried = [*chosen, track]
            if self.budget.seconds is not None and len(tried) > FEWEST and not track.parts:
                if rates is None:
                    break
                works = [Work(name=t.name, rate=rate_of(t, rates), done=t.done) for t in tried]
                if affordable(works, capacity, length, WORTH * length) < len(works):
                    targets = allocate(weighted(works), capacity, length)
                    if sum(w.rate * (targets[w.name] - w.done) for w in works[FEWEST:]) > EXTRA * capacity:
                        break
            chosen = tried
        return chosen

    def _order(self) -> Iterator[tuple[Contact, float]]:
        """All candidates, those first that tell most: the edge of softness, then other ways to be there."""
        soft, reduced = self.groups["softened"], self.groups["reduced"]
        by_factor = {contact.factor or 0.0: contact for contact in soft}
        inside = {f: ok for f, c in by_factor.items() if (ok := self._inside(c.at(self.steps).name)) is not None}
        factors = [f for f in by_factor if f != 1.0]
        known = [f for f in factors if f in inside]
        yield self.top, self.steps
        yield by_factor[1.0], self.steps
        for factor in (*known, *bisection_order(factors, inside)[: max(4 - len(known), 1)]):
            yield by_factor[factor], self.steps
        # the softest that seems to do
        edge = min((f for f, ok in inside.items() if ok), default=1.0)
        hertz = {contact.factor or 0.0: contact for contact in reduced}
        if edge != 1.0 and edge in hertz:
            yield hertz[edge], self.steps
        for steps in self._other_steps():
            yield by_factor[edge], steps
        for contact in self.groups["overlap"]:
            yield contact, self.steps
        for factor in bisection_order(factors, inside):
            yield by_factor[factor], self.steps
        for contact in self.groups["method"]:
            yield contact, self.steps
        for factor in bisection_order([f for f in hertz if f not in (1.0, edge)], {}):
            yield hertz[factor], self.steps
        for steps in self._other_steps():
            for contact in (hertz[1.0], *soft, *self.groups["overlap"], *self.groups["method"], *reduced):
                yield contact, steps

    def _other_steps(self) -> list[float]:
        return [n for n in sorted(self.options.steps) if n != self.steps]

    def _add(self, contact: Contact, steps: float) -> Track | None:
        """Return the track of a contact at N; None for one that a limit refuses."""
        candidate = contact.at(steps)
        name = candidate.name
        if name not in self.tracks and name not in self.refused:
            try:
                track = self._track(candidate)
            except KncalError as error:
                text = str(error).partition("\n(with ")[0]  # the values stand beside it anyway
                self.refused[name] = TradePoint(candidate=candidate, status="refused", message=text, ran_share=0.0)
            else:
                why = refused_by(track)
                if why:
                    self.refused[name] = self._refusal(track, why)
                else:
                    track.take_up()
                    self.tracks[name] = track
        return self.tracks.get(name)

    def _track(self, candidate: Candidate) -> Track:
        # the case itself, without the many positions of the shared one: the plan is the same
        scene = load_case(self.case, overrides=candidate.variant.overrides)
        if not isinstance(scene, BedScene):
            raise CaseFileError(f"{self.case}: expected a bed")
        model = plan(scene, (candidate.model,))[candidate.model]
        folder = self.folder / "runs" / candidate.name
        return Track(candidate=candidate, model=model, folder=folder, key=key_of(self.text, candidate))

    def _refusal(self, track: Track, why: str) -> TradePoint:
        return replace(planned(track), status="refused", message=why, signs=model_signs(track.model))

    # --- what was seen --------------------------------------------------------

    def _told(self, track: Track) -> None:
        share = 100.0 * track.done / track.length
        self.tell(f"{track.name}: {track.status.replace('_', ' ')}, {share:.0f} % of its time, {track.cpu:.0f} CPU s")

    def _observed(self, name: str) -> ObservedRun | None:
        """Return what was seen of a run as far as it came; None if it is too short, or failed."""
        track = self.tracks.get(name)
        if track is None or track.run is None or track.status not in (STOPPED, "completed"):
            return None
        kept = self.seen.get(name)
        if kept is not None and kept[0] == track.couplings:
            return kept[1]
        began = awake()
        run: ObservedRun | None = None
        with suppress(InputError):  # too short
            run = observed(load_part(track.run))
        self.looking = max(self.looking, awake() - began)
        self.seen[name] = (track.couplings, run)
        return run

    def _inside(self, name: str) -> bool | None:
        """Return whether a candidate seems to do; None while it, or the reference, is too short to tell.

        Only for the order of what follows: errors within their uncertainty count at face value from `TOLD` on.
        """
        track = self.tracks.get(name)
        if track is None:
            return False if name in self.refused else None
        if not track.open and track.status != "completed":
            return False
        reference, run = self._observed(self.reference.name), self._observed(name)
        if reference is None or run is None or track is self.reference:
            return None
        key = (name, track.couplings, self.reference.couplings)
        if key not in self.judged:
            limits = self.options.tolerances
            errors = bed_errors(run, reference, limits)
            found = {errors[metric].verdict(limit) for metric, limit in limits.items()}
            near = all((e := errors[m].error) is not None and abs(e) <= limit for m, limit in limits.items())
            told = min(track.done, self.reference.done) >= TOLD * track.length
            if found & {"outside", "missing"}:
                self.judged[key] = False
            else:
                self.judged[key] = near if told or found == {"ok"} else None
        return self.judged[key]

    # --- the result -----------------------------------------------------------

    def trade(self, load: float) -> Trade:
        """Return what was found."""
        reference = self.reference
        top = self._observed(reference.name)
        judged: dict[str, Judged] = {}
        points: dict[str, TradePoint] = {}
        for contact, steps in self._order():
            name = contact.at(steps).name
            if name in points or name == reference.name:
                continue
            track = self._add(contact, steps)
            if track is None:
                points[name] = self.refused[name]
                continue
            points[name] = self._point(track, top)
            run = self._observed(name)
            if run is not None and points[name].completed:
                judged[name] = Judged(candidate=track.candidate, run=run, errors=points[name].errors)
        step, tracks = (self.steps, self.left), list(self.tracks.values())
        return Trade(
            case=self.scene.name,
            title=self.scene.title,
            bed=True,
            reference=self._point(reference, top),
            convergence=None,
            points=tuple(points.values()),
            tolerances=dict(self.options.tolerances),
            splits={} if top is None else bed_splits(judged.values(), top, self.steps),
            caveats=(*self.notes, *caveats(tracks, reference, step, self.budget, load, self.workers)),
            options=self.options,
            wall_seconds=self.budget.spent(),
        )

    def _point(self, track: Track, top: ObservedRun | None) -> TradePoint:
        plan, run = planned(track), self._observed(track.name)
        if run is None:
            short = "" if not track.parts else f"run for {track.done:.3g} s, too short for any average"
            status = "skipped" if track.status in (WAITING, STOPPED, "completed") else plan.status
            return replace(plan, status=status, message=short or plan.message, signs=model_signs(track.model))
        is_top = track is self.reference
        errors = {} if top is None or is_top else bed_errors(run, top, self.options.tolerances)
        return replace(
            plan,
            status="completed",
            message="" if track.status == "completed" else f"run for {track.done:.3g} of {track.length:.3g} s",
            cpu_seconds=track.whole(),
            ran_share=track.done / track.length,
            errors=errors,
            signs=signs(run.data, None if is_top or top is None else top.data),
        )
