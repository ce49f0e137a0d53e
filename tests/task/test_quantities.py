"""Quantities of task files, against the definitions of their units."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.schema import UNITS, read_quantity

# What one of each unit is, by how it is defined: so many of one base unit are so many of another.
IN_SI = {
    "length": {"m": 1, "cm": 1 / 100, "mm": 1 / 1000},
    "angle": {"rad": 1, "deg": math.tau / 360, "turns": math.tau},
    "time": {"s": 1, "ms": 1 / 1000, "min": 60},
    "speed": {"m/s": 1, "cm/s": 1 / 100, "mm/s": 1 / 1000},
    "rate of turning": {"rad/s": 1, "deg/s": math.tau / 360, "turns/s": math.tau, "rpm": math.tau / 60},
    "acceleration": {"m/s^2": 1, "cm/s^2": 1 / 100, "mm/s^2": 1 / 1000},
    "rate of change of turning": {"rad/s^2": 1, "deg/s^2": math.tau / 360, "turns/s^2": math.tau},
    "jerk": {"m/s^3": 1, "cm/s^3": 1 / 100, "mm/s^3": 1 / 1000},
    "jerk of turning": {"rad/s^3": 1, "deg/s^3": math.tau / 360, "turns/s^3": math.tau},
    "mass": {"kg": 1, "g": 1 / 1000, "t": 1000},
    "mass per length": {"kg/m": 1, "g/m": 1 / 1000, "t/m": 1000},
    "moment of inertia": {"kgm^2": 1},
    "stiffness": {"N/m": 1, "N/mm": 1000, "kN/m": 1000},
    "stiffness of turning": {"Nm/rad": 1, "Nm/deg": 360 / math.tau, "kNm/rad": 1000},
    "torque": {"Nm": 1, "Ncm": 1 / 100, "mNm": 1 / 1000, "kNm": 1000},
    "force": {"N": 1, "mN": 1 / 1000, "kN": 1000},
}
PAIRS = [(kind, unit) for kind, units in IN_SI.items() for unit in units]
NUMBERS = st.floats(-1e9, 1e9)


def test_there_are_no_other_units() -> None:
    assert {kind: set(units) for kind, units in UNITS.items()} == {
        kind: set(units) for kind, units in IN_SI.items()
    }


@pytest.mark.parametrize(("kind", "unit"), PAIRS)
def test_each_unit_is_what_it_is_defined_to_be(kind: str, unit: str) -> None:
    assert read_quantity(f"1 {unit}", kind) == pytest.approx(IN_SI[kind][unit], rel=1e-15)
    assert read_quantity(f"-2.5e2{unit}", kind) == pytest.approx(-250 * IN_SI[kind][unit], rel=1e-15)


@examples(40)
@given(number=NUMBERS, pair=st.sampled_from(PAIRS), gap=st.sampled_from(["", " ", "  ", "\t"]))
def test_any_number_with_any_unit_comes_back(number: float, pair: tuple[str, str], gap: str) -> None:
    kind, unit = pair
    for text in (f"{number!r}{gap}{unit}", f" {number:+.17e}{gap}{unit} "):
        assert read_quantity(text, kind) / IN_SI[kind][unit] == pytest.approx(number, rel=1e-14)
    assert read_quantity(number, kind) == number


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        (3, "length", 3.0),
        ("7.m", "length", 7.0),
        (".5 m", "length", 0.5),
        ("1 rad/s²", "rate of change of turning", 1.0),
        ("1 rad / s ^ 2", "rate of change of turning", 1.0),
        ("1 m/s**2", "acceleration", 1.0),
        ("1 m/s/s", "acceleration", 1.0),
        ("7.5 N m", "torque", 7.5),
        ("-0 s", "time", 0.0),
    ],
)
def test_ways_of_writing(text: object, kind: str, value: float) -> None:
    found = read_quantity(text, kind)
    assert isinstance(found, float)
    assert found == value


@pytest.mark.parametrize(
    "text", ["", " ", "m", "1", "1 2 m", "1,5 m", "1 km", "1 M", "--1 m", "1e m", "0x1 m"]
)
@pytest.mark.parametrize("kind", IN_SI)
def test_nonsense_is_refused(text: str, kind: str) -> None:
    with pytest.raises(
        ValueError, match=r"is '.*allowed: a number in SI units, or text with one of the units "
    ):
        read_quantity(text, kind)


@pytest.mark.parametrize("value", [None, True, [], {}, [1], "inf m", "nan m", math.inf, -math.inf, math.nan])
def test_other_values_are_refused(value: object) -> None:
    with pytest.raises(ValueError, match="allowed: "):
        read_quantity(value, "length")


@pytest.mark.parametrize("value", ["1e309 m", "-1e400 mm", 10.0**300 * 1e10])
def test_what_is_beyond_numbers_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="not finite"):
        read_quantity(value, "length")


@examples(40)
@given(value=st.text(max_size=12))
def test_any_text_is_a_finite_number_or_refused(value: str) -> None:
    try:
        assert math.isfinite(read_quantity(value, *UNITS))
    except ValueError as error:
        assert "\n" not in str(error)


def test_the_message_tells_kinds_apart_and_lists_every_unit_that_would_do() -> None:
    with pytest.raises(ValueError, match=r"is '3 m', of the kind length; allowed: .* units s, ms, min$"):
        read_quantity("3 m", "time")
    with pytest.raises(ValueError, match=r"is '3 lb', and 'lb' is not a known unit; .* rad, deg, turns, m,"):
        read_quantity("3 lb", "angle", "length")
    with pytest.raises(ValueError, match=r"is '3', without a unit"):
        read_quantity("3", "angle")


def test_a_unit_that_two_kinds_could_have_goes_to_the_one_that_is_asked_for() -> None:
    units = [unit for known in UNITS.values() for unit in known]
    assert len(units) == len(set(units))
    assert read_quantity("90 deg", "length", "angle") == pytest.approx(math.pi / 2)
