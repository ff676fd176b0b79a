"""present.py ROOT OUT: store the numbers of the present checkout; ROOT has the shipped cases in the first format."""

# ruff: noqa: E402, I001 - the path comes first
from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parent)]

from common import House, store
from kncal.core.errors import KncalError
from kncal.engines.dpmfoam.case import write_case
from kncal.engines.liggghts.batch import Liggghts
from kncal.engines.liggghts.deck import bed_deck, write_deck
from kncal.engines.base import gas_setup
from kncal.scene.bed_case_file import parse_bed
from kncal.scene.case_file import parse_case
from kncal.scene.limits import check
from kncal.scene.needs import decide
from kncal.scene.placement import lattice
from kncal.scene.plan import plan
from kncal.scene.scene import Scene


def contacts(model):
    if not isinstance(model.scene, Scene):
        return model.named
    return {(a.name, b.name): model.between(a.name, b.name) for a, b in model.scene.body_pairs()}


def render(model, needs, folder):
    if isinstance(model.scene, Scene):
        Liggghts().render(model, folder)
        return
    if needs.uses("liggghts"):
        (folder / "particles").mkdir()
        write_deck(bed_deck(model, lattice(model.scene)), folder / "particles")
    if (setup := gas_setup(model)) is not None:
        interval = model.frames_every * model.gas_steps
        write_case(setup, folder / "gas", end_time=model.couplings * model.coupling, write_interval=interval)


HOUSE = House(
    error=KncalError,
    parse=lambda name, tables: (parse_bed if "column" in tables else parse_case)("", name=name, tables=tables),
    needs=decide,
    plan=lambda scene, kind: plan(scene, [kind])[kind],
    contacts=contacts,
    check=check,
    render=render,
)
store(HOUSE, Path(sys.argv[1]), Path(sys.argv[2]))
