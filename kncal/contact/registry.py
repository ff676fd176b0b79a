"""The contact laws by name. A new law is one file and one entry here."""

from __future__ import annotations

from kncal.checks import one_of
from kncal.contact.base import ContactLaw
from kncal.contact.hertz import HERTZ
from kncal.contact.hunt_crossley import HUNT_CROSSLEY
from kncal.contact.kuwabara_kono import KUWABARA_KONO
from kncal.contact.linear import LINEAR
from kncal.contact.tsuji import TSUJI
from kncal.contact.walton_braun import WALTON_BRAUN

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
