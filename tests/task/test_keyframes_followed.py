"""Keyframe motions by least squares: arms without closed forms, and curves that bend too much in between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from task.keyed_arms import S_CURVE, coil, five_postures, positions, snake, straight

import pinposture as pp
from pinposture.task.keyframes import Keyframe, keyframe_reference
from pinposture.task.reference import AnchoredCurve, Bending, Reference, crossfade

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
    arm, q = reference.arm, positions(reference)
    assert np.all(np.isfinite(q))
    assert np.all((q >= arm.limits.lower) & (q <= arm.limits.upper))
    assert (np.abs(np.diff(q, axis=0)) / arm.joint_units).max() <= 0.06
    for mark in reference.marks:
        assert np.array_equal(mark.target.q, reference.configuration(mark.row))


def midway(reference: Reference, index: int) -> tuple[np.ndarray, int]:
    """Points that trace the curve in the middle of the time from one rest to the next; and the row."""
    arm, (first, last) = reference.arm, reference.marks[index : index + 2]
    bending, vectors = Bending(arm, 1.2 * arm.length), []
    for mark in (first, last):
        vectors.append(
            bending.vector(AnchoredCurve(mark.target.curve, 0.0), vectors[-1] if vectors else None)
        )
    curve = bending.curves(np.mean(vectors, axis=0)[None])[0]
    return curve.at(np.linspace(0, curve.length, 40_000)), (first.row + last.row) // 2


def off_curve(reference: Reference, index: int) -> float:
    """How far off that curve the control points are, in arm lengths."""
    traced, row = midway(reference, index)
    points = reference.arm.at(reference.configuration(row)).points
    return float(KDTree(traced).query(points)[0].max()) / reference.arm.length


@pytest.mark.parametrize("name", ARMS)
def test_arms_without_closed_forms_follow_their_curves(name: str) -> None:
    arm = ARMS[name]()
    reference = keyframe_reference(arm, gentle(arm.length), 0.02)
    promises(reference)
    for mark in reference.marks:
        assert mark.target.residual.max() < 1e-5 * arm.length
    alone = keyframe_reference(arm, gentle(arm.length)[:2], 0.02)
    assert off_curve(alone, 0) < 1e-4


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
    assert max(mark.target.residual.max() for mark in reference.marks) < 5e-4 * length
    # Half way it is on the arc of half the curvature, in either plane.
    assert off_curve(reference, 0) < 5e-3


def test_rolling_modules_take_postures_in_space() -> None:
    arm = snake(J("x"), J("z"), modules=6)
    reference = keyframe_reference(arm, five_postures(arm.length)[:3], 0.05)
    promises(reference)
    assert max(mark.target.residual.max() for mark in reference.marks) < 2e-2 * arm.length


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
    assert {mark.target.method for mark in reference.marks} == {"sequential"}
    assert max(mark.target.residual.max() for mark in reference.marks) < 1e-8
    between = slice(reference.marks[1].row, reference.marks[2].row)
    assert np.ptp(positions(reference)[between], axis=0).max() < 1e-6


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
    assert [mark.target.method for mark in reference.marks] == ["smooth"] * 3
    keyframes[2] = replace(keyframes[2], method="sequential")
    mixed = keyframe_reference(arm, keyframes, 0.02)
    promises(mixed)
    assert mixed.marks[2].target.method == "sequential"
    assert mixed.marks[2].target.residual.max() < 1e-8
    alone = pp.resolve_targets(arm, keyframes[2].curve, 200_000, "align", method="sequential")
    assert np.abs(mixed.configuration(mixed.marks[2].row) - alone.q).max() < 1e-6


def test_a_crossfade_begins_with_one_motion_and_ends_with_the_other() -> None:
    before, after = np.zeros((81, 2)), np.ones((81, 2))
    for start in (0, 30, 60):
        faded = crossfade(before, after, start)
        assert np.all(faded[: start + 1] == 0.0)
        assert np.all(faded[start + 20 :] == 1.0)
        assert np.all(np.diff(faded, axis=0) >= 0.0)
        assert np.abs(np.diff(faded, 2, axis=0)).max() < 6.0 / 20**2  # that of 10 t^3 - 15 t^4 + 6 t^5
