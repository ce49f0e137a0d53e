"""Calls of the public functions with one value replaced, made in a process that may die of it.

    python tests/hostile_calls.py list                # the names of all cases
    python tests/hostile_calls.py run < names         # makes the calls; names each before, and how it ended

The calls are made from the signatures in `pinposture.__all__`: each parameter has an example by its name.
Every number in the examples, also within arrays, curves, targets, limits, scenes and keyframes, is replaced
in turn by each of `NUMBERS`, every argument by each of `OTHERS`. Files, control cycles and the command are
called in the same way, by the functions in `hostile_inputs.py`.
"""

from __future__ import annotations

import inspect
import math
import os
import resource
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import hostile_inputs
import numpy as np
import pinocchio as pin
from hostile_inputs import a_target, an_arm

import pinposture as pp
from pinposture import kernels
from pinposture.arm import Load, Weight
from pinposture.motion import DriveModel
from pinposture.schema import Declared
from pinposture.task.reference import Reference

NUMBERS = {
    "1e100": 1e100,
    "-1e154": -1e154,
    "1e200": 1e200,
    "1e308": 1e308,
    "1e-320": 1e-320,
    "inf": math.inf,
    "nan": math.nan,
    "whole": 10**400,
    "-1": -1,
    "text": "x",
}
RECORDS = ("Leader", "Intrinsics", "Mounting")
"""Classes that hold arguments, which are checked where they are used."""
OTHERS: dict[str, Any] = {"text": "x", "object": object(), "list": [], "number": 3, "none": None}
MEMORY = 3 << 30
"""Address space of a process beyond what it has at the start [bytes]; more is a fault."""


def a_path() -> Any:
    return pp.plan(an_arm().at(an_arm().straight()), a_target())


@cache
def a_fed_arm() -> pp.Arm:
    slide = pp.ModuleTemplate("Feed", (pp.JointSpec("x", "prismatic", 0.0, 0.3),), (0.03,))
    return pp.Arm.from_modules([slide, *[pp.template("RyRz")] * 3])


def a_trajectory_on_a_slide() -> pp.JointTrajectory:
    positions = [(0.0, 0.1), (0.0005, 0.2), (0.001, 0.1)]
    return pp.JointTrajectory.from_positions(("slide", "hinge"), positions, 0.1, ("m", "rad"))


def a_log() -> pp.Log:
    times = 0.05 * np.arange(60)
    sent = 0.5 * np.sin(3.0 * times[:, None] + np.arange(6))
    return pp.Log(times, sent, times, 0.9 * sent, an_arm().joint_names, 0.2 * sent, (0.0, 0.0, -9.81), 0.1)


def a_map() -> pp.Map:
    mapped = pp.Map(0.05, an_arm())
    mapped.measure(np.zeros(6), 0.0)
    mapped.measure(np.full(6, 0.1), 0.9)
    return mapped


