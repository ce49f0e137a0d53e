"""Where an arm on a feed belongs on its way, depth by depth."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import CurveBendsTooMuch, TargetError, UnsupportedModule
from pinposture.target.walk import place_in_turn
from pinposture.task.passage import Passage

Array = NDArray[np.float64]
Method = Literal["closest", "sequential"]

METHODS: tuple[Method, ...] = ("closest", "sequential")

BENDING = 1e-3
"""What one radian of bending weighs against distance from the way, in mean link lengths [1/rad]: a trace, so
that joints that move nothing off the way stay where they are."""

ITERATIONS, SETTLED = 20, 1e-8
"""Most Gauss-Newton steps of a posture, and the largest motion of a joint at which it is found."""

OFF_THE_WAY = 0.25
"""How far off the way the end of a link may be, in module lengths: as far as the middle of a module of one
hinge whose ends are on an arc on which it turns by a quarter turn."""

SAMPLES = 80
"""How many samples of the way there are to a mean link length, for the sequential placement."""


class Row(NamedTuple):
    """A posture on the way.

    Attributes:
        positions: joint positions of the body, (nv - 1,) [rad or m].
        failure: why there is none; None if there is.
    """

    positions: Array
    failure: TargetError | None


class Sequential:
    """Algorithm 1: each module where it first crosses the way, from the end of the feed on."""

    def __init__(self, laid: Passage) -> None:
        fed = laid.fed
        self._laid = laid
        self._samples = int(np.ceil(SAMPLES * laid.way.length * fed.links.n_modules / fed.length)) + 1

    def place(self, depth: float) -> Row:
        """The posture at a depth [m]."""
        # The arm stays and the way moves, which is the same.
        fed = self._laid.fed
        shifted = self._laid.way.moved(np.eye(3), -depth * fed.axis)
        try:
            placed = place_in_turn(fed.body, shifted, self._samples)
        except UnsupportedModule as error:
            module = error.module + fed.arm.n_modules - fed.body.n_modules
            raise UnsupportedModule(module, error.joints, error.reason) from None
        return Row(placed.positions, placed.failure)


class Closest:
    """The whole arm as close to the way as it can be: least squares over the ends of all links.

    Minimised are the distances across the way, from one depth to the next by a few Gauss-Newton steps within
    the joint limits. Where along the way a link ends follows from the links and from where the feed is.
    """

    def __init__(self, laid: Passage) -> None:
        fed = laid.fed
        self._laid = laid
        ends = np.vstack([fed.links.chain.base, fed.links.chain.points])
        lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
        self._s = np.cumsum(lengths)
        self._depth = 0.0
        self._positions = fed.straight.copy()
        self._bending = (BENDING * float(lengths.mean()) / fed.body.joint_units) ** 2
        self._lower, self._upper = fed.body.limits.lower, fed.body.limits.upper
        self._allowed = OFF_THE_WAY * fed.length / fed.body.n_modules

    def place(self, depth: float) -> Row:
        """The posture at a depth [m], next to the one found last."""
        self._s = self._s + (depth - self._depth)
        self._depth = depth
        for _ in range(ITERATIONS):
            step = self._step()
            self._positions = self._positions + step
            if np.abs(step / self._laid.fed.body.joint_units).max() < SETTLED:
                break
        return Row(self._positions, self._failure())

    def _step(self) -> Array:
        """The Gauss-Newton step from where the arm is."""
        fed, way, x = self._laid.fed, self._laid.way, self._positions
        state = fed.links.at(fed.links.configuration(x))
        points = state.points + self._depth * fed.axis
        for _ in range(2):  # the feet of the ends of the links on the way
            ahead = np.einsum("ij,ij->i", points - way.at(self._s), way.tangent(self._s))
            self._s = np.clip(self._s + ahead, 0.0, way.length)
        gaps, tangents = way.at(self._s) - points, way.tangent(self._s)
        along = np.einsum("ij,ijk->ik", tangents, state.jacobians)
        across = (state.jacobians - tangents[:, :, None] * along[:, None, :]).reshape(-1, len(x))
        error = (gaps - tangents * np.einsum("ij,ij->i", gaps, tangents)[:, None]).ravel()
        hessian = across.T @ across + np.diag(self._bending)
        gradient = across.T @ error - self._bending * (x - fed.straight)
        return _within(hessian, gradient, self._lower - x, self._upper - x)

    def _failure(self) -> TargetError | None:
        fed = self._laid.fed
        ends = fed.links.at(fed.links.configuration(self._positions)).points + self._depth * fed.axis
        off = np.linalg.norm(self._laid.way.at(self._s) - ends, axis=1)
        if off.max() <= self._allowed:
            return None
        link = int(np.argmax(off > self._allowed))
        joint = fed.links.chain.module_starts[link]
        module = int(np.searchsorted(fed.body.module_starts, joint, side="right"))
        advice = "use a gentler path, wider joint limits or shorter modules"
        text = f"the closest that it can come to the path is {off[link]:.4g} m; {advice}"
        return CurveBendsTooMuch(module, float(self._s[link]), text)


def _within(hessian: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """The step that a quadratic model asks for, joints that would leave their limits held there."""
    step, held = np.zeros(len(gradient)), np.zeros(len(gradient), dtype=np.bool_)
    while not held.all():
        free = ~held
        rest = gradient[free] - hessian[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], rest)
        over = free & ((step < lower) | (step > upper))
        step = np.clip(step, lower, upper)
        if not over.any():
            break
        held |= over
    return step
