"""``kncal adapter``: the library that OpenFOAM loads for the live transport."""

from __future__ import annotations

from cyclopts import App

from kncal.cli import show

adapter = App(name="adapter", help="The adapter of the live transport: a small library for OpenFOAM, built here once.")


@adapter.command
def build() -> None:
    """Build the adapter against the headers of this machine's OpenFOAM (downloads its source package, 45 MB)."""
    from kncal.engines.dpmfoam.adapter_build import build as build_adapter

    show.say(f"adapter: {build_adapter(progress=show.say)}")


@adapter.command
def status() -> int:
    """Say whether the adapter is built; exit code 4 if not."""
    from kncal.engines.dpmfoam.adapter_build import find

    library = find()
    show.say(f"adapter: {library}" if library else "adapter: not built; build it: kncal adapter build")
    return 0 if library else 4