@cache
def a_hand() -> tuple[pp.Arm, pp.Scene]:
    """An arm that is just long enough to wrap around a can."""
    can = pp.Capsule((0.2, 0.06, -0.05), (0.2, 0.06, 0.05), 0.03)
    scene = pp.Scene({"can": can, "ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)}, touchable=["can"])
    return pp.Arm.from_template("RyRz", modules=9).with_effort(5.0), scene


@cache
def a_grip() -> pp.Grip:
    arm, scene = a_hand()
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=5.0)
    return pp.wrap(arm, "can", scene, arm.straight(), limits, turns=0.5)


class FromPoints(NamedTuple):
    """A curve by its control points, so that they can be replaced."""

    points: Any


@cache
def examples() -> dict[str, Any]:
    """A value for each parameter, by its name, or by the name of the function and its own."""
    arm = an_arm()
    line = FromPoints([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0), (0.4, 0.0, 0.0)])
    limits = pp.Limits(step=0.1, dt=0.02, velocity=1.0, acceleration=5.0, jerk=100.0)
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)}, margin=0.01)
    keyframes = [pp.Keyframe(joints=(0.0,) * 6), pp.Keyframe(joints=(0.1,) * 6, duration=1.0)]
    path = a_path()
    return {
        "arm": arm,
        "JointTrajectory.compensated.arm": arm.with_stiffness(50.0),
        "Run.reported.name": "scale",
        "Run.reported.default": 1.0,
        "state": arm.at(np.full(6, 0.2)),
        "target": a_target(),
        "targets": a_target(),
        "curve": line,
        "path": line,
        "Mesh.path": Path("mesh.stl"),
        "Scan.path": Path("scan.ply"),
        "Scene.displacement.before": scene,
        "Scene.displacement.reach": 0.1,
        "Scene.depth.name": "ball",
        "q": np.full(6, 0.1),
        "q0": np.full(6, 0.1),
        "CollisionModel.q0": np.full(6, 0.1),
        "starts": np.full((2, 6), 0.1),
        "start": np.full(6, 0.1),
        "end": np.full(6, 0.3),
        "find_path.start": (0.0, 0.0, 0.0),
        "curve_around.obstacle": pp.Sphere((0.4, 0.1, 0.0), 0.1),
        "curve_around.start": (0.0, 0.0, 0.0),
        "gap": 0.03,
        "motions": [pp.JointTrajectory.from_configurations(arm, np.zeros((3, 6)), 0.1)],
        "find_path.goal": (0.1, 0.0, 0.0),
        "find_path.direction": (1.0, 0.0, 0.0),
        "find_path.budget": 0.5,
        "goal": (0.1, 0.03, 0.03),
        "direction": (1.0, 0.0, 0.0),
        "reach.budget": 0.5,
        "density": 1200.0,
        "masses": {},
        "mass": 0.5,
        "com": (0.01, 0.0, 0.02),
        "beside": ["ball"],
        "onto": ["ball"],
        "Carrying.turn": (0.1, 0.2, 0.3),
        "Wrapping.obstacle": "ball",
        "squeeze": 0.1,
        "force": None,
        "wrap.arm": a_hand()[0],
        "wrap.scene": a_hand()[1],
        "wrap.obstacle": "can",
        "wrap.q0": np.zeros(18),
        "wrap.turns": 0.5,
        "grip": a_grip(),
        "displacement": (0.0, 0.0, 0.02),
        "q_end": np.zeros(18),
        "carried": {"ball": pp.Carried("module_02")},
        "frame": "module_02",
        "inertia": (1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0),
        "mass_per_length": 0.1,
        "Arm.with_cable.start": "module_01",
        "Arm.with_cable.end": 2,
        "effort": 7.0,
        "stiffness": 50.0,
        "q_command": np.full(6, 0.1),
        "gravity": (0.0, 0.0, -9.81),
        "weight": Weight(payloads=(Load(0.5),), effort=7.0, stiffness=50.0),
        "Arm.inverse_dynamics.q": np.full((2, 6), 0.1),
        "Arm.inverse_dynamics.velocities": np.full((2, 6), 0.1),
        "Arm.inverse_dynamics.accelerations": np.full((2, 6), 0.1),
        "EndEffector.weight": 0.5,
        "JointPosture.weight": 0.5,
        "Tangents.weight": 0.5,
        "spec": arm.spec,
        "plan.budget": 0.5,
        "dq": np.full(6, 0.01),
        "previous": np.full(6, 0.01),
        "positions": np.full(6, 0.1),
        "near": np.full(6, 0.1),
        "resolve_targets.near": None,
        "position_limits": np.array([np.full(6, -1.0), np.full(6, 1.0)]),
        "limits": limits,
        "scene": scene,
        "interval": 0.05,
        "speed": 0.05,
        "depth": 0.02,
        "keyframes": keyframes,
        "points": arm.at(np.full(6, 0.1)).points,
        "weights": np.ones(3),
        "measured": arm.at(np.full(6, 0.1)).points,
        "q_measured": np.full(6, 0.1),
        "dt": 0.02,
        "velocity": np.full(6, 0.1),
        "tolerance": 1e-6,
        "base_placement": np.eye(4),
        "name": "RyRz",
        "modules": 3,
        "split": 2,
        "Arm.from_modules.modules": [pp.template("RyRz")],
        "link_lengths": (0.02, 0.03),
        "source": arm.urdf,
        "locked": {"m02_j1_y": 0.1},
        "Arm.load.tip": "tip",
        "Arm.load.split": 1,
        "Run.scene_in.row": 1,
        "assess_support.state": arm.with_effort(5.0).at(np.full(6, 0.2)),
        "couplings": {},
        "characteristic_length": 0.1,
        "a": (0.0, 0.0, 0.0),
        "b": (0.2, 0.1, 0.0),
        "control_points": [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.1, 0.0), (0.4, 0.0, 0.0)],
        "radius": 0.1,
        "pitch": 0.05,
        "turns": 1.0,
        "phase": 0.1,
        "axis": (1.0, 0.0, 0.0),
        "center": (0.1, 0.3, 0.2),
        "xyz": [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.1, 0.0), (0.4, 0.0, 0.0)],
        "smoothing": 0.001,
        "s": 0.1,
        "u": 0.5,
        "n": 10,
        "count": 8,
        "reach.count": 1,
        "within": 0.1,
        "offsets": np.full((2, 6), 0.01),
        "time": np.array([0.0, 1.0, 2.0]),
        "Keyframe.time": None,
        "times": np.array([0.0, 0.5]),
        "Scene.after.time": 0.1,
        "noise": 1e-4,
        "size": (0.1, 0.1, 0.1),
        "Capsule.start": (0.1, 0.3, 0.2),
        "Capsule.end": (0.2, 0.3, 0.2),
        "Cylinder.start": (0.1, 0.3, 0.2),
        "Cylinder.end": (0.2, 0.3, 0.2),
        "point": (0.0, 0.0, -1.0),
        "normal": (0.0, 0.0, 1.0),
        "vertices": np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)]),
        "faces": np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], dtype=np.int32),
        "Scan.points": np.random.default_rng(0).uniform(0.3, 0.4, (30, 3)),
        "rotation": np.eye(3),
        "TipGoal.rotation": None,
        "distance": 0.1,
        "position": (0.1, 0.0, 0.1),
        "directions": np.array([(1.0, 0.0, 0.0)] * 3),
        "first": 0,
        "last": 1,
        "lower": -1.0,
        "upper": 1.0,
        "joints": [pp.JointSpec("y"), pp.JointSpec("z")],
        "JointPosture.joints": None,
        "ArmState.points": None,
        "ArmState.frame": "module_01",
        "Tangents.points": None,
        "JointSpec.velocity": 2.0,
        "Keyframe.joints": (0.1,) * 6,
        "joint_names": ("a", "b"),
        "JointTrajectory.from_positions.positions": np.zeros((3, 2)),
        "log": a_log(),
        "can_retreat.q": np.array([np.zeros(6), np.full(6, 0.1)]),
        "can_retreat.out": None,
        "failed": "m02_j1_y",
        "postures": [1],
        "Arm.with_locked.positions": {"m02_j1_y": 0.2},
        "deviation": 0.1,
        "drift": 0.3,
        "give": 0.05,
        "give_time": 2.0,
        "outliers": 1e-4,
        "change": np.full(6, 0.01),
        "side": "motor",
        "at": [0, 1],
        "turn_noise": 0.01,
        "ShapeEstimator.add_encoders.positions": np.full(6, 0.11),
        "ShapeEstimator.add_orientations.rotations": np.array([np.eye(3), np.eye(3)]),
        "ShapeEstimator.add_orientations.mounting": np.eye(3),
        "ShapeEstimator.add_tilts.up": np.array([(0.0, 0.1, 1.0), (0.0, 0.0, 1.0)]),
        "ShapeEstimator.add_tilts.mounting": np.eye(3),
        "ShapeEstimator.add_points.points": np.array([(0.1, 0.0, 0.0), (0.2, 0.0, 0.01)]),
        "ShapeEstimator.add_curvatures.curvatures": np.array([(0.0, 1.0, 1.0), (0.0, 1.0, 1.0)]),
        "ShapeEstimator.add_placement.placement": pin.SE3.Identity(),
        "ShapeEstimator.add_placement.at": -1,
        "ShapeEstimator.move_base.placement": pin.SE3.Identity(),
        "carrier": an_arm(),
        "CarrierFeed.q": np.array([0.1, 0.3, 0.2, -0.4, 0.2, 0.5]),
        "CarrierFeed.stroke": 0.001,
        "CarrierFeed.at.s": 0.0005,
        "CarrierFeed.offsets.s": 0.0005,
        "CarrierFeed.rates.s": 0.0005,
        "CarrierFeed.joint_trajectory.trajectory": a_trajectory_on_a_slide(),
        "CarrierFeed.find.q": np.array([0.1, 0.3, 0.2, -0.4, 0.2, 0.5]),
        "Steering.arm": a_fed_arm(),
        "Steering.start": None,
        "Steering.curvature": (1.0, -2.0),
        "Tracker.drives": DriveModel(),
        "Tracker.touch": pp.Touch(threshold=0.5),
        "threshold": 0.5,
        "assess_hold.obstacle": "ball",
        "friction": 0.5,
        "torques": np.full(6, 0.1),
        "command_time": a_log().command_time,
        "commands": a_log().commands,
        "Log.time": a_log().time,
        "Log.positions": a_log().positions,
        "Log.joint_names": an_arm().joint_names,
        "Log.effort": a_log().effort,
        "payload": 0.1,
        "JointTrajectory.from_configurations.q": np.zeros((3, 6)),
        "path_deviation.q": np.zeros((3, 6)),
        "path_deviation.start": np.zeros(6),
        "follow_leader.start": None,
        "JointTrajectory.sampled.dt": 0.1,
        "retime.path": path,
        "follow.path": pp.retime(path, limits),
        "reference": pp.keyframe_reference(arm, keyframes, 0.05),
        "obstacles": {"ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)},
        "velocities": {"ball": (0.1, 0.0, 0.0)},
        "placements": {"ball": (0.0, 0.1, 0.0)},
        "turn": np.eye(3),
        "translation": (0.0, 0.1, 0.0),
        "max_steps": 30,
        "Limits.step": 0.1,
        "Limits.velocity": 1.0,
        "Limits.acceleration": 5.0,
        "Limits.jerk": 100.0,
        "Limits.dt": 0.02,
        "lead": 0.0,
        "motion": (keyframes[0], keyframes[1]),
        "jobs": 1,
        "compensate": False,
        "rng": 0,
        "seed": 0,
        "tip": pp.EndEffector(position=(0.1, 0.0, 0.1)),
        "EndEffector.point": -1,
        "Keyframe.curve": None,
        "Keyframe.tip": None,
        "Keyframe.duration": 1.0,
        "Curve.trimmed.start": 0.05,
        "Curve.trimmed.end": 0.2,
        "timeout": 1.0,
        "deadline": math.inf,
        "planning": "thread",
        "max_rate": 1.0,
        "length": 0.1,
        "resolution": 0.05,
        "Map.center": (0.0, 0.0, 0.0),
        "reach": 0.5,
        "own_margin": 0.01,
        "forget": 5.0,
        "unknown": "free",
        "sensor_range": (0.1, 2.0),
        "content": None,
        "Map.measure.time": 1.0,
        "Map.configuration_at.time": 0.5,
        "Map.add_cloud.time": 0.5,
        "Map.add_depth.time": 0.5,
        "Map.advance.time": 0.5,
        "Map.add_cloud.points": np.array([(0.1, 0.2, 0.3), (0.2, 0.1, 0.3)]),
        "Map.states.points": np.array([(0.1, 0.2, 0.3), (0.2, 0.1, 0.3)]),
        "Map.add_depth.depth": np.full((4, 5), 0.3),
        "camera": pp.Intrinsics(4.0, 4.0, 2.0, 1.5),
        "sensor": pin.SE3.Identity(),
        "mounting": pp.Mounting("module_02", pin.SE3.Identity()),
        "Mounting.placement": pin.SE3.Identity(),
        "fx": 4.0,
        "fy": 4.0,
        "cx": 2.0,
        "cy": 1.5,
        "maps": {},
        "before": scene,
        **hostile_inputs.examples(),
    }


