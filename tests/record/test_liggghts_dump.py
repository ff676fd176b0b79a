"""Dumps: what was written comes back, to the last bit; what is damaged is refused, with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kncal.core.errors import InputError, KncalError, ReadError
from kncal.record.frames import Trajectory
from kncal.record.liggghts_dump import TRAJECTORY_COLUMNS, read_dump, read_trajectory, write_trajectory

FINITE = st.floats(allow_nan=False, allow_infinity=False)


def trajectory(frames: int, particles: int, values: np.ndarray, steps: np.ndarray, dt: float) -> Trajectory:
    parts = values.reshape(4, frames, particles, 3)
    return Trajectory(
        names=tuple(f"p{i}" for i in range(particles)),
        step=steps,
        t=steps * dt,
        x=parts[0],
        v=parts[1],
        spin=parts[2],
        force=parts[3],
        radius=np.full(particles, 1e-3),
    )


@st.composite
def trajectories(draw: st.DrawFn, elements: st.SearchStrategy[float] = FINITE) -> Trajectory:
    frames, particles = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    values = draw(hnp.arrays(np.float64, 12 * frames * particles, elements=elements))
    steps = np.cumsum(draw(hnp.arrays(np.int64, frames, elements=st.integers(1, 10**9))))
    return trajectory(frames, particles, values, steps, draw(st.floats(1e-12, 1.0)))


def frame(step: int, rows: list[str], columns: str = "id type x", item: str = "ATOMS") -> str:
    return (
        f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF {item}\n{len(rows)}\nITEM: BOX BOUNDS ff ff ff\n"
        f"-1 1\n-1 1\n-1 1\nITEM: {item} {columns} \n" + "".join(f"{row} \n" for row in rows)
    )


GOOD = frame(0, ["1 1 0.5", "2 1 -0.25"]) + frame(7, ["1 1 1e-3", "2 1 4"])


@pytest.fixture
def write(tmp_path: Path):
    def _write(text: str | bytes) -> Path:
        path = tmp_path / "a.dump"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return _write


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    a, b = (np.ascontiguousarray(c, dtype=np.float64).view(np.int64) for c in (a, b))
    return np.array_equal(a, b)


@given(trajectories())
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, given_one: Trajectory) -> None:
    path = tmp_path_factory.mktemp("dump") / "a.dump"
    write_trajectory(path, given_one, [1] * len(given_one.names))
    dt = given_one.t[0] / given_one.step[0]
    back = read_trajectory(path, given_one.names, given_one.radius, dt)
    assert back.names == given_one.names
    assert np.array_equal(back.step, given_one.step)
    assert np.array_equal(back.t, given_one.step * dt)
    for name in ("x", "v", "spin", "force", "radius"):
        assert same_bits(getattr(back, name), getattr(given_one, name)), name


@given(trajectories(st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1.7976931348623157e308])))
def test_values_that_are_not_finite_survive(tmp_path_factory: pytest.TempPathFactory, given_one: Trajectory) -> None:
    path = tmp_path_factory.mktemp("dump") / "a.dump"
    with np.errstate(over="ignore"):
        write_trajectory(path, given_one, [2] * len(given_one.names))
    table = read_dump(path)
    assert set(table["type"]) == {2}
    expected = np.concatenate([given_one.x, given_one.v, given_one.spin, given_one.force], axis=-1)
    np.testing.assert_array_equal(table[list(TRAJECTORY_COLUMNS[2:])].to_numpy(), expected.reshape(-1, 12))


@given(st.permutations(range(14)), st.permutations(range(3)), st.integers(0, 2**32 - 1))
def test_names_decide_not_places(
    tmp_path_factory: pytest.TempPathFactory, places: list[int], rows: list[int], seed: int
) -> None:
    """Columns and rows in any order give the same trajectory."""
    path = tmp_path_factory.mktemp("dump") / "a.dump"
    values = np.random.default_rng(seed).standard_normal((3, 12))
    table = [[str(i + 1), "1", *(repr(float(v)) for v in values[i])] for i in range(3)]
    lines = [" ".join(table[r][p] for p in places) for r in rows]
    path.write_text(frame(4, lines, " ".join(TRAJECTORY_COLUMNS[p] for p in places)))
    back = read_trajectory(path, ("a", "b", "c"), (1.0, 1.0, 1.0), 0.5)
    read = np.concatenate([back.x, back.v, back.spin, back.force], axis=-1)[0]
    assert same_bits(read, values)
    assert back.t.tolist() == [2.0]


def test_types_steps_and_order(write) -> None:
    table = read_dump(write(GOOD))
    assert list(table.columns) == ["step", "id", "type", "x"]
    assert [str(kind) for kind in table.dtypes] == ["int64", "int64", "int64", "float64"]
    assert table.to_numpy().tolist() == [[0, 1, 1, 0.5], [0, 2, 1, -0.25], [7, 1, 1, 1e-3], [7, 2, 1, 4]]


def test_integers_beyond_the_doubles(write) -> None:
    """Ids are not read by way of a double, and whole numbers in a float column stay floats."""
    table = read_dump(write(frame(0, [f"{2**53 + 1} 1 3"])))
    assert table["id"].tolist() == [2**53 + 1]
    assert table["x"].dtype == np.float64


def test_empty_frames(write) -> None:
    text = frame(0, []) + frame(5, ["1 1 2"]) + frame(9, [])
    assert read_dump(write(text))["step"].tolist() == [5]
    none = read_dump(write(frame(0, []) + frame(5, [])))
    assert none.empty
    assert list(none.columns) == ["step", "id", "type", "x"]
    assert [str(kind) for kind in none.dtypes] == ["int64", "int64", "int64", "float64"]


def many() -> list[str]:
    """Frames of three kinds in turn, more than are read at once: like the one before, longer, and empty ones."""
    rows = [["1 1 0.5", "2 1 -0.25"]] * 40 + [["1 1 1"] * 3] + [[]] * 60 + [["3 1 2"]] * 40
    return [frame(step, rows[step % len(rows)]) for step in range(9000)]


def test_frames_alike_and_others(write) -> None:
    frames = many()
    table = read_dump(write("".join(frames)))
    expected = [(step, *map(float, row.split())) for step, text in enumerate(frames) for row in text.split("\n")[9:-1]]
    assert table.to_numpy().tolist() == [list(row) for row in expected]


def test_empty_frames_of_more_than_is_read_at_once(write) -> None:
    text = "".join(frame(step, []) for step in range(9000)) + frame(10_000, ["1 1 2"])
    assert read_dump(write(text))["step"].tolist() == [10_000]


@pytest.mark.parametrize(("at", "damage"), [(8000, "TIMESTEX"), (77, "TIMESTEX"), (8005, "NUMBER OF ATOM\n")])
def test_a_bad_header_among_many_has_its_line(write, at: int, damage: str) -> None:
    frames = many()
    good, line = damage.replace("X", "P").replace("ATOM\n", "ATOMS\n"), 1 + "".join(frames[:at]).count("\n")
    frames[at] = frames[at].replace(good, damage)
    with pytest.raises(ReadError, match=rf"line {line if 'X' in damage else line + 2}: "):
        read_dump(write("".join(frames)))


def test_local_dump(write) -> None:
    text = frame(0, [], "c_p[1] c_p[2]", "ENTRIES") + frame(3, ["1 2.5e-6"], "c_p[1] c_p[2]", "ENTRIES")
    table = read_dump(write(text), kind="local")
    assert table.to_dict("list") == {"step": [3], "c_p[1]": [1.0], "c_p[2]": [2.5e-6]}
    with pytest.raises(ReadError, match="line 3: 'ITEM: NUMBER OF ENTRIES', expected 'ITEM: NUMBER OF ATOMS'"):
        read_dump(write(text))
    with pytest.raises(InputError, match="did you mean 'local'"):
        read_dump(write(text), kind="locals")


def test_blanks_of_any_width(write) -> None:
    """A deck's own format may pad its columns."""
    padded = GOOD.replace("1 1 0.5 ", "   1    1\t 0.5   ")
    assert read_dump(write(padded)).equals(read_dump(write(GOOD)))


