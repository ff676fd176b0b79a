"""compare.py A B: what differs between two stores by more than 1e-12, with a few examples of each sort.

    git worktree add ../first f1a589f
    python tests/same_numbers/first.py ../first first.json.gz
    python tests/same_numbers/present.py ../first present.json.gz
    python tests/same_numbers/compare.py first.json.gz present.json.gz

Adapt ``present.py`` where names move; where the format of cases does, it converts the tables of the first format.
"""

from __future__ import annotations

import gzip
import json
import math
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

differences: dict[str, list[tuple[Any, ...]]] = defaultdict(list)


def same(a: Any, b: Any) -> bool:
    both = isinstance(a, (int, float)) and isinstance(b, (int, float))
    return a == b or (both and math.isclose(a, b, rel_tol=1e-12, abs_tol=0.0))


def compare_models(where: tuple[str, str], a: dict[str, Any], b: dict[str, Any]) -> None:
    for key in sorted({*a, *b}):
        x, y = a.get(key), b.get(key)
        if key == "contacts" and x is not None and y is not None:
            for pair in sorted({*x, *y}):
                for name in {*x.get(pair, {}), *y.get(pair, {})}:
                    u, v = x.get(pair, {}).get(name), y.get(pair, {}).get(name)
                    if not same(u, v):
                        differences[f"contact {name}"].append((*where, pair, u, v))
        elif key == "rendered" and isinstance(x, list) and isinstance(y, list):
            for sort, these, those in (("rendered lost", x, y), ("rendered new", y, x)):
                if odd := [u for u in these if not any(same(u, v) for v in those)]:
                    differences[sort].append((*where, odd[:5]))
        elif not same(x, y):
            differences[key].append((*where, x, y))


def main() -> None:
    first, second = (json.loads(gzip.decompress(Path(path).read_bytes())) for path in sys.argv[1:3])
    for name in sorted({*first, *second}):
        a, b = first.get(name), second.get(name)
        if not (isinstance(a, dict) and isinstance(b, dict)):
            if a != b:
                differences["refused"].append((name, a, b))
            continue
        if a["needs"] != b["needs"]:
            differences["needs"].append((name, a["needs"], b["needs"]))
        for kind in a["models"]:
            compare_models((name, kind), a["models"][kind], b["models"][kind])
    for sort, found in differences.items():
        print(len(found), sort)
        for each in found[:4]:
            print("    ", *(str(part)[:120] for part in each))
    print("different" if differences else "same", f"({len(first)} cases)")


main()