SUBJECTS: dict[str, Callable[[], Any]] = {
    "Arm": lambda: an_arm().with_effort(7.0).with_stiffness(50.0),
    "ArmState": lambda: an_arm().with_effort(7.0).with_stiffness(50.0).at(np.full(6, 0.2)),
    "CarrierFeed": lambda: pp.CarrierFeed(an_arm(), examples()["CarrierFeed.q"], 0.001),
    "CollisionModel": lambda: pp.CollisionModel(an_arm(), examples()["scene"]),
    "Curve": lambda: pp.Curve.spline(examples()["control_points"]),
    "EndEffector": lambda: pp.EndEffector(position=(0.1, 0.0, 0.1)),
    "Geodesic": pp.Geodesic,
    "JointPosture": lambda: pp.JointPosture(np.zeros(6)),
    "JointTrajectory": lambda: pp.JointTrajectory.from_configurations(an_arm(), np.zeros((3, 6)), 0.1),
    "Limits": lambda: examples()["limits"],
    "Map": a_map,
    "ModuleTemplate": lambda: pp.template("RyRz"),
    "PointFilter": lambda: pp.PointFilter(an_arm(), 0.02, 1e-4),
    "Projection": pp.Projection,
    "Run": lambda: pp.track(an_arm(), a_target(), np.full(6, 0.1)),
    "Scan": lambda: pp.Scan(examples()["Scan.points"]),
    "Scene": lambda: examples()["scene"],
    "Selection": pp.Selection,
    "ShapeEstimator": lambda: pp.ShapeEstimator(an_arm(), np.full(6, 0.1)),
    "Steering": lambda: pp.Steering(a_fed_arm(), examples()["limits"]),
    "Sphere": lambda: pp.Sphere((0.1, 0.3, 0.2), 0.05),
    "Switching": pp.Switching,
    "Tangents": lambda: pp.Tangents(np.array([(1.0, 0.0, 0.0)] * 3)),
    "Target": a_target,
    "Tracker": lambda: pp.Tracker(an_arm(), limits=examples()["limits"]),
}
"""Objects whose methods are called."""

