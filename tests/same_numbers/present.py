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
from kncal.scene.case_file import parse_case
from kncal.scene.limits import check
from kncal.scene.needs import decide
from kncal.scene.placement import lattice
from kncal.scene.plan import plan


#: What the bodies of a bed were called.
OLD = {"beads": "particles", "column": "walls"}


def present(tables):
    """Return the tables of a case of the first format in the present one."""
    new = {key: value for key, value in tables.items() if key not in ("particles", "walls", "column")}
    if "column" not in tables:
        for kind in ("particles", "walls"):
            rows = {row["name"]: {k: v for k, v in row.items() if k != "name"} for row in tables.get(kind, [])}
            new |= {kind: rows} if rows else {}
        return new
    column, beads, run = tables["column"], dict(tables["particles"]), dict(tables["run"])
    new["gravity"] = [0.0, 0.0, -tables.get("gravity", 9.81)]
    beads["place"] = beads.pop("packing", "settled")
    new["particles"] = {"beads": beads}
    size = [column["width"], column["depth"], column["height"]]
    box = {"shape": "box", "size": size, "material": column.get("wall_material", "rigid")}
    new["walls"] = {"column": box}
    match column.get("front_back", "walls"):
        case "periodic":
            new["periodic"] = ["y"]
        case "layer":
            new["layer"] = "y"
    if "gas" in tables:
        new["gas"] = {**tables["gas"], "cells": column["cells"], "walls": column.get("gas_walls", "slip")}
    run["until_time"] = run.pop("end_time")
    new["run"] = run
    if "contact" in tables:
        names = {old: name for name, old in OLD.items()}
        pairs = [
            {**pair, "between": [names.get(name, name) for name in pair["between"]]}
            for pair in tables["contact"].get("pairs", [])
        ]
        new["contact"] = {**tables["contact"], "pairs": pairs}
    return new


def contacts(model):
    if model.scene.coupled:
        return {tuple(OLD.get(name, name) for name in names): c for names, c in model.named.items()}
    return {(a.name, b.name): model.between(a.name, b.name) for a, b in model.scene.body_pairs()}


def render(model, needs, folder):
    if not model.scene.coupled:
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
    parse=lambda name, tables: parse_case("", name=name, tables=present(tables)),
    needs=decide,
    plan=lambda scene, kind: plan(scene, [kind])[kind],
    contacts=contacts,
    check=check,
    render=render,
)
store(HOUSE, Path(sys.argv[1]), Path(sys.argv[2]))
