"""The smallest distance that an arm had from what it was to keep clear of, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def closest_in_words(clearance: Mapping[str, Any], dt: float | None = None) -> str:
    """A smallest distance as a person reads it.

    Args:
        clearance: what `pinposture.motion.trajectory.closest` returned.
        dt: how long a step takes [s]; None to count steps.
    """
    if clearance["pair"] is None:
        return "nothing to keep clear of"
    steps = clearance["after_steps"]
    after = "at the start"
    if steps:
        after = f"after {steps} steps" if dt is None else f"after {steps * dt:.4g} s"
    return (
        f"{clearance['smallest']:.4g} m where it is smallest, {' to '.join(clearance['pair'])}, {after}; "
        f"{clearance['final']:.4g} m at the end; the margin is {clearance['margin']:.4g} m"
    )