RESULTS = (
    *("Batch", "Run", "Trajectory", "JointTrajectory", "ReachedPosture", "JointPath", "TimedPath"),
    *(
        "ArmState",
        "JointLimits",
        "Step",
        "Ellipsoid",
        "Feasibility",
        "Grip",
        "Hold",
        "Support",
        "Retreat",
        "Retreats",
        "PostureError",
        "PostureWarning",
    ),
)
"""What functions return; users do not make them."""
ON_FILES = (
    *("load", "save", "save_html", "view", "animate", "plot", "plot_arm", "plot_comparison", "template"),
    *("Curve.load", "Curve.save", "Mesh.load", "Scan.load", "Scene.load", "Scene.save", "Task.load"),
    *("Arm.from_dict", "Arm.from_spec", "Arm.from_model", "Curve.from_dict", "Scene.from_dict", "Log.read"),
)
"""What reads and writes, which has tests of its own."""
IN_LOOPS = (
    *(
        "Arm.integrate",
        "Arm.difference",
        "ArmState.moved",
        "Arm.require_near",
        "CollisionModel.contacts_along",
    ),
    *(
        "CollisionModel.clear_of_maps",
        "CollisionModel.count_movers",
        "CollisionModel.grow_trees",
        "CollisionModel.keep_distance",
        "CollisionModel.nearest",
        "CollisionModel.minimum_along",
    ),
    *("CollisionModel.minimum_on_motions", "Projection.step_with", "Projection.posture_control_matrix"),
    *(
        "Geodesic.start",
        "Geodesic.objective",
        "Geodesic.keep_clear",
        "Geodesic.with_offset",
        "follow",
        "retime",
    ),
)
"""What solvers call on values that they have checked."""
ON_OTHERS = ("Arm", "Curve", "Controller", "Target", "Tangents.of_curve", "Tracker.step")
NEED_A_FEED = ("follow_leader", "path_deviation")
HOOKS = frozenset(name for name in vars(Declared) if not name.startswith("_"))
"""What the reader and the writer of files call on tables that they have checked."""
LEFT_OUT = {*RESULTS, *ON_FILES, *IN_LOOPS, *ON_OTHERS, *NEED_A_FEED}
"""What is not called from its signature; `hostile_inputs.CALLS` reads files, makes cycles and has a feed."""


