"""Keyframe motions of arms with closed forms: keyframes, continuity, limits, closed forms in between."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sampling import examples
from scipy.spatial.distance import pdist, squareform
from task.keyed_arms import S_CURVE, coil, five_postures, positions, snake, straight

import pinposture as pp
from pinposture.task.keyframe import resolve_keyframe
from pinposture.task.keyframes import Keyframe, keyframe_reference
from pinposture.task.reference import Reference

J = pp.JointSpec


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 20)


@pytest.fixture(scope="session")
def small() -> pp.Arm:
    return template_arm("RyRz", 6, (0.1, 0.08))


def points(reference: Reference, rows: np.ndarray | range) -> np.ndarray:
    return np.array([reference.arm.at(reference.configuration(int(row))).points for row in rows])


@pytest.fixture(scope="module", params=("velocity", "acceleration"))
def five(arm: pp.Arm, request: pytest.FixtureRequest) -> Reference:
    return keyframe_reference(arm, five_postures(), 0.02, request.param)


def test_keyframes_are_taken_exactly_at_their_times(arm: pp.Arm, five: Reference) -> None:
    assert [waypoint.name for waypoint in five.waypoints] == [
        "straight",
        "S",
        "keyframe 3",
        "coil",
        "keyframe 5",
    ]
    times = [five.times[waypoint.row] for waypoint in five.waypoints]
    assert np.allclose(times, [0.0, 1.5, 2.5, 4.5, 7.0])  # to whole cycles of 0.02 s
    for waypoint, keyframe in zip(five.waypoints, five_postures(), strict=True):
        alone = pp.resolve_targets(arm, keyframe.curve)
        q = five.configuration(waypoint.row)
        assert np.array_equal(q, waypoint.target.q)
        assert np.abs(q - alone.q).max() < 1e-3  # by default, fewer samples stand for the curve
        assert np.array_equal(waypoint.target.points, arm.at(q).points)
        assert np.linalg.norm(waypoint.target.points - alone.points, axis=1).max() < 5e-5
        assert waypoint.target.residual.max() < 1e-8
        assert np.all(waypoint.target.weights == 1.0)


def test_it_begins_ends_and_holds_at_rest(arm: pp.Arm, five: Reference) -> None:
    q = positions(five)
    coiled = five.waypoints[3].row
    held = coiled + round(0.5 / five.interval)
    assert np.array_equal(q[coiled : held + 1], np.broadcast_to(q[coiled], (held + 1 - coiled, arm.nv)))
    steps = np.abs(np.diff(q, axis=0)).max(axis=1)
    for row in (0, coiled - 1, held, len(steps) - 1):
        assert steps[row] < 0.02 * steps.max()
    assert five.duration == pytest.approx(7.0)


def test_joints_stay_within_limits_and_take_short_steps(arm: pp.Arm, five: Reference) -> None:
    q = positions(five)
    assert np.all((q >= arm.limits.lower) & (q <= arm.limits.upper))
    assert np.abs(np.diff(q, axis=0)).max() <= 0.06


def test_the_arm_never_touches_itself_while_it_uncoils(five: Reference) -> None:
    uncoiling = range(five.waypoints[3].row, five.rows, 9)
    apart = np.abs(np.subtract.outer(np.arange(20), np.arange(20))) >= 3
    nearest = min(squareform(pdist(each))[apart].min() for each in points(five, uncoiling))
    assert nearest > 0.9 * 0.06  # the rise of the coil in one turn


@pytest.mark.long
@pytest.mark.parametrize("continuity", ("velocity", "acceleration"))
def test_joints_move_as_continuously_as_the_curve(arm: pp.Arm, continuity: str) -> None:
    def largest_change(order: int, interval: float) -> float:
        reference = keyframe_reference(arm, five_postures(), interval, continuity)
        assert reference.interval == interval
        return float(np.abs(np.diff(positions(reference), order, axis=0)).max()) / interval ** (order - 1)

    # How much velocity (or acceleration) changes from row to row falls with the distance of rows.
    order = 2 if continuity == "velocity" else 3
    assert largest_change(order, 0.005) < 0.6 * largest_change(order, 0.01)


def test_between_two_arcs_the_arm_lies_on_the_arc_of_the_mean_curvature(arm: pp.Arm) -> None:
    arcs = [pp.Curve.helix(radius, 0, 1, axis=(0, 0, 1)) for radius in (1.0, 0.25)]
    keyframes = [
        Keyframe(arcs[0], trim=True, placement="align"),
        Keyframe(arcs[1], duration=1.0, trim=True, placement="align"),
    ]
    reference = keyframe_reference(arm, keyframes, 0.01)
    for share in (0.2, 0.5, 0.9):
        row = round(share * (reference.rows - 1))
        spline = 3 * share**2 - 2 * share**3
        radius = 1.0 / ((1 - spline) * 1.0 + spline * 4.0)
        found = points(reference, [row])[0]
        away = np.hypot(found[:, 0], np.linalg.norm(found[:, 1:], axis=1) - radius)
        assert np.allclose(away, radius, atol=1e-7)


@pytest.mark.parametrize("name", ("RzRy", "RzRzRz"))
def test_other_templates_follow_their_curves(name: str) -> None:
    arm = pp.Arm.from_template(name, modules=8)
    ring = pp.Curve.helix(arm.length / 5, 0, 1, axis=(0, 0, 1))
    hook = pp.Curve.spline(arm.length * S_CURVE * (1, 1, 0))
    keyframes = [
        Keyframe(straight(arm.length)),
        Keyframe(ring, duration=1.0, trim=True, placement="align"),
        Keyframe(hook, duration=1.0, trim=True),
    ]
    reference = keyframe_reference(arm, keyframes, 0.05)
    assert {waypoint.target.method for waypoint in reference.waypoints} == {"sequential"}
    assert np.abs(np.diff(positions(reference), axis=0)).max() <= 0.06
    assert max(waypoint.target.residual.max() for waypoint in reference.waypoints) < 1e-8 * arm.length
    # Ends of modules stay as far apart as modules can be long.
    found = points(reference, range(0, reference.rows, 7))
    ends = np.linalg.norm(np.diff(found, axis=1), axis=2)
    assert ends.max() <= arm.length / 8 + 1e-9
    assert ends.min() > 0.9 * arm.length / 8


def test_continuous_joints_go_on_past_half_a_turn() -> None:
    arm = snake(J("z", "continuous"), modules=12)

    def out(angle: float) -> pp.Curve:
        return pp.Curve.line((0, 0, 0), (0.3 * np.cos(angle), 0.3 * np.sin(angle), 0))

    keyframes = [
        Keyframe(out(angle), duration=None if angle == 0 else 1.0, placement="as_is")
        for angle in (0.0, 2.5, 5.0, 7.5, 5.0)
    ]
    reference = keyframe_reference(arm, keyframes, 0.02)
    turned = [reference.offsets[waypoint.row, 0] for waypoint in reference.waypoints]
    assert np.allclose(turned, (0.0, 2.5, 5.0, 7.5, 5.0), atol=1e-9)
    assert np.abs(np.diff(reference.offsets, axis=0)).max() <= 0.06


@pytest.mark.parametrize(("lasting", "interval"), ((1.0, 0.5), (0.2, 0.2)))
def test_rows_are_added_until_steps_are_short(arm: pp.Arm, lasting: float, interval: float) -> None:
    keyframes = [Keyframe(straight(1.0)), Keyframe(coil(1.0), duration=lasting, trim=True)]
    reference = keyframe_reference(arm, keyframes, interval)
    finer = interval / reference.interval
    assert finer == pytest.approx(round(finer))
    assert reference.rows - 1 == round(lasting / interval) * round(finer) >= 16
    assert np.abs(np.diff(positions(reference), axis=0)).max() <= 0.06
    assert reference.duration == pytest.approx(lasting)


def test_between_a_region_and_all_a_point_has_a_target_if_it_has_one_at_either_end(arm: pp.Arm) -> None:
    keyframes = five_postures()
    for index, region in ((1, (0, 4)), (2, (3, 9)), (3, (0, 9))):
        keyframes[index] = replace(keyframes[index], region=region)
    reference = keyframe_reference(arm, keyframes, 0.02)
    rows = [waypoint.row for waypoint in reference.waypoints]

    def chosen(row: int) -> list[int]:
        return np.flatnonzero(reference.weights[row]).tolist()

    assert chosen(rows[0] + 1) == list(range(20))
    assert chosen(rows[1]) == [0, 1, 2, 3, 4]
    assert chosen(rows[1] + 1) == chosen(rows[2] - 1) == list(range(10))
    assert chosen(rows[2]) == list(range(3, 10))
    held = rows[3] + round(0.5 / reference.interval)
    assert chosen(rows[3]) == chosen(held) == list(range(10))
    assert chosen(held + 1) == chosen(rows[4]) == list(range(20))
    assert np.array_equal(reference.waypoints[1].target.weights, reference.weights[rows[1]])


def test_tips_are_served_and_the_rest_of_the_motion_stays(arm: pp.Arm) -> None:
    keyframes = five_postures()
    plain = keyframe_reference(arm, keyframes, 0.02)
    tips = [waypoint.target.points[-1] for waypoint in plain.waypoints]
    wanted = tips[1] - (0.05, 0.02, 0.0), tips[3] + (0.01, 0.0, 0.0)
    keyframes[1] = replace(keyframes[1], tip=pp.EndEffector(wanted[0], priority=True), region=(0, 9))
    keyframes[3] = replace(keyframes[3], tip=pp.EndEffector(wanted[1], weight=100.0))
    reference = keyframe_reference(arm, keyframes, 0.02)
    first = reference.waypoints[1]
    last = reference.waypoints[3]
    assert np.linalg.norm(first.target.points[-1] - wanted[0]) < 1e-4 * arm.length
    assert (
        np.linalg.norm(first.target.points[:10] - plain.waypoints[1].target.points[:10], axis=1).max() < 1e-3
    )
    assert np.linalg.norm(last.target.points[-1] - wanted[1]) < 0.005
    offsets = positions(reference) - positions(plain)
    for row in (0, reference.waypoints[2].row, reference.waypoints[4].row):
        assert np.abs(offsets[row]).max() < 1e-9
    assert np.abs(np.diff(positions(reference), axis=0)).max() <= 0.06
    held = slice(last.row, last.row + round(0.5 / reference.interval) + 1)
    assert np.ptp(reference.offsets[held], axis=0).max() == 0.0
    q = positions(reference)
    assert np.all((q >= arm.limits.lower) & (q <= arm.limits.upper))


@pytest.mark.long
@pytest.mark.parametrize("name", ("RyRz", "RyRz, 20 modules", "Rz", "narrow"))
@given(st.integers(0, 10_000), st.booleans())
@examples(4)
def test_a_tip_with_priority_goes_wherever_reach_brings_it(name: str, seed: int, posed: bool) -> None:
    narrow = pp.ModuleTemplate("narrow", tuple(J(axis, lower=-0.4, upper=0.4) for axis in "yz"), (0.05, 0.05))
    arm = {
        "RyRz": lambda: template_arm("RyRz", 10),
        "RyRz, 20 modules": lambda: template_arm("RyRz", 20),
        "Rz": lambda: template_arm("Rz", 12),
        "narrow": lambda: pp.Arm.from_modules([narrow] * 6),
    }[name]()
    state = arm.at(arm.random(np.random.default_rng(seed)))
    pose = pin.SE3(state.rotations[-1], state.points[-1])
    reached = pp.reach(arm, pose if posed else state.points[-1])
    tip = (
        pp.EndEffector(pose=pose, priority=True) if posed else pp.EndEffector(state.points[-1], priority=True)
    )
    line = Keyframe(straight(1.2 * arm.length), trim=True, placement="align", tip=tip)
    target = resolve_keyframe(arm, line)
    found = arm.at(target.q)
    assert arm.within_limits(target.q)
    assert np.linalg.norm(found.points[-1] - state.points[-1]) <= 1e-5 * arm.length
    if posed:
        assert np.abs(found.rotations[-1] - state.rotations[-1]).max() <= 1e-4
    assert len(reached) == 1


@pytest.mark.long
def test_an_arm_moves_its_tip_where_priority_asks(arm: pp.Arm) -> None:
    line = straight(1.2)
    place = np.array((0.5, 0.2, 0.2))
    tip = pp.EndEffector(position=place, priority=True)
    keyframes = [Keyframe(line, trim=True), Keyframe(line, duration=5.0, trim=True, tip=tip)]
    motion = pp.move_through(arm, keyframes)
    assert motion.run.status == "converged"
    assert np.linalg.norm(motion.run.points[-1, -1] - place) <= 1e-5


def test_progress_is_told(small: pp.Arm) -> None:
    told: list[tuple[int, int]] = []
    reference = keyframe_reference(
        small, [Keyframe(straight(1.2)), Keyframe(straight(1.2), roll=1.0, duration=4.0)], 0.01,
        progress=lambda done, total: told.append((done, total)),
    )  # fmt: skip
    assert told[-1] == (reference.rows, reference.rows)
    assert all(a[0] <= b[0] for a, b in itertools.pairwise(told))


@given(
    arrays(float, (3, 4, 3), elements=st.floats(-0.15, 0.15)),
    st.lists(st.floats(0.3, 2.0), min_size=2, max_size=2),
    st.sampled_from(("velocity", "acceleration")),
)
@examples(20)
def test_any_splines_give_a_motion_that_keeps_its_promises(
    small: pp.Arm, noise: np.ndarray, durations: list[float], continuity: str
) -> None:
    even = np.linspace((0.35, 0, 0), (1.5, 0, 0), 4)
    curves = [pp.Curve.spline(np.vstack([[0, 0, 0], even + each])) for each in noise]
    keyframes = [
        Keyframe(curve, duration=lasting, trim=True)
        for curve, lasting in zip(curves, (None, *durations), strict=True)
    ]
    reference = keyframe_reference(small, keyframes, 0.05, continuity)
    q = positions(reference)
    assert np.all(np.isfinite(q))
    assert np.all((q >= small.limits.lower) & (q <= small.limits.upper))
    assert np.abs(np.diff(q, axis=0)).max() <= 0.06
    steps = np.abs(np.diff(q, axis=0)).max(axis=1)
    # From rest, a smooth motion is slow at first: its first step of n is a small share of its largest one.
    first, middle, last = (waypoint.row for waypoint in reference.waypoints)
    for away in (steps[first:middle], steps[middle:last][::-1]):
        assert away[0] <= 0.6 * away.max() / max(len(away) // 16, 1) + 1e-9
    for waypoint, curve in zip(reference.waypoints, curves, strict=True):
        own = pp.resolve_targets(small, curve, method=waypoint.target.method)
        assert waypoint.target.residual.max() <= own.residual.max() + 0.01 * 0.18
