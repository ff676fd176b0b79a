"""Which OpenFOAM this machine has."""

from __future__ import annotations

import os
from dataclasses import replace

from kncal.core.installed import Finding, ask_version


def look() -> Finding:
    """Start DPMFoam once and return what there is."""
    finding = ask_version(
        "DPMFoam",
        ["-help"],
        r"Using:\s+OpenFOAM\S*\s+\((\w+)\)[^\n]*(?:\nBuild:\s+(\S+))?",
        wanted="1912",
        title="OpenFOAM",
        needed_for="cases with gas; contact scenes do not need it",
        package="openfoam",
    )
    given = os.environ.get("WM_PROJECT_DIR")
    if finding.ok or not given:
        return finding
    # The usual reason: without the settings in that folder none of its programs starts.
    return replace(finding, hint=f"unset WM_PROJECT_DIR (it is {given}), or: {finding.hint}")
