"""first.py ROOT OUT: store the numbers of a checkout whose modules are not in rooms yet (commit f1a589f)."""

# ruff: noqa: E402, I001 - the path comes first
from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [sys.argv[1], str(Path(__file__).parent)]

from common import House, store
from kncal.bed.case_file import parse_bed
from kncal.bed.limits import check_bed
from kncal.bed.needs import decide as decide_bed
from kncal.bed.packing import lattice
from kncal.bed.planning import plan_bed
from kncal.bed.scene import Scene
from kncal.case_file import parse_case
from kncal.coupling.dem_deck import write_deck
from kncal.coupling.gas_case import write_case
from kncal.coupling.loop import gas_setup
from kncal.engines.liggghts import Liggghts
from kncal.errors import KncalError
from kncal.needs import decide
from kncal.planning import plan
from kncal.scene_limits import check_scene


def bed(scene):
    return isinstance(scene, Scene)


def render(model, needs, folder):
    if not bed(model.scene):
        Liggghts().render(model, folder)
        return
    if needs.uses("liggghts"):
        (folder / "particles").mkdir()
        write_deck(model, folder / "particles", lattice(model.scene))
    if (setup := gas_setup(model)) is not None:
        interval = model.frames_every * model.gas_steps
        write_case(setup, folder / "gas", end_time=model.couplings * model.coupling, write_interval=interval)


HOUSE = House(
    error=KncalError,
    parse=lambda name, tables: (parse_bed if "column" in tables else parse_case)("", name=name, tables=tables),
    needs=lambda scene: (decide_bed if bed(scene) else decide)(scene),
    plan=lambda scene, kind: (plan_bed if bed(scene) else plan)(scene, [kind])[kind],
    contacts=lambda model: model.contacts,
    check=lambda model: (check_bed if bed(model.scene) else check_scene)(model),
    render=render,
)
store(HOUSE, Path(sys.argv[1]), Path(sys.argv[2]))
