"""Numbers with units: no prefix is put before another."""

import pytest

from kncal.core.units import quantity, si_prefix


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(2500.0, "kg/m³", "2500 kg/m³"), (0.002, "kg/s", "2 g/s"), (1.5, "kg", "1.5 kg"), (3e-6, "m", "3 µm")],
)
def test_a_kilogram_has_its_prefix_already(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text
    factor, label = si_prefix(value, unit)
    assert f"{factor * value:g} {label}" == text
