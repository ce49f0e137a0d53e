"""Coming out with a joint that is stuck: against an exhaustive search, dense checks, and refusals."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.ndimage import label

import pinposture as pp
from pinposture.arm import JointSpec, ModuleTemplate
from pinposture.errors import InvalidValue, UnknownName, WeightUnknown
from pinposture.task import retreat
from pinposture.task.retreat import Retreat

Array = NDArray[np.float64]

LINK, RADIUS, MARGIN, MOST = 0.1, 0.01, 0.005, 2.5

CELLS = 161
"""Cells along each axis of the grid."""


@cache
def planar(joints: int = 3) -> pp.Arm:
    hinge = ModuleTemplate("m", (JointSpec("z", lower=-MOST, upper=MOST),), (LINK,))
    return pp.Arm.from_modules([hinge] * joints)


def clearances(positions: Array, discs: Array) -> Array:
    """Return the distances of planar arms (n, joints) from discs (k, 3): x, y and radius, (n,) [m]."""
    angles = np.cumsum(positions, axis=1)
    links = LINK * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    ends = np.cumsum(links, axis=1)
    begins = ends - links
    least = np.full(len(positions), np.inf)
    for x, y, radius in discs:
        to = np.array([x, y]) - begins
        share = np.clip(np.einsum("nij,nij->ni", to, links) / LINK**2, 0.0, 1.0)
        off = np.linalg.norm(to - share[..., None] * links, axis=-1).min(axis=1)
        least = np.minimum(least, off - radius - RADIUS)
    return least


def scene_of(discs: Array) -> pp.Scene:
    balls = {f"ball {k}": pp.Sphere((x, y, 0.0), radius) for k, (x, y, radius) in enumerate(discs)}
    return pp.Scene(balls, margin=MARGIN, self_collision=False, arm_radius=RADIUS)


def drawn(seed: int) -> tuple[Array, Array, Array]:
    """Return discs, a posture among them and one outside, both clear."""
    rng = np.random.default_rng(seed)
    while True:
        count = rng.integers(3, 6)
        around = rng.uniform(0.06, 0.3, count)
        angles = rng.uniform(-np.pi, np.pi, count)
        discs = np.column_stack(
            [around * np.cos(angles), around * np.sin(angles), rng.uniform(0.01, 0.04, count)]
        )
        both = rng.uniform(-MOST, MOST, (2, 3))
        if clearances(both, discs).min() > MARGIN:
            return discs, both[0], both[1]


def truth(discs: Array, q: Array, goal: Array, joint: int) -> bool | None:
    """Return whether a way exists with a joint at the same place in both; None if the grid is too coarse.

    Free space is filled from cell to cell. No part of the arm moves by more than `moved` within a cell: what
    keeps the margin by more than that is free in the whole cell, and what lacks more is not free at all.
    """
    axis = np.linspace(-MOST, MOST, CELLS)
    step = axis[1] - axis[0]
    moved = 0.5 * step * LINK * (3 + 2)
    free = [k for k in range(3) if k != joint]
    positions = np.full((CELLS, CELLS, 3), q[joint])
    positions[..., free[0]], positions[..., free[1]] = np.meshgrid(axis, axis, indexing="ij")
    distances = clearances(positions.reshape(-1, 3), discs).reshape(CELLS, CELLS)
    ends = [tuple(np.rint((each[free] + MOST) / step).astype(int)) for each in (q, goal)]
    surely = label(distances > MARGIN + moved)[0]
    perhaps = label(distances > MARGIN - moved, np.ones((3, 3)))[0]
    if surely[ends[0]] > 0 and surely[ends[0]] == surely[ends[1]]:
        return True
    return None if perhaps[ends[0]] == perhaps[ends[1]] else False


def require_clear(way: Retreat, discs: Array, q: Array, joint: int) -> Array:
    """Require that a way begins at q, keeps the joint and the margin; return where it ends."""
    assert way.path is not None
    rows = way.path.configurations
    assert np.array_equal(rows[0], q)
    assert np.all(rows[:, joint] == q[joint])
    for begin, end in pairwise(rows):
        shares = np.linspace(0.0, 1.0, 2 + int(np.abs(end - begin).max() / 0.005))[:, None]
        assert clearances(begin + shares * (end - begin), discs).min() > MARGIN - 1e-4
    return np.asarray(rows[-1])


def compare(seed: int) -> list[tuple[bool, bool | None]]:
    """Return for each joint whether a way was found, and whether one exists."""
    discs, q, outside = drawn(seed)
    found = []
    for way in pp.can_retreat(planar(), np.array([outside, q]), scene_of(discs), postures=[1]).ways:
        joint = planar().joint_names.index(way.joint)
        goal = outside.copy()
        goal[joint] = q[joint]
        if way.path is not None:
            last = require_clear(way, discs, q, joint)
            if clearances(goal[None], discs)[0] > MARGIN + 1e-6:
                assert np.abs(last - goal).max() < 1e-9
                found.append((True, truth(discs, q, goal, joint)))
        elif "outside" in way.reason:
            assert clearances(goal[None], discs)[0] < MARGIN + 1e-6
        else:
            assert "there may be a way" in way.reason
            found.append((False, truth(discs, q, goal, joint)))
    return found


@pytest.mark.parametrize("seed", [10, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(10))])
def test_ways_out_are_found_where_an_exhaustive_search_finds_them_and_nowhere_else(seed: int) -> None:
    for found, exists in compare(seed):
        assert exists is None or found == exists


def hooked() -> tuple[Array, Array]:
    """Return a way by which the last link hooks around a disc, (n, 3), and discs on both sides, (k, 3)."""
    discs = np.array([(0.12, 0.045, 0.02), (0.1, -0.07, 0.03)])
    return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.1], [0.0, 0.0, 2.1]]), discs


def test_the_exhaustive_search_tells_both_kinds_apart() -> None:
    rows, discs = hooked()
    away = np.array([-2.0, 0.0, 2.1])
    assert truth(np.zeros((0, 3)), rows[-1], away, 2) is True
    assert truth(discs, rows[-1], away, 2) is False


def test_a_posture_that_was_reached_by_one_joint_is_left_by_it_and_by_no_other() -> None:
    rows, discs = hooked()
    scene = scene_of(discs)
    retreats = pp.can_retreat(planar(), rows, scene, "m01_j1_z")
    assert retreats
    assert retreats.first is None
    assert [each.posture for each in retreats.ways] == [0, 1, 2]
    for each in retreats.ways:
        assert each.path is not None
        assert np.allclose(each.path.configurations[-1], rows[0])
        assert each.path.found_by == "the way back"


@pytest.mark.long
def test_the_search_ends_with_the_first_posture_that_is_blocked() -> None:
    rows, discs = hooked()
    away = [-2.0, 0.0, 0.0]
    stuck = pp.can_retreat(
        planar(), rows, scene_of(discs), "m03_j1_z", postures=[2, 1], out=away, until_blocked=True
    )
    assert not stuck
    assert stuck.first is not None
    assert (stuck.first.posture, stuck.first.position) == (2, 2.1)
    assert len(stuck.ways) == 1


def test_a_way_out_can_be_performed_by_the_arm_with_the_joint_locked() -> None:
    rows, discs = hooked()
    scene = scene_of(discs)
    (way,) = pp.can_retreat(planar(), rows, scene, "m02_j1_z", postures=[2]).ways
    assert way.path is not None
    timed = pp.retime(way.path, pp.Limits(dt=0.01, velocity=1.0, acceleration=5.0))
    assert timed.duration > 2.0
    assert way.path.arm.limits.lower[1] == way.path.arm.limits.upper[1] == 0.0


def test_an_arm_that_overlaps_an_obstacle_has_no_way_out_and_says_what_it_overlaps() -> None:
    ball = pp.Scene({"ball": pp.Sphere((0.2, 0.0, 0.0), 0.03)}, self_collision=False, arm_radius=RADIUS)
    (way,) = pp.can_retreat(planar(), np.zeros(3), ball, "m01_j1_z", out=[1.5, 0.0, 0.0]).ways
    assert way.path is None
    assert way.reason.startswith("at the posture, ")
    assert "ball" in way.reason
    # Outside, the tip is bent into a ball as well, and nothing near is clear.
    around = {"ball": pp.Sphere((0.0, 0.3, 0.0), 0.15)}
    scene = pp.Scene(around, self_collision=False, arm_radius=RADIUS)
    (way,) = pp.can_retreat(planar(), np.zeros(3), scene, "m03_j1_z", out=[np.pi / 2, 0.0, 0.0]).ways
    assert way.reason.startswith("outside, with the joint as it is, ")


def test_bad_questions_are_refused() -> None:
    rows, discs = hooked()
    scene = scene_of(discs)
    for words, arguments in (
        ("out", {"q": rows[0]}),
        ("q (shape)", {"q": rows[None]}),
        ("failed", {"q": rows, "failed": []}),
        ("postures", {"q": rows, "postures": [3]}),
        ("postures", {"q": rows, "postures": []}),
        ("budget", {"q": rows, "budget": 0.0}),
    ):
        with pytest.raises(InvalidValue, match=words.replace("(", r"\(").replace(")", r"\)")):
            pp.can_retreat(planar(), scene=scene, **arguments)
    with pytest.raises(UnknownName, match="joint that moves"):
        pp.can_retreat(planar(), rows, scene, "elbow")
    moving = pp.Scene(scene.obstacles, velocities={"ball 0": (0.1, 0.0, 0.0)})
    with pytest.raises(InvalidValue, match="obstacles that rest"):
        pp.can_retreat(planar(), rows, moving)


@cache
def heavy() -> pp.Arm:
    hinges = tuple(pp.JointSpec(axis, lower=-0.8, upper=0.8) for axis in "yz")
    return pp.Arm.from_modules([ModuleTemplate("m", hinges, (0.05, 0.05))] * 5)


def bent(seed: int) -> Array:
    """Return a way in to a bent posture."""
    goal = np.random.default_rng(seed).uniform(-0.5, 0.5, heavy().nv)
    return np.linspace(0.0, 1.0, 20)[:, None] * goal


def held_by(q: Array) -> Array:
    """Return the torques that hold the heavy arm, by Pinocchio, (nv,) [N m]."""
    model = heavy().model
    return np.array(pin.computeGeneralizedGravity(model, model.createData(), q))


BALL = pp.Scene({"ball": pp.Sphere((0.25, 0.2, 0.1), 0.05)}, margin=MARGIN)


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.long) for seed in (0, 3, 4))])
def test_a_limp_joint_hangs_or_lies_at_its_end_stop_all_the_way(seed: int) -> None:
    rows = bent(seed)
    found = 0
    for way in pp.can_retreat(heavy(), rows, BALL, torque=0.0, postures=[19]).ways:
        if way.path is None:
            continue
        found += 1
        column = heavy().joint_names.index(way.joint)
        after = way.path.configurations
        assert after[0, column] == pytest.approx(way.position)
        assert np.all(np.delete(after[0] - rows[19], column) == 0.0)
        for q in np.concatenate([after, 0.5 * (after[:-1] + after[1:])]):
            gravity = held_by(q)[column]
            beside = q.copy()
            beside[column] += 1e-4
            stable = held_by(beside)[column] > gravity
            at_stop = abs(abs(q[column]) - 0.8) < 1e-9 and gravity * q[column] < 0.0
            assert at_stop or (stable and abs(gravity) < 1e-3 * heavy().outstretched_torques[column])
    assert found == 5


@pytest.mark.parametrize("seed", [0, 4])
def test_a_weak_joint_is_spared_on_the_way_out(seed: int) -> None:
    rows = bent(seed)
    column = 0
    name = heavy().joint_names[column]
    needed = np.array([abs(held_by(q)[column]) for q in rows])
    torque = float(max(needed[-1], 0.97 * needed.max()))
    assert needed.max() > torque  # on the way by which it came, the joint would not hold
    (way,) = pp.can_retreat(heavy(), rows, BALL, name, torque=torque, postures=[19]).ways
    assert way.path is not None
    assert way.path.arm.effort[column] == torque
    most = np.array([abs(held_by(q)[column]) for q in way.path.configurations]).max()
    assert most <= torque * (1.0 + 1e-5)


def test_a_weak_joint_that_lies_at_its_end_stop_need_not_be_held() -> None:
    rows = bent(2)
    torque = 0.3 * float(heavy().outstretched_torques[0])
    (way,) = pp.can_retreat(heavy(), rows, BALL, "m01_j1_y", torque=torque, postures=[19]).ways
    assert way.path is not None
    assert way.position == pytest.approx(0.8, abs=1e-12)
    for q in way.path.configurations:
        assert q[0] == pytest.approx(0.8, abs=1e-12)
        assert held_by(q)[0] < -torque  # weight presses it there, more than its drive could lift
    np.testing.assert_allclose(way.path.configurations[-1, 1:], rows[0, 1:], atol=1e-9)


def test_what_falls_into_something_or_nobody_knows_where_has_no_way_out() -> None:
    rows = bent(1)
    below = pp.Scene({"floor": pp.Box((0.3, 0.0, -0.16), (0.8, 0.8, 0.02))}, margin=MARGIN)
    names = heavy().joint_names
    falls, turns = pp.can_retreat(
        heavy(), rows, below, list(names[:2]), torque=0.0, postures=[0], out=rows[0]
    ).ways
    assert falls.path is None
    assert falls.reason.startswith(f"as {names[0]} falls, ")
    assert "floor" in falls.reason
    assert turns.path is None
    assert turns.reason.startswith(f"{names[1]} falls, and weight does not tell where to")
    assert pp.can_retreat(heavy(), rows, below, names[1], torque=0.1, postures=[0])  # that holds it


def test_each_drive_may_have_its_own_torque_left_and_joints_without_one_stick() -> None:
    rows = bent(2)
    first, second, third = heavy().joint_names[0], heavy().joint_names[2], heavy().joint_names[4]
    torques = {first: 0.0, third: 0.3 * float(heavy().outstretched_torques[4])}
    together = pp.can_retreat(heavy(), rows, BALL, [first, second, third], torque=torques, postures=[19]).ways
    for way, torque in zip(together, (torques[first], None, torques[third]), strict=True):
        (alone,) = pp.can_retreat(heavy(), rows, BALL, way.joint, torque=torque, postures=[19]).ways
        assert way.position == alone.position
        np.testing.assert_array_equal(way.path.configurations, alone.path.configurations)
    assert together[0].position == pytest.approx(0.8)  # it fell
    assert together[1].position == rows[19, 2]  # it stuck


def test_torques_of_joints_that_fail_are_checked() -> None:
    rows = bent(1)
    with pytest.raises(InvalidValue, match=r"torque\['m01_j1_y'\]"):
        pp.can_retreat(heavy(), rows, BALL, torque={"m01_j1_y": -0.1})
    with pytest.raises(UnknownName, match="no joint that may fail is called 'm02_j1_y'"):
        pp.can_retreat(heavy(), rows, BALL, "m01_j1_y", torque={"m02_j1_y": 0.1})
    with pytest.raises(InvalidValue, match="torque"):
        pp.can_retreat(heavy(), rows, BALL, torque=-0.1)
    follows = pp.JointSpec("z", follows=0)
    coupled = pp.Arm.from_modules([ModuleTemplate("m", (pp.JointSpec("y"), follows), (0.05, 0.05))] * 3)
    with pytest.raises(InvalidValue, match="no other follows"):
        pp.can_retreat(coupled, np.zeros((2, coupled.nv)), BALL, torque=0.0)
    bare = pp.Arm.load(heavy().urdf.replace("inertial", "ignored"))
    with pytest.raises(WeightUnknown):
        pp.can_retreat(bare, rows, BALL, torque=0.0)


def test_the_way_in_has_no_detours_and_keeps_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = pp.Arm.from_template("RyRz", modules=2)
    way = retreat.WayIn(arm)
    there = np.linspace(0.0, 1.0, 201)[:, None] * np.array([1.0, 0.5, 0.0, 0.0])
    aside = there[-1] + np.linspace(0.0, 0.7, 101)[:, None] * np.array([0.0, 0.0, 1.0, 1.0])
    for q in [*there, *aside, *aside[::-1], *there[:99:-1]]:  # in, aside and back, and half of the way out
        way.add(q)
    step = retreat.RETREAT.recorded
    steps = np.abs(np.diff(way.rows, axis=0)).max(axis=1)
    np.testing.assert_array_equal(way.rows[0], np.zeros(4))
    assert np.all((steps >= step) & (steps < 2.0 * step))
    assert np.abs(way.rows[-1] - there[100]).max() < 2.0 * step
    assert np.all(way.rows[:, 2:] == 0.0)
    monkeypatch.setattr(retreat, "RETREAT", retreat.RETREAT._replace(max_recorded=5))
    for q in there[100:]:
        way.add(q)
    assert len(way.rows) <= 5
    np.testing.assert_array_equal(way.rows[0], np.zeros(4))
    np.testing.assert_array_equal(way.until(there[-1])[-1], there[-1])
    np.testing.assert_array_equal(way.until(way.rows[-1]), way.rows)
