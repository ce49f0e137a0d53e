"""A run in words, for titles."""

from __future__ import annotations

from pinposture.motion import Trajectory

ENDINGS = {
    "converged": "converged",
    "stalled": "stalled",
    "no_control_points": "found no control point to move",
    "max_steps": "ran out of steps",
    "stopped": "was stopped",
}


def controller_name(run: Trajectory) -> str:
    """Name of the controller of a run, without its parameters."""
    return run.controller.partition("(")[0].strip() or "The run"


def ending(run: Trajectory) -> str:
    """How and when a run ended, as what is said of its controller."""
    how = ENDINGS.get(run.status, f"ended ({run.status})")
    return f"{how} after {run.steps} step{'s' * (run.steps != 1)}"
