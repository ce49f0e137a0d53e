"""Compiled kernels: passes along a chain, on plain arrays.

Whatever runs in every control cycle and cannot be put into a few NumPy calls. Kernels know arrays only, no
arm and no target; the rooms above say what the numbers mean. They are compiled by numba, see
`kernels.compiled`, and imported when first used: numba takes a while to start, and who only draws a curve does
not need it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pinposture.kernels.kinematics import jacobians as jacobians
    from pinposture.kernels.kinematics import placements as placements

_HOMES = {"placements": "kinematics", "jacobians": "kinematics"}


def __getattr__(name: str) -> object:
    """Import a kernel when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    kernel = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = kernel
    return kernel
