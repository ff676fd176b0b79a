"""How uncertain k_n is, given how uncertain its inputs are, and which of them matters most.

Quantiles by quasi-Monte Carlo (scrambled Sobol points, several independent scrambles for their own error), and the
shares of the variance of ln k_n by Sobol's indices: Sobol', Math. Comput. Simul. 55 (2001) 271; estimators of Saltelli
et al., Comput. Phys. Commun. 181 (2010) 259, as in `scipy.stats.sobol_indices`. The logarithm, because k_n is nearly a
product of powers of its inputs, whose logarithms add up.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

import numpy as np

from kncal.core.checks import Array, as_floats, in_range, instance, one_of, short, single, whole
from kncal.core.errors import InputError, KncalError
from kncal.physics.calibration import calibrate
from kncal.physics.material import Material, Pair, pair
from kncal.physics.statistics import Interval, average_of_samples

#: What may be uncertain: the particle's material, its radius, and the impact.
INPUTS = ("young", "poisson", "density", "radius", "e_n", "v_0")
#: Ends of inputs that are a share of something; what is given in percent is cut off there.
_BOUNDS = {"poisson": (0.0, 0.5), "e_n": (1e-3, 1.0)}
#: Shares whose quantiles are told.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
#: Standard deviations in percent that mean something: the tails of 1000 % are a factor of 100 away.
_PERCENTS = (1e-9, 1e3)
#: Most evaluations: a second or two.
MOST_SAMPLES = 262_144
_SCRAMBLES = 8
_PERCENT = re.compile(r"([0-9.eE+-]+)\s*%")
_EXPECTED = "expected 5% (standard deviation), LOW:HIGH (uniform) or log:LOW:HIGH (log-uniform)"


class Distribution(Protocol):
    """What an input may be: its quantile function, as every distribution of `scipy.stats` has it."""

    def ppf(self, q: Any, /) -> Any:
        """Return the values that shares ``q`` of all do not exceed, of the shape of ``q``."""
        ...


@dataclass(frozen=True, kw_only=True)
class Propagation:
    """The distribution of k_n [N/m].

    Attributes
    ----------
    quantiles : share of `QUANTILES` -> k_n, its interval (95 %) that of the sampling
    first_order, total : input -> share of the variance of ln k_n by itself, and with all its interactions; 95 %
        intervals of the sampling
    samples : evaluations for the quantiles
    """

    quantiles: Mapping[float, Interval]
    first_order: Mapping[str, Interval]
    total: Mapping[str, Interval]
    samples: int

    @property
    def most(self) -> str:
        """The input that matters most: the one with the largest total share."""
        return max(self.total, key=lambda name: self.total[name].value)

    def to_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        shares = {name: {key: asdict(value) for key, value in getattr(self, name).items()} for name in _SHARES}
        return {
            "quantiles": {f"{share:g}": asdict(value) for share, value in self.quantiles.items()},
            **shares,
            "matters_most": self.most,
            "samples": self.samples,
        }


_SHARES = ("first_order", "total")


def distribution(name: str, text: str, value: float | None) -> Distribution:
    """Return the distribution that ``text`` describes: "5%", "LOW:HIGH" or "log:LOW:HIGH".

    A percentage is a standard deviation relative to ``value``: of young, density, radius and v_0 log-normal with the
    median ``value`` (they cannot be negative); of poisson and e_n normal about ``value``, cut off at the ends of their
    range.

    Raises
    ------
    InputError
        If it is not of that form, or a percentage has no value to refer to.
    """
    from scipy import stats

    text = text.strip()
    one_of("name", name, INPUTS)
    if found := _PERCENT.fullmatch(text):
        share = single(f"{name} [%]", in_range(f"{name} [%]", _number(name, text, found[1]), *_PERCENTS)) / 100.0
        if value is None:
            raise InputError(f"{name} = {text}: a percentage of what? Expected a value of {name} too, or LOW:HIGH")
        if name in _BOUNDS:
            low, high = _BOUNDS[name]
            deviation = share * value
            if deviation <= 0.0:
                raise InputError(f"{name} = {text} of {value:g}: expected LOW:HIGH for a value of 0")
            return stats.truncnorm((low - value) / deviation, (high - value) / deviation, value, deviation)
        return stats.lognorm(math.sqrt(math.log1p(share**2)), scale=value)
    kind, _, ends = text.rpartition("log:")
    low_text, colon, high_text = ends.partition(":")
    if kind or not colon:
        raise InputError(f"{name} = {short(text)}: {_EXPECTED}")
    low, high = _number(name, text, low_text), _number(name, text, high_text)
    if not low < high or not math.isfinite(high - low) or (text.startswith("log:") and low <= 0.0):
        raise InputError(f"{name} = {text}: expected a lower end, above 0 for log, and a higher one")
    return stats.loguniform(low, high) if text.startswith("log:") else stats.uniform(low, high - low)


def _number(name: str, text: str, part: str) -> float:
    try:
        value = float(part)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{name} = {short(text)}: {_EXPECTED}")
    return value


def propagate(
    uncertain: Mapping[str, str | Distribution],
    *,
    material: Material,
    radius: float,
    v_0: float | None = None,
    e_n: float | None = None,
    pair_of: Callable[[Material, Any], Pair] = pair,
    law: str = "tsuji",
    method: str = "mean_overlap",
    end: str = "overlap",
    samples: int = 8192,
    seed: int = 0,
    **method_options: Any,
) -> Propagation:
    """Return the distribution of k_n for inputs that are uncertain independently of each other.

    Parameters
    ----------
    uncertain : mapping
        Input (one of `INPUTS`) -> "5%", "LOW:HIGH", "log:LOW:HIGH" (see `distribution`), or an object with ``ppf``.
    material, radius, v_0, e_n
        What is not in ``uncertain``, and what a percentage refers to (floats).
    pair_of : callable
        From (material, radius), whose values are arrays, to the `Pair`: `kncal.pair` for two equal spheres,
        `kncal.wall_pair` for a sphere on a rigid wall, or a function of yours.
    law, method, end, method_options
        As in `kncal.calibrate`.
    samples : int
        Evaluations for the quantiles, 1 to 262 144 (at least 128 are made); as many per input for the indices.
    seed : int
        Of the scrambling, 0 to 2^63 - 1.

    Raises
    ------
    InputError
        If nothing is uncertain, an input is missing or is no single number, a distribution leaves the range of its
        input, or ``pair_of`` or a ``ppf`` fails.
    ValidityError
        If an overlap of some sample reaches the radius.
    """
    plain = _plain(instance("material", material, Material, "made by kncal.Material"), radius, e_n, v_0)
    laws = _laws(uncertain, plain)
    for name, value in method_options.items():
        if not isinstance(value, str):
            single(name, value)
    whole("samples", samples, 1, MOST_SAMPLES)
    whole("seed", seed, 0, 2**63 - 1)

    def k_n(values: Array) -> Array:
        now = plain | dict(zip(laws, values, strict=True))
        sampled = replace(material, **{key: now[key] for key in ("young", "poisson", "density")})
        both = _own("pair_of", pair_of, sampled, now["radius"])
        given: dict[str, Any] = {"v_0": now["v_0"], "e_n": now["e_n"], "law": law, "method": method, "end": end}
        found = calibrate(both, **given, **method_options).k_n
        if np.size(found) not in (1, values[0].size):
            raise InputError(f"pair_of gives a pair of shape {np.shape(found)}: expected {values.shape[1:]}, or ()")
        return np.broadcast_to(np.asarray(found, dtype=np.float64), values.shape[1:])

    each = 1 << max(round(math.log2(samples / _SCRAMBLES)), 4)
    rng = np.random.default_rng(seed)
    parts = _sampled(k_n, laws, each, rng)
    quantiles = {share: _spread([float(np.quantile(part, share)) for part in parts]) for share in QUANTILES}
    if np.ptp(np.concatenate(parts)) <= 1e-12 * quantiles[0.5].value:
        first = total = dict.fromkeys(
            laws, Interval(value=0.0, low=0.0, high=0.0, why=f"{method} does not depend on it")
        )
    elif len(laws) == 1:
        first = total = dict.fromkeys(laws, Interval(value=1.0, low=1.0, high=1.0))
    else:
        first, total = _shares(k_n, laws, each, rng)
    return Propagation(quantiles=quantiles, first_order=first, total=total, samples=each * _SCRAMBLES)


def _sampled(
    k_n: Callable[[Array], Array], laws: Mapping[str, Distribution], each: int, rng: np.random.Generator
) -> list[Array]:
    """Return k_n at ``each`` points of every scramble."""
    from scipy.stats import qmc

    parts = []
    for _ in range(_SCRAMBLES):
        points = qmc.Sobol(len(laws), rng=rng).random(each)
        parts.append(k_n(np.stack([law.ppf(points[:, i]) for i, law in enumerate(laws.values())])))
    return parts


def _shares(
    k_n: Callable[[Array], Array], laws: Mapping[str, Distribution], each: int, rng: np.random.Generator
) -> tuple[dict[str, Interval], dict[str, Interval]]:
    """Return Sobol's indices of ln k_n by input: of the first order, and total."""
    from scipy.stats import sobol_indices

    found = [
        sobol_indices(func=lambda values: np.log(k_n(values)), n=each, dists=list(laws.values()), rng=rng)
        for _ in range(_SCRAMBLES)
    ]
    first, total = (
        {name: _spread([float(getattr(one, key)[i]) for one in found]) for i, name in enumerate(laws)}
        for key in ("first_order", "total_order")
    )
    return first, total


