"""Whatever is given to the public API: a result, or an error of kncal's own, in little time and memory."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kncal
from kncal.core.checks import MOST_VALUES
from kncal.core.errors import InputError, KncalError
from kncal.physics.material import Pair
from kncal.physics.matrix import MOST_TYPES
from kncal.physics.uncertainty import MOST_SAMPLES

pytestmark = pytest.mark.slow

GLASS = kncal.Material(young=70e9, poisson=0.22, density=2500.0)
BEADS = kncal.pair(GLASS, 1e-3)
#: Far above what any refusal needs, far below what the garbage asks for.
SECONDS, MEMORY = 10.0, 2**30


class LikeAll:
    """Compares as an array does."""

    def __eq__(self, other: object) -> Any:
        return np.array([True, False])

    __hash__ = object.__hash__


class Silent:
    """Cannot say what it is."""

    def __repr__(self) -> str:
        raise RuntimeError


class NoArray:
    """Cannot become what it offers to."""

    def __array__(self, *_: object, **__: object) -> Any:
        raise ZeroDivisionError


def deep() -> list[Any]:
    inside: list[Any] = []
    for _ in range(20_000):
        inside = [inside]
    return inside


def ring() -> list[Any]:
    inside: list[Any] = []
    inside.append(inside)
    return inside


GARBAGE: dict[str, Callable[[], Any]] = {
    "none": lambda: None,
    "bool": lambda: True,
    "text": lambda: "5 GPa",
    "long text": lambda: "x" * 1_000_000,
    "surrogate": lambda: "\ud800",
    "nul": lambda: "a\0b",
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "zero": lambda: 0,
    "negative": lambda: -1,
    "huge": lambda: 1e300,
    "tiny": lambda: 1e-300,
    "big integer": lambda: 10**9,
    "no float": lambda: 10**400,
    "no text": lambda: 10**6000,
    "complex": lambda: 1 + 2j,
    "decimal": lambda: Decimal("0.5"),
    "bytes": lambda: b"x",
    "empty list": list,
    "ragged": lambda: [1, [2]],
    "deep": deep,
    "ring": ring,
    "dict": lambda: {"a": 1},
    "odd keys": lambda: {LikeAll(): 1},
    "0-d array": lambda: np.array(0.5),
    "object": object,
    "class": lambda: kncal.Material,
    "function": lambda: lambda *_: 1 / 0,
    "material": lambda: GLASS,
    "pair": lambda: BEADS,
    "path": lambda: Path("/dev/zero"),
    "silent": Silent,
    "no array": NoArray,
    "endless range": lambda: range(10**9),
    "rows of ranges": lambda: [range(10**5)] * 10**4,
    "huge view": lambda: np.broadcast_to(1e-3, (10**5, 10**5)),
    "row": lambda: np.full(1000, 0.5),
    "column": lambda: np.full((1000, 1), 0.5),
    "plane": lambda: np.full((1001, 1, 1), 0.5),
    "array of nan": lambda: np.full(3, np.nan),
    "array of text": lambda: np.array(["0.5"]),
    "array of times": lambda: np.array(["2020-01-01"], dtype="datetime64[s]"),
    "masked": lambda: np.ma.masked_array([0.5, 0.6], mask=[True, False]),
    "long float": lambda: np.array([np.longdouble("1e4000")]),
}

#: function -> arguments that it accepts; each in turn, or several at once, gives way to garbage.
CALLS: dict[Callable[..., Any], dict[str, Any]] = {
    kncal.Material: {"young": 70e9, "poisson": 0.22, "density": 2500.0, "yield_strength": 1e8, "name": "glass"},
    Pair: dict(vars(BEADS)),
    kncal.pair: {"material_1": GLASS, "radius_1": 1e-3, "material_2": GLASS, "radius_2": 2e-3},
    kncal.wall_pair: {"material": GLASS, "radius": 1e-3, "wall_material": GLASS},
    kncal.calibrate: {
        "pair": BEADS, "v_0": 0.5, "e_n": 0.9, "law": "tsuji", "method": "limited_overlap", "end": "force",
        "fraction": 0.01, "of": "diameter",
    },
    kncal.calibrate_matrix: {
        "particles": {"a": (GLASS, 1e-3)}, "walls": {"w": None}, "v_0": {("a", "a"): 0.5, ("a", "w"): 1.0}, "e_n": 0.9,
        "law": "tsuji", "method": "limited_overlap", "end": "force", "fraction": 0.01,
    },
    kncal.matrix_block: {
        "matrix": kncal.calibrate_matrix({"a": (GLASS, 1e-3)}, {"w": GLASS}, v_0=0.5, e_n=0.9),
        "style": "hooke/stiffness", "friction": 0.5, "k_t_ratio": 0.5, "steps_per_contact": 50.0,
    },
    kncal.contact_time: {"k_n": 1e5, "m_eff": 1e-6, "e_n": 0.9, "end": "force"},
    kncal.hertz_time: {"pair": BEADS, "v_0": 0.5, "e_n": 0.9, "law": "tsuji", "end": "force"},
    kncal.rayleigh_time: {"material": GLASS, "radius": 1e-3},
    kncal.verlet_limit: {"k_n": 1e5, "m_eff": 1e-6, "eta_n": 0.0, "contacts": 12},
    kncal.advise_time_step: {
        "calibration": kncal.calibrate(BEADS, v_0=0.5, e_n=0.9), "steps_per_contact": 50.0, "contacts": 12.0,
    },
    kncal.predict_error: {"law": "tsuji", "e_n": 0.9, "steps_per_contact": 10.0, "end": "force"},
    kncal.advised_steps: {"law": "tsuji", "e_n": 0.9, "end": "force", "error": 0.05},
    kncal.smallest_restitution: {"steps_per_contact": 50.0, "laws": ["linear"], "end": "overlap"},
    kncal.dimensionless_impact: {"law": "tsuji", "e_n": 0.9, "end": "force"},
    kncal.propagate: {
        "uncertain": {"young": "5%"}, "material": GLASS, "radius": 1e-3, "v_0": 0.5, "e_n": 0.9, "pair_of": kncal.pair,
        "law": "tsuji", "method": "limited_overlap", "end": "force", "samples": 128, "seed": 0, "fraction": 0.01,
    },
    kncal.load_case: {"case": "wall_impact", "name": "x", "overrides": ["run.steps_per_contact=20"]},
}  # fmt: skip
ARGUMENTS = [(function, name) for function, arguments in CALLS.items() for name in arguments]


def test_every_public_function_is_tried() -> None:
    functions = {f for f in map(kncal.__dict__.get, kncal.__all__) if f is not None} | {
        getattr(kncal, name) for name in kncal.__all__ if name[0].islower() and name != "__version__"
    }
    assert {f for f in functions if callable(f) and not isinstance(f, type)} <= CALLS.keys()


@pytest.fixture(autouse=True, scope="module")
def little_memory() -> Iterator[None]:
    """Let what needs too much memory fail with `MemoryError`."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def tried(function: Callable[..., Any], arguments: dict[str, Any]) -> None:
    """Call; fail if anything but a result or an error of kncal's comes of it, or it takes too long."""
    begin = time.process_time()
    try:
        function(**arguments)
    except KncalError as error:
        # an error is to be read: no megabytes of what was given
        assert len(str(error)) < 2000
    assert time.process_time() - begin < SECONDS


