"""Damaged and invented files: a value or a KncalError, never another exception, in bounded time and memory.

Each example takes a whole file that kncal or a solver wrote and damages it in a few places, with pieces of its own
grammar, numbers at the ends of their range, and bytes.
"""

from __future__ import annotations

import json
import tomllib
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bed_runs import facts
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.arrays import read_npz
from kncal.core.errors import KncalError
from kncal.core.files import read_json
from kncal.record import liggghts_dump, liggghts_log, openfoam
from kncal.record.series import read_series
from kncal.record.steps import ParticleState
from kncal.runs.folder import read_manifest, read_result
from kncal.scene.case_file import load_case, parse_case, shipped_cases
from kncal.scene.case_text import find_case
from kncal.scene.particle_files import read_particles
from kncal.scene.plan import plan
from kncal.scene.sizes import Sieve, Sizes, classes
from tests.promises.fuzz.conftest import fuzzed, in_time

pytestmark = pytest.mark.slow

NUMBERS = [
    b"0", b"-1", b"1e308", b"-1e308", b"1e999", b"5e-324", b"nan", b"inf", b"-inf", b"99999999999999999999",
    b"1" * 5000, b"0x1p3", b"1_0", b"1.", b".5", b"1,5", b"\xd9\xa3", b"4294967296", b"2147483648", b"-0.0", b"1e-308",
]  # fmt: skip
NOISE = [
    b"", b"\x00", b"\xff\xfe", b"\n", b"\r\n", b"\r", b"\n\n", b" ", b"\t", b"\xe2\x80\xa8", b"\x1b[2J", b'"', b"'",
    b"{", b"}", b"[", b"]", b"(", b")", b";", b"#", b"//", b"/*", b"*/", b"=", b".", b",", b"[[", b"a" * 5000,
    b"(" * 3000, b"{a " * 200, b"[" * 3000, b"$x", b"#calc", b"\x85", b"\x1c", b"\xc2\xa0",
]  # fmt: skip


def damaged(good: bytes, *pieces: bytes) -> st.SearchStrategy[bytes]:
    """The file with up to five places replaced, removed, doubled or cut, by pieces of its own and foreign ones."""
    own = sorted({word for word in good[:20_000].split() if len(word) < 60})[:300]
    piece = st.one_of(
        st.sampled_from([*pieces, *NUMBERS, *NOISE]), st.sampled_from(own or [b""]), st.binary(max_size=12)
    )
    # most damage near the start, where headers are
    place = st.one_of(st.integers(0, len(good)), st.integers(0, min(300, len(good))))
    change = st.tuples(place, st.integers(0, 60), piece, st.sampled_from(["put", "word", "twice", "cut"]))

    def apply(changes: list[tuple[int, int, bytes, str]]) -> bytes:
        data = good
        for at, length, what, how in changes:
            if how == "word":  # a whole word: what a grammar looks at
                end = at
                while end < len(data) and data[end : end + 1] not in b' \n\t;,()[]{}"':
                    end += 1
                data = data[:at] + what + data[end:]
            elif how == "put":
                data = data[:at] + what + data[at + length :]
            elif how == "twice":
                data = data[: at + length] + data[at:]
            else:
                data = data[:at] + what
        return data[:200_000]

    return st.lists(change, min_size=1, max_size=5).map(apply)


