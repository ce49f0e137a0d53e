"""How far a joint may go in one step and still stop in time: braking in discrete time.

A joint that moves by d in this step may move by d - A, d - 2A, ... in the next ones, until less than A is
left and it stands: A is the acceleration limit times the square of the duration of a step. From d > 0 on,
this step included, it covers at least

    S(d) = sum over j >= 0 of max(d - j A, 0) = max over n >= 1 of (n d - A n (n - 1) / 2).

S grows with d, so that the joint stops within a room r >= 0 if and only if S(d) <= r, that is, if d is at
most

    g(r) = min over n >= 1 of (r / n + A (n - 1) / 2), taken at n = max(1, ceil(sqrt(1/4 + 2 r / A) - 1/2)).

To the other side all signs change: let g(-r) = -g(r). Call L and U the displacements to the lower and the
upper limit, b the largest |d| of a step, and p the step before. The joint may take any d with

    g(L) <= d <= g(U),    p - A <= d <= p + A,    -b <= d <= b.

A state is viable if L <= 0 <= U, |p| <= b, and full braking from p stops in time: S(p - A) <= U if p > A, and
S(-p - A) <= -L if p < -A.

* From a viable state there is such a d: full braking, d = p - A, or 0 if 0 <= p <= A. It is at most g(U)
  because S(d) <= U, not below g(L) <= 0, and not above b; for p < 0 the same with the signs changed.
* Whichever is taken, the next state is viable. Take d >= 0: S(d) <= U gives d <= U and, if d > A,
  S(d - A) = S(d) - d <= U - d, which is what viability asks of the next state; L - d <= 0 and |d| <= b hold.
* No larger box will do: beyond g(U) the joint leaves its limits however it brakes.

Where there is something to keep clear of, it matters on what way the arm stops, not only how far each joint
goes. It goes straight on if all joints slow down in proportion: with r = max_j |d_j| / A_j, the step d is
followed by (1 - 1/r) d, (1 - 2/r) d, ... and rest. No joint then changes by more than its A, and none slows
down faster than in full braking. One that would so go beyond g(L) or g(U) is held there, as its A allows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels

Array = NDArray[np.float64]

MOST = 5000
"""Braking steps beyond which it is not looked how an arm stops."""


def farthest(room: Array, brake: Array) -> Array:
    """The largest step towards a place from which a joint can still stop at it, g(r) above.

    A joint that takes it again and again comes to rest there, as fast as it can.

    Args:
        room: displacement to that place, with its sign, (..., nv) [rad or m]; may be infinite.
        brake: the most that a step may differ from the one before, A, (nv,) [rad or m]; finite, > 0.

    Returns:
        Steps of the signs of `room`, none longer than it, (..., nv) [rad or m].
    """
    rooms = np.ascontiguousarray(np.atleast_2d(room), dtype=np.float64)
    steps = np.empty_like(rooms)
    kernels.stoppable_steps(rooms, np.array(brake, dtype=np.float64), steps)
    return steps.reshape(np.shape(room))


def stopping_steps(rooms: Array, dq: Array, bound: Array, brake: Array | None) -> Array:
    """The steps that bring an arm to rest after a step, straight on, as derived above.

    Args:
        rooms: displacements to the lower and the upper position limits after that step, (2, nv) [rad or m]. A
            joint that is outside of them stops, too, and is not brought back.
        dq: that step, (nv,) [rad or m].
        bound: largest |dq|, (nv,) [rad or m].
        brake: the most that a step may differ from the one before, (nv,) [rad or m]; None: any.

    Returns:
        Steps, (k, nv) [rad or m]; k = 0 if the arm can rest at once.
    """
    found = [np.empty((0, len(dq)))]
    while brake is not None and (ratio := float(np.max(np.abs(dq) / brake))) > 1.0:
        shares = 1.0 - np.arange(1.0, min(np.ceil(ratio), MOST)) / ratio
        steps = shares[:, None] * dq
        gone = np.cumsum(steps, axis=0) - steps
        low = np.maximum(np.minimum(farthest(rooms[0] - gone, brake), 0.0), -bound)
        high = np.minimum(np.maximum(farthest(rooms[1] - gone, brake), 0.0), bound)
        beyond = np.any((steps < low) | (steps > high), axis=1)
        first = int(np.argmax(beyond)) if beyond.any() else len(steps)
        found.append(steps[:first])
        if first == len(steps):
            break
        # Here a joint has to brake harder than the others; they go on from there in proportion again.
        before = steps[first - 1] if first else dq
        held = np.minimum(np.maximum(steps[first], low[first]), high[first])
        dq = np.minimum(np.maximum(held, before - brake), before + brake)
        found.append(dq[None])
        rooms = rooms - gone[first] - dq
    return np.concatenate(found)


def full_braking(previous: Array, brake: Array) -> Array:
    """The step that comes closest to standing still after the step before, (nv,) [rad or m]."""
    return previous - np.minimum(np.maximum(previous, -brake), brake)
