"""Normal-contact laws: one published law per file, and the registry that names them."""

from kncal.core.registry import Registry
from kncal.physics.laws.base import ContactLaw
from kncal.physics.laws.hertz import HERTZ
from kncal.physics.laws.hunt_crossley import HUNT_CROSSLEY
from kncal.physics.laws.kuwabara_kono import KUWABARA_KONO
from kncal.physics.laws.linear import LINEAR
from kncal.physics.laws.tsuji import TSUJI
from kncal.physics.laws.walton_braun import WALTON_BRAUN

#: The laws by name; packages add theirs by entry points of the group ``kncal.laws``.
LAWS = Registry(
    "law",
    ContactLaw,  # type: ignore[type-abstract]  # what makes one of its subclasses is not asked
    *(LINEAR, HERTZ, TSUJI, KUWABARA_KONO, HUNT_CROSSLEY, WALTON_BRAUN),
    group="kncal.laws",
)
