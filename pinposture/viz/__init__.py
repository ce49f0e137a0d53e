"""Visualization of runs: figures, a viewer in the browser, and animations in HTML files."""

from pinposture.viz.arm_figure import plot_arm
from pinposture.viz.drawing import visual_model
from pinposture.viz.meshcat import AnimationPage, Viewer, animate, save_html, view
from pinposture.viz.panels import (
    plot,
    plot_active_points,
    plot_clearance,
    plot_comparison,
    plot_point_errors,
    plot_posture_error,
)
from pinposture.viz.postures import plot_postures

__all__ = [
    "AnimationPage",
    "Viewer",
    "animate",
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