def public_calls() -> dict[str, Callable[..., Any]]:
    """The functions to call, by name; methods are of `SUBJECTS`, and made anew for each call."""
    found: dict[str, Callable[..., Any]] = {}
    for name in pp.__all__:
        value = getattr(pp, name)
        if name not in LEFT_OUT:
            found[name] = value
        if not inspect.isclass(value):
            continue
        for method in sorted(vars(value)):
            kind = inspect.getattr_static(value, method)
            called = f"{name}.{method}"
            if (
                method.startswith("_")
                or called in LEFT_OUT
                or (method in HOOKS and issubclass(value, Declared))
            ):
                continue
            if isinstance(kind, classmethod | staticmethod):
                found[called] = getattr(value, method)
            elif inspect.isfunction(kind) and name in SUBJECTS:
                found[called] = kind
    return found | hostile_inputs.CALLS


def arguments_of(name: str, function: Callable[..., Any]) -> dict[str, Any]:
    """An example of each argument; without those that have neither an example nor a default."""
    given: dict[str, Any] = {}
    short = name.split(".", maxsplit=1)[0]
    known = examples()
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in ("self", "jobs") or parameter.kind == parameter.VAR_KEYWORD:
            continue
        for key in (f"{name}.{parameter.name}", f"{short}.{parameter.name}", parameter.name):
            if key in known:
                given[parameter.name] = known[key]
                break
        else:
            if parameter.default is not parameter.empty:
                given[parameter.name] = parameter.default
    return given


