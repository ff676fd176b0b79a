"""The public face of the impact solution: arguments, refusals, cost."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from kncal.core.errors import InputError
from kncal.physics.impact import dimensionless_impact, impact_path
from kncal.physics.laws import LAWS
from kncal.physics.laws.base import ENDS


@pytest.mark.parametrize("bad", [0.0, -0.5, 1.0 + 1e-12, 2.0, np.nan, np.inf, [0.5, np.nan], [0.9, 0.0], "0.5", None])
@pytest.mark.parametrize("law", LAWS)
def test_bad_restitution_is_refused_by_name(law: str, bad: object) -> None:
    with pytest.raises(InputError, match="e_n"):
        dimensionless_impact(law, bad)


def test_unknown_law_and_end_are_refused_with_the_nearest_name() -> None:
    with pytest.raises(InputError, match="did you mean 'tsuji'"):
        dimensionless_impact("tsuij", 0.5)
    with pytest.raises(InputError, match="end"):
        dimensionless_impact("tsuji", 0.5, "never")
    with pytest.raises(InputError, match="law"):
        dimensionless_impact(3, 0.5)


def test_hertz_refuses_restitution_below_one_and_points_to_tsuji() -> None:
    with pytest.raises(InputError, match="tsuji"):
        dimensionless_impact("hertz", [1.0, 0.9])
    assert dimensionless_impact("hertz", [1.0, 1.0]).C.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("law", "end"),
    [("tsuji", "force"), ("kuwabara_kono", "overlap"), ("kuwabara_kono", "force"), ("hunt_crossley", "overlap")],
)
def test_the_smallest_restitution_is_named(law: str, end: str) -> None:
    with pytest.raises(InputError, match=r"smallest supported e_n .* is 0.001"):
        dimensionless_impact(law, [0.5, 9e-4], end)
    assert np.isfinite(dimensionless_impact(law, 1e-3, end).tau_c)


def test_the_result_keeps_what_was_asked() -> None:
    impact = dimensionless_impact("tsuji", 0.5, "force")
    assert (impact.law, impact.e_n, impact.end) == ("tsuji", 0.5, "force")
    with pytest.raises(FrozenInstanceError):
        impact.C = 0.0
    assert dimensionless_impact("tsuji", 1).C == 0.0


@pytest.mark.parametrize("n", [1, 0, -3, 2.5, True])
def test_a_path_needs_two_points(n: object) -> None:
    with pytest.raises(InputError, match="n = "):
        impact_path("tsuji", 0.5, n=n)


def test_a_path_is_of_one_impact() -> None:
    with pytest.raises(InputError, match="single number"):
        impact_path("tsuji", [0.5, 0.6])


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("law", LAWS)
def test_no_negative_zero_at_an_elastic_impact(law: str, end: str) -> None:
    impact = dimensionless_impact(law, 1.0, end)
    assert impact.C == 0.0
    assert not np.signbit([impact.C, impact.x_end]).any()


@pytest.mark.parametrize("law", ["linear", "tsuji", "walton_braun"])
@pytest.mark.parametrize("end", ENDS)
def test_a_restitution_below_any_meaning_is_refused(law: str, end: str) -> None:
    with pytest.raises(InputError, match="smallest supported e_n"):
        dimensionless_impact(law, 5e-324, end)
    lowest = LAWS[law].e_min(end)
    impact = dimensionless_impact(law, lowest, end)
    numbers = [impact.C, impact.x_max, impact.tau_c, impact.x_mean]
    assert np.isfinite(numbers).all() and min(numbers) > 0.0


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ([], "at least one value"),
        ([[0.5, 0.6], [0.7]], "equal length"),
        (np.ma.array([0.5, 0.6], mask=[False, True]), "masked"),
        (np.ma.masked, "masked"),
    ],
)
def test_arrays_with_holes_are_refused(bad: object, words: str) -> None:
    with pytest.raises(InputError, match=rf"e_n .*{words}"):
        dimensionless_impact("tsuji", bad)
    with pytest.raises(InputError, match="e_n"):
        impact_path("tsuji", bad)


def test_a_masked_array_without_masked_elements_is_an_array() -> None:
    e_n = np.array([0.5, 0.6])
    expected = dimensionless_impact("tsuji", e_n).tau_c
    np.testing.assert_array_equal(dimensionless_impact("tsuji", np.ma.array(e_n)).tau_c, expected)


def test_impacts_of_arrays_can_be_compared() -> None:
    impact = dimensionless_impact("tsuji", [0.5, 0.6])
    assert impact == impact  # noqa: PLR0124 - what is tested
    assert impact != dimensionless_impact("tsuji", [0.5, 0.7])
    assert len({impact, impact}) == 1
