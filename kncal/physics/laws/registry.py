"""The contact laws by name. A new law is one file and one entry here."""

from __future__ import annotations

from kncal.core.checks import one_of
from kncal.physics.laws.base import ContactLaw
from kncal.physics.laws.hertz import HERTZ
from kncal.physics.laws.hunt_crossley import HUNT_CROSSLEY
from kncal.physics.laws.kuwabara_kono import KUWABARA_KONO
from kncal.physics.laws.linear import LINEAR
from kncal.physics.laws.tsuji import TSUJI
from kncal.physics.laws.walton_braun import WALTON_BRAUN

#: name -> law
LAWS: dict[str, ContactLaw] = {
    law.name: law for law in (LINEAR, HERTZ, TSUJI, KUWABARA_KONO, HUNT_CROSSLEY, WALTON_BRAUN)
}


def get_law(name_or_law: str | ContactLaw) -> ContactLaw:
    """Return the law of a registry name, or a law object as it is.

    Raises
    ------
    InputError
        If it is neither.
    """
    if isinstance(name_or_law, ContactLaw):
        return name_or_law
    return LAWS[one_of("law", name_or_law, LAWS)]
