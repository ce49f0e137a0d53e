"""Does a change of the code leave every number as it was? 300 seeded runs, saved before and compared after.

    python -m benchmarks.same_results --save before.npz      # in the tree as it was
    python -m benchmarks.same_results --compare before.npz   # in the tree as it is now

Arms, controllers, limits, scenes, streamed targets, task files, paths to follow, curves to take and points to
fit: of each run the configuration of every step is kept, and what else comes out of it: times, target points,
distances. No run looks at a clock or uses a second thread, and all random numbers are drawn here, by numpy: a
run that is repeated on the same machine is the same bit for bit.
"""

from __future__ import annotations

import os

# Before numpy is imported: sums are added up in one order only if one thread does it.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import hashlib
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import pinposture as pp
from benchmarks.baselines import register_baselines
from pinposture.collision import pipe, pipe_axis

register_baselines()

Array = NDArray[np.float64]
Found = dict[str, NDArray[Any]]

TOLERANCE = 1e-10
"""Largest difference of numbers that count as equal."""

SHOWN = 40
"""The most runs that are listed by name."""

TASKS = Path(__file__).resolve().parents[1] / "examples" / "tasks"
ROBOTS = next(
    (at for up in Path(pin.__file__).parents if (at := up / "share/example-robot-data/robots").is_dir()),
    Path(),
)

EXAMPLES = """
examples:
  python -m benchmarks.same_results --list
  python -m benchmarks.same_results --save before.npz
  python -m benchmarks.same_results --compare before.npz
  python -m benchmarks.same_results --compare before.npz --only 'track|stream'
  python -m benchmarks.same_results --only tasks/keyframes      # how long do these take?

Exit code 1 if a run differs, is missing or is new.
"""


# The names of the library that this script needs and that may change.

CONTROLLERS: dict[str, Any] = {
    "default": "geodesic",
    "selection": "selection",
    "projection": "projection",
    "switching": "switching",
    "joint": "joint",
    "pinv": "pinv",
    "task-constraints": "task-constraints",
    "extended": "extended",
    "augmented": "augmented",
    "dls": "dls",
    "lm": "lm",
}
"""Controllers by the names that runs are called by."""


def default(scene: pp.Scene | None = None, joint_weight: float = 0.2, relative: float = 1.0, tasks: Any = ()):
    """The default controller with parameters."""
    return pp.Geodesic(joint_weight=joint_weight, relative_position_weight=relative, tasks=tasks, scene=scene)


def tip_task(**values: Any) -> pp.EndEffector:
    """A task of the tip."""
    return pp.EndEffector(
        position=values.get("position"),
        pose=values.get("pose"),
        weight=values.get("weight", 1.0),
        priority=values.get("first", False),
        direction_only=values.get("direction", False),
    )


def tracker(arm: pp.Arm, controller: Any, limits: pp.Limits, scene: pp.Scene | None, velocity: bool):
    """A streaming controller."""
    interface = "velocity" if velocity else "position"
    return pp.Tracker(
        arm,
        controller,
        limits,
        scene,
        interface=interface,
        feedback_time_constant=0.2,
        max_tracking_error=0.4,
        resync_time=0.1,
    )


def of_run(run: pp.Run) -> Found:
    """What is kept of a run."""
    kept = {"q": run.q, "errors": run.point_errors}
    return {**kept, "clearance": run.clearance} if run.scene is not None else kept


def of_motion(motion: pp.Trajectory) -> Found:
    """What is kept of a motion in time."""
    return {**of_run(motion.run), "time": motion.time, "plan": motion.plan_time, "targets": motion.targets}


def of_reference(reference: Any) -> Found:
    """What is kept of the motion that is asked for."""
    return {"q": reference.start + 0.0, "offsets": reference.offsets, "time": reference.times}


def of_target(target: pp.Target) -> Found:
    """What is kept of a target."""
    kept = {"q": target.q, "targets": target.points, "s": target.parameters, "residual": target.residual}
    return {name: value for name, value in kept.items() if value is not None}


def of_state(state: pp.ArmState) -> Found:
    """What is kept of an arm at a configuration."""
    kept = {"q": state.q, "points": state.points, "rotations": state.rotations}
    return {**kept, "jacobians": state.jacobians, "manipulability": state.manipulability()}


# Arms.


def _template(name: str, modules: int, links: tuple[float, ...] | None = None) -> Callable[[], pp.Arm]:
    return lambda: pp.Arm.from_template(name, modules, links)


