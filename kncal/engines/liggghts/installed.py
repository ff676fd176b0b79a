"""Which LIGGGHTS this machine has."""

from __future__ import annotations

from kncal.core.installed import Finding, ask_version

#: The version whose force laws, log and dumps kncal knows.
VERSION = "3.8.0"


def look() -> Finding:
    """Start LIGGGHTS once and return what there is."""
    # `-log none` keeps it from writing a log; an empty deck makes it print its banner and end.
    return ask_version(
        "liggghts",
        ["-log", "none"],
        r"Version LIGGGHTS-PUBLIC ([0-9][\w.]*)",
        wanted=VERSION,
        title="LIGGGHTS",
        needed_for="--engine liggghts (the engine builtin needs no solver)",
        package="liggghts",
    )
