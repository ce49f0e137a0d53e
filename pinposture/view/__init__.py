"""How people see a run: figures, a viewer in the browser, animations in a file."""

import sys
from types import ModuleType
from typing import Any

from pinposture.view.anatomy import plot_arm
from pinposture.view.clearance import plot_clearance
from pinposture.view.html import save_html
from pinposture.view.panels import plot_active_points, plot_point_errors, plot_posture_error
from pinposture.view.plots import plot, plot_comparison
from pinposture.view.run_postures import plot_postures
from pinposture.view.viewer import Viewer, view

__all__ = [
    "Viewer",
    "plot",
    "plot_active_points",
    "plot_arm",
    "plot_clearance",
    "plot_comparison",
    "plot_point_errors",
    "plot_posture_error",
    "plot_postures",
    "save_html",
    "view",
]


class _View(ModuleType):
    """Lets `pinposture.view(...)` work once this package is imported, which then goes by the same name."""

    def __call__(self, *args: Any, **kwargs: Any) -> Viewer:
        return view(*args, **kwargs)


sys.modules[__name__].__class__ = _View