def _laws(uncertain: object, plain: Mapping[str, float | None]) -> dict[str, Distribution]:
    """Return the distribution of every uncertain input, checked."""
    if not isinstance(uncertain, Mapping):
        raise InputError(f"uncertain = {short(uncertain)}: expected a mapping from names of inputs")
    if not uncertain:
        raise InputError(f"nothing is uncertain: expected at least one of {', '.join(INPUTS)}")
    laws = {name: _law(name, given, plain) for name, given in uncertain.items()}
    for name in ("v_0", "e_n"):
        if plain[name] is None and name not in laws:
            raise InputError(f"{name}: missing: expected a value or a distribution")
    return laws


def _plain(material: Material, radius: float, e_n: float | None, v_0: float | None) -> dict[str, float | None]:
    """The values of all `INPUTS`, single numbers."""
    given = {name: getattr(material, name) for name in ("young", "poisson", "density")}
    given |= {"radius": radius, "e_n": e_n, "v_0": v_0}
    return {name: None if value is None else single(name, value) for name, value in given.items()}


@dataclass(frozen=True)
class _Checked:
    """A distribution of somebody else's making, whose values are checked."""

    name: str
    given: Distribution

    def ppf(self, q: Any, /) -> Array:
        """Return its quantiles; `InputError` if they are no finite numbers of the shape of ``q``."""
        values = as_floats(f"quantiles of {self.name}", _own(f"the ppf of {self.name}", self.given.ppf, q))
        if values.shape != np.shape(q):
            raise InputError(f"quantiles of {self.name} have shape {values.shape}: expected {np.shape(q)}")
        return values


def _law(name: str, given: object, plain: Mapping[str, float | None]) -> Distribution:
    one_of("uncertain", name, INPUTS)
    if isinstance(given, str):
        return _Checked(name, distribution(name, given, plain[name]))
    if not callable(getattr(given, "ppf", None)):
        raise InputError(f"{name} = {short(given)}: {_EXPECTED}, or a distribution with a method ppf")
    return _Checked(name, given)  # type: ignore[arg-type]


def _own(what: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of the user's; whatever it raises becomes an `InputError` that names it."""
    try:
        return function(*arguments)
    except KncalError:
        raise
    except Exception as error:
        raise InputError(f"{what}: {type(error).__name__}: {error}: expected a function that works") from error


def _spread(values: list[float]) -> Interval:
    """Return the mean of independent estimates with its 95 % interval (Student's t)."""
    found = average_of_samples(values)
    return Interval(value=found.mean, low=found.mean - found.uncertainty, high=found.mean + found.uncertainty)