def only_ours(what: Callable[[], object]) -> None:
    """Call it; a KncalError with a text is as good as a value."""
    with in_time(), warnings.catch_warnings():
        # numbers at the ends of their range may overflow on the way to a refusal
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            what()
        except KncalError as error:
            assert str(error)
            assert len(str(error)) < 5000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def keep(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


CASES = st.sampled_from([find_case(name).read_bytes() for name in shipped_cases()]).flatmap(
    lambda good: damaged(
        good, b"[walls]", b"[[particles]]", b"[walls.column]", b"[column]", b"young", b"true", b'"rigid"', b"1979-05-27"
    )
)


@fuzzed(short=200)
@given(data=CASES)
def test_case_files(folder: Path, data: bytes) -> None:
    only_ours(lambda: load_case(keep(folder / "fuzz.toml", data)))


def leaves(tables: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of the single values of a case."""
    if isinstance(tables, dict | list):
        items = tables.items() if isinstance(tables, dict) else enumerate(tables)
        return [leaf for key, value in items for leaf in leaves(value, (*path, key))]
    return [path]


FLOATS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([0.0, 1.0, 1e308, 1e-308, 5e-324, 1e20, 1e-20, 1e6, 1e-6, 0.5, 10.0, 1, 0, 2, 1000, 10**20]),
)
CHANGES = st.lists(st.tuples(st.integers(0, 200), FLOATS), min_size=1, max_size=3)


@fuzzed(share=0.2, short=60)
@given(
    name=st.sampled_from([n for n in shipped_cases() if "sscp" not in n and "goldschmidt" not in n]), changes=CHANGES
)
def test_numbers_of_cases_up_to_the_plan(name: str, changes: list[tuple[int, float]]) -> None:
    """Any number in the place of any number: refused by its range, or planned."""
    text = find_case(name).read_text()
    tables = tomllib.loads(text)
    for index, value in changes:
        *way, last = leaves(tables)[index % len(leaves(tables))]
        here = tables
        for key in way:
            here = here[key]
        here[last] = value

    only_ours(lambda: plan(parse_case(text, name="fuzz", tables=tables)))


COLUMNS = b"ITEM: ATOMS id type x y z vx vy vz omegax omegay omegaz fx fy fz "
DUMP = b"".join(
    b"ITEM: TIMESTEP\n%d\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\n" % step
    + COLUMNS
    + b"\n"
    + b"".join(b"%d 1 " % i + b" ".join(b"%.17g" % (0.1 * k * i + step) for k in range(12)) + b" \n" for i in (1, 2))
    for step in (0, 10, 20)
)


PARTICLES = {
    "csv": b"x,y,z,diameter,vx,vy,vz,id\n" + b"".join(b"0.1,0.2,%d,2e-3,1,0,-1.5,%d\n" % (i, i) for i in range(4)),
    "dump": DUMP,
    "data": b"title\n\n2 atoms\n1 atom types\n0 1 xlo xhi\n0 1 ylo yhi\n0 1 zlo zhi\n\nAtoms\n\n1 1 2e-3 2500 0 0 0\n"
    b"2 1 2e-3 2500 0 0 1\n\nVelocities\n\n1 0 0 1 0 0 0\n2 0 0 1 0 0 0\n",
}


@fuzzed(short=150)
@given(
    data=st.sampled_from(sorted(PARTICLES)).flatmap(lambda kind: damaged(PARTICLES[kind], b"Atoms\n", b"ITEM: ATOMS"))
)
def test_files_of_particles(folder: Path, data: bytes) -> None:
    path = keep(folder / "fuzz.txt", data)
    only_ours(lambda: read_particles(path).classes(0.02, 0.5))


@fuzzed(short=100)
@given(data=damaged(b"mesh,passing\n1,0\n1.5,50\n2,100\n", b"mesh", b"1e-9", b"100"))
def test_sieve_curves(folder: Path, data: bytes) -> None:
    path = keep(folder / "fuzz.csv", data)
    only_ours(lambda: classes(Sizes(sieve=Sieve(file=str(path), scale=1e-3))))


@fuzzed(short=250)
@given(data=damaged(DUMP, b"ITEM: TIMESTEP\n", b"ITEM: ATOMS", b"ITEM: NUMBER OF ENTRIES\n", b"id", b"step"))
def test_dumps(folder: Path, data: bytes) -> None:
    path = keep(folder / "fuzz.dump", data)
    only_ours(lambda: liggghts_dump.read_dump(path))
    only_ours(lambda: liggghts_dump.read_trajectory(path, ("a", "b"), (1.0, 1.0), 1e-6))


LOG = b"""LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled)
Setting up run ...
Step Atoms KinEng
0 1 0.5
100 1 0.25
Loop time of 0.001 on 1 procs for 100 steps with 1 atoms
WARNING: one
Step Atoms KinEng c_a
200 1 0.1 3
Loop time of 0.002 on 1 procs for 100 steps with 1 atoms
KNCAL_DONE
"""


@fuzzed(short=250)
@given(data=damaged(LOG, b"Step", b"ERROR", b"Loop time of nan on 1 procs for 1 steps", b"Step " + b"a " * 3000))
def test_logs(folder: Path, data: bytes) -> None:
    log = []
    path = keep(folder / "fuzz.log", data)
    only_ours(lambda: log.append(liggghts_log.read_log(path)))
    only_ours(lambda: openfoam.fatal_error(path))
    for line in data.decode("latin-1").splitlines():
        liggghts_log.step_of_line(line)
    assert all(text.isprintable() or "\t" in text for found in log for text in found.errors)


RESULT = json.dumps(
    {
        "status": "completed", "engine": "liggghts", "model": "linear", "folder": "linear", "steps": 100, "dt": 1e-6,
        "cpu_seconds": 0.5, "wall_seconds": 0.6, "version": "3.8.0", "returncode": 0, "message": "", "log": "log",
        "extra": {"cpu_samples": [0.5]}, "files_sha256": {"particles.dump": "0" * 64}, "ended": "2026-01-01",
    },
    indent=1,
).encode()  # fmt: skip
MANIFEST = json.dumps(
    {
        "kncal": "0.1.0", "case": "x", "case_sha256": "0" * 64, "model": "linear", "engine": "liggghts",
        "solver": {"program": "/usr/bin/liggghts", "version": "3.8.0", "sha256": "", "warning": ""}, "command": ["a"],
        "environment": {"PATH": "/usr/bin"}, "python": "3.11", "platform": "Linux", "dt": 1e-6, "steps": 100,
        "t_end": 1e-4, "contacts": {"a–b": {"k": 1.0}}, "files_sha256": {"in": "0" * 64}, "rendered": "2026-01-01",
    },
    indent=1,
).encode()  # fmt: skip


@fuzzed(short=200)
@given(result=damaged(RESULT, b"null", b"true", b"NaN", b"{}"), manifest=damaged(MANIFEST, b"null", b"true", b"[]"))
def test_records(folder: Path, result: bytes, manifest: bytes) -> None:
    keep(folder / "result.json", result)
    keep(folder / "manifest.json", manifest)
    only_ours(lambda: read_json(folder / "result.json"))
    only_ours(lambda: read_result(folder))
    only_ours(lambda: read_manifest(folder))


HEAD = b'FoamFile { version 2.0; format binary; class %s; arch "LSB;label=32;scalar=64"; object p; }\n'
FIELD = (
    HEAD % b"volScalarField"
    + b"dimensions [0 2 -2 0 0 0 0];\ninternalField nonuniform List<scalar> 3("
    + np.arange(3.0).tobytes()
    + b");\nboundaryField\n{\n inlet { type fixedValue; value uniform 2.5; }\n /* c */ // d\n"
    + b" outlet { type x; value nonuniform List<vector> 1("
    + np.arange(3.0).tobytes()
    + b"); }\n walls { type slip; value nonuniform List<scalar> 0(); gradient nonuniform List<scalar> 3{1}; }\n}\n"
)
LIST = HEAD % b"labelField" + b"3(" + np.arange(3, dtype="<i4").tobytes() + b")\n"
GRAMMAR = (
    b"nonuniform List<scalar> 9999999999{1}", b"uniform", b"nonuniform List<tensor> 1000000{1 2 3 4 5 6 7 8 9}",
    b"nonuniform List<label> 2{1e99}", b"nonuniform List<scalar> 0(", b"boundaryField 1;", b"a { ", b"format ascii;",
    b"class vectorField;", b"uniform (1 2 3);", b"FoamFile {", b"internalField uniform (nan 1);", b"value uniform ();",
)  # fmt: skip


@fuzzed(short=250)
@given(field=damaged(FIELD, *GRAMMAR), numbers=damaged(LIST, *GRAMMAR, b"3{1}", b"3{nan}"))
def test_openfoam_files(folder: Path, field: bytes, numbers: bytes) -> None:
    path = keep(folder / "p", field)
    only_ours(lambda: openfoam.read_field(path))
    only_ours(lambda: openfoam.read_cells(path, 3))
    only_ours(lambda: openfoam.read_patch(path, "inlet", 4))
    only_ours(lambda: openfoam.read_patch(path, "outlet", 1))
    only_ours(lambda: openfoam.refuse_code(path))
    only_ours(lambda: openfoam.set_patch_vector(path, "inlet", "value", (0.0, 0.0, 1.0)))
    only_ours(lambda: openfoam.read_list(keep(folder / "list", numbers)))


FACTS = facts(
    size=(1.0, 1.0, 1.0), cells=(1, 1, 2), count=2, diameter=0.1, histogram_edges=(0.0, 0.5, 1.0), walls=("floor",)
)


def piece(folder: Path) -> bytes:
    good = folder / "good" / "piece-00000.npz"
    if not good.exists():
        from kncal.record.series import SeriesWriter

        state = ParticleState.at_rest(np.full((2, 3), 0.5))
        with SeriesWriter(good.parent, FACTS) as writer:
            writer.add(1, 0.5, None, None, state)
            writer.frame(1, state, None)
            writer.add(2, 0.5, None, None, state)
    return good.read_bytes()


@pytest.fixture(scope="module")
def series(folder: Path) -> Path:
    where = folder / "series"
    where.mkdir()
    return where


def test_the_series_to_damage_is_good(folder: Path, series: Path) -> None:
    keep(series / "piece-00000.npz", piece(folder))
    keep(series / "facts.json", json.dumps(asdict(FACTS)).encode())
    found = read_series(series)
    assert len(found.t) == 2 and found.x[0].shape == (2, 3)


@fuzzed(short=200)
@given(data=st.data())
def test_series(folder: Path, series: Path, data: st.DataObject) -> None:
    good = piece(folder)
    about = json.dumps(asdict(FACTS)).encode()
    arrays = data.draw(damaged(good, b"PK\x05\x06", b"'shape': (9999999999,)", b"'descr': '|O'", b"True", b"<f4"))
    keep(series / "piece-00000.npz", arrays)
    keep(series / "facts.json", data.draw(st.one_of(st.just(about), damaged(about, b"null", b"[]", b'"x"'))))
    only_ours(lambda: np.asarray(read_series(series).x))
    only_ours(lambda: read_npz(series / "piece-00000.npz", 1 << 20))
