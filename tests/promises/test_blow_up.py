"""Small files that ask for much: each is refused at once, in a child process with 1 GiB and 20 s of processor time."""

from __future__ import annotations

import io
import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from children import bounded

from kncal.scene.case_text import find_case

pytestmark = pytest.mark.slow

SINGLE = find_case("wall_impact")
BED = find_case("bubbling_bed_mini")


def test_case_files(tmp_path: Path) -> None:
    """Nesting, numbers of keys, and huge counts and times; what is refused names the key, and what is wrong."""
    half = 120_000
    texts = {
        "dotted": "a." * half + "a = 1\n",
        "header": "[" + "a." * half + "a]\n",
        "inline": "x = {" + "a.b.c.d = {" * 50 + "}" * 51,
        "arrays": "a = " + "[" * half,
        "keys": "".join(f"k{i} = 1\n" for i in range(26_000)),
        "integer": "gravity = [0, 0, " + "9" * 200_000 + "]",
        "large": "#" * (256 * 1024 + 1),
        "tables": "[[particles]]\n" * 18_000,
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text)
    lines = bounded(f"""
        for name in {list(texts)!r}:
            attempt(lambda: kncal.scene.case_file.load_case(Path({str(tmp_path)!r}, name + ".toml")))
    """)
    assert len(lines) == len(texts)
    assert all(line.startswith("CaseFileError") for line in lines), lines


def test_times_and_steps() -> None:
    """Every time of a case from the smallest to the largest number: planned, or refused by kncal."""
    values = ["1e308", "1e200", "1e15", "1e-15", "1e-200", "5e-324"]
    lines = bounded(f"""
        import tomllib
        for value in ({", ".join(values)}):
            for key in ("until_time", "dt"):
                tables = tomllib.loads(Path({str(SINGLE)!r}).read_text())
                tables["run"] = {{"until_time": 1e-4}} | {{key: value}}
                attempt(lambda: kncal.scene.plan.plan(kncal.scene.case_file.parse_case("", name="x", tables=tables)))
            for key in ("until_time", "coupling", "frames_every", "gas_step", "discard"):
                tables = tomllib.loads(Path({str(BED)!r}).read_text())
                tables["run"][key] = value
                attempt(lambda: plan(parse_case("", name="x", tables=tables)))
    """)
    assert len(lines) == 7 * len(values)
    for i, value in enumerate(values):
        refused = [line.startswith("CaseFileError") for line in lines[7 * i : 7 * i + 7]]
        # long ends need too many steps, and so do short steps; the longest step is one step
        assert all(refused[k] for k in ((0, 2) if i < 3 else (1, 3, 5))), (value, lines[7 * i : 7 * i + 7])


def test_counts() -> None:
    lines = bounded(f"""
        import tomllib
        def bed(table, key, value):
            tables = tomllib.loads(Path({str(BED)!r}).read_text())
            (tables["particles"]["beads"] if table == "beads" else tables[table])[key] = value
            attempt(lambda: plan(parse_case("", name="x", tables=tables)))
        bed("beads", "count", 10**6 + 1)
        bed("beads", "count", 10**30)
        bed("gas", "cells", [10_000, 10_000, 10_000])
        bed("gas", "ramp", [[float(i), 1.0] for i in range(1001)])
        bed("run", "frames_every", 1e-9)
        tables = tomllib.loads(Path({str(SINGLE)!r}).read_text())
        tables["particles"] = {{f"p{{i}}": one for one in tables["particles"].values() for i in range(101)}}
        attempt(lambda: kncal.scene.case_file.parse_case("", name="x", tables=tables))
    """)
    assert all(line.startswith("CaseFileError") for line in [*lines[:4], lines[5]]), lines
    assert "expected at most 1000000" in lines[2]
    # the mini bed's couplings all recorded: 20 B x cells + 24 B x particles each are few
    assert lines[4].startswith(("accepted", "CaseFileError"))


def test_frames_that_would_fill_the_disk_are_refused() -> None:
    """1e5 couplings, all recorded, of 1e5 cells: 20 B x 1e10 = 200 GB."""
    (line,) = bounded(f"""
        import tomllib
        tables = tomllib.loads(Path({str(BED)!r}).read_text())
        tables["gas"]["cells"] = [100, 10, 100]
        tables["run"] |= {{"until_time": 50.0, "frames_every": 1e-9}}
        attempt(lambda: plan(parse_case("", name="x", tables=tables)))
    """)
    assert re.match(r"CaseFileError .* frames of .*run.frames_every", line)


