"""Species: bodies that are alike in everything that their contacts depend on.

Two bodies are of one species if they have the same material and radius, and the same exceptions of the case name them.
A pair of species has one contact, so the cost of planning goes with species, not with bodies.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from kncal.scene.bodies import Body, Particle, Wall
from kncal.scene.scene import Scene

#: Two species by number, the first a species of particles and not the larger number.
SpeciesPair = tuple[int, int]
#: Names that a line of text holds before it says how many more there are.
_MOST_NAMES = 5


@dataclass(frozen=True)
class SpeciesTable:
    """The species of a scene: those of particles first, in the order of the case file.

    Attributes
    ----------
    members : bodies of each species
    index : body name -> number of its species, from 0
    stand_ins : whether each body stands for a whole group, of which any two may meet
    """

    members: tuple[tuple[Body, ...], ...]
    index: Mapping[str, int]
    stand_ins: bool = False

    def pair_of(self, names: tuple[str, str]) -> SpeciesPair:
        """Return the pair of species of two bodies."""
        i, j = sorted(self.index[name] for name in names)
        return i, j

    def pairs(self) -> Iterator[SpeciesPair]:
        """Every pair of species that can touch at all: of particles, also with themselves, and with walls."""
        for i, own in enumerate(self.members):
            if isinstance(own[0], Particle):
                yield from ((i, j) for j in range(i, len(self.members)))

    def bodies(self, pair: SpeciesPair) -> tuple[Particle, Body]:
        """Return two bodies that stand for a pair of species; one and the same if the species has no second."""
        i, j = pair
        one, other = self.members[i][0], self.members[j][1 if i == j and len(self.members[j]) > 1 else 0]
        assert isinstance(one, Particle)  # noqa: S101  # `pairs` and `pair_of` put particles first
        return one, other

    def names(self, pair: SpeciesPair) -> tuple[str, str]:
        """Return the names of the two bodies that stand for a pair of species."""
        one, other = self.bodies(pair)
        return one.name, other.name

    def meetings(self, pair: SpeciesPair) -> int:
        """Return how many pairs of bodies are of a pair of species (of groups: 1)."""
        if self.stand_ins:
            return 1
        i, j = pair
        n = len(self.members[i])
        return n * (n - 1) // 2 if i == j else n * len(self.members[j])

    def label(self, pair: SpeciesPair, names: tuple[str, str] | None = None) -> str:
        """Return a pair of species in words: two of its bodies (``names``, or the first), and how many are alike."""
        others = self.meetings(pair) - 1
        return "–".join(names or self.names(pair)) + (f" (and {others} alike)" if others > 0 else "")


def species_of(scene: Scene) -> SpeciesTable:
    """Return the species of a scene."""
    members: dict[object, list[Body]] = {}
    for body in scene.bodies:
        names = body.names
        named = tuple((one in names, two in names) for one, two in (choice.between for choice in scene.contact.pairs))
        radius = body.radius if isinstance(body, Particle) else None
        group = body.group if scene.coupled and isinstance(body, Particle) else ""  # to tell where each one is from
        members.setdefault((isinstance(body, Wall), body.material, radius, named, group), []).append(body)
    return SpeciesTable(
        members=tuple(tuple(bodies) for bodies in members.values()),
        index={body.name: number for number, bodies in enumerate(members.values()) for body in bodies},
        stand_ins=scene.coupled,
    )


def listed(names: Sequence[str]) -> str:
    """Return names with commas; of a long list the first few, and how many more there are."""
    more = len(names) - _MOST_NAMES
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:_MOST_NAMES])} and {more} more"
