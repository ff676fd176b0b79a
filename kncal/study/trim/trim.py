"""What trimming a scene is made of: its optional parts, what each costs and changes, and what is left in the end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from kncal.observe.row import Row
from kncal.observe.verdict import Verdict
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
    effects: tuple[Row, ...] = ()

    @property
    def worst(self) -> Row | None:
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
    effects : a row per metric: the scene tried against the full one, see `kncal.study.trim.effects`
    put_back : names of the parts that go back for the next attempt
    """

    without: tuple[str, ...]
    verdict: str
    sentence: str
    together: tuple[str, ...] = ()
    put_back: tuple[str, ...] = ()
    cost: CostChange | None = None
    effects: tuple[Row, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Trim:
    """Everything that trimming a scene found.

    Attributes
    ----------
    case, title : of the full scene
    model : contact model of the full scene
    tolerances : metric -> largest allowed abs(change) [-]
    results : one per part
    attempts : the trimmed scene against the full one, until it held
    without : names of the parts that the trimmed case leaves out
    trimmed : the trimmed scene
    verdict : the outcome in words
    """

    case: str
    title: str
    model: str
    tolerances: Mapping[str, float]
    results: tuple[PartResult, ...]
    attempts: tuple[Attempt, ...]
    without: tuple[str, ...]
    trimmed: Scene
    trimmed_model: str
    verdict: Verdict

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trimmed scene (that is case.toml), as plain JSON types."""
        return {
            **{key: value for key, value in vars(self).items() if key not in ("results", "trimmed")},
            "tolerances": dict(self.tolerances),
            "verdict": list(self.verdict.all),
            "parts": [{**vars(r.part), **_plain(r)} for r in self.results],
            "attempts": [_plain(attempt) for attempt in self.attempts],
        }


def _plain(found: PartResult | Attempt) -> dict[str, Any]:
    cost = None if found.cost is None else asdict(found.cost)
    values = {key: value for key, value in vars(found).items() if key != "part"}
    return {**values, "cost": cost, "effects": [row.to_dict() for row in found.effects]}


def share(row: Row) -> tuple[float, float] | None:
    """Return the size of a change and its uncertainty over its limit, or None.

    The limit is the tolerance; without one the uncertainty.
    """
    size, width = row.difference.value, row.difference.deciding
    limit = row.tolerance if row.tolerance is not None else width
    return None if size is None or not limit else (abs(size) / limit, width / limit)


def worst_of(effects: Iterable[Row]) -> Row | None:
    """Return the effect that decides, None if none has a share of a limit.

    That is one of the judged, if there are any: those outside before the undecided, then the one that uses most of its
    limit.
    """
    effects = list(effects)
    ranks = {"outside": 2, "undecided": 1}
    judged = [row for row in effects if row.tolerance is not None] or effects
    shares = [(ranks.get(row.verdict, 0), sum(used), row) for row in judged if (used := share(row)) is not None]
    return max(shares, key=lambda item: item[:2])[2] if shares else None