def places(value: Any) -> Iterator[tuple[Any, ...]]:
    """Where the numbers of a value are, as keys and indices; only the first and the last of an array."""
    if isinstance(value, bool | np.bool_ | str | pp.Arm | pp.ArmState | pp.Grip | Reference | type(None)):
        return
    if isinstance(value, int | float | np.number):
        yield ()
    elif isinstance(value, np.ndarray):
        if value.size and value.dtype.kind in "fi":
            yield (0,) * value.ndim
            yield (-1,) * value.ndim
    elif isinstance(value, FromPoints):
        yield from (("points", *place) for place in places(value.points))
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from ((key, *place) for place in places(each))
    elif isinstance(value, list | tuple):
        for index in sorted({0, len(value) - 1}) if value else ():
            yield from ((index, *place) for place in places(value[index]))
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            if field.init and not isinstance(getattr(value, field.name), pp.Curve):
                yield from ((field.name, *place) for place in places(getattr(value, field.name)))


def replaced(value: Any, place: tuple[Any, ...], by: Any) -> Any:
    """The value with another at one place."""
    if not place:
        return by
    key, *rest = place
    if isinstance(value, np.ndarray):
        fits = isinstance(by, float) and value.dtype.kind == "f"
        changed = value.copy() if fits else value.astype(object)
        changed[place] = by
        return changed
    if isinstance(value, FromPoints):
        return FromPoints(replaced(value.points, tuple(rest), by))
    if isinstance(value, Mapping):
        return {**value, key: replaced(value[key], tuple(rest), by)}
    if isinstance(value, list | tuple):
        listed = list(value)
        listed[key] = replaced(listed[key], tuple(rest), by)
        return listed if isinstance(value, list) else tuple(listed)
    return replace(value, **{key: replaced(getattr(value, key), tuple(rest), by)})


def cases() -> list[str]:
    """The names of all cases: function, argument and place in it, value."""
    found = []
    for name, function in public_calls().items():
        found.append(f"{name}||")
        for argument, value in arguments_of(name, function).items():
            for place in places(value):
                where = ".".join(map(str, (argument, *place)))
                found += [f"{name}|{where}|{number}" for number in NUMBERS]
            if not (isinstance(value, str) and name in hostile_inputs.CALLS):
                found += [f"{name}|{argument}|!{other}" for other in OTHERS]
    return found


def finite(value: Any, depth: int = 0) -> bool:
    """Whether no NaN is in a result."""
    if isinstance(value, float):
        return not math.isnan(value)
    if isinstance(value, np.ndarray):
        return value.dtype.kind != "f" or not np.isnan(value).any()
    if isinstance(value, pp.Curve | pp.Arm | pp.ArmState) or depth > 3:
        return True
    if isinstance(value, Mapping):
        return all(finite(each, depth + 1) for each in value.values())
    if isinstance(value, list | tuple):
        return all(finite(each, depth + 1) for each in value)
    return True


def make_call(case: str) -> str:
    """Make the call of a case; return "fine" or what is wrong with how it ended."""
    name, where, number = case.split("|")
    function = public_calls()[name]
    given = arguments_of(name, function)
    try:
        if where:
            argument, *rest = where.split(".")
            if number.startswith("!"):
                given[argument] = OTHERS[number[1:]]
            else:
                place = next(
                    each for each in places(given[argument]) if ".".join(map(str, each)) == ".".join(rest)
                )
                given[argument] = replaced(given[argument], place, NUMBERS[number])
        for argument, value in given.items():
            if isinstance(value, FromPoints):
                given[argument] = pp.Curve.spline(value.points)
        subject = [SUBJECTS[name.split(".")[0]]()] if "self" in inspect.signature(function).parameters else []
        result = function(*subject, **given)
        held = name.partition("|")[0] in RECORDS
        return "fine" if held or finite(result) else "NaN in the result"
    except pp.PostureError as error:
        return "fine" if where else f"{type(error).__name__}: {error}"
    except Exception as error:  # what is looked for
        at = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {str(error)[:80]!r} at {Path(at.filename).name}:{at.lineno}"


def main() -> None:
    warnings.simplefilter("ignore")
    os.chdir(tempfile.mkdtemp())
    if sys.argv[1] == "list":
        sys.stdout.write("\n".join(cases()))
        return
    kernels.load()
    a_path()
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    grown = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (grown + MEMORY, grown + MEMORY))
    for case in sys.stdin.read().split("\n"):
        if case:
            answers.write(f"begin {case}\n")
            answers.write(f"end {case} -> {make_call(case)}\n")


if __name__ == "__main__":
    main()
