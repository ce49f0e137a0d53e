"""Posture control of modular hyper-redundant serial arms: draw a curve, and the arm takes its shape.

    import pinposture as pp

    arm = pp.Arm.from_template("RyRz", modules=20)
    curve = pp.Curve.helix(radius=0.06, pitch=0.15, turns=4)
    target = pp.resolve_targets(arm, curve)
    run = pp.track(arm, target, arm.random(rng))
    pp.plot(run)

SI units throughout: metres, radians, seconds.

Bad input raises a `PostureError` that names it. That includes numbers that can only be mistakes: above 1e30
in size, or between 0 and 1e-30; joint positions above 1e9; points farther than 1e6 arm lengths from the base;
arms of more than 5,000 moving joints, and descriptions of more than 10,001 links.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pinposture.arm import Arm, ArmState, Ellipsoid, Feasibility, JointLimits, JointSpec, ModuleTemplate
    from pinposture.arm.template import template
    from pinposture.collision import (
        Box,
        Capsule,
        Carried,
        CollisionModel,
        Cylinder,
        HalfSpace,
        Intrinsics,
        Map,
        Mesh,
        Mounting,
        Scan,
        Scene,
        Sphere,
        curve_around,
        weigh,
    )
    from pinposture.control import (
        Controller,
        EndEffector,
        Geodesic,
        JointPath,
        JointPosture,
        Limits,
        PointFilter,
        Projection,
        Selection,
        Step,
        Switching,
        Tangents,
        TimedPath,
        fit_points,
        follow,
        plan,
        retime,
    )
    from pinposture.control.hold import Hold, Support, assess_hold, assess_support
    from pinposture.control.reach import ReachedPosture, reach
    from pinposture.curve import Curve
    from pinposture.errors import PostureError, PostureWarning
    from pinposture.motion import (
        Batch,
        JointTrajectory,
        Log,
        Run,
        ShapeEstimator,
        Tracker,
        Trajectory,
        load,
        save,
    )
    from pinposture.motion.batch import track_many
    from pinposture.motion.identification import identify
    from pinposture.motion.touch import Touch
    from pinposture.motion.track import track
    from pinposture.placement import Target, resolve_targets
    from pinposture.task.carrier_feed import CarrierFeed
    from pinposture.task.find_path import find_path
    from pinposture.task.follow_leader import Leader, follow_leader, path_deviation
    from pinposture.task.keyframe import Keyframe
    from pinposture.task.keyframes import keyframe_reference
    from pinposture.task.perform import move_through, perform
    from pinposture.task.phases import Carrying, Phase, Release, TipGoal, Withdrawal
    from pinposture.task.retreat import Retreat, Retreats, can_retreat
    from pinposture.task.steering import Steering
    from pinposture.task.task import Task
    from pinposture.task.wrap import Grip, Wrapping, carry, unwrap, wrap
    from pinposture.viz import animate, plot, plot_arm, plot_comparison, save_html, view

__version__ = "0.1.0"

__all__ = [
    "Arm",
    "ArmState",
    "Batch",
    "Box",
    "Capsule",
    "Carried",
    "CarrierFeed",
    "Carrying",
    "CollisionModel",
    "Controller",
    "Curve",
    "Cylinder",
    "Ellipsoid",
    "EndEffector",
    "Feasibility",
    "Geodesic",
    "Grip",
    "HalfSpace",
    "Hold",
    "Intrinsics",
    "JointLimits",
    "JointPath",
    "JointPosture",
    "JointSpec",
    "JointTrajectory",
    "Keyframe",
    "Leader",
    "Limits",
    "Log",
    "Map",
    "Mesh",
    "ModuleTemplate",
    "Mounting",
    "Phase",
    "PointFilter",
    "PostureError",
    "PostureWarning",
    "Projection",
    "ReachedPosture",
    "Release",
    "Retreat",
    "Retreats",
    "Run",
    "Scan",
    "Scene",
    "Selection",
    "ShapeEstimator",
    "Sphere",
    "Steering",
    "Step",
    "Support",
    "Switching",
    "Tangents",
    "Target",
    "Task",
    "TimedPath",
    "TipGoal",
    "Touch",
    "Tracker",
    "Trajectory",
    "Withdrawal",
    "Wrapping",
    "animate",
    "assess_hold",
    "assess_support",
    "can_retreat",
    "carry",
    "curve_around",
    "find_path",
    "fit_points",
    "follow",
    "follow_leader",
    "identify",
    "keyframe_reference",
    "load",
    "move_through",
    "path_deviation",
    "perform",
    "plan",
    "plot",
    "plot_arm",
    "plot_comparison",
    "reach",
    "resolve_targets",
    "retime",
    "save",
    "save_html",
    "template",
    "track",
    "track_many",
    "unwrap",
    "view",
    "weigh",
    "wrap",
]

# Everything is imported when it is first asked for: who plans needs no matplotlib, who draws no solver.
_PACKAGES = {
    "arm": (
        "Feasibility",
        "Arm",
        "ArmState",
        "Ellipsoid",
        "JointLimits",
        "JointSpec",
        "ModuleTemplate",
        "template",
    ),
    "control": (
        "Geodesic",
        "Hold",
        "Controller",
        "EndEffector",
        "JointPath",
        "JointPosture",
        "Limits",
        "PointFilter",
        "Projection",
        "ReachedPosture",
        "Selection",
        "Step",
        "Support",
        "Switching",
        "Tangents",
        "TimedPath",
        "assess_hold",
        "assess_support",
        "fit_points",
        "follow",
        "plan",
        "reach",
        "retime",
    ),
    "curve": ("Curve",),
    "errors": ("PostureError", "PostureWarning"),
    "motion": (
        "Batch",
        "JointTrajectory",
        "Log",
        "Run",
        "ShapeEstimator",
        "Touch",
        "Tracker",
        "Trajectory",
        "identify",
        "load",
        "save",
        "track",
        "track_many",
    ),
    "collision": (
        "Box",
        "Capsule",
        "Carried",
        "CollisionModel",
        "Cylinder",
        "HalfSpace",
        "Intrinsics",
        "Map",
        "Mesh",
        "Mounting",
        "Scan",
        "Scene",
        "Sphere",
        "curve_around",
        "weigh",
    ),
    "placement": ("Target", "resolve_targets"),
    "task": (
        "CarrierFeed",
        "Carrying",
        "Grip",
        "can_retreat",
        "carry",
        "unwrap",
        "wrap",
        "Keyframe",
        "Leader",
        "Phase",
        "Release",
        "Retreat",
        "Retreats",
        "Steering",
        "Task",
        "TipGoal",
        "Withdrawal",
        "Wrapping",
        "find_path",
        "follow_leader",
        "keyframe_reference",
        "move_through",
        "path_deviation",
        "perform",
    ),
    "viz": ("animate", "plot", "plot_arm", "plot_comparison", "save_html", "view"),
}
_PACKAGE_OF = {name: package for package, names in _PACKAGES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _PACKAGES or name in ("editor", "sim"):  # as in `pp.placement.register_module_kinematics`
        return import_module(f"{__name__}.{name}")
    if name not in _PACKAGE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_PACKAGE_OF[name]}"), name)
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


# In a notebook, arms, targets and runs show themselves.
if "IPython" in sys.modules and (_shell := sys.modules["IPython"].get_ipython()) is not None:
    import_module(f"{__name__}.notebook").register(_shell)