def _chain(name: str, *joints: tuple[Any, ...], length: float = 0.1, cut: Any = None) -> Callable[[], pp.Arm]:
    """An arm of joints (axis, lower, upper, type), each with a link of that length."""
    specs = [
        pp.JointSpec(axis, type=kind, lower=lower, upper=upper)
        if kind != "continuous"
        else pp.JointSpec(axis, kind)
        for axis, lower, upper, kind in ((*each, "revolute")[:4] for each in joints)
    ]
    if cut is None:
        return lambda: pp.Arm.from_modules([pp.ModuleTemplate(name, specs, [length] * len(specs))])
    ends = np.cumsum(cut)
    parts = [specs[end - size : end] for end, size in zip(ends, cut, strict=True)]
    return lambda: pp.Arm.from_modules(
        [pp.ModuleTemplate(f"{name}{k}", part, [length] * len(part)) for k, part in enumerate(parts)]
    )


def _fed() -> pp.Arm:
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.6, velocity=0.1)
    return pp.Arm.from_modules([pp.ModuleTemplate("Feed", (slide,), (0.05,)), *[pp.template("RyRz")] * 8])


def _fed_planar() -> pp.Arm:
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.5, velocity=0.1)
    return pp.Arm.from_modules([pp.ModuleTemplate("Feed", (slide,), (0.1,)), *[pp.template("Rz")] * 8])


def _placed() -> pp.Arm:
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 1.1), np.array([0.2, -0.1, 0.4]))
    return pp.Arm.from_template("RyRz", 8, base_placement=turned)


def _robot(file: str, **options: Any) -> Callable[[], pp.Arm]:
    return lambda: pp.Arm.load(ROBOTS / file, **options)


YAW, BEND, ROLL = ("z", -2.8, 2.8), ("y", -1.5, 1.5), ("x", -1.5, 1.5)
DRIVE = (-1e6, 1e6, "prismatic")
TURN = (None, None, "continuous")

ARMS: dict[str, Callable[[], pp.Arm]] = {
    "ryrz3": _template("RyRz", 3),
    "ryrz5": _template("RyRz", 5),
    "ryrz8": _template("RyRz", 8),
    "ryrz20": _template("RyRz", 20),
    "ryrz40": _template("RyRz", 40),
    "ryrz10-unequal": _template("RyRz", 10, (0.06, 0.03)),
    "rzry10": _template("RzRy", 10),
    "planar5": _template("Rz", 5),
    "planar12": _template("Rz", 12),
    "planar2x6": _template("RzRz", 6),
    "planar3x4": _template("RzRzRz", 4),
    "narrow6": lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.7)] * 6),
    "mixed6": lambda: pp.Arm.from_modules([pp.template("RyRz"), pp.template("RzRy")] * 3),
    "placed8": _placed,
    "unrepeating12": _chain(
        "u", YAW, ROLL, *[("y", -0.5 - 0.05 * k, 0.6 + 0.03 * k) for k in range(10)], cut=[3] * 4
    ),
    "yaw-bends9": _chain("b", *[YAW, BEND, BEND] * 3, cut=[3] * 3),
    "roll-bends8": _chain("r", *[ROLL, BEND, YAW, BEND] * 2, cut=[2] * 4),
    "endless8": _chain("e", *[("z", *TURN), ("y", *TURN)] * 4, cut=[2] * 4),
    "driven8": _chain("d", ("x", *DRIVE), ("y", *DRIVE), *[YAW, BEND] * 4, cut=[4, 2, 2, 2]),
    "telescope6": _chain("t", *[YAW, BEND, ("x", 0.0, 0.1, "prismatic")] * 2, cut=[3, 3]),
    "fed8": _fed,
    "panda": _robot("panda_description/urdf/panda.urdf"),
    "xarm7": _robot("xarm_description/urdf/xarm7.urdf"),
    "ur5": _robot("ur_description/urdf/ur5_robot.urdf"),
    "talos-arm": _robot("talos_data/robots/talos_left_arm.urdf"),
}
"""Arms by the names that runs are called by; the last four come with the package example-robot-data."""


@cache
def arm_named(name: str) -> pp.Arm:
    """An arm of the table, or one that only follows a leader; made once."""
    return _fed_planar() if name == "fed-planar8" else ARMS[name]()


# What is drawn: the same numbers for the same names, whatever the library does.


