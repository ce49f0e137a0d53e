"""Lengths in words."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinposture.units import error_text, length_text, number_text


@pytest.mark.parametrize(
    ("length", "text"),
    [
        (0.0, "0 mm"),
        (9e-8, "below 0.0001 mm"),
        (3e-7, "0.0003 mm"),
        (0.0199, "19.9 mm"),
        (-0.0199, "-19.9 mm"),
        (0.3456, "346 mm"),
        (0.9994, "999 mm"),
        (0.9996, "1 m"),
        (1.0, "1 m"),
        (12.3456, "12.35 m"),
        (float("inf"), "inf m"),
    ],
)
def test_lengths_are_in_millimetres_below_one_metre(length, text):
    assert length_text(length) == text


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (13112.6, "13113"),
        (9999.7, "10000"),
        (2332.0, "2332"),
        (0.36981, "0.3698"),
        (2e-7, "2e-07"),
        (1e12, "1e+12"),
    ],
)
def test_torques_of_large_arms_are_written_without_an_exponent(number, text):
    assert number_text(number) == text


@pytest.mark.parametrize(
    ("given", "text"), [(5e-8, "0.00005 mm"), (1.26e-12, "0.00000000126 mm"), (0.01, "10 mm")]
)
def test_a_given_length_is_written_however_short(given, text):
    assert length_text(given, smallest=0.0) == text


@given(st.floats(1e-7, 1e6))
def test_a_text_is_the_length_to_three_digits(length):
    number, unit = length_text(length).split()
    assert float(number) * {"mm": 1e-3, "m": 1.0}[unit] == pytest.approx(length, rel=6e-3)


@given(st.floats(1e-3, 1e3), st.floats(-0.99e-9, 0.99e-9))
def test_errors_of_rounding_are_no_numbers(arm_length, share):
    assert length_text(share * arm_length, arm_length) == "below rounding"
    assert error_text(share * arm_length, arm_length) == "below rounding"


def test_errors_have_their_share_of_the_arm():
    assert error_text(0.003, 0.5) == "3 mm, 0.006 of the arm length"
