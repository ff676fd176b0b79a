"""How fast are dumps read? Few large frames and many tiny ones, next to the table parser alone on the same rows.

Run: .venv/bin/python tests/benchmarks/bench_dump_reader.py [rows]
CPU seconds of this process, the two readings of a file in turn, median of seven; 17 digits, and a blank at the end of
each row as LIGGGHTS writes it.
"""

from __future__ import annotations

import io
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from kncal.record.liggghts_dump import read_dump

HEAD = (
    "ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{atoms}\n"
    "ITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\nITEM: ATOMS {names}\n"
)


def write(path: Path, frames: int, atoms: int, columns: int) -> bytes:
    """Write a dump of random numbers; returns its rows without the headers."""
    rng = np.random.default_rng(1)
    names = "id type " + " ".join(f"c{i}" for i in range(columns - 2))
    rows = io.BytesIO()
    with path.open("w") as handle:
        for step in range(frames):
            numbers = rng.normal(size=(atoms, columns - 2))
            lines = [f"{i + 1} 1 " + " ".join(f"{x:.17g}" for x in row) for i, row in enumerate(numbers)]
            text = " \n".join(lines) + " \n"
            handle.write(HEAD.format(step=step, atoms=atoms, names=names) + text)
            rows.write(text.encode())
    return rows.getvalue()


def cpu(action: Callable[[], object]) -> float:
    start = time.process_time()
    action()
    return time.process_time() - start


def main() -> None:
    rows = int(float(sys.argv[1])) if len(sys.argv) > 1 else 1_000_000
    print(f"{'frames':>8} {'atoms':>8} {'columns':>8} {'MB':>6} {'read_dump':>10} {'parser':>8} {'ratio':>6}")
    for frames, columns in ((10, 8), (10, 14), (rows // 10, 14)):
        atoms = rows // frames
        with tempfile.TemporaryDirectory() as folder:
            path, plain = Path(folder) / "dump", Path(folder) / "rows"
            plain.write_bytes(write(path, frames, atoms, columns))
            pairs = [
                (
                    cpu(lambda p=path: read_dump(p)),
                    cpu(lambda p=plain, n=columns: pd.read_csv(p, sep=" ", header=None, usecols=range(n))),
                )
                for _ in range(7)
            ]
            size = path.stat().st_size / 1e6
        own, parser = (statistics.median(column) for column in zip(*pairs, strict=True))
        ratio = statistics.median(a / b for a, b in pairs)
        print(f"{frames:8d} {atoms:8d} {columns:8d} {size:6.0f} {own:10.2f} {parser:8.2f} {ratio:6.2f}")


if __name__ == "__main__":
    main()