@pytest.mark.parametrize(("function", "name"), ARGUMENTS, ids=lambda part: getattr(part, "__name__", part))
def test_one_argument_of_garbage(function: Callable[..., Any], name: str) -> None:
    for make in GARBAGE.values():
        tried(function, CALLS[function] | {name: make()})


@settings(max_examples=60)
@given(data=st.data())
def test_several_arguments_of_garbage(data: st.DataObject) -> None:
    function = data.draw(st.sampled_from(list(CALLS)))
    names = data.draw(st.sets(st.sampled_from(list(CALLS[function])), min_size=2))
    numbers = st.floats() | st.floats(1e-12, 1.0) | st.integers() | st.text(max_size=5)
    anything = st.sampled_from(list(GARBAGE)).map(lambda key: GARBAGE[key]()) | numbers | st.lists(numbers, max_size=3)
    tried(function, CALLS[function] | {name: data.draw(anything) for name in names})


class Quantiles:
    """A distribution that is none."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.ppf = function


@pytest.mark.parametrize(
    "uncertain",
    [
        {"young": "1e300%"}, {"young": "1e-300%"}, {"poisson": "1e300%"}, {"v_0": "-1e308:1e308"}, {"v_0": "0:1e308"},
        {"v_0": "log:1e-320:1e308"}, {"e_n": "::"}, {1: "5%"}, {"young": 5}, {"young": Quantiles(lambda q: q * np.nan)},
        {"young": Quantiles(lambda q: 1 / 0)}, {"young": Quantiles(lambda q: np.ones(3))},
        {"young": Quantiles(lambda q: "x")}, [("young", "5%")],
    ],
)  # fmt: skip
def test_distributions_that_are_none(uncertain: Any) -> None:
    with pytest.raises(InputError):
        kncal.propagate(uncertain, material=GLASS, radius=1e-3, v_0=0.5, e_n=0.9)


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 0}, {"samples": float("nan")}, {"samples": 10**9}, {"samples": MOST_SAMPLES + 1}, {"seed": 1.5},
        {"seed": -1}, {"material": None}, {"material": kncal.Material(young=[1e9, 2e9], poisson=0.2, density=1e3)},
        {"radius": [1e-3, 2e-3]}, {"pair_of": None}, {"pair_of": lambda material, radius: 1 / 0},
        {"pair_of": lambda material, radius: kncal.pair(GLASS, [1e-3] * 5)},
    ],
    ids="-".join,
)  # fmt: skip
def test_what_propagate_refuses(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    given = {"material": GLASS, "radius": 1e-3, "v_0": 0.5, "e_n": 0.9} | wrong
    with pytest.raises(InputError, match="young" if name == "material" and wrong[name] else name):
        kncal.propagate({"young": "5%"}, **given)


def test_more_values_than_memory_holds_are_refused_and_what_is_promised_is_not() -> None:
    radii = np.full(MOST_VALUES, 1e-3)
    assert np.shape(kncal.rayleigh_time(GLASS, radii)) == (MOST_VALUES,)
    with pytest.raises(InputError, match=r"radius_1.*at most 1,000,000"):
        kncal.pair(GLASS, np.full(MOST_VALUES + 1, 1e-3))
    with pytest.raises(InputError, match="at most 1,000,000"):
        kncal.calibrate(kncal.pair(GLASS, np.full(1001, 1e-3)), v_0=np.full((1000, 1), 0.5), e_n=0.9)
    names = [f"t{i}" for i in range(MOST_TYPES + 1)]
    with pytest.raises(InputError, match=f"at most {MOST_TYPES}"):
        kncal.calibrate_matrix({name: (GLASS, 1e-3) for name in names}, v_0=0.5, e_n=0.9)
