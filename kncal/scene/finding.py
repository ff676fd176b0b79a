"""A limit that a scene or a bed runs into, found before anything starts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from kncal.core.errors import CaseFileError


@dataclass(frozen=True)
class Finding:
    """One limit.

    Attributes
    ----------
    code : short stable name, e.g. "cell-size"
    level : "refuse" (a run would be meaningless or fail) or "warn"
    message : one sentence: what, how much, what was expected, what to do
    """

    code: str
    level: Literal["refuse", "warn"]
    message: str

    def __str__(self) -> str:
        """Return the message with its level."""
        return f"{self.level}: {self.message}"


def require_possible(findings: Iterable[Finding]) -> None:
    """Raise `CaseFileError` with the refusals among ``findings``, if there are any."""
    refused = dict.fromkeys(finding.message for finding in findings if finding.level == "refuse")
    if refused:
        raise CaseFileError("\n".join(refused))
