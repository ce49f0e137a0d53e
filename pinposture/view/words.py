"""A run or a motion in words, for titles."""

from __future__ import annotations

from pinposture.motion import Motion, Trajectory
from pinposture.motion.ending import ENDINGS


def moved_curves(run: Trajectory | Motion) -> str:
    """How curves were moved from where they were drawn, in words; empty if none was."""
    if isinstance(run, Motion):
        told = [f"{place.name} {place.moved}" for place in run.passed if place.moved]
        return f"curves: {', '.join(told)}" if told else ""
    return f"curve {run.target.moved} to the base of the arm" if run.target.moved else ""


SLOWED = 1.001
"""How many times as long as planned a motion takes that was slowed down."""


def controller_name(run: Trajectory) -> str:
    """Name of the controller of a run, without its parameters."""
    return run.controller.partition("(")[0].strip() or "The run"


def ending(run: Trajectory) -> str:
    """How and when a run ended, as what is said of its controller."""
    return f"{ENDINGS[run.status]} after {run.steps} step{'s' * (run.steps != 1)}"


def ending_in_time(motion: Motion) -> str:
    """How and when a motion ended, as what is said of its controller."""
    return f"{ENDINGS[motion.run.status]} after {motion.time[-1]:.4g} s{slower(motion)}"


def slower(motion: Motion) -> str:
    """How much a motion was slowed down, after a comma; empty if it was not, or did not get to its end."""
    if motion.clock[-1] < motion.planned or not is_slowed(motion):
        return ""
    since = f"from {motion.time[motion.set_out]:.4g} s on " if motion.set_out else ""
    return f", {since}{motion.slowing:.3g} times as long as planned"


def is_slowed(motion: Motion) -> bool:
    """Whether something slowed a motion down, by more than one sees."""
    return motion.slowing > SLOWED