DAMAGE = {
    "empty": ("", 1, "the file is empty"),
    "other text": ("hello\n", 1, "'hello', expected 'ITEM: TIMESTEP'"),
    "binary": (b"\x00\xff\x00\xff\n\x01", 1, "expected 'ITEM: TIMESTEP'"),
    "word": (GOOD.replace("-0.25", "x.25"), 11, "'x' = 'x.25', expected a number"),
    "comma": (GOOD.replace("-0.25", "-0,25"), 11, "'x' = '-0,25', expected a number"),
    "python number": (GOOD.replace("-0.25", "1_0"), 11, "expected a number"),
    "quoted": (GOOD.replace("-0.25", '"1"'), 11, "expected a number"),
    "not a value": (GOOD.replace("-0.25", "NA"), 11, "expected a number"),
    "id": (GOOD.replace("2 1 -0.25", "2.5 1 -0.25"), 11, "'id' = '2.5', expected an integer"),
    "nan id": (GOOD.replace("2 1 -0.25", "nan 1 -0.25"), 11, "'id' = 'nan', expected an integer"),
    "missing value": (GOOD.replace("2 1 -0.25", "2 1"), 11, "2 values, expected 3 (row 2 of 2 of step 0)"),
    "one value more": (GOOD.replace("2 1 -0.25", "2 1 0 9"), 11, "4 values, expected 3"),
    "first row longer": (GOOD.replace("1 1 0.5", "1 1 0.5 9"), 10, "4 values, expected 3"),
    "every row longer": (frame(0, ["1 1 1 1", "2 1 1 1"]), 10, "4 values, expected 3"),
    "two values more": (GOOD.replace("1 1 0.5", "1 1 0.5 9 9"), 10, "5 values, expected 3"),
    "row missing": (GOOD.replace("2 1 -0.25 \n", ""), 11, "2 values, expected 3"),
    "row too many": (GOOD.replace("2 1 -0.25 \n", "2 1 0 \n3 1 0 \n"), 12, "the number of rows above is wrong"),
    "blank line": (GOOD.replace("2 1 -0.25 \n", "\n2 1 -0.25 \n"), 11, "0 values, expected 3"),
    "count": (GOOD.replace("ATOMS\n2", "ATOMS\nx", 1), 4, "'x', expected a number of rows"),
    "step": (GOOD.replace("STEP\n7", "STEP\n7.5"), 13, "'7.5', expected a step number"),
    "box": (GOOD.replace("-1 1\n", "", 1), 8, "expected two bounds of the box"),
    "columns change": (
        frame(0, ["1 1 0", "2 1 0"]) + frame(7, ["1 1 1e-3", "2 1 4"], "id type y"),
        20,
        "columns 'id type y', expected those of frame 1: 'id type x'",
    ),
    "columns twice": (frame(0, ["1 1 0"], "id x x"), 9, "expected distinct names"),
    "no columns": (frame(0, [""], ""), 9, "expected distinct names"),
    "cut row": (GOOD[:-4], 22, "the file ends inside a frame"),
    "cut number": (GOOD[:-2], 22, "the file ends inside a frame"),
    "cut header": (GOOD + "ITEM: TIMES", 23, "the file ends inside a frame"),
    "rows missing at the end": (GOOD[: GOOD.rindex("2 1 4")], 22, "the file ends inside a frame"),
    "hole": (GOOD.replace("-0.25", "\0\0\0\0\0"), 11, "expected a number"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damage_is_refused_with_its_line(write, name: str) -> None:
    text, line, part = DAMAGE[name]
    path = write(text)
    with pytest.raises(ReadError) as caught:
        read_dump(path)
    assert str(caught.value).startswith(f"{path}, line {line}: ")
    assert part in str(caught.value)


def test_wrong_counts_that_add_up_are_refused(write) -> None:
    """One row too few in one frame and one too many in the next."""
    text = GOOD.replace("2 1 -0.25 \n", "").replace("1 1 1e-3 \n", "1 1 1e-3 \n3 1 0 \n")
    with pytest.raises(ReadError, match="line 11"):
        read_dump(write(text))


def test_every_cut_is_seen(write) -> None:
    """A file cut at any byte either ends at the border of two frames, or is refused."""
    border = GOOD.index("ITEM: TIMESTEP", 5)
    for cut in range(len(GOOD)):
        path = write(GOOD[:cut])
        if cut == border:
            assert read_dump(path)["step"].tolist() == [0, 0]
        else:
            with pytest.raises(ReadError, match="line"):
                read_dump(path)


@given(st.integers(0, len(GOOD) - 1), st.integers(0, 255))
def test_one_wrong_byte_never_raises_anything_else(
    tmp_path_factory: pytest.TempPathFactory, place: int, byte: int
) -> None:
    path = tmp_path_factory.mktemp("dump") / "a.dump"
    data = bytearray(GOOD.encode())
    data[place] = byte
    path.write_bytes(bytes(data))
    try:
        table = read_dump(path)
    except KncalError as error:
        assert str(path) in str(error)
    else:
        assert len(table) == 4  # a changed digit, blank or name


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        read_dump(tmp_path / "none.dump")


NUMBERS = " ".join(["0"] * 12)
FULL = " ".join(TRAJECTORY_COLUMNS)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (frame(0, [f"1 1 {NUMBERS}"], FULL), "line 1: step 0 holds 1 particles, expected 2"),
        (frame(0, [f"1 1 {NUMBERS}", f"1 1 {NUMBERS}"], FULL), r"line 1: step 0 holds ids \[1, 1\]"),
        (frame(0, [f"0 1 {NUMBERS}", f"1 1 {NUMBERS}"], FULL), r"line 1: step 0 holds ids \[0, 1\]"),
        (2 * frame(5, [f"1 1 {NUMBERS}", f"2 1 {NUMBERS}"], FULL), "line 1: step 5 holds 4 particles"),
        (
            "".join(frame(s, [f"1 1 {NUMBERS}", f"2 1 {NUMBERS}"], FULL) for s in (5, 9, 7)),
            "line 23: step 7 after 9",
        ),
        (
            frame(0, [f"1 1 {NUMBERS}", f"2 1 {NUMBERS}"], FULL) + frame(1, [f"2 1 {NUMBERS}"], FULL),
            "line 12: step 1 holds 1 particles",
        ),
        (frame(0, [], FULL), "no frame holds a particle"),
        (frame(0, ["1 1 0", "2 1 0"]), "no column y, z, vx"),
    ],
)
def test_trajectory_needs_every_particle_in_every_frame(write, text: str, part: str) -> None:
    with pytest.raises(ReadError, match=part):
        read_trajectory(write(text), ("a", "b"), (1.0, 1.0), 1e-6)


def test_trajectory_arguments(write) -> None:
    path = write(frame(0, [f"1 1 {NUMBERS}"], FULL))
    with pytest.raises(InputError, match="dt"):
        read_trajectory(path, ("a",), (1.0,), 0.0)
    with pytest.raises(InputError, match="radius"):
        read_trajectory(path, ("a",), (1.0, 2.0), 1.0)
    one = read_trajectory(path, ("a",), (1.0,), 1.0)
    with pytest.raises(InputError, match="types"):
        write_trajectory(path, one, [1, 1])
