"""Braking in discrete time: the closed form against searches that know nothing of it."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.control.limits import farthest, full_braking

UNIT = 0.1  # of the grid that is searched [rad]
DT = 0.05


@cache
def stops(step: int, room: int, brake: int) -> bool:
    """Whether some sequence of decelerations after this step ends at rest within the room."""
    if step > room:
        return False
    return step == 0 or any(
        stops(after, room - step, brake) for after in range(max(0, step - brake), step + 1)
    )


@pytest.mark.parametrize("brake", range(1, 7))
def test_farthest_is_the_largest_step_from_which_some_deceleration_stops_in_time(brake: int) -> None:
    for room in range(81):
        largest = max(step for step in range(room + 1) if stops(step, room, brake))
        found = farthest(np.array([room, -room]) * UNIT, np.full(2, brake * UNIT)) / UNIT
        assert found[0] == -found[1]
        # The grid knows whole steps only: the closed form lies between its largest and the next one.
        assert largest - 1e-9 <= found[0] < largest + 1 - 1e-9


@given(st.floats(1e-6, 1e3), st.floats(1e-4, 10.0))
@examples(40)
def test_farthest_uses_up_the_room_to_the_last_bit(room: float, brake: float) -> None:
    step = float(farthest(np.array([room]), np.array([brake]))[0])
    steps = np.arange(step, 0.0, -brake)
    assert steps.sum() == pytest.approx(room, rel=1e-9)
    # Taken again and again, it is full braking, and comes to rest at the place.
    again = step
    left = room - step
    for expected in steps[1:]:
        again = float(farthest(np.array([left]), np.array([brake]))[0])
        assert again == pytest.approx(expected, abs=1e-9 * (1.0 + room))
        left -= again
    assert left == pytest.approx(0.0, abs=1e-9 * (1.0 + room))


def test_farthest_at_its_ends() -> None:
    room = np.array([0.0, np.inf, -np.inf, 1e9, 1.0, -1.0])
    brake = np.array([0.1, 0.1, 1e-100, 1e-100, 1e200, 1e200])
    np.testing.assert_allclose(farthest(room, brake), [0.0, np.inf, -np.inf, 0.0, 1.0, -1.0], atol=1e-40)
    np.testing.assert_allclose(full_braking(np.array([0.5, -0.5, 0.05]), np.full(3, 0.1)), [0.4, -0.4, 0.0])


def viable_states(low: int, high: int, bound: int, brake: int) -> set[tuple[int, int]]:
    """All (position, last step) from which one can go on for ever: the others are struck, one by one."""
    states = set(product(range(low, high + 1), range(-bound, bound + 1)))
    while True:
        left = {(x, p) for x, p in states if steps_from(x, p, bound, brake, states)}
        if left == states:
            return states
        states = left


def steps_from(x: int, p: int, bound: int, brake: int, states: set[tuple[int, int]]) -> list[int]:
    steps = range(max(-bound, p - brake), min(bound, p + brake) + 1)
    return [d for d in steps if (x + d, d) in states]


@pytest.mark.parametrize(("bound", "brake"), [(1, 1), (4, 1), (5, 2), (6, 3), (3, 5), (9, 1)])
@pytest.mark.parametrize(("low", "high"), [(-6, 9), (-1, 2), (0, 14)])
@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_the_box_is_the_viability_kernel(low: int, high: int, bound: int, brake: int) -> None:
    template = pp.template("Rz").with_limits((low - 1) * UNIT, (high + 1) * UNIT)
    arm = pp.Arm.from_modules([template])
    limits = pp.Limits(
        step=bound * UNIT, dt=DT, velocity=1e9, acceleration=brake * UNIT / DT**2, position_margin=UNIT
    )
    viable = viable_states(low, high, bound, brake)
    for x, p in product(range(low, high + 1), range(-bound, bound + 1)):
        box = limits.step_bounds(arm.at([x * UNIT]), np.array([p * UNIT]))
        lower = box.lower[0] / UNIT
        upper = box.upper[0] / UNIT
        assert lower <= upper
        if (x, p) in viable:
            allowed = steps_from(x, p, bound, brake, viable)
            assert list(range(int(np.ceil(lower - 1e-9)), int(np.floor(upper + 1e-9)) + 1)) == allowed
            assert box.violated_constraints == ()
        else:
            assert lower == pytest.approx(upper)  # full braking, and nothing else
            assert abs(lower) == pytest.approx(max(abs(p) - brake, 0))
            assert len(box.violated_constraints) == 1
            assert "too fast to stop" in box.violated_constraints[0]
