"""Operate an arm live: what an operator holds in a page moves the tip, and else the arm holds.

The page needs the extra `editor`, the simulated arm the extra `sim`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pinposture.operate.control import Control, Order
from pinposture.operate.operation import Operation, Shown
from pinposture.operate.simulated import SimulatedArm

if TYPE_CHECKING:
    from pinposture.operate.page import LivePage

__all__ = ["Control", "LivePage", "Operation", "Order", "Shown", "SimulatedArm"]


def __getattr__(name: str) -> Any:
    if name != "LivePage":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from pinposture.editor import Editor  # noqa: F401  # says what to install if it is missing
    from pinposture.operate.page import LivePage

    return LivePage
