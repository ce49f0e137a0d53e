"""How people see a run: figures, a viewer in the browser, animations in a file."""

from pinposture.viz.arm_figure import plot_arm
from pinposture.viz.drawing import visual_model
from pinposture.viz.html import save_html
from pinposture.viz.meshcat import Viewer, view
from pinposture.viz.panels import plot_active_points, plot_clearance, plot_point_errors, plot_posture_error
from pinposture.viz.plots import plot, plot_comparison
from pinposture.viz.postures import plot_postures

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
    "visual_model",
]
