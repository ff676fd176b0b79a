"""The impact speeds of one run, read from its folder, and the stiffness that its case's method gives at them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kncal.core.errors import InputError
from kncal.observe.averages import window_start
from kncal.observe.impact_speeds import (
    Enduring,
    ImpactSpeeds,
    StiffnessAt,
    bed_impact_speeds,
    contact_impact_speeds,
    enduring,
    kinds_of_impacts,
    stiffness_at,
)
from kncal.observe.run_data import RunData
from kncal.physics.material import Pair
from kncal.runs.workflow import load
from kncal.scene.bodies import Particle
from kncal.scene.model import PairContact
from kncal.scene.pair_contact import PairNumbers
from kncal.scene.plan import pair_choice, pair_of, species_choices
from kncal.scene.scene import Scene

if TYPE_CHECKING:
    from kncal.scene.contact_event import ContactEvent

#: Key of the impacts of single contacts whose pairs are all alike.
ALL = "all"


@dataclass(frozen=True, kw_only=True)
class MetPair:
    """Two bodies that met in a run: what they are called, their pair, the case's numbers, the contact that ran."""

    names: tuple[str, str]
    both: Pair
    numbers: PairNumbers
    contact: PairContact


@dataclass(frozen=True, kw_only=True)
class RunSpeeds:
    """What one run says about impact speeds.

    Attributes
    ----------
    scene, model : of the run, model "linear" or "hertz"
    begin, end : of the time that counts [s]; of single contacts all of it
    speeds : "particles" and "walls" of a bed of one kind of particles, else the names of each pair of species ->
        ImpactSpeeds; of single contacts `ALL`, or, where pairs met that are not alike, the names of the first of each
        kind ("ball–floor"), in the order in which they met
    pairs : the same keys -> MetPair (of pairs that are alike the first that met)
    enduring : of a bed's contacts, or None
    """

    scene: Scene
    model: str
    begin: float
    end: float
    speeds: Mapping[str, ImpactSpeeds]
    pairs: Mapping[str, MetPair]
    enduring: Enduring | None

    @property
    def main(self) -> str:
        """The key of the impacts that a case is calibrated at: the first of ``speeds`` that were any."""
        return next((kind for kind, found in self.speeds.items() if found.count), next(iter(self.speeds)))

    def stiffness(self, kind: str) -> tuple[StiffnessAt, ...]:
        """Return k_n at the three speeds of one key of ``speeds``."""
        pair = self.pairs[kind]
        return stiffness_at(self.speeds[kind], self.scene.contact, pair.both, pair.numbers)

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "model": self.model,
            "begin": self.begin,
            "end": self.end,
            "enduring": None if self.enduring is None else asdict(self.enduring),
            "impacts": {
                kind: found.to_dict()
                | {
                    "between": list(self.pairs[kind].names),
                    "calibrated_at": {"v_0": self.pairs[kind].contact.v_0, "k_n": self.pairs[kind].numbers.k_n},
                    "k_n": [asdict(row) for row in self.stiffness(kind)],
                }
                for kind, found in self.speeds.items()
            },
        }


def run_speeds(folder: Path) -> RunSpeeds:
    """Return the impact speeds of the completed run in a model's folder, e.g. ``runs/wall_impact/linear``.

    Raises
    ------
    ReadError, RunError
        If there is no such run, or it did not complete.
    InputError
        If it has no record of impact speeds.
    """
    data = load(folder)
    try:
        return _of_contacts(data) if data.signals is None else _of_bed(data)
    except InputError as error:
        raise InputError(f"{folder}: {error}") from error


def _of_bed(data: RunData) -> RunSpeeds:
    scene, series, species = data.model.scene, data.series, data.model.species
    window = window_start(series, scene.run.discard)
    kinds = kinds_of_impacts(species)
    speeds = bed_impact_speeds(series, window.begin, window.doubt, kinds)
    pairs = {
        kind: MetPair(
            names=species.names(pair),
            both=pair_of(*species.bodies(pair)),
            numbers=pair_choice(scene, *species.bodies(pair)),
            contact=data.model.contacts[pair],
        )
        for kind, pair in kinds.items()
        if kind in speeds
    }
    own = [pair for pair in kinds.values() if isinstance(species.members[pair[1]][0], Particle)]
    return RunSpeeds(
        scene=scene,
        model=data.model.kind,
        begin=window.begin,
        end=float(series.t[-1]),
        speeds=speeds,
        pairs=pairs,
        enduring=enduring(series, window.begin, max(data.model.contacts[pair].t_c for pair in own)),
    )


def _of_contacts(data: RunData) -> RunSpeeds:
    scene, contacts = data.model.scene, [event for event in data.observations.contacts if event.v_in > 0.0]
    bodies = {(a.name, b.name): (a, b) for a, b in scene.body_pairs()}
    species, choices = data.model.species, species_choices(scene)
    alike: dict[tuple[object, ...], list[ContactEvent]] = {}
    for event in contacts:
        contact = data.model.between(*event.pair)
        like = (contact.m_eff, contact.R_eff, contact.E_eff, choices[species.pair_of(event.pair)])
        alike.setdefault(like, []).append(event)
    groups = list(alike.values()) or [[]]
    met = []
    for names in [group[0].pair for group in groups if group] or list(bodies)[:1]:
        a, b = bodies[names]
        numbers, contact = choices[species.pair_of(names)], data.model.between(*names)
        met.append(MetPair(names=names, both=pair_of(a, b), numbers=numbers, contact=contact))
    keys = [ALL] if len(met) == 1 else ["–".join(pair.names) for pair in met]
    return RunSpeeds(
        scene=scene,
        model=data.model.kind,
        begin=0.0,
        end=data.model.t_end,
        speeds={key: contact_impact_speeds(group) for key, group in zip(keys, groups, strict=True)},
        pairs=dict(zip(keys, met, strict=True)),
        enduring=None,
    )
