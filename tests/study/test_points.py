"""Points of a sweep: every combination once, the sample in every slice once, what is wrong is named."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kncal.core.errors import InputError
from kncal.core.shipped import folder
from kncal.scene.case_file import load_case
from kncal.study.points import combine, grid_axis, parse_range, read_points, sample, split_values


def shown(points) -> list[str]:
    return [", ".join(map(str, point)) for point in points]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1,2,3", ["1", "2", "3"]),
        ("[10,2,30],[20,4,60]", ["[10,2,30]", "[20,4,60]"]),
        ("[[0, 0.1], [1, 0.5]],[[0, 0.2]]", ["[[0, 0.1], [1, 0.5]]", "[[0, 0.2]]"]),
        ('"a,b",c', ['"a,b"', "c"]),
        ('"a\\",b",c', ['"a\\",b"', "c"]),
        ("5", ["5"]),
    ],
)
def test_commas_in_brackets_and_quotes_separate_nothing(text: str, values: list[str]) -> None:
    assert split_values(text) == values


@given(st.lists(st.lists(st.integers(-9, 9), min_size=1, max_size=3), min_size=1, max_size=4))
def test_lists_come_back_from_their_text(lists: list[list[int]]) -> None:
    points = grid_axis("x.y=" + ",".join(map(str, lists)))
    assert [point[0].value for point in points] == lists


def test_a_grid_is_the_product_and_its_points_do_not_depend_on_the_order_of_the_flags() -> None:
    one, two = grid_axis("contact.k_n=500,1000,2000"), grid_axis("run.steps_per_contact=10,20")
    points = combine([one, two])
    expected = set(itertools.product((500, 1000, 2000), (10, 20)))
    assert {tuple(o.value for o in p) for p in points} == expected
    assert len(points) == 6
    assert set(shown(points)) == set(shown(combine([two, one])))


@pytest.mark.parametrize("text", ["contact.k_n", "contact.k_n=", "contact.k_n=500,,1000", "=5", "a b=5", "x=1,[2"])
def test_what_is_no_axis_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="expected"):
        grid_axis(text)


def test_a_key_varied_twice_and_too_many_points_are_refused() -> None:
    with pytest.raises(InputError, match=r"run\.dt: varied twice"):
        combine([grid_axis("run.dt=1,2"), grid_axis("run.dt=3")])
    axis = grid_axis("a=" + ",".join(map(str, range(400))))
    other = grid_axis("b=" + ",".join(map(str, range(400))))
    with pytest.raises(InputError, match="160000 points: expected at most 100000"):
        combine([axis, other])
    with pytest.raises(InputError, match="nothing to vary"):
        combine([])


# --- files ------------------------------------------------------------------------------------------------------------


def test_rows_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(b'\xef\xbb\xbfcontact.k_n, gas.cells,contact.law\r\n500,"[10,2,30]",hertz\r\n\r\n1000,,\r\n')
    assert shown(read_points(path)) == [
        'contact.k_n = 500, gas.cells = [10, 2, 30], contact.law = "hertz"',
        "contact.k_n = 1000",
    ]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "empty"),
        (b"contact.k_n\n", "no row"),
        (b"a,b\n1,2\n3\n", r"line 3: 1 cells, expected 2"),
        (b"a,b\n1,2 m\n", r"line 2: .*no TOML value"),
        (b"a\n\xff\n", "byte 2 is not UTF-8"),
        (b'a\n"1\n', "line 2"),
        (b"a,\n1,2\n", r"line 2: .*expected KEY=VALUE"),
    ],
)
def test_a_file_that_is_none_is_refused_with_its_line(tmp_path: Path, data: bytes, said: str) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(data)
    with pytest.raises(InputError, match=said) as error:
        read_points(path)
    assert str(path) in str(error.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_points(tmp_path / "points.csv")


# --- samples ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 7, 100])
def test_each_slice_of_each_range_holds_one_point(number: int) -> None:
    """The definition of a Latin hypercube; slices equal in the value, or in its logarithm."""
    ranges = [parse_range("contact.v_0=0.1:1.0"), parse_range("contact.k_n=1e2:1e6", log=["contact.k_n"])]
    points = sample(ranges, number, seed=3)
    for i, r in enumerate(ranges):
        values = np.array([point[i].value for point in points])
        u = np.log(values / r.low) / math.log(r.high / r.low) if r.log else (values - r.low) / (r.high - r.low)
        # six digits of the value are at most 5e-6 of it, here up to 1e-5 of the range: far less than a slice
        slices = np.clip(np.floor(u * number), 0, number - 1)
        near = np.abs(u * number - np.round(u * number)) < 1e-3
        assert len(set(slices[~near])) == (~near).sum()
        assert ((values >= r.low) & (values <= r.high)).all()


def test_the_seed_decides() -> None:
    ranges = [parse_range("a=0:1")]
    assert shown(sample(ranges, 5, 1)) == shown(sample(ranges, 5, 1))
    assert shown(sample(ranges, 5, 1)) != shown(sample(ranges, 5, 2))


@pytest.mark.parametrize(
    "text", ["a", "a=1", "a=2:1", "a=1:1", "a=x:2", "a=0:inf", "a=nan:1", "=1:2", "a=-1e308:1e308"]
)
def test_what_is_no_range_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="expected"):
        parse_range(text)


def test_a_logarithm_needs_positive_numbers() -> None:
    with pytest.raises(InputError, match="positive"):
        parse_range("a=0:1", log=["a"])


@pytest.mark.parametrize(("number", "seed"), [(0, 0), (-1, 0), (10**6, 0), (5, -1)])
def test_sample_sizes_and_seeds_have_limits(number: int, seed: int) -> None:
    with pytest.raises(InputError, match="expected"):
        sample([parse_range("a=0:1")], number, seed)


@pytest.mark.parametrize(
    "path", sorted(folder("cases").glob("*/*.csv")), ids=lambda path: f"{path.parent.name}-{path.stem}"
)
def test_shipped_points_are_scenes(path: Path) -> None:
    points = read_points(path)
    assert points
    for point in points:
        scene = load_case(path.parent.name, overrides=[str(change) for change in point])
        assert scene.body_pairs()
