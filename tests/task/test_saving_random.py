"""Tasks drawn at random are saved and loaded again, in both formats, to the last bit."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, assume, given
from hypothesis import strategies as st
from sampling import examples
from task.same_tasks import assert_same

import pinposture as pp
from pinposture.errors import PostureError
from pinposture.task.follow_leader import Leader

PLACED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.2, 2.9), np.array([0.1, -1 / 3, 1e-7]))
FEED = pp.ModuleTemplate("Feed", (pp.JointSpec("x", "prismatic", 0.0, 0.3, velocity=0.1),), (0.05,))
TURNS = pp.ModuleTemplate("Turns", (pp.JointSpec("y", "continuous"), pp.JointSpec("z")), (0.05, 0.05))
ARMS = {
    "ryrz": lambda: pp.Arm.from_template("RyRz", modules=6),
    "planar": lambda: pp.Arm.from_template("RzRz", modules=3, link_lengths=(0.1, 1 / 3)),
    "turned": lambda: pp.Arm.from_template("RzRy", 4, base_placement=PLACED),
    "fed": lambda: pp.Arm.from_modules([FEED, *[pp.template("RyRz")] * 4]),
    "endless": lambda: pp.Arm.from_modules([TURNS] * 3, name="endless"),
}


@cache
def arm_named(name: str) -> pp.Arm:
    return ARMS[name]()


NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=8) | st.sampled_from(
    ['a "b"', "c:\\d", "line\nbreak", "größe", "腕", "'", "\x7f\x01", "# no comment"]
)
SCANS = NAMES.filter(lambda name: name.strip() not in ("", ".", "..") and "\0" not in name)
NUMBER = st.floats(-2.0, 2.0)
POSITIVE = st.floats(1e-6, 1e3)
PLACE = st.tuples(NUMBER, NUMBER, NUMBER)
FAR = st.tuples(st.floats(3.0, 9.0), NUMBER, NUMBER)
ANGLES = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)


@st.composite
def curves(draw: Any) -> pp.Curve:
    """A curve of any kind that is not far too long, perhaps moved, reversed or trimmed."""
    degree = draw(st.integers(1, 5))
    points = draw(st.lists(PLACE, min_size=degree + 1, max_size=8))
    kind = draw(st.sampled_from(["spline", "through", "line", "helix", "points", "knots"]))
    try:
        if kind == "spline":
            curve = pp.Curve.spline(points, degree)
        elif kind == "through":
            curve = pp.Curve.spline(points, degree, through=True)
        elif kind == "line":
            curve = pp.Curve.line(points[0], points[1])
        elif kind == "helix":
            curve = pp.Curve.helix(draw(st.floats(0.01, 1)), draw(st.floats(0, 1)), draw(st.floats(0.1, 1)))
        elif kind == "points":
            curve = pp.Curve.points(points)
        else:
            inner = np.cumsum(draw(st.lists(st.floats(0.1, 1), min_size=len(points), max_size=len(points))))
            ends = (degree + 1) * [0.0], (degree + 1) * [inner[-1] + 1]
            knots = [*ends[0], *inner[: len(points) - degree - 1], *ends[1]]
            curve = pp.Curve(knots, points, degree)
        assume(curve.length < 20.0)
        change = draw(st.sampled_from(["none", "move", "reverse", "trim"]))
        if change == "move":
            return curve.moved(pin.rpy.rpyToMatrix(*draw(ANGLES)), draw(PLACE))
        if change == "trim":
            return curve.trimmed(0.1 * curve.length, 0.8 * curve.length)
        return curve.reversed() if change == "reverse" else curve
    except PostureError:
        return pp.Curve.line((0, 0, 0), (draw(st.floats(0.1, 2)), 0, 0))


@st.composite
def tips(draw: Any, arm: pp.Arm) -> pp.EndEffector:
    m = arm.n_modules
    point = draw(st.integers(-m, m - 1) | st.sampled_from(arm.control_points))
    options = {"point": point, "weight": draw(POSITIVE), "priority": draw(st.booleans())}
    options["length"] = draw(st.none() | POSITIVE)
    place = np.array(draw(PLACE))
    if draw(st.booleans()):
        return pp.EndEffector(place, **options)
    pose = pin.SE3(pin.rpy.rpyToMatrix(*draw(ANGLES)), place)
    return pp.EndEffector(pose=pose, direction_only=draw(st.booleans()), **options)


@st.composite
def keyframes(draw: Any, arm: pp.Arm) -> pp.Keyframe:
    times = [{}, {"time": draw(POSITIVE)}, {"duration": draw(POSITIVE)}, {"time": draw(st.integers(0, 9))}]
    first = draw(st.integers(0, arm.n_modules - 1))
    region = (first, draw(st.integers(first, arm.n_modules - 1)))
    lower = np.maximum(arm.limits.lower, -9.0)
    upper = np.minimum(arm.limits.upper, 9.0)
    joints = [st.floats(low, high) for low, high in zip(lower, upper, strict=True)]
    return pp.Keyframe(
        draw(curves()),
        name=draw(NAMES),
        hold=draw(st.just(0.0) | POSITIVE),
        placement=draw(st.sampled_from(["as_is", "translate", "align"])),
        roll=draw(st.just(0.0) | NUMBER),
        method=draw(st.sampled_from(["auto", "sequential", "smooth", "closest"])),
        tip=draw(st.none() | tips(arm)),
        region=draw(st.none() | st.just(region)),
        trim=draw(st.booleans()),
        joints=draw(st.none() | st.tuples(*joints)),
        **draw(st.sampled_from(times)),
    )


@st.composite
def limits(draw: Any, arm: pp.Arm) -> pp.Limits:
    def each() -> Any:
        numbers = POSITIVE | st.just(np.inf)
        both = st.tuples(numbers, numbers).map(lambda pair: np.where(arm.slides, *pair))
        one = st.lists(numbers, min_size=arm.nv, max_size=arm.nv).map(np.array)
        return draw(st.none() | numbers | both | one)

    margin = draw(st.just(0.0) | st.floats(0, 0.1))
    return pp.Limits(each(), each(), draw(st.floats(1e-4, 60)), margin, each())


@st.composite
def scenes(draw: Any) -> pp.Scene:
    size = st.tuples(*[st.floats(0.01, 1)] * 3)
    radius = st.floats(0.01, 1)
    turn = draw(ANGLES) if draw(st.booleans()) else None
    corners = draw(st.lists(PLACE, min_size=4, max_size=6, unique=True))
    makers = {
        "sphere": lambda: pp.Sphere(draw(FAR), draw(radius)),
        "capsule": lambda: pp.Capsule(draw(FAR), (5.0, 5.0, 5.0), draw(radius)),
        "cylinder": lambda: pp.Cylinder(draw(FAR), (5.0, 5.0, 5.0), draw(radius)),
        "box": lambda: pp.Box(draw(FAR), draw(size), turn),
        "half-space": lambda: pp.HalfSpace((0, 0, -5), (draw(NUMBER), draw(NUMBER), 9)),
        "mesh": lambda: pp.Mesh([*corners, (1, 1, 3), (-1, 1, 3), (1, -1, 3)], (9, 0, 0), turn),
    }
    obstacles = {}
    printable = NAMES.filter(lambda name: bool(name.strip()) and name.isprintable())
    for kind in draw(st.lists(st.sampled_from(sorted(makers)), max_size=3)):
        name = draw(printable)
        try:
            obstacles[name] = makers[kind]()
        except PostureError:  # flat, or without length
            continue
    return pp.Scene(obstacles, draw(st.booleans()), draw(st.floats(0, 0.1)), draw(st.none() | radius))


CONTROLLERS = st.sampled_from(
    ["geodesic", "selection", "projection", "switching", "joint", "dls", "lm", "pinv"]
)


@st.composite
def tasks(draw: Any) -> pp.Task:
    arm = arm_named(draw(st.sampled_from(sorted(ARMS))))
    leading = draw(st.booleans())
    if leading:
        motion: Any = Leader(
            draw(curves()),
            draw(POSITIVE),
            draw(st.none() | POSITIVE),
            draw(st.sampled_from(["align", "as_is"])),
            draw(st.sampled_from(["closest", "sequential"])),
            draw(st.booleans()),
            draw(st.none() | st.floats(0.05, 1)),  # wide enough for each of the arms
        )
    else:
        motion = tuple(draw(st.lists(keyframes(arm), min_size=2, max_size=4)))
    relative = st.sampled_from([0.0, 0.3, 9.0])
    geodesic = st.builds(pp.Geodesic, joint_weight=st.floats(0.01, 9), relative_position_weight=relative)
    starts = (None, arm.straight(), arm.neutral(), arm.random(np.random.default_rng(draw(st.integers(0, 9)))))
    formats = st.lists(st.sampled_from(["npz", "csv", "json", "png", "html"]), unique=True).map(tuple)
    return pp.Task(
        arm,
        motion,
        draw(limits(arm)),
        draw(CONTROLLERS | geodesic),
        draw(st.none() | scenes()),
        starts[draw(st.integers(0, 3))],
        "velocity" if leading else draw(st.sampled_from(["velocity", "acceleration"])),
        draw(st.just(("npz", "csv", "json", "png", "html")) | formats),
        draw(NAMES),
        draw(st.lists(SCANS, max_size=2).map(tuple)),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("saved")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:dt is .* long for a control cycle", "ignore:velocity .* is above")
@examples(50, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(task=tasks(), suffix=st.sampled_from([".toml", ".json"]))
def test_a_task_that_was_saved_loads_equal(folder: Path, task: pp.Task, suffix: str) -> None:
    # A name for each arm, so that there is room for its URDF file.
    arm = next(name for name in ARMS if arm_named(name) is task.arm)
    path = task.save(folder / f"{arm}{suffix}")
    loaded = pp.Task.load(path)
    assert_same(loaded, task)
    again = folder / "again" / f"{arm}{suffix}"
    loaded.save(again)
    assert_same(pp.Task.load(again), task)
    third = folder / "third" / f"{arm}{suffix}"
    pp.Task.load(again).save(third)
    assert third.read_text() == again.read_text()
