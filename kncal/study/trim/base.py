"""What trimming a scene is made of: its optional parts, what each costs and changes, and what is left in the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from kncal.scene.bed_scene import BedScene
from kncal.scene.scene import Scene
from kncal.study.variants import Changes

#: What is tried: the full scene without a part that it has, with one that it has not, or with another of equal rank.
OFF, ON, OTHER = "off", "on", "other"
#: Verdicts on a part that the scene has.
LEAVE_OUT, KEEP = "leave out", "keep"
#: Verdicts on a part that the scene has not, or on one of equal rank.
NOT_NEEDED, EITHER, MATTERS = "not needed", "either", "matters"
#: Verdicts without a judgement.
UNDECIDED, CANNOT_RUN, DOES_NOT_APPLY = "undecided", "cannot run", "does not apply"

#: File that says that a folder is that of a trim.
RECORD = "trim.json"
#: Told in one line what is done now.
Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Part:
    """One optional part of a scene's physics or output, and how the scene is run to tell what it is worth.

    Attributes
    ----------
    name : unique in a scene, for variants and files
    group : what `--parts` calls it; differs from ``name`` only where there are several of a kind ("smoothing")
    text : what it is, in words that follow "the"
    change : `OFF`, `ON` or `OTHER`
    tried : what is run instead of the full scene, in words
    changes : of the case that make it, see `kncal.study.Variant`
    model : the contact model it is run with; "": that of the full scene
    why_not : why it has no meaning for this scene; empty if it has
    output : whether it is no physics, only what is recorded
    lost : metric -> why it cannot be compared with the full scene's
    """

    name: str
    group: str
    text: str
    change: str
    tried: str
    changes: Changes = field(default_factory=dict)
    model: str = ""
    why_not: str = ""
    output: bool = False
    lost: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """How one metric of the scene changes.

    Attributes
    ----------
    metric, unit : name, and unit of ``full`` and ``tried``
    full, tried : values of the full scene and of the one tried, or None
    change : (tried - full)/scale [-], or None if it cannot be computed
    uncertainty : of ``change`` [-]; of single contacts the discretisation error of both runs together, of beds the
        half-width of the 95 % confidence interval (three times that where it is not reliable); None: not known
    basis : what the scale is
    tolerance : largest allowed abs(change) [-]; None: not judged
    verdict : "none" (equal to the last bit), "within" (the whole interval is inside the tolerance), "changed" (all of
        it is outside, or the metric is gone), "undecided", or "-" (not judged)
    significant : whether the change is larger than its uncertainty; None: not known
    needed_end_time : run.end_time that would decide [s], or None
    reason : what to know
    """

    metric: str
    unit: str
    full: float | None
    tried: float | None
    change: float | None
    uncertainty: float | None
    basis: str
    tolerance: float | None
    verdict: str
    significant: bool | None
    needed_end_time: float | None = None
    reason: str = ""

    @property
    def share(self) -> tuple[float, float] | None:
        """Size of the change and its uncertainty over the tolerance (without one: over the uncertainty), or None."""
        limit = self.tolerance if self.tolerance is not None else self.uncertainty
        if self.change is None or not limit:
            return None
        return abs(self.change) / limit, (self.uncertainty or 0.0) / limit


@dataclass(frozen=True, kw_only=True)
class CostChange:
    """What having a part costs: with over without (or, between equals, tried over full), less one [-].

    Attributes
    ----------
    cpu, cpu_low, cpu_high : of the CPU times: median, smallest and largest of the paired rounds; None: not measurable
    rounds : pairs of runs
    steps : of the numbers of steps
    disk : of the bytes of the run folders
    full_cpu, tried_cpu : median CPU times [s]
    full_bytes, tried_bytes : of the run folders
    caveat : one sentence, or empty
    """

    cpu: float | None
    cpu_low: float | None
    cpu_high: float | None
    rounds: int
    steps: float
    disk: float
    full_cpu: float
    tried_cpu: float
    full_bytes: int
    tried_bytes: int
    caveat: str = ""


@dataclass(frozen=True, kw_only=True)
class PartResult:
    """What became of one part: ``verdict`` is one of the constants of this module, ``sentence`` says why."""

    part: Part
    verdict: str
    sentence: str
    cost: CostChange | None = None
    effects: tuple[Effect, ...] = ()

    @property
    def worst(self) -> Effect | None:
        """The effect that decides, see `worst_of`."""
        return worst_of(self.effects)


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One run of everything that was to be left out at once, against the full scene.

    Attributes
    ----------
    without : names of the parts left out
    verdict : "holds", "changed", "undecided" or `CANNOT_RUN`
    together : metrics that change (or are undecided) though they do not for any of these parts alone
    put_back : names of the parts that go back for the next attempt
    """

    without: tuple[str, ...]
    verdict: str
    sentence: str
    together: tuple[str, ...] = ()
    put_back: tuple[str, ...] = ()
    cost: CostChange | None = None
    effects: tuple[Effect, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Trim:
    """Everything that trimming a scene found.

    Attributes
    ----------
    case, title : of the full scene
    model : contact model of the full scene
    bed : whether it is a coupled bed
    tolerances : metric -> largest allowed abs(change) [-]
    results : one per part
    attempts : the trimmed scene against the full one, until it held
    without : names of the parts that the trimmed case leaves out
    trimmed : the trimmed scene
    sentences : the outcome in words, then what to keep in mind
    """

    case: str
    title: str
    model: str
    bed: bool
    tolerances: Mapping[str, float]
    results: tuple[PartResult, ...]
    attempts: tuple[Attempt, ...]
    without: tuple[str, ...]
    trimmed: Scene | BedScene
    trimmed_model: str
    sentences: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trimmed scene (that is case.toml), as plain JSON types."""
        return {
            "case": self.case,
            "title": self.title,
            "model": self.model,
            "bed": self.bed,
            "tolerances": dict(self.tolerances),
            "sentences": list(self.sentences),
            "parts": [_plain(result) for result in self.results],
            "attempts": [asdict(attempt) for attempt in self.attempts],
            "without": list(self.without),
            "trimmed_model": self.trimmed_model,
        }


def _plain(result: PartResult) -> dict[str, Any]:
    values = asdict(result)
    part = values.pop("part")
    return {**part, "lost": dict(result.part.lost), **values}


def worst_of(effects: tuple[Effect, ...]) -> Effect | None:
    """Return the effect that decides, None if none has a share of a limit.

    That is one of the judged, if there are any: the changed before the undecided, then the one that uses most of its
    limit.
    """
    judged = [e for e in effects if e.tolerance is not None] or list(effects)
    ranks = {"changed": 2, "undecided": 1}
    shares = [(ranks.get(e.verdict, 0), sum(e.share), e) for e in judged if e.share is not None]
    return max(shares, key=lambda item: item[:2])[2] if shares else None