def stream(*names: object) -> np.random.Generator:
    """Random numbers for one purpose."""
    digest = hashlib.sha256(" ".join(map(str, names)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


def within(arm: pp.Arm, positions: Array) -> Array:
    """The configuration of joint positions (nv,) that are cut at the limits."""
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))


def smooth(arm: pp.Arm, amplitude: float, *names: object) -> Array:
    """A posture that changes slowly along the arm: waves in every second joint; the rest is straight."""
    rng, columns = stream(*names), arm.columns
    along = np.linspace(0.0, 1.0, len(columns))
    waves = np.zeros(len(columns))
    for parity, number in product((0, 1), (1, 2, 3)):
        wave = rng.normal() / number * np.sin(np.pi * number * along + rng.uniform(0.0, 2.0 * np.pi))
        waves[parity::2] += wave[parity::2]
    positions = np.array(arm.positions(arm.straight()))
    positions[columns] += amplitude * waves / np.abs(waves).max() * arm.joint_units[columns]
    return within(arm, positions)


def harsh(arm: pp.Arm, width: float, *names: object) -> Array:
    """A posture of joints that know nothing of each other."""
    positions = np.array(arm.positions(arm.straight()))
    drawn = stream(*names).uniform(-width, width, len(arm.columns))
    positions[arm.columns] += drawn * arm.joint_units[arm.columns]
    return within(arm, positions)


def curve_for(arm: pp.Arm, bend: float, *names: object) -> pp.Curve:
    """A curve longer than the arm that bends that much, in a plane if the arm is planar."""
    points = np.array([(0, 0, 0), (0.3, 0, 0), (0.6, 0.3, 0.2), (0.9, 0.8, 0.3), (1.5, 1.0, -0.2)])
    points[2:, 1:] = bend * (points[2:, 1:] + 0.2 * stream(*names).normal(size=(3, 2)))
    return pp.Curve.spline(arm.length * points * ((1, 1, 0) if arm.dimension == 2 else 1))


LIMITS: dict[str, Callable[[], pp.Limits | None]] = {
    "none": lambda: pp.Limits(step=None),
    "step": lambda: None,
    "speed": lambda: pp.Limits(step=None, velocity=0.8, dt=0.03),
    "acceleration": lambda: pp.Limits(
        step=None, velocity=2.0, acceleration=10.0, dt=0.02, position_margin=0.01
    ),
}


def scene_around(arm: pp.Arm, way: tuple[Array, Array], kind: str) -> pp.Scene:
    """Something in the way from one posture to the other, clear of both ends."""
    middle = arm.integrate(way[0], 0.5 * arm.difference(*way))
    ends = np.vstack([_along(arm, q) for q in way])
    passed = _along(arm, middle)
    gaps = np.linalg.norm(passed[:, None] - ends[None], axis=2).min(axis=1)
    center, room = passed[gaps.argmax()], gaps.max() - 0.015  # of the arm and the margin
    along = 0.4 * room * np.array((0.0, 0.6, 0.8))
    away = center - ends[np.linalg.norm(ends - center, axis=1).argmin()]
    things: dict[str, Any] = {
        "ball": pp.Sphere(center, 0.6 * room),
        "box": pp.Box(center, (0.5 * room, 0.6 * room, 0.8 * room), (0.1, 0.2, 0.3)),
        "post": pp.Cylinder(center - along, center + along, 0.4 * room),
        "rod": pp.Capsule(center - along, center + along, 0.3 * room),
        "mesh": pp.Mesh(center + 0.7 * room * np.vstack([np.eye(3), -np.eye(3)])),
        "wall": pp.HalfSpace(ends[(ends @ away).argmax()] + 0.02 * away / np.linalg.norm(away), -away),
    }
    if kind == "itself":
        return pp.Scene({}, self_collision=True, margin=0.003, arm_radius=0.008)
    chosen = things if kind == "all" else {kind: things[kind]}
    return pp.Scene(chosen, self_collision=kind == "all", margin=0.004, arm_radius=0.008)


def _along(arm: pp.Arm, q: Array) -> Array:
    """Points along an arm, (n, 3) [m]."""
    points, shares = arm.at(q).points, np.linspace(0.0, 1.0, 5)[:, None]
    return np.vstack([a + shares * (b - a) for a, b in pairwise(points)])


# Runs of each kind.


