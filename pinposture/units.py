"""Lengths and numbers in words, the same in every message, figure and page."""

from __future__ import annotations

from decimal import Decimal

ROUNDING = 1e-9
"""What is smaller is rounding: a length as a share of that of the arm or the curve, a joint motion in
`Arm.joint_units`, rad or m, an excess over a limit as a share of it. Forward kinematics of 40 joints is exact
to some 1e-15 of the arm length."""

CONVERGED = 1e-6
"""What is smaller counts as none where numbers come from iterations or files: a share of the arm length, of
a period, or of a unit of `Arm.joint_units`. Runs converge to it."""

BELOW_ROUNDING = "below rounding"
"""How an error below `ROUNDING` is written."""


def length_text(length: float, arm_length: float = 0.0, smallest: float = 1e-7) -> str:
    """Return a length in words: in millimetres below one metre, in metres from there on.

    Args:
        length: the length [m].
        arm_length: length of the arm [m]: an error below `ROUNDING` times it is written as `BELOW_ROUNDING`.
            0: exact lengths.
        smallest: shorter lengths are not written as numbers [m]; 0 for what is given, such as a tolerance.
    """
    if abs(length) < ROUNDING * arm_length:
        return BELOW_ROUNDING
    metres = round(length, 3)
    if not abs(metres) < 1.0:
        return f"{metres:.4g} m"
    if 0.0 < abs(length) < smallest:
        return f"below {1e3 * smallest:g} mm"
    millimetres = 1e3 * length
    if abs(millimetres) >= 100.0:
        return f"{millimetres:.0f} mm"
    digits = f"{Decimal(f'{millimetres:.3g}'):f}"  # without an exponent
    return f"{digits} mm"


def number_text(number: float) -> str:
    """Return a number with four digits, or as a whole one from 10,000 to 1e9: "13110", not "1.311e+04"."""
    return f"{number:.0f}" if 9999.5 <= abs(number) < 1e9 else f"{number:.4g}"


def error_text(error: float, arm_length: float) -> str:
    """Return an error [m] in words, with its share of the arm length [m] unless it is below rounding."""
    text = length_text(error, arm_length)
    if text == BELOW_ROUNDING or not arm_length > 0.0:
        return text
    return f"{text}, {error / arm_length:.2g} of the arm length"