def test_many_bodies_are_planned() -> None:
    """The impact speed is looked for once, not once for each of the n² pairs."""
    particles = "".join(
        f'[particles.p{i}]\nmaterial = "m"\ndiameter = 1e-3\n'
        f"position = [{2e-3 * (i % 10)}, {2e-3 * (i // 10)}, 0.0]\nvelocity = [{float((-1) ** i)}, 0.0, 0.0]\n"
        for i in range(60)
    )
    pairs = '[[contact.pairs]]\nbetween = ["p58", "p59"]\ne_n = 0.5\n' * 200
    head = "[materials.m]\nyoung = 5e6\npoisson = 0.3\ndensity = 2500.0\n"
    text = f"{head}{particles}[contact]\n{pairs}[run]\nuntil_time = 1e-4\n"
    (line,) = bounded(f"attempt(lambda: kncal.scene.plan.plan(kncal.scene.case_file.parse_case({text!r}, name='x')))")
    assert line == "accepted"


def npz(**arrays: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)
    return out.getvalue()


def claimed(shape: str, kind: str = "<f8") -> bytes:
    """The header of an array of that shape, without the array."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def test_results_of_runs(tmp_path: Path) -> None:
    """Files that a stranger's run folder may hold: each claims, or would unpack to, far more than it is."""
    header = "FoamFile { version 2.0; format binary; class %s; object p; }\n"
    frame = "ITEM: TIMESTEP\n{}\nITEM: NUMBER OF ATOMS\n{}\nITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\nITEM: ATOMS {}\n"
    wide = "".join(f"Step c{i}_{' d'.join(map(str, range(150)))}\n{'1 ' * 151}\n" for i in range(900))
    files = {
        "bomb.npz": npz(rows=claimed("(25000000,)") + bytes(2 * 10**8)),
        "claim.npz": npz(rows=claimed("(100000000000000,)")),
        "object.npz": npz(rows=claimed("(1,)", "|O")),
        "step.dump": frame.format("9" * 5000, 1, "id") + "1\n",
        "step64.dump": frame.format("9" * 25, 1, "id") + "1\n",
        "rows.dump": frame.format(1, 10**17, "id") + "1\n",
        "columns.dump": frame.format(1, 0, " ".join(f"c{i}" for i in range(100_000))),
        "wide.log": wide,
        "many.log": "Step a\n1 1\nStep b\n1 1\n" * 50_000,
        "errors.log": "ERROR\n" * 1_000_000,
        "deep.json": "[" * 10**6,
        "digits.json": '{"a": ' + "1" * 10_000 + "}",
        "infinite.json": '{"a": 1e999}',
        "deep.foam": header % "volScalarField" + "a {" * 100_000,
        "comments.foam": header % "volScalarField" + "/* ;" * 250_000,
        "endless.foam": ";" + header % "volScalarField" + "internalField nonuniform List<scalar> 0(",
        "uniform.foam": header % "scalarField" + "9999999999{1}",
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    readers = {
        ".npz": "lambda path: kncal.core.arrays.read_npz(path, 1 << 30)",
        ".dump": "kncal.record.liggghts_dump.read_dump",
        ".log": "kncal.record.liggghts_log.read_log",
        ".json": "kncal.core.files.read_json",
        ".foam": "lambda path: kncal.record.openfoam.read_cells(path, 10)",
    }
    table = ", ".join(f"{suffix!r}: {code}" for suffix, code in readers.items())
    lines = bounded(f"""
        readers = {{{table}}}
        for name in {list(files)!r}:
            path = Path({str(tmp_path)!r}, name)
            attempt(lambda: readers[path.suffix](path))
    """)
    found = dict(zip(files, lines, strict=True))
    for name in ("errors.log", "wide.log", "many.log"):  # of which 20 errors and the last line are kept
        assert found.pop(name) == "accepted"
    assert all(line.startswith("ReadError") for line in found.values()), found


def test_devices_and_pipes_are_no_files(tmp_path: Path) -> None:
    """A link to /dev/zero has no size and never ends; a pipe that nobody writes to never begins."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    lines = bounded(f"""
        for name in ("pipe", "zero"):
            path = Path({str(tmp_path)!r}, name)
            attempt(lambda: kncal.record.liggghts_dump.read_dump(path))
            attempt(lambda: kncal.record.liggghts_log.read_log(path))
            attempt(lambda: kncal.core.files.read_json(path))
            attempt(lambda: kncal.record.openfoam.read_field(path))
            attempt(lambda: kncal.scene.meshes.read_mesh(path))
            attempt(lambda: kncal.core.arrays.read_npz(path, 1 << 30))
            attempt(lambda: kncal.scene.case_file.load_case(path))
    """)
    assert len(lines) == 14
    assert all(line.startswith(("ReadError", "CaseFileError")) for line in lines), lines


def test_what_numpy_writes_reads_back(tmp_path: Path) -> None:
    from kncal.core.arrays import read_npz

    arrays = {
        "rows": np.arange(12.0).reshape(3, 4),
        "empty": np.empty((0, 5, 2), np.float32),
        "counts": np.arange(5),
        "scalar": np.array(2.5),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "flags": np.array([True, False]),
    }
    np.savez(tmp_path / "a.npz", **arrays)
    found = read_npz(tmp_path / "a.npz", 10**6)
    assert found.keys() == arrays.keys()
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