def track(
    arm_name: str,
    controller: str | Any = "default",
    start: str = "smooth",
    target: str = "smooth",
    limits: str = "step",
    seed: int = 0,
    max_steps: int = 120,
    scene: str = "",
) -> Found:
    """One run from a start to a target."""
    arm = arm_named(arm_name)
    begin, goal = start_of(arm, arm_name, start, seed), target_of(arm, arm_name, target, seed)
    around = None
    if scene:
        assert goal.q is not None
        around = scene_around(arm, (begin, np.array(goal.q)), scene)
    chosen = CONTROLLERS[controller] if isinstance(controller, str) else controller
    return of_run(pp.track(arm, goal, begin, chosen, LIMITS[limits](), around, max_steps=max_steps))


def start_of(arm: pp.Arm, name: str, kind: str, seed: int) -> Array:
    """A configuration to start from."""
    if kind == "straight":
        return arm.straight()
    return smooth(arm, 0.5, name, seed, "start") if kind == "smooth" else harsh(arm, 1.2, name, seed, "start")


def target_of(arm: pp.Arm, name: str, kind: str, seed: int) -> pp.Target:
    """A target: of a configuration, of a curve, of bare points, of a part of the arm, or out of reach."""
    if kind == "curve":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pp.PostureWarning)
            return pp.resolve_targets(arm, curve_for(arm, 0.4, name, seed), incomplete="partial")
    amplitude = {"near": 0.05, "folded": 1.6}.get(kind, 0.7)
    q = smooth(arm, amplitude, name, seed, "target")
    if kind == "folded":
        q = harsh(arm, 1.6, name, seed, "target")
    target = pp.Target.from_configuration(arm, q)
    if kind in ("points", "beyond"):
        points = np.array(target.points) * (1.3 if kind == "beyond" else 1.0)
        return pp.Target.from_points(arm, points)
    if kind == "noisy":
        noise = 0.01 * arm.length * stream(name, seed, "noise").normal(size=target.points.shape)
        return pp.Target.from_points(arm, target.points + noise)
    if kind == "region":
        return target.region(arm.n_modules // 3, arm.n_modules - 1)
    return target


def with_tasks(arm_name: str, which: str, limits: str) -> Found:
    """The default controller with other tasks beside the posture."""
    arm = arm_named(arm_name)
    goal = target_of(arm, arm_name, "smooth", 0)
    assert goal.q is not None
    there = arm.at(goal.q)
    place, turn = np.array(there.points[-1]), np.array(there.rotations[-1])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place + 0.03 * arm.length
    tasks: dict[str, Any] = {
        "tip": tip_task(position=place + 0.05 * arm.length),
        "tip-first": tip_task(position=place + 0.05 * arm.length, first=True),
        "pose": tip_task(pose=pose, weight=5.0),
        "pose-first": tip_task(pose=pose, first=True),
        "direction-first": tip_task(pose=pose, first=True, direction=True),
        "straight": pp.JointPosture(arm.straight(), weight=0.05),
        "tangents": pp.Tangents(turn[:, 0], points=arm.n_modules - 1, weight=2.0),
    }
    return track(arm_name, default(tasks=(tasks[which],)), limits=limits)


def streamed(
    arm_name: str,
    controller: str,
    limits: str,
    velocity: bool = False,
    scene: bool = False,
    faults: bool = False,
) -> Found:
    """Targets that move, and come and go, in a loop whose cycles all take the same time."""
    arm = arm_named(arm_name)
    rng = stream(arm_name, controller, limits, velocity, faults)
    one, two = (smooth(arm, 0.5, arm_name, place, "stream") for place in "ab")
    q, bounds = smooth(arm, 0.3, arm_name, "begin"), LIMITS[limits]()
    assert bounds is not None
    around = scene_around(arm, (one, two), "ball") if scene else None
    loop = tracker(arm, CONTROLLERS[controller], bounds, around, velocity)
    across, moved, commands = arm.difference(one, two), [], []
    for cycle in range(90):
        if 5 <= cycle < 50:
            share = 0.5 - 0.5 * np.cos(0.07 * (cycle - 5))
            loop.update(pp.Target.from_configuration(arm, arm.integrate(one, share * across)))
        elif cycle == 60:
            points = arm.at(arm.integrate(one, 0.3 * across)).points
            loop.update(pp.Target.from_points(arm, points))
        measured: Array | None = q
        if faults:
            measured = arm.integrate(q, 1e-3 * rng.normal(size=arm.nv))
            if 20 <= cycle < 25:
                measured = None
            if cycle == 30:
                measured = np.full(arm.nq, np.nan)
            if cycle == 70:
                q = arm.integrate(q, 0.5 * rng.normal(size=arm.nv) * arm.joint_units)  # a push
        dq = loop.step(measured, dt=None if cycle % 7 else 0.6 * bounds.dt)
        q = arm.integrate(q, dq) if velocity else arm.integrate(q, 0.8 * arm.difference(q, loop.command))
        moved.append(dq)
        commands.append(q)
    return {"q": np.array(commands), "dq": np.array(moved)}


def task_file(file: str, controller: str = "", limits: str = "") -> Found:
    """A task file, as it is or with another controller or other limits."""
    task = pp.Task.load(TASKS / file)
    if controller:
        task = task.edited(controller=CONTROLLERS[controller])
    if limits:
        task = task.edited(limits=LIMITS[limits]())
    reference = task.reference()
    return {**of_motion(task.perform(reference)), "asked for": reference.offsets}


def led(
    arm_name: str,
    method: str,
    bend: float = 0.0,
    and_back: bool = False,
    limits: str = "",
    in_pipe: bool = False,
    depth: float | None = None,
) -> Found:
    """Follow the leader: the motion asked for, and how it is performed within limits."""
    arm = arm_named(arm_name)
    planar = arm.dimension == 2
    radius = 0.4 if planar else 0.2
    path = pipe_axis((0.1, 0.15), [(radius, bend, 0.0)]) if bend else pp.Curve.line((0, 0, 0), (0.3, 0, 0))
    asked = pp.follow_leader(arm, path, 0.1, 0.05, method=method, and_back=and_back, depth=depth)
    found = {f"asked {name}": value for name, value in of_reference(asked).items()}
    if limits:
        laid = asked.waypoints[0].target.curve
        scene = pipe(laid, radius=0.045) if in_pipe else None
        found |= of_motion(
            pp.perform(asked, CONTROLLERS["default"], pp.Limits(step=None, dt=0.1, acceleration=2.0), scene)
        )
        deviation = pp.path_deviation(arm, found["q"], path)
        found["deviation"] = np.array([deviation.largest, deviation.percent])
    return found


SLIGHT, BENDS = (0.05, 0.15, 0.1), (0.05, 0.6, -0.6)
"""How much the curves of postures bend, one after the other: a little, and so that something fits between."""


def through(
    arm_name: str,
    controller: str = "default",
    limits: str = "",
    tip: str = "",
    scene: str = "",
    **options: Any,
) -> Found:
    """Postures at their times."""
    arm = arm_named(arm_name)
    curves = [curve_for(arm, bend, arm_name, "through", bend) for bend in (BENDS if scene else SLIGHT)]
    frames = [
        pp.Keyframe(curve, time=1.0 * k, trim=True, hold=0.2 * (k == 1), placement="align")
        for k, curve in enumerate(curves)
    ]
    around = None
    if tip or scene:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pp.PostureWarning)
            first, last = (pp.resolve_targets(arm, curve, placement="align") for curve in curves[1:])
        assert first.q is not None
        assert last.q is not None
    if tip:
        place = last.points[-1] + 0.04 * arm.length * np.array(
            (-1.0, 0.5, 0.0 if arm.dimension == 2 else 0.5)
        )
        frames[-1] = replace(
            frames[-1], tip=tip_task(position=place, first=tip == "first"), region=(0, arm.n_modules // 2)
        )
    if scene:
        around = scene_around(arm, (first.q, last.q), scene)
    bounds = LIMITS[limits]() if limits else pp.Limits(step=None, dt=0.05, velocity=3.0)
    return of_motion(pp.move_through(arm, frames, CONTROLLERS[controller], bounds, around, **options))


def resolved(arm_name: str, bend: float, near: bool = False, **options: Any) -> Found:
    """Places on a curve."""
    arm = arm_named(arm_name)
    curve = curve_for(arm, bend, arm_name, "resolve", bend)
    found = pp.resolve_targets(arm, curve, incomplete="partial", **options)
    if near:
        beside = curve_for(arm, 0.9 * bend, arm_name, "resolve", bend)
        found = pp.resolve_targets(arm, beside, near=found, incomplete="partial", **options)
    return of_target(found)


def fitted(arm_name: str, noise: float, weighted: bool = False) -> Found:
    """The configuration that is closest to points."""
    arm = arm_named(arm_name)
    points = arm.at(smooth(arm, 0.7, arm_name, "fit")).points
    points = points + noise * arm.length * stream(arm_name, "fit", noise).normal(size=points.shape)
    weights = 1.0 - 0.5 * (np.arange(arm.n_modules) % 2) if weighted else None
    return of_target(pp.fit_points(arm, points, weights))


def many(arm_name: str, controller: str, limits: str, each: bool) -> Found:
    """Several runs in one call, in this process."""
    arm = arm_named(arm_name)
    targets = [target_of(arm, arm_name, "smooth", seed) for seed in range(4)]
    starts = [smooth(arm, 0.5, arm_name, seed, "many") for seed in range(4)]
    batch = pp.track_many(
        arm,
        targets if each else targets[0],
        starts,
        CONTROLLERS[controller],
        LIMITS[limits](),
        max_steps=60,
        jobs=1,
    )
    found = {"q": batch.q_final, "steps": batch.steps.astype(np.float64), "errors": batch.final_error}
    return {**found, **{f"q{k}": batch[k].q for k in range(len(batch.status))}}


def seen(arm_name: str) -> Found:
    """An arm at a configuration."""
    arm = arm_named(arm_name)
    return of_state(arm.at(harsh(arm, 1.0, arm_name, "seen")))


# The list.

BOUNDED = ("step", "speed", "acceleration")


class Run(NamedTuple):
    """One run: what it is called, and what it does."""

    name: str
    make: Callable[[], Found]


def all_runs() -> list[Run]:
    """Every run there is, in order; those of robots that are not installed among them."""
    parts = (tracked(), among_obstacles(), with_other_tasks(), in_loops(), in_time(), places())
    return [each for part in parts for each in part]


def run(kind: Callable[..., Found], label: str, *args: Any, **options: Any) -> Run:
    """A run that is called as its arguments say."""
    words = [*map(str, args), *(f"{key}={value}" for key, value in options.items())]
    return Run("/".join([label, *words]), partial(kind, *args, **options))


def tracked() -> Iterator[Run]:
    """From a start to a target."""
    three = (
        ("smooth", "smooth", "step"),
        ("straight", "curve", "speed"),
        ("harsh", "smooth", "acceleration"),
    )
    for name, (start, target, limits) in product(ARMS, three):
        yield run(track, "track", name, "default", start, target, limits)
    others = [name for name in CONTROLLERS if name != "default"]
    for number, name in enumerate(("ryrz8", "planar12", "unrepeating12", "telescope6")):
        for count, controller in enumerate(others):
            limits = BOUNDED[(number + count) % 3]
            yield run(track, "track", name, controller, "smooth", "smooth", limits, max_steps=40)
    for name in ("ryrz8", "ryrz20", "yaw-bends9", "narrow6", "panda"):
        for target in ("points", "noisy", "beyond", "region", "near", "folded"):
            yield run(track, "track", name, "default", "smooth", target, "step", max_steps=100)
    yield run(track, "track", "ryrz8", "default", "smooth", "smooth", "none")
    for printed in (pp.Selection(score="thesis"), pp.Projection(coupling="local")):
        found = partial(track, "ryrz8", printed, limits="speed", max_steps=60)
        yield Run(f"track/ryrz8/{printed.name} as in the thesis", found)
    for name, controller in product(("ryrz20", "ryrz40"), ("selection", "projection", "switching")):
        yield run(track, "track", name, controller, "smooth", "curve", "step", max_steps=40)
    for weight, relative in ((0.05, 1.0), (1.0, 1.0), (0.2, 0.0), (0.2, 5.0)):
        found = partial(track, "ryrz8", default(None, weight, relative), "harsh", "smooth", "step")
        yield Run(f"track/ryrz8/weights {weight:g} {relative:g}", found)


def among_obstacles() -> Iterator[Run]:
    """The same with something in the way."""
    kinds = ("ball", "box", "post", "rod", "wall", "mesh", "itself", "all")
    for name, kind in product(("ryrz5", "planar5"), kinds):
        yield run(track, "scene", name, "default", "smooth", "smooth", "step", scene=kind)
    for kind in ("ball", "post", "wall"):
        yield run(track, "scene", "ryrz8", "default", "smooth", "smooth", "acceleration", scene=kind)
    for name, controller in (("ryrz5", "selection"), ("xarm7", "default")):
        yield run(track, "scene", name, controller, "smooth", "near", "step", scene="ball")


def with_other_tasks() -> Iterator[Run]:
    """The same with something else to do."""
    tasks = ("tip", "tip-first", "pose", "pose-first", "direction-first", "straight", "tangents")
    for number, which in enumerate(tasks):
        yield run(with_tasks, "tasks", "ryrz8", which, BOUNDED[number % 3])
    for which in ("tip-first", "straight"):
        yield run(with_tasks, "tasks", "yaw-bends9", which, "step")


def in_loops() -> Iterator[Run]:
    """Control loops."""
    for name, limits in product(("ryrz8", "planar12", "endless8"), ("speed", "acceleration")):
        for velocity, faults in ((False, False), (True, False), (False, True)):
            yield run(streamed, "stream", name, "default", limits, velocity=velocity, faults=faults)
    for controller in ("selection", "switching", "lm", "joint"):
        yield run(streamed, "stream", "ryrz5", controller, "speed")
    yield run(streamed, "stream", "ryrz5", "default", "acceleration", scene=True)
    yield run(streamed, "stream", "ryrz20", "default", "acceleration", faults=True)


def in_time() -> Iterator[Run]:
    """Motions in time: task files, paths to follow, postures at their times."""
    for file in ("keyframes.toml", "around.toml", "pipe.toml"):
        yield run(task_file, "task file", file)
    for options in ({"limits": "speed"}, {"limits": "acceleration"}, {"controller": "joint"}):
        yield run(task_file, "task file", "keyframes.toml", **options)

    for name, method in (("fed8", "closest"), ("fed8", "sequential"), ("fed-planar8", "closest")):
        yield run(led, "leader", name, method, bend=0.6)
        yield run(led, "leader", name, method, bend=0.6, and_back=True, depth=0.2)
        yield run(led, "leader", name, method, limits="yes")
    yield run(led, "leader", "fed8", "closest", bend=0.8, limits="yes", in_pipe=True)

    for name in ("ryrz5", "planar5", "unrepeating12", "panda"):
        yield run(through, "through", name)
        yield run(through, "through", name, limits="acceleration", continuity="acceleration")
    for tip in ("also", "first"):
        yield run(through, "through", "ryrz8", tip=tip)
    for controller in ("joint", "lm", "switching"):
        yield run(through, "through", "ryrz5", controller)
    for kind in ("ball", "wall"):
        yield run(through, "through", "ryrz5", scene=kind)


def places() -> Iterator[Run]:
    """Places on curves, configurations for points, several runs at once, arms as such."""
    for name, method in product(
        ("ryrz8", "planar12", "rzry10", "mixed6"), ("sequential", "smooth", "closest")
    ):
        yield run(resolved, "resolve", name, 0.12, method=method)
    for name in ("ryrz20", "ryrz10-unequal", "unrepeating12", "telescope6", "driven8", "placed8", "ur5"):
        yield run(resolved, "resolve", name, 0.1)
        yield run(resolved, "resolve", name, 0.1, near=True)
    for placement in ("as_is", "translate", "align"):
        yield run(resolved, "resolve", "ryrz8", 0.08, placement=placement, roll=0.4)
    yield run(resolved, "resolve", "ryrz5", 1.5)

    for name in ("ryrz5", "ryrz8", "planar12", "narrow6", "unrepeating12", "endless8", "telescope6", "panda"):
        yield run(fitted, "fit", name, 0.0)
        yield run(fitted, "fit", name, 0.01)
    yield run(fitted, "fit", "ryrz20", 0.002)
    yield run(fitted, "fit", "ryrz8", 0.01, weighted=True)

    for controller, limits, each in (
        ("default", "step", False),
        ("default", "acceleration", True),
        ("lm", "speed", True),
    ):
        yield run(many, "many", "ryrz5", controller, limits, each)
    for name in ("ryrz20", "planar3x4", "endless8", "fed8", "placed8", "panda"):
        yield run(seen, "arm", name)


# Saving and comparing.


def done(runs: list[Run], slow: bool = False) -> dict[str, Found]:
    """What comes out of runs; a run that raises is named, and the others go on."""
    found: dict[str, Found] = {}
    for number, run in enumerate(runs, 1):
        began = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pp.PostureWarning)  # what is far or cannot avoid says so
            try:
                found[run.name] = {key: np.array(value) for key, value in run.make().items()}
            except pp.PostureError as error:
                print(f"{run.name}: {type(error).__name__}: {error}", file=sys.stderr)
        took = time.process_time() - began
        if slow:
            rows = max((len(kept) for kept in found.get(run.name, {}).values()), default=0)
            print(f"{took:7.2f} s {rows:5} rows  {run.name}")
        elif sys.stderr.isatty():
            print(f"\r{number} of {len(runs)}", end="", file=sys.stderr)
    return found


