"""What is stored of each case: contacts, steps, needs, limits and the numbers of the rendered files."""

from __future__ import annotations

import gzip
import json
import math
import re
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cases import generated, shipped

NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
OF_BEDS = ("steps_per_coupling", "coupling", "couplings", "frames_every", "gas_steps")
OF_FEW = ("t_end", "n_steps", "record_every", "flight_every")


@dataclass
class House:
    """How a checkout says what is asked; ``tables`` are those of a case file of the first format."""

    error: type[Exception]
    parse: Callable[[str, dict[str, Any]], Any]
    needs: Callable[[Any], Any]
    plan: Callable[[Any, str], Any]
    contacts: Callable[[Any], dict[tuple[str, str], Any]]
    check: Callable[[Any], Any]
    render: Callable[[Any, Any, Path], None]


def numbers_in(folder: Path) -> list[float]:
    found: set[float] = set()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix not in (".json", ".txt", ".md", ".data") and path.name != "Allrun":
            for line in path.read_text().split("\n"):
                found |= {float(m.group()) for m in NUMBER.finditer(line.split("#")[0].split("//")[0])}
    return sorted(found)


def plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else value


def numbers_of(house: House, name: str, tables: dict[str, Any]) -> dict[str, Any]:
    scene = house.parse(name, tables)
    needs = house.needs(scene)
    found: dict[str, Any] = {"needs": {row["physics"]: row["needed"] for row in needs.rows()}, "models": {}}
    for kind in ("linear", "hertz"):
        try:
            model = house.plan(scene, kind)
        except house.error as error:
            found["models"][kind] = {"refused": [float(x) for x in NUMBER.findall(str(error))]}
            continue
        about: dict[str, Any] = {"dt": model.dt, "contacts": {}}
        for names, contact in house.contacts(model).items():
            values = asdict(contact)
            about["contacts"]["|".join(names)] = values | {"warnings": sorted(values["warnings"])}
        about |= {key: getattr(model, key) for key in (OF_BEDS if "column" in tables else OF_FEW)}
        about["findings"] = sorted(
            [f.code, f.level, [float(x) for x in NUMBER.findall(f.message)]] for f in house.check(model)
        )
        with tempfile.TemporaryDirectory() as folder:
            try:
                house.render(model, needs, Path(folder))
                about["rendered"] = numbers_in(Path(folder))
            except house.error:
                about["rendered"] = "refused"
        found["models"][kind] = about
    return found


def store(house: House, root: Path, out: Path) -> None:
    found: dict[str, Any] = {}
    for name, tables in {**shipped(root), **generated()}.items():
        try:
            found[name] = numbers_of(house, name, tables)
        except house.error:
            found[name] = "refused"
        except Exception:
            traceback.print_exc()
            raise
    out.write_bytes(gzip.compress(json.dumps(plain(found)).encode()))
    print(len(found), "cases:", dict(Counter("refused" if v == "refused" else "stored" for v in found.values())))
