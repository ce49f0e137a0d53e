"""Where one module ends and the next begins (Section 4.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import InvalidValue

Array = NDArray[np.float64]


def module_sizes(axes: Array, revolute: NDArray[np.bool_], modules: int | Sequence[int] | None) -> list[int]:
    """Group the joints of a chain into modules.

    A module must be able to put its end on any curve through its base (Section 4.1). In the plane one
    joint does that; in space it takes two, with axes that are not parallel. Unless told otherwise, joints
    are therefore gathered from the base until a module has what it needs; what is left at the tip joins
    the last module.

    Args:
        axes: unit joint axes at the neutral configuration, (n, 3), world frame.
        revolute: True for a joint that turns, (n,).
        modules: joints per module, the same for all or one number each; None to choose.

    Returns:
        Number of joints of each module, from base to tip; the sum is n.

    Raises:
        InvalidValue: sizes that are not positive or do not add up to the number of joints.
    """
    n = len(axes)
    if modules is None:
        return _smallest_modules(axes, revolute)
    if isinstance(modules, int):
        if modules < 1 or n % modules:
            divisors = ", ".join(str(k) for k in range(1, n + 1) if n % k == 0)
            raise InvalidValue("modules (joints per module)", modules, f"a divisor of {n} joints: {divisors}")
        return [modules] * (n // modules)
    sizes = list(modules)
    if not sizes or any(not isinstance(size, int) or size < 1 for size in sizes) or sum(sizes) != n:
        raise InvalidValue("modules (sizes)", sizes, f"positive whole numbers that add up to {n} joints")
    return sizes


def _smallest_modules(axes: Array, revolute: NDArray[np.bool_]) -> list[int]:
    turning = axes[revolute]
    if len(turning) and np.all(np.linalg.norm(np.cross(turning, turning[0]), axis=1) < 1e-9):
        return [1] * len(axes)
    sizes: list[int] = []
    first = 0
    for u in range(1, len(axes)):
        if np.any(np.linalg.norm(np.cross(axes[first:u], axes[u]), axis=1) > 1e-3):
            sizes.append(u + 1 - first)
            first = u + 1
    left = len(axes) - first
    if left > 0 and sizes:
        sizes[-1] += left
    elif left > 0:
        sizes.append(left)
    return sizes
