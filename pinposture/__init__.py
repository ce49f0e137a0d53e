"""Posture control of modular hyper-redundant serial arms: draw a curve, and the arm takes its shape.

    import pinposture as pp

    arm = pp.Arm.from_template("RyRz", modules=20)
    curve = pp.Curve.helix(radius=0.06, pitch=0.15, turns=4)
    target = pp.resolve_targets(arm, curve)
    run = pp.track(arm, target, arm.random(rng))
    pp.plot(run)

SI units throughout: metres, radians, seconds.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pinposture.arm import (
    Adequacy,
    Arm,
    ArmState,
    Ellipsoid,
    JointLimits,
    JointSpec,
    ModuleTemplate,
    template,
)
from pinposture.control import (
    ConstrainedQP,
    Controller,
    EndEffector,
    JointPosture,
    Limits,
    Projection,
    Selection,
    Step,
    Switching,
    Tangents,
)
from pinposture.curve import Curve
from pinposture.errors import PostureError, PostureWarning
from pinposture.motion import Batch, Trajectory, track, track_many
from pinposture.scene import Box, Capsule, Cylinder, HalfSpace, Mesh, Scene, Sphere
from pinposture.target import Target, fit_points, resolve_targets

if TYPE_CHECKING:
    from pinposture.view import plot, plot_arm, plot_comparison, save_html, view

__version__ = "0.1.0"

__all__ = [
    "Adequacy",
    "Arm",
    "ArmState",
    "Batch",
    "Box",
    "Capsule",
    "ConstrainedQP",
    "Controller",
    "Curve",
    "Cylinder",
    "Ellipsoid",
    "EndEffector",
    "HalfSpace",
    "JointLimits",
    "JointPosture",
    "JointSpec",
    "Limits",
    "Mesh",
    "ModuleTemplate",
    "PostureError",
    "PostureWarning",
    "Projection",
    "Scene",
    "Selection",
    "Sphere",
    "Step",
    "Switching",
    "Tangents",
    "Target",
    "Trajectory",
    "fit_points",
    "plot",
    "plot_arm",
    "plot_comparison",
    "resolve_targets",
    "save_html",
    "template",
    "track",
    "track_many",
    "view",
]


def __getattr__(name: str) -> Any:
    # Matplotlib and meshcat take longer to import than everything else together: only when asked for.
    if name in ("plot", "plot_arm", "plot_comparison", "save_html", "view"):
        drawing = import_module("pinposture.view")
        return drawing if name == "view" else getattr(drawing, name)  # that package can be called
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
