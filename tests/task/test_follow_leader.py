"""Follow the leader: postures against closed forms, distances against brute force, and what is refused."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nearest import distances_to_nearest
from sampling import examples

from pinposture.arm import Arm, JointSpec, ModuleTemplate, continuum_section, template
from pinposture.arm.template import modules_to_urdf
from pinposture.collision import CollisionModel
from pinposture.collision.pipe import pipe, pipe_axis
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.errors import (
    CurveBendsTooMuch,
    InvalidValue,
    TargetError,
    UnknownName,
    UnsupportedModule,
)
from pinposture.task.follow_leader import depths_in_time, follow_leader, path_deviation
from pinposture.task.perform import perform
from pinposture.task.reference import off_curve
from pinposture.units import length_text

LINK = 0.05


def feed(axis="x", lower=0.0, upper=0.6, length=0.03):
    return ModuleTemplate("Feed", (JointSpec(axis, "prismatic", lower, upper, velocity=0.1),), (length,))


HINGES = [template("Rz").with_lengths((LINK,))] * 8
CROSSED = [template("RyRz")] * 8


@cache
def hinged():
    return Arm.from_modules([feed(), *HINGES])


@cache
def crossed():
    return Arm.from_modules([feed(), *CROSSED])


def arc(radius, turn):
    """About z, to the left."""
    return Curve.helix(radius, 0.0, turn / (2 * np.pi), axis=(0, 0, 1))


def winding():
    """A curve that bends and twists, more and less."""
    return Curve.spline([(0, 0, 0), (0.1, 0, 0), (0.25, 0.02, 0), (0.3, 0.15, 0.1), (0.4, 0.2, 0.3)])


def rows(reference):
    return np.array([reference.configuration(row) for row in range(reference.rows)])


def links(arm, q):
    """Joints that bend and the tip, of an arm whose only control points between them are at joints."""
    state = arm.at(q)
    return np.vstack([state.origins[1:], state.points[-1]])


@pytest.mark.parametrize("method", ["closest", "sequential"])
@pytest.mark.parametrize("make", [hinged, crossed])
def test_a_straight_path_is_followed_by_the_feed_alone(make, method):
    arm = make()
    path = Curve.line((1, 2, 3), (1, 2.5, 3))
    reference = follow_leader(arm, path, 0.1, 0.1, method=method)
    assert np.abs(reference.offsets[:, 1:]).max() < 1e-9
    assert reference.offsets[-1, 0] == pytest.approx(0.5, abs=1e-12)
    deviation = path_deviation(arm, rows(reference), path)
    assert deviation.largest < 1e-9
    assert deviation.length == pytest.approx(0.4, abs=1e-12)  # the feed does not count
    assert deviation.points.shape == (reference.rows, arm.n_modules)


@pytest.mark.parametrize("method", ["closest", "sequential"])
@pytest.mark.parametrize("radius", [0.3, 0.12])
def test_joints_on_an_arc_leave_the_sagitta_of_a_chord(method, radius):
    path = arc(radius, 0.4 / radius)
    reference = follow_leader(hinged(), path, 0.05, 0.1, method=method)
    q = rows(reference)
    deviation = path_deviation(hinged(), q, path)
    assert deviation.largest == pytest.approx(radius - np.sqrt(radius**2 - LINK**2 / 4), rel=2e-3)
    assert deviation.percent == pytest.approx(100 * deviation.largest / 0.4)
    # Wherever it is past the entry, a joint is on the circle, and the angle at it that between two chords.
    center = hinged().at(reference.start).points[-1] + (0, radius, 0)
    ends = links(hinged(), q[-1])
    turn = 2 * np.arcsin(LINK / 2 / radius)
    assert np.abs(np.linalg.norm(ends[:-1] - center, axis=1) - radius).max() < 1e-6
    assert q[-1][2:-1] == pytest.approx(turn, abs=1e-4)
    # The tip is ahead of the feed by what chords are shorter than arcs: straight on, where the path ends.
    ahead = radius * 8 * turn - 0.4
    angle = 0.4 / radius
    assert ahead == pytest.approx(0.4 * (LINK / radius) ** 2 / 24, rel=0.1)
    end = center + radius * np.array([np.sin(angle), -np.cos(angle), 0.0])
    assert np.linalg.norm(ends[-1] - end - ahead * np.array([np.cos(angle), np.sin(angle), 0.0])) < 1e-4


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_distances_are_those_of_brute_force(seed):
    """From a segment and a circle, for postures that are off the path in every way."""
    radius = 0.2
    rng = np.random.default_rng(seed)
    path = arc(radius, 0.5 / radius)
    reference = follow_leader(crossed(), path, 0.2, 0.1, depth=0.4)
    q = rows(reference)[:: reference.rows // 9] + 0.0
    q[:, 1:] += rng.normal(0.0, 0.03, q[:, 1:].shape)
    deviation = path_deviation(crossed(), q, path)
    first, tip = links(crossed(), reference.start)[[0, -1]]

    def way(s):
        """The straight way from the first joint, then the arc."""
        angle = np.clip(s - 0.4, 0.0, None)[:, None] / radius
        turned = radius * np.hstack([np.sin(angle), 1 - np.cos(angle), 0 * angle])
        return np.where(s[:, None] <= 0.4, first + s[:, None] * [1, 0, 0], tip + turned)

    for row, each in enumerate(q):
        ends = links(crossed(), each)
        depth = each[0]
        near = np.linspace(0.4 + depth - 0.06, 0.4 + depth + 0.06, 4001)
        stop = near[np.argmin(np.linalg.norm(way(near) - ends[-1], axis=1))]
        travelled = way(np.linspace(0.0, stop, 6000))
        shares = np.arange(9)[:, None, None] / 8
        body = (ends[:-1] + shares * np.diff(ends, axis=0)).reshape(-1, 3)
        points = crossed().at(each).points
        on_body, at_points = (distances_to_nearest(places, travelled) for places in (body, points))
        assert deviation.body[row] == pytest.approx(on_body.max(), abs=7e-5)
        assert deviation.points[row] == pytest.approx(at_points, abs=7e-5)
    assert deviation.body[deviation.row] == deviation.largest == deviation.body.max()
    assert 0.0 <= deviation.where[deviation.row] <= 0.4 + 1e-12


def test_what_lies_ahead_of_the_tip_does_not_count():
    """A path that goes round and comes back: at the start it is near the arm, but not yet travelled."""
    path = arc(0.05, 1.9 * np.pi)
    q = hinged().neutral()
    q[1] = 0.1  # the whole arm turned about its first joint
    tip = hinged().at(q).points[-1]
    laid = path.moved(np.eye(3), hinged().at(hinged().neutral()).points[-1] - path.start)
    assert laid.nearest(tip).distance < 0.02
    deviation = path_deviation(hinged(), q[None], path)
    assert deviation.body[0] == pytest.approx(0.4 * np.sin(0.1), rel=2e-3)
    assert deviation.where[0] == pytest.approx(0.4, abs=1e-12)


@examples(12)
@given(
    st.floats(0.5, 12.0),
    st.floats(0.0, 6.0),
    st.floats(0.05, 0.36),
    st.floats(-np.pi, np.pi),
    st.sampled_from(["closest", "sequential"]),
)
def test_rows_go_on_smoothly_within_the_limits(curvature, torsion, depth, turn, method):
    twist = np.hypot(curvature, torsion)
    path = Curve.helix(curvature / twist**2, 2 * np.pi * torsion / twist**2, 0.4 * twist / 2 / np.pi)
    path = path.moved(pin.exp3(np.array([turn, 0.3, 0.1])))
    speed = 0.1
    reference = follow_leader(crossed(), path, 0.05, speed, depth=depth, method=method)
    assert np.all(reference.offsets[0] == 0.0)
    assert all(crossed().within_limits(q) for q in rows(reference))
    fed = np.diff(reference.offsets[:, 0])
    assert np.all(fed > 0.0)
    assert fed.max() <= speed * reference.interval * (1 + 1e-9)
    assert reference.offsets[-1, 0] == pytest.approx(depth, abs=1e-9)
    # A joint turns by kappa l while the arm goes on by a module; where sequential placement zigzags, by more.
    steps = np.abs(np.diff(reference.offsets[:, 1:], axis=0)).max()
    assert steps < 5.0 * curvature * fed.max()
    deviation = path_deviation(crossed(), rows(reference), path)
    assert deviation.largest < 2.2 * curvature * LINK**2 / 8 + 1e-6
    if method == "sequential":
        assert deviation.largest_point < 1e-5


def test_closest_is_least_of_what_is_near():
    """No joint can be turned, alone or with others, so that the ends of links come nearer to the path."""
    reference = follow_leader(crossed(), winding(), 0.05, 0.1, depth=0.35)
    laid = reference.waypoints[-1].target.curve
    q = reference.configuration(reference.rows - 1)

    def cost(q):
        ends = links(crossed(), q)[1:]
        ahead = laid.nearest(ends).distance
        behind = np.linalg.norm(ends[:, 1:] - laid.start[1:], axis=1)  # from the line of the feed, the x axis
        return float(np.sum(np.where(ends[:, 0] < laid.start[0], behind, ahead) ** 2))

    least = cost(q)
    rng = np.random.default_rng(0)
    changes = [*np.eye(crossed().nv)[1:], *rng.normal(0.0, 0.3, (60, crossed().nv))]
    for change in changes:
        change[0] = 0.0
        for size in (1e-3, -1e-3, 1e-2, -1e-2):
            assert cost(q + size * change) > least * (1 - 1e-4)


@pytest.mark.long
def test_a_mechanism_of_any_kind_is_followed():
    """Hinges in one place, unequal links, and a description whose modules nobody named."""
    path = arc(0.2, 1.5)
    for lengths in ((0.0, 0.05), (0.03, 0.02)):
        arm = Arm.from_modules([feed(), *[template("RyRz").with_lengths(lengths)] * 8])
        reference = follow_leader(arm, path, 0.1, 0.1)
        assert path_deviation(arm, rows(reference), path).largest < 1.05 * LINK**2 / 8 / 0.2
    loaded = Arm.load(modules_to_urdf([feed(), *CROSSED], "found"))
    reference = follow_leader(loaded, path, 0.1, 0.1)
    expected = follow_leader(crossed(), path, 0.1, 0.1)
    assert reference.offsets == pytest.approx(expected.offsets, abs=1e-9)


def test_where_the_arm_stands_and_which_way_its_slide_counts_make_no_difference():
    expected = follow_leader(crossed(), winding(), 0.1, 0.1, depth=0.35)
    pose = pin.SE3(pin.exp3(np.array([0.3, -0.5, 1.0])), np.array([1.0, -2.0, 0.5]))
    moved = Arm.from_modules([feed(), *CROSSED], base_placement=pose)
    laid = expected.waypoints[-1].target.curve.moved(pose.rotation, pose.translation)
    there = follow_leader(moved, laid, 0.1, 0.1, placement="as_is", depth=0.35)
    assert there.offsets == pytest.approx(expected.offsets, abs=1e-7)
    back = Arm.from_modules([feed((-1, 0, 0), -0.6, 0.0), *CROSSED])
    other = follow_leader(back, winding(), 0.1, 0.1, depth=0.35)
    assert other.offsets[:, 0] == pytest.approx(-expected.offsets[:, 0], abs=1e-12)
    assert other.offsets[:, 1:] == pytest.approx(expected.offsets[:, 1:], abs=1e-9)


def test_a_start_with_the_feed_half_way_and_the_way_back():
    path = arc(0.3, 0.9)
    start = hinged().neutral()
    counted = []
    start[0] = 0.2
    reference = follow_leader(
        hinged(), path, 0.1, 0.1, start=start, and_back=True, progress=lambda *each: counted.append(each)
    )
    assert reference.start == pytest.approx(start, abs=1e-12)
    middle = reference.rows // 2
    assert reference.rows == 2 * middle + 1
    assert np.array_equal(reference.offsets[::-1], reference.offsets)
    assert [(waypoint.name, waypoint.row) for waypoint in reference.waypoints] == [
        ("inside", middle),
        ("outside", 2 * middle),
    ]
    for waypoint in reference.waypoints:
        assert waypoint.target.q == pytest.approx(reference.configuration(waypoint.row))
    assert counted == [(k + 1, middle + 1) for k in range(middle + 1)]
    deviation = path_deviation(hinged(), rows(reference), path, start=start)
    assert deviation.largest == pytest.approx(LINK**2 / 8 / 0.3, rel=1e-2)


def test_rows_are_close_together_however_long_the_interval():
    reference = follow_leader(hinged(), arc(0.2, 1.5), 2.0, 0.1)
    assert np.diff(reference.offsets[:, 0]).max() <= LINK / 2 * (1 + 1e-9)
    pieces = 2.0 / reference.interval
    assert pieces == pytest.approx(round(pieces))


@examples(40)
@given(st.floats(0.01, 2.0), st.floats(0.01, 1.0), st.floats(0.01, 0.5))
def test_the_feed_starts_and_stops_gently(depth, speed, interval):
    depths, interval = depths_in_time(depth, speed, interval, 0.02)
    step = np.diff(depths)
    assert depths[0] == 0.0
    assert depths[-1] == pytest.approx(depth, rel=1e-12)
    assert np.all(step > 0.0)
    assert step.max() <= min(speed * interval, 0.02) * (1 + 1e-9)
    assert step == pytest.approx(step[::-1], abs=1e-12)
    # The ramps take a sixth of the time each. There the acceleration is a parabola, 6 x (1 - x) of its mean,
    # and never jumps by more than its slope lets it from one row to the next.
    ramp = len(step) / 6.0
    full = 1.2 * depth / len(step)
    if ramp > 10.0:
        bends = np.diff(np.concatenate([[0.0], step, [0.0]])) / (full / ramp)
        assert np.abs(bends).max() <= 1.5 * (1 + 1e-6)
        assert np.abs(np.diff(np.concatenate([[0.0], bends, [0.0]]))).max() <= 6.0 / ramp + 1e-6


@pytest.mark.long
def test_an_arm_of_twenty_modules_goes_through_a_pipe_with_two_bends():
    path = pipe_axis((0.1, 0.1, 0.05), [(0.25, np.pi / 2), (0.25, np.pi / 2, np.pi / 2)])
    arm = Arm.from_modules([feed(upper=1.2), *[template("RyRz")] * 20])
    reference = follow_leader(arm, path, 0.2, 0.1)
    deviation = path_deviation(arm, rows(reference), path)
    assert deviation.length == pytest.approx(1.0)
    assert deviation.percent < 0.1
    walls = CollisionModel(arm, pipe(reference.waypoints[-1].target.curve, 0.045, self_collision=False))
    # A radius of the arm of 1 cm, 1 percent of the pipe's for how its walls are made, and the deviation.
    least = 0.045 * 0.99 - 0.01 - deviation.largest
    clear = [walls.minimum(q).distance for q in rows(reference)[::12]]
    assert least <= min(clear) <= 0.035


def test_performing_it_keeps_to_the_path():
    path = arc(0.2, 1.5)
    reference = follow_leader(crossed(), path, 0.1, 0.1)
    motion = perform(reference, "geodesic", Limits(dt=0.1, acceleration=3.0))
    assert motion.run.status == "converged"
    planned = path_deviation(crossed(), rows(reference), path)
    performed = path_deviation(crossed(), motion.run.q, path)
    assert performed.largest < 1.3 * planned.largest


def test_a_leader_is_not_followed_to_a_posture_that_cannot_be_held():
    """The feed pushes along gravity; the first hinge holds the whole body, by Pinocchio."""
    arm = crossed()
    reference = follow_leader(arm, arc(0.2, 1.5), 0.1, 0.1)
    last = pin.computeGeneralizedGravity(
        arm.model, arm.model.createData(), reference.configuration(reference.rows - 1)
    )
    first = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), reference.start)
    effort = np.where(
        np.arange(arm.nv) == 0, 100.0, 0.99 * max(np.abs(first[1:]).max(), np.abs(last[1:]).max())
    )
    with pytest.raises(InvalidValue, match=r"needs .* could with"):
        perform(reference, limits=Limits(dt=0.1, effort=effort))


def chain_of_hinges():
    """All hinges in one module, whose end can be on the path while its joints are not."""
    joints = [JointSpec("y"), JointSpec("z")] * 4
    return Arm.from_modules([feed(), ModuleTemplate("long", joints, [LINK] * 8)])


@pytest.mark.parametrize("radius", [0.3, 0.6, 1.5])
def test_joints_that_leave_the_path_between_control_points_are_refused(radius):
    """The end of the module is on the path; a joint of the arc of a hinge is a sagitta off, not a link."""
    arm = chain_of_hinges()
    path = arc(radius, 0.3 / radius)
    closest = follow_leader(arm, path, 0.1, 0.1, method="closest")
    assert path_deviation(arm, rows(closest), path).largest < (2 * LINK) ** 2 / 8 / radius * 1.2
    with pytest.raises(TargetError, match=r"of the arm \(at a depth of .* allowed: .*use method='closest'"):
        follow_leader(arm, path, 0.1, 0.1, method="sequential")


def test_the_distance_of_the_plan_from_the_path_is_told():
    path = arc(0.2, 1.5)
    reference = follow_leader(crossed(), path, 0.1, 0.1, and_back=True)
    deviation = path_deviation(crossed(), rows(reference), path)
    assert [off_curve(waypoint) for waypoint in reference.waypoints] == pytest.approx([deviation.largest] * 2)
    motion = perform(reference, "geodesic", Limits(dt=0.1, acceleration=3.0))
    inside, outside = motion.waypoints
    for waypoint, performed in ((inside, motion.q[: inside.row + 1]), (outside, motion.q[inside.row :])):
        measured = path_deviation(crossed(), performed, path)
        assert waypoint.off_curve == pytest.approx(measured.largest, rel=1e-12)


@pytest.mark.long
def test_a_motion_that_leaves_the_path_on_its_way_is_missed_though_it_arrives():
    """Selection moves a few points at a time, so that the others leave the path."""
    arm = Arm.from_modules([feed(upper=1.2, length=0.05), *[template("RyRz")] * 10])
    path = arc(0.2, np.pi / 2)
    reference = follow_leader(arm, path, 0.1, 0.05)
    motion = perform(reference, "selection", Limits(step=None, dt=0.1))
    off = path_deviation(arm, motion.run.q, path).largest
    assert off > 0.1 * LINK + path_deviation(arm, rows(reference), path).largest
    assert motion.run.mean_error[-1] < 1e-6
    assert motion.run.status == "missed"
    assert f"the arm left its path by {length_text(off)} on the way to inside" in motion.run.reason
    assert motion.faults


REFUSED = {
    "speed": ({"speed": 0.0}, InvalidValue, "speed is 0.0"),
    "interval": ({"interval": -1.0}, InvalidValue, "interval is -1.0"),
    "path": ({"path": "helix"}, InvalidValue, "path is 'helix'; allowed: a Curve"),
    "placement": ({"placement": "translate"}, UnknownName, "no placement is called 'translate'"),
    "method": ({"method": "smooth"}, UnknownName, "no method is called 'smooth'"),
    "no depth": ({"depth": 0.0}, InvalidValue, "depth is 0.0"),
    "short path": ({"depth": 0.31}, InvalidValue, "at most 0.3 m: the path is 0.3 m long"),
    "short feed": (
        {"path": lambda: Curve.line((0, 0, 0), (0.7, 0, 0))},
        InvalidValue,
        "at most 0.6 m: the feed has 0.6 m of travel from the start, 100 mm are missing; depth= follows",
    ),
    "bend at the feed": ({"path": lambda: arc(0.2, 2.3)}, InvalidValue, "straight feed would leave"),
    "elsewhere": (
        {"placement": "as_is"},
        InvalidValue,
        "90 degrees off the axis of the arm'; allowed: within 0.057 degrees",
    ),
    "no feed": (
        {"arm": lambda: Arm.from_modules(HINGES)},
        InvalidValue,
        "m01_j1_z (revolute), m02_j1_z (revolute)",
    ),
    "coupled joints": (
        {"arm": lambda: Arm.from_modules([feed(), continuum_section(3)])},
        InvalidValue,
        "follows 'm02_j2_z'",
    ),
    "feed across": (
        {"arm": lambda: Arm.from_modules([feed("y"), *HINGES])},
        InvalidValue,
        "90 degrees off the straight arm, whose tip is 430 mm beside it",
    ),
    "no arm": ({"arm": "snake"}, InvalidValue, "arm is 'snake'"),
    "bent start": ({"start": np.full(9, 0.1)}, InvalidValue, "the straight arm"),
    "short start": ({"start": np.zeros(3)}, InvalidValue, "start"),
    "tight bend": ({"path": lambda: arc(0.015, 3.0)}, CurveBendsTooMuch, "m along the curve"),
    "out of its plane": (
        {"path": lambda: Curve.helix(0.1, 0.3, 0.15)},
        CurveBendsTooMuch,
        "(at a depth of ",
    ),
}


@pytest.mark.parametrize(("change", "error", "words"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_followed_is_refused(change, error, words):
    asked = {"arm": hinged, "path": lambda: arc(0.2, 1.5), "interval": 0.1, "speed": 0.1} | change
    asked = {name: value() if callable(value) else value for name, value in asked.items()}
    with pytest.raises(error) as caught:
        follow_leader(**asked)
    assert words in str(caught.value)


def test_all_reasons_are_named_at_once_with_what_is_allowed_and_what_is_missing():
    """Amounts are those of the construction: lengths, a shift of (1, 2, 3) mm, a turn of 0.87 degrees."""
    arm = hinged()
    tip = arm.at(arm.neutral()).points[-1]
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(0.87))
    path = Curve.line((0, 0, 0), (0.9, 0, 0)).moved(turn, tip + (1e-3, 2e-3, 3e-3))
    with pytest.raises(InvalidValue) as caught:
        follow_leader(arm, path, 0.0, -0.1, placement="as_is", depth=1.0)
    words = (
        "5 reasons: (1) interval is 0.0",
        "(2) speed is -0.1",
        "(3) start of the path is '3.74 mm from the tip'; allowed: within 0.004 mm of the tip, at (0.43,",
        "move it by (-0.001, -0.002, -0.003) m, or the base of the arm the other way",
        "(4) first direction of the path is '0.87 degrees off the axis of the arm'",
        "allowed: within 0.057 degrees of the arm, (1, 0, 0)",
        "(5) depth is 1.0; allowed: at most 0.9 m: the path is 0.9 m long, 100 mm are missing",
        "at most 0.6 m: the feed has 0.6 m of travel from the start, 400 mm are missing",
    )
    for each in words:
        assert each in str(caught.value)
    assert [type(each) for each in caught.value.reasons] == [InvalidValue] * 5


def test_a_start_names_the_joint_that_is_bent_and_the_one_beyond_its_limit():
    start = hinged().neutral()
    start[0] = 0.7
    start[3] = 0.02
    with pytest.raises(InvalidValue) as caught:
        follow_leader(hinged(), arc(0.2, 0.5), 0.1, 0.1, start=start)
    assert "1 of 8 joints bent, most m04_j1_z, by 0.02'; allowed: the straight arm, to within 1e-06" in str(
        caught.value
    )
    assert "m01_j1_x at 0.7, 0.1 beyond its limit'; allowed: from 0 to 0.6" in str(caught.value)


def test_an_arm_without_a_feed_names_all_that_is_missing():
    arm = Arm.from_modules([continuum_section(3), *HINGES])
    with pytest.raises(InvalidValue) as caught:
        follow_leader(arm, arc(0.2, 0.5), 0.1, 0.1)
    assert [each.name for each in caught.value.reasons][1] == "first joints of the arm"
    assert "follows" in str(caught.value.reasons[0])


@pytest.mark.parametrize("method", ["closest", "sequential"])
def test_narrow_limits_name_the_module_and_the_place_on_the_path(method):
    points = [(0, 0, 0), (0.1, 0, 0), (0.2, 0, 0), (0.25, 0.02, 0), (0.27, 0.12, 0), (0.27, 0.3, 0)]
    path = Curve.spline(points)
    arm = Arm.from_modules([feed(), *[each.with_limits(-0.1, 0.1) for each in CROSSED]])
    s = np.linspace(0.0, path.length, 500)
    bent = s[path.curvature(s) > 0.1 / LINK]  # where a module would have to turn by more than it can
    with pytest.raises(CurveBendsTooMuch) as caught:
        follow_leader(arm, path, 0.1, 0.1, method=method, depth=0.4)
    assert caught.value.module == 9  # the tip gets there first; the feed is the first module
    assert bent[0] - 2 * LINK < caught.value.parameter < bent[-1] + 2 * LINK


def test_sequential_placement_needs_joints_that_move_the_end():
    rolling = ModuleTemplate("Rx", [JointSpec("x")], [0.05])
    arm = Arm.from_modules([feed(), rolling, *CROSSED[:4]])
    with pytest.raises(UnsupportedModule) as caught:
        follow_leader(arm, arc(0.2, 1.5), 0.1, 0.1, depth=0.1, method="sequential")
    assert caught.value.module == 2
    assert caught.value.joints == arm.module_joints[1]


def test_modules_without_closed_forms_follow_in_turn_too():
    tilted = ModuleTemplate("tilted", [JointSpec("y"), JointSpec((0.3, 0.2, 1.0))], [0.02, 0.03])
    arm = Arm.from_modules([feed(), *[tilted] * 4])
    run = follow_leader(arm, arc(0.2, 1.5), 0.1, 0.1, depth=0.15, method="sequential")
    deviation = path_deviation(arm, rows(run), arc(0.2, 1.5))
    assert deviation.points[:, 1:].max() < 1e-4


@pytest.mark.parametrize("q", [np.zeros((2, 3)), np.zeros((0, 9)), np.zeros(9)])
def test_deviation_wants_rows_of_configurations(q):
    with pytest.raises(InvalidValue, match="q \\(shape\\)"):
        path_deviation(hinged(), q, arc(0.2, 1.5))


@pytest.mark.long
def test_an_arm_whose_joints_reach_their_limits_stays_as_near_the_path_as_they_allow() -> None:
    """Joints that reach a limit in one step must be free to leave it in the next part of the same step."""
    hinges = (JointSpec("y", lower=-0.12, upper=0.12), JointSpec("z", lower=-0.12, upper=0.12))
    feed = ModuleTemplate("feed", (JointSpec("x", type="prismatic", lower=0.0, upper=1.2),), (0.05,))
    arm = Arm.from_modules([feed] + [ModuleTemplate("bend", hinges, (0.025, 0.025))] * 20)
    rng = np.random.default_rng(0)
    points = [arm.at(arm.straight()).points[-1]]
    heading = np.array([1.0, 0.0, 0.0])
    for number in range(12):
        points.append(points[-1] + 0.08 * heading)
        if number > 0:
            heading = heading + np.cross(0.3 * rng.normal(size=3), heading)
            heading /= np.linalg.norm(heading)
    path = Curve.points(np.array(points))
    reference = follow_leader(arm, path, speed=0.05, interval=0.1)
    q = np.array([arm.integrate(reference.start, offset) for offset in reference.offsets])
    assert path_deviation(arm, q, path, start=reference.start).largest < 5e-3