def saved(path: Path, found: Mapping[str, Found]) -> None:
    """Write the arrays of all runs to one file."""
    np.savez_compressed(
        path, **{f"{run} | {key}": a for run, kept in found.items() for key, a in kept.items()}
    )


def opened(path: Path) -> dict[str, Found]:
    """Read what `saved` wrote."""
    found: dict[str, Found] = {}
    with np.load(path) as file:
        for name in file.files:
            run, _, key = name.rpartition(" | ")
            found.setdefault(run, {})[key] = file[name]
    return found


class Difference(NamedTuple):
    """How two results of one run differ: in which array, at which of its rows first, and how much at most."""

    key: str
    row: int | None
    largest: float


def difference(before: Found, after: Found) -> Difference:
    """The first array that differs, `q` before the others; the largest difference of all."""
    first, largest = Difference("", None, 0.0), 0.0
    for key in sorted(before.keys() | after.keys(), key=lambda key: (key != "q", key)):
        if key not in before or key not in after or before[key].shape[1:] != after[key].shape[1:]:
            return Difference(f"{key} (missing, or of another shape)", None, np.inf)
        rows = min(len(before[key]), len(after[key]))
        one, two = before[key][:rows], after[key][:rows]
        same = (one == two) | (np.isnan(one) & np.isnan(two))  # infinite in both is the same as well
        with np.errstate(invalid="ignore"):
            apart = np.where(same, 0.0, np.abs(one - two))
        apart = np.where(np.isnan(apart), np.inf, apart).reshape(rows, -1)
        here = float(apart.max(initial=0.0))
        over = np.flatnonzero(apart.max(axis=1, initial=0.0) > TOLERANCE)
        row = int(over[0]) if len(over) else None
        if len(before[key]) != len(after[key]):
            row, here = rows if row is None else row, np.inf
        largest = max(largest, here)
        if row is not None and not first.key:
            first = Difference(key, row, here)
    return first._replace(largest=largest)


