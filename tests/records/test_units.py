"""Units convert by a factor, or not at all."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgrssnn_jax.records.units import conversion

FACTORS = {
    ("mbar", "bar"): 1e-3,
    ("kPa", "bar"): 1e-2,
    ("N/m^2", "Pa"): 1.0,
    ("deg", "rad"): math.pi / 180,
    ("°/s", "rad/s"): math.pi / 180,
    ("mNm", "Nm"): 1e-3,
    ("N m", "Nm"): 1.0,
    ("N·m", "kNm"): 1e-3,
    ("J", "kg m^2/s^2"): 1.0,
    ("cm/s", "m/s"): 1e-2,
    ("km/h", "m/s"): 1 / 3.6,
    ("m/s/s", "m/s^2"): 1.0,
    ("m s^-1", "m/s"): 1.0,
    ("rpm", "rad/s"): 2 * math.pi / 60,
    ("rev/min", "rpm"): 1.0,
    ("1/min", "Hz"): 1 / 60,
    ("L/min", "m^3/s"): 1e-3 / 60,
    ("cm^2", "m^2"): 1e-4,
    ("sqrt(mV)/s", "sqrt(V)/s"): 1e-3**0.5,
    ("mV", "V"): 1e-3,
    ("W/A", "V"): 1.0,
    ("µA", "uA"): 1.0,
    ("g", "kg"): 1e-3,
    ("ms", "s"): 1e-3,
    ("kW h", "J"): 3.6e6,
    ("%", "1"): 1e-2,
}


@pytest.mark.parametrize(("found", "wanted"), FACTORS)
def test_a_value_converts_by_its_factor(found, wanted):
    assert conversion(found, wanted) == pytest.approx(FACTORS[found, wanted], rel=1e-12)


UNITS = sorted({unit for pair in FACTORS for unit in pair} | {"min", "h", "m", "mm", "mrad", "K", "°C", "mol", "", "?"})
units = st.sampled_from(UNITS)


@settings(deadline=None, max_examples=300, derandomize=True)
@given(one=units, other=units)
def test_the_way_back_is_the_inverse(one, other):
    there, back = conversion(one, other), conversion(other, one)
    assert (there is None) == (back is None)
    if there is not None and back is not None:
        assert there * back == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("middle", UNITS)
def test_two_conversions_after_each_other_are_one(middle):
    there = {one: factor for one in UNITS if (factor := conversion(one, middle)) is not None}
    for one, first in there.items():
        for other in there:  # every one of them has a way back, as the test above shows
            second = conversion(middle, other)
            assert second is not None
            assert conversion(one, other) == pytest.approx(first * second, rel=1e-12)


@pytest.mark.parametrize("unit", UNITS)
def test_a_unit_is_itself_whether_it_is_known_or_not(unit):
    assert conversion(unit, unit) == 1.0


@pytest.mark.parametrize(
    ("found", "wanted"),
    [
        ("°C", "K"),  # an offset is no factor
        ("V", "A"),
        ("m", "m^2"),
        ("rad/s", "1/s"),
        ("Nm", "N"),
        ("sqrt(V)/s", "V/s"),
        ("furlong", "m"),
        ("m", "furlong"),
        ("", "V"),
        ("V", ""),
        ("m^", "m"),
        ("m//s", "m/s"),
        ("5 m", "m"),
    ],
)
def test_what_does_not_convert_has_no_factor(found, wanted):
    assert conversion(found, wanted) is None


def test_powers_may_be_written_as_in_python():
    assert conversion("kg*m**2/s**2", "J") == pytest.approx(1.0)
