"""The step that points and chords want, by sweeps along the chain: where nothing else has a say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ArmState
from pinposture.control.constrained.posture import Posture
from pinposture.kernels.arrays import Springs

Array = NDArray[np.float64]


class Sweeps:
    """Least squares over points and chords of a posture at one state, in time linear in the number of joints.

    With all rows A of the posture and its errors e, `control.constrained.program` would do the same; but it
    takes the cube of the number of joints, as it knows of no chain.
    """

    def __init__(self, posture: Posture, state: ArmState) -> None:
        chain, placed = posture.chain, state.placed
        screws, points = np.empty((len(chain.which), 6)), chain.points_of(state)
        given = chain.which, state.arm.kinematics.slides, chain.units, placed.axes, placed.origins
        kernels.find_screws(*given, chain.ends, points, screws)
        self._springs = Springs(screws, chain.ends, points, chain.weights, chain.chords)

    def stiffness(self) -> float:
        """Mean diagonal of A^T A [m^2]."""
        return kernels.stiffness(self._springs)

    def covered(self, x: Array) -> Array:
        """What a step x (n,) covers of each error, (p, 3) [m]."""
        screws, ends, points, *_ = self._springs
        covered = np.empty_like(points)
        kernels.move_points(screws, ends, points, x, covered)
        return covered

    def step(self, errors: Array, damping: float, centre: Array, lower: Array, upper: Array) -> Array:
        """The x within a box that minimises |A x - e|^2 + damping |x - centre|^2, (n,).

        Args:
            errors: what points should cover, (p, 3) [m]; chords cover the differences.
            damping: above 0 [m^2].
            centre: (n,), in `Arm.joint_units`.
            lower: smallest x, (n,).
            upper: largest x, (n,).
        """
        n = len(centre)
        x, sides = np.empty(n), (centre > upper).astype(np.int8) - (centre < lower).astype(np.int8)
        kernels.minimise_in_box(self._springs, errors, np.full(n, damping), centre, lower, upper, sides, x)
        return x