def compared(before: Mapping[str, Found], after: Mapping[str, Found]) -> bool:
    """Print what differs; whether nothing does."""
    differences = {name: difference(before[name], after[name]) for name in before if name in after}
    different = {name: each for name, each in differences.items() if each.key}
    for name, each in list(different.items())[:SHOWN]:
        at = "" if each.row is None else f" from row {each.row} on"
        print(f"differs: {name}: {each.key}{at}, by {each.largest:.3g}")
    missing = [f"missing now: {name}" for name in before if name not in after]
    missing += [f"not there before: {name}" for name in after if name not in before]
    print(*missing[:SHOWN], sep="\n", end="\n" if missing else "")
    exactly = sum(each.largest == 0.0 for each in differences.values())
    largest = max((each.largest for each in differences.values()), default=0.0)
    equal, every = len(differences) - len(different), len(before.keys() | after.keys())
    print(f"equal to {TOLERANCE:g}: {equal} of {every} runs, {exactly} of them bit for bit")
    print(f"largest difference: {largest:.3g}")
    return not different and not missing


def main() -> int:
    """Run all, or some, and save or compare them."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--save", type=Path, metavar="FILE", help="write what comes out to an .npz file")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="compare with what was written before")
    parser.add_argument(
        "--only", metavar="PATTERN", help="only runs in whose names this regular expression is found"
    )
    parser.add_argument("--list", action="store_true", help="print the names of the runs, and run none")
    given = parser.parse_args()
    runs = [run for run in all_runs() if given.only is None or re.search(given.only, run.name)]
    if given.list:
        print(*(run.name for run in runs), f"{len(runs)} runs", sep="\n")
        return 0
    before = opened(given.compare) if given.compare else None
    found = done(runs, slow=not (given.save or given.compare))
    print(f"{len(found)} of {len(runs)} runs done, {time.process_time():.0f} s of one core")
    if given.save:
        given.save.parent.mkdir(parents=True, exist_ok=True)
        saved(given.save, found)
    if before is None:
        return 0 if len(found) == len(runs) else 1
    if given.only is not None:
        before = {name: kept for name, kept in before.items() if re.search(given.only, name)}
    return 0 if compared(before, found) else 1


if __name__ == "__main__":
    sys.exit(main())
