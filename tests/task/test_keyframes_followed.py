"""Keyframe motions by least squares: arms without closed forms, and curves that bend too much in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from nearest import distances_to_nearest
from task.keyed_arms import S_CURVE, coil, five_postures, positions, snake, straight

import pinposture as pp
import pinposture.task.keyframes as planning
from pinposture.errors import PostureWarning
from pinposture.task.keyframes import Keyframe, keyframe_reference
from pinposture.task.reference import AnchoredCurve, Bending, Reference, crossfade
from pinposture.task.reference import off_curve as planned_off_curve

J = pp.JointSpec
ARMS = {
    "tilted axes": lambda: snake(J((0.2, 1.0, 0.1)), J((-0.1, 0.3, 1.0)), modules=8),
    "three hinges": lambda: snake(J("y"), J("z"), J("y"), modules=6),
    "sliding": lambda: snake(J("y"), J("z"), J("x", "prismatic", 0.0, 0.02), modules=6),
    "continuous": lambda: snake(J((0.1, 1.0, 0.0), "continuous"), J("z", "continuous"), modules=8),
}


def gentle(length: float) -> list[Keyframe]:
    bow = pp.Curve.helix(length / 2, 0.1 * length, 1)
    hook = pp.Curve.spline(1.2 * length * S_CURVE)
    return [
        Keyframe(straight(1.5 * length), trim=True, method="closest"),
        Keyframe(bow, duration=1.0, trim=True, roll=0.5, placement="align"),
        Keyframe(hook, duration=1.0, trim=True),
        Keyframe(straight(1.5 * length), duration=1.0, trim=True, method="closest"),
    ]


def promises(reference: Reference) -> None:
    """What holds of every reference."""
    arm = reference.arm
    q = positions(reference)
    assert np.all(np.isfinite(q))
    assert np.all((q >= arm.limits.lower) & (q <= arm.limits.upper))
    assert (np.abs(np.diff(q, axis=0)) / arm.joint_units).max() <= 0.06
    for waypoint in reference.waypoints:
        assert np.array_equal(waypoint.target.q, reference.configuration(waypoint.row))


def midway(reference: Reference, index: int) -> tuple[np.ndarray, int]:
    """Points that trace the curve in the middle of the time from one rest to the next; and the row."""
    arm, (first, last) = reference.arm, reference.waypoints[index : index + 2]
    bending = Bending(arm, 1.2 * max(arm.length, first.target.parameters[-1]))
    vectors = []
    for waypoint in (first, last):
        vectors.append(
            bending.vector(AnchoredCurve(waypoint.target.curve, 0.0), vectors[-1] if vectors else None)
        )
    curve = bending.curves(np.mean(vectors, axis=0)[None])[0]
    return curve.at(np.linspace(0, curve.length, 40_000)), (first.row + last.row) // 2


def off_curve(reference: Reference, index: int) -> float:
    """How far off that curve the control points are, in arm lengths."""
    traced, row = midway(reference, index)
    points = reference.arm.at(reference.configuration(row)).points
    return float(distances_to_nearest(points, traced).max()) / reference.arm.length


@pytest.mark.long
@pytest.mark.parametrize("name", ARMS)
def test_arms_without_closed_forms_follow_their_curves(name: str) -> None:
    arm = ARMS[name]()
    reference = keyframe_reference(arm, gentle(arm.length), 0.02)
    promises(reference)
    for waypoint in reference.waypoints:
        assert waypoint.target.residual.max() < 1e-5 * arm.length
    alone = keyframe_reference(arm, gentle(arm.length)[:2], 0.02)
    assert off_curve(alone, 0) < 1e-4


@pytest.mark.long
def test_an_arm_that_has_to_roll_while_it_is_straight_does_so_without_a_jump() -> None:
    arm = snake(J("x"), J("z"), modules=10)
    length = arm.length
    arc = pp.Curve.helix(length / 4, 0, 1, axis=(0, 0, 1))
    keyframes = [
        Keyframe(straight(length)),
        Keyframe(arc, duration=1.0, hold=0.1, trim=True, placement="align"),
        Keyframe(straight(length), duration=1.0),
        Keyframe(arc, duration=1.0, roll=np.pi / 2, trim=True, placement="align"),
    ]
    reference = keyframe_reference(arm, keyframes, 0.01)
    promises(reference)
    assert np.array_equal(reference.start, arm.neutral())
    assert max(waypoint.target.residual.max() for waypoint in reference.waypoints) < 5e-4 * length
    # Half way it is on the arc of half the curvature, in either plane.
    assert off_curve(reference, 0) < 5e-3


@pytest.mark.long
def test_rolling_modules_take_postures_in_space() -> None:
    arm = snake(J("x"), J("z"), modules=6)
    reference = keyframe_reference(arm, five_postures(arm.length)[:3], 0.05)
    promises(reference)
    assert max(waypoint.target.residual.max() for waypoint in reference.waypoints) < 2e-2 * arm.length


@pytest.mark.parametrize("continuity", ("velocity", "acceleration"))
def test_a_shape_near_the_joint_limits_is_held_between_equal_keyframes(continuity: str) -> None:
    bend = 0.265
    arm = snake(J("y", lower=-bend, upper=bend), J("z", lower=-bend, upper=bend), modules=20)
    ring = pp.Curve.helix(0.2, 0, 0.95, axis=(0, 0, 1))
    keyframes = [
        Keyframe(straight(1.0)),
        Keyframe(ring, duration=1.0, trim=True, placement="align"),
        Keyframe(ring, duration=1.0, trim=True, placement="align"),
        Keyframe(straight(1.0), duration=1.0),
    ]
    reference = keyframe_reference(arm, keyframes, 0.05, continuity)
    promises(reference)
    assert {waypoint.target.method for waypoint in reference.waypoints} == {"sequential"}
    assert max(waypoint.target.residual.max() for waypoint in reference.waypoints) < 1e-8
    between = slice(reference.waypoints[1].row, reference.waypoints[2].row)
    assert np.ptp(positions(reference)[between], axis=0).max() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("repeat", (1, 2))
def test_a_time_that_is_much_too_short_does_not_multiply_the_rows_of_all_others(repeat: int) -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    keyframes = [
        Keyframe(straight(1.2 * arm.length), trim=True, method="smooth"),
        Keyframe(coil(2.5 * arm.length), duration=0.05, trim=True, placement="align", method="smooth"),
        Keyframe(straight(1.2 * arm.length), duration=3.0, trim=True, method="smooth"),
    ]
    reference = keyframe_reference(arm, keyframes, 0.05, repeat=repeat)
    slow = [replace(keyframes[0])] + [replace(each, duration=3.0) for each in keyframes[1:]]
    alike = keyframe_reference(arm, slow, 0.05, repeat=repeat)
    assert reference.rows <= repeat * 10_000
    for waypoint, other in zip(reference.waypoints, alike.waypoints, strict=True):
        assert np.allclose(waypoint.target.points, other.target.points, atol=1e-4 * arm.length)


@pytest.mark.long
def test_rows_between_those_placed_by_least_squares_are_as_if_they_were(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm = ARMS["tilted axes"]()
    first, second = gentle(arm.length)[:2]
    keyframes = [first, replace(second, duration=60.0)]
    some = keyframe_reference(arm, keyframes, 0.05)
    monkeypatch.setattr(planning, "TRANSITION", planning.TRANSITION._replace(most_solved=10_000))
    each = keyframe_reference(arm, keyframes, 0.05)
    assert some.rows == each.rows == 1201
    assert np.abs(positions(some) - positions(each)).max() < 1e-5


@pytest.mark.long
def test_one_method_serves_the_whole_motion_unless_a_keyframe_asks_for_its_own() -> None:
    arm = pp.Arm.from_template("RyRz", modules=8)
    slanted = pp.Curve.spline(1.2 * arm.length * (S_CURVE + [[0, 0, 0], *[(0, 0.3, 0)] * 4]))
    keyframes = [
        Keyframe(straight(arm.length), duration=None),
        Keyframe(slanted, duration=1.0, placement="translate", trim=True),
        Keyframe(coil(2.5 * arm.length), duration=1.0, trim=True, placement="align"),
    ]
    reference = keyframe_reference(arm, keyframes, 0.02)
    promises(reference)
    assert [waypoint.target.method for waypoint in reference.waypoints] == ["smooth"] * 3
    keyframes[2] = replace(keyframes[2], method="sequential")
    mixed = keyframe_reference(arm, keyframes, 0.02)
    promises(mixed)
    assert mixed.waypoints[2].target.method == "sequential"
    assert mixed.waypoints[2].target.residual.max() < 1e-8
    alone = pp.resolve_targets(arm, keyframes[2].curve, 200_000, placement="align", method="sequential")
    assert np.abs(mixed.configuration(mixed.waypoints[2].row) - alone.q).max() < 1e-6


def test_a_crossfade_begins_with_one_motion_and_ends_with_the_other() -> None:
    before = np.zeros((81, 2))
    after = np.ones((81, 2))
    for start in (0, 30, 60):
        faded = crossfade(before, after, start)
        assert np.all(faded[: start + 1] == 0.0)
        assert np.all(faded[start + 20 :] == 1.0)
        assert np.all(np.diff(faded, axis=0) >= 0.0)
        assert np.abs(np.diff(faded, 2, axis=0)).max() < 6.0 / 20**2  # that of 10 t^3 - 15 t^4 + 6 t^5


# Arms with slides, which extend to the end of each curve.

FEED = pp.ModuleTemplate("feed", (pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.0),), (0.05,))
TELESCOPE = pp.ModuleTemplate(
    "telescope",
    (J("y"), J("z"), pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.06)),
    (0.025, 0.0, 0.05),
)
BENDS = pp.template("RyRz")
SLIDING_ARMS = {
    "feed at the base": lambda: pp.Arm.from_modules([FEED, *[BENDS] * 4]),
    "feed in the middle": lambda: pp.Arm.from_modules([*[BENDS] * 3, FEED, *[BENDS] * 3]),
    "feed at the tip": lambda: pp.Arm.from_modules([*[BENDS] * 4, FEED]),
    "telescope": lambda: pp.Arm.from_modules([TELESCOPE] * 8),
}


def tip(reference: Reference, row: int) -> np.ndarray:
    return np.asarray(reference.arm.at(reference.configuration(row)).points[-1])


@pytest.mark.long
@pytest.mark.parametrize("continuity", ("velocity", "acceleration"))
@pytest.mark.parametrize("name", SLIDING_ARMS)
def test_slides_extend_and_retract_from_curve_to_curve(name: str, continuity: str) -> None:
    arm = SLIDING_ARMS[name]()
    retracted = float(np.linalg.norm(arm.at(arm.neutral()).points[-1]))
    stroke = float(arm.limits.upper[arm.slides].sum())
    lengths = [retracted + share * stroke for share in (0.1, 0.8, 0.3)]
    keyframes = [
        Keyframe(straight(length), duration=None if index == 0 else 2.0)
        for index, length in enumerate(lengths)
    ]
    reference = keyframe_reference(arm, keyframes, 0.05, continuity)
    rows = [waypoint.row for waypoint in reference.waypoints]
    for waypoint, length in zip(reference.waypoints, lengths, strict=True):
        off = np.linalg.norm(tip(reference, waypoint.row) - (length, 0.0, 0.0))
        assert off <= 1e-4 * arm.length
        assert planned_off_curve(waypoint) == pytest.approx(off, abs=1e-9)
    along = np.array([tip(reference, row)[0] for row in range(reference.rows)])
    for begin, end, sign in ((rows[0], rows[1], 1.0), (rows[1], rows[2], -1.0)):
        assert np.all(sign * np.diff(along[begin : end + 1]) >= -1e-6 * arm.length)


@pytest.mark.long
def test_a_long_feed_extends_with_twenty_modules() -> None:
    arm = pp.Arm.from_modules([replace(FEED, link_lengths=(0.0,)), *[BENDS] * 20])
    keyframes = [Keyframe(straight(1.2)), Keyframe(straight(1.9), duration=5.0)]
    motion = pp.move_through(arm, keyframes, limits=pp.Limits(step=None, dt=0.05, velocity=1.0))
    tips = [motion.run.points[place.row, -1, 0] for place in motion.waypoints]
    assert motion.run.status == "converged"
    assert np.allclose(tips, (1.2, 1.9), atol=1e-4)


def test_a_curved_shape_is_taken_with_its_slides_as_alone() -> None:
    arm = SLIDING_ARMS["telescope"]()
    bow = pp.Curve.helix(0.5, 0.0, 0.3, axis=(0, 0, 1))
    keyframes = [Keyframe(straight(0.65)), Keyframe(bow, duration=2.0), Keyframe(straight(0.8), duration=2.0)]
    keyframes = [replace(each, placement="align") for each in keyframes]
    reference = keyframe_reference(arm, keyframes, 0.05)
    promises(reference)
    for waypoint, keyframe in zip(reference.waypoints, keyframes, strict=True):
        alone = pp.resolve_targets(arm, keyframe.curve, placement="align")
        assert np.linalg.norm(waypoint.target.points - alone.points, axis=1).max() < 1e-4 * arm.length


def test_a_base_without_limits_moves_from_curve_to_curve() -> None:
    axes = tuple(pp.JointSpec(axis, type="prismatic", lower=-1e9, upper=1e9) for axis in "xyz")
    base = pp.ModuleTemplate("base", axes, (0.0, 0.0, 0.05))
    arm = pp.Arm.from_modules([base, *[BENDS] * 6])
    starts = np.array([(0.0, 0.0, 0.0), (0.3, 0.2, 0.1), (0.5, -0.1, 0.0)])
    keyframes = [
        Keyframe(
            pp.Curve.line(start, start + (1.0, 0.0, 0.0)),
            duration=None if index == 0 else 2.0,
            placement="as_is",
            trim=True,
        )
        for index, start in enumerate(starts)
    ]
    reference = keyframe_reference(arm, keyframes, 0.05)
    for waypoint, start in zip(reference.waypoints, starts, strict=True):
        assert np.allclose(arm.positions(reference.configuration(waypoint.row))[:3], start, atol=1e-9)
        assert waypoint.target.residual.max() < 1e-9
    half = positions(reference)[reference.waypoints[1].row // 2, :3]
    assert np.all((half > starts[0]) & (half < starts[1]))


@pytest.mark.long
def test_the_end_of_a_curve_counts_unless_it_is_trimmed() -> None:
    arm = SLIDING_ARMS["feed at the base"]()
    first = Keyframe(straight(0.5))
    long = Keyframe(straight(1.5), duration=3.0)
    reach = arm.length + 1.0
    with pytest.warns(PostureWarning, match="takes the first 1.25 m of its curve of 1.5 m"):
        reference = keyframe_reference(arm, [first, long], 0.05)
    assert planned_off_curve(reference.waypoints[1]) == pytest.approx(1.5 - reach, abs=1e-4)
    for change in ({"trim": True}, {"region": (0, 2), "trim": True}):
        other = keyframe_reference(arm, [first, replace(long, **change)], 0.05)
        assert planned_off_curve(other.waypoints[1]) < 1e-6
