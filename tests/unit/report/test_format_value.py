"""Numbers are printed to the digits that their sigma supports, and never as NaN."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.report import format_value
from jaxmocap.report.text import format_number


@pytest.mark.parametrize(
    ("value", "sigma", "unit", "text"),
    [
        (859.1234, 0.3412, "px", "859.12 ± 0.34 px"),
        (859.12, 0.0996, "px", "859.12 ± 0.10 px"),
        (859.12, 0.00999, "px", "859.120 ± 0.010 px"),
        (859.0, 96.0, "px", "859 ± 96 px"),
        (859.0, 99.6, "px", "860 ± 100 px"),
        (859.12, 1234.0, "px", "900 ± 1200 px"),
        (-0.11804, 0.00342, "1", "-0.1180 ± 0.0034"),
        (-0.0001, 0.02, "1", "0.000 ± 0.020"),
        (0.0, 0.3, "px", "0.00 ± 0.30 px"),
        (1.23e-9, 3.4e-10, "1", "(1.23 ± 0.34)e-09"),
        (1e9, 1e7, "px", "(1.000 ± 0.010)e+09 px"),
        (859.12, 3e-14, "px", "859.120000000 ± 3.0e-14 px"),
        (859.12, 0.0, "px", "859.12 ± 0 px"),
        (-0.0, 0.0, "", "0 ± 0"),
        (859.1234567, None, "px", "859.123 px"),
        (0.25, None, "1", "0.25"),
        (math.nan, 0.1, "px", "not determined"),
        (math.inf, None, "px", "not determined"),
        (859.12, math.nan, "px", "859.12 px (sigma not determined)"),
        (859.12, math.inf, "px", "859.12 px (sigma not determined)"),
    ],
)
def test_value_and_sigma(value, sigma, unit, text):
    assert format_value(value, sigma, unit) == text


@given(st.floats(), st.none() | st.floats(min_value=0.0))
def test_any_floats_give_readable_text(value, sigma):
    text = format_value(value, sigma, "px")
    assert "nan" not in text and "inf" not in text and "-0 " not in text and len(text) < 60


@given(st.floats(-1e6, 1e6), st.floats(1e-5, 1e5))
def test_the_printed_value_is_within_half_a_digit_of_sigma(value, sigma):
    text = format_value(value, sigma)
    if text.startswith("("):
        inner, exponent = text[1:].split(")e")
        scale = 10.0 ** int(exponent)
    else:
        inner, scale = text, 1.0
    shown, shown_sigma = (float(part) * scale for part in inner.split(" ± "))
    assert shown == pytest.approx(value, abs=0.051 * sigma + 1e-9 * abs(value))
    assert shown_sigma == pytest.approx(sigma, rel=0.051)


def test_a_missing_number_is_a_dash():
    assert [format_number(v) for v in (None, math.nan, math.inf, -0.0, 1.234)] == [
        "–",
        "–",
        "–",
        "0.00",
        "1.23",
    ]
