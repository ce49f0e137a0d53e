"""An arm moves while something is held, and brakes within 100 ms when it is not: in simulated time."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence

import numpy as np
import pytest

import pinposture as pp
from pinposture.operate import Control, Operation
from pinposture.ros2.driver import usual_limits

DT = 0.02
WITHIN = 0.1
"""Time within which an arm shall brake [s]."""


class Desk:
    """An operator and an arm that does what it is told, in simulated time."""

    def __init__(self, arm: pp.Arm, q: np.ndarray | None = None) -> None:
        self.now = 0.0
        self.arm = arm
        self.limits = usual_limits(arm, DT)
        self.control = Control()
        self.operation = Operation(arm, self.limits, self.control, clock=lambda: self.now)
        self.scene = pp.Scene()
        self.tracker = pp.Tracker(arm, limits=self.limits, scene=self.scene)
        self.q = arm.neutral() if q is None else q
        self.speed = 1.0  # what a driver allows
        self.speeds: list[float] = []  # of the fastest joint in each cycle
        for message in ("ask", "release"):
            self.tell(do=message)

    def tell(self, **message: object) -> None:
        self.control.take("page", json.dumps(message), self.now)

    def hold(self, direction: Sequence[float], override: float = 1.0) -> None:
        ahead, left, up = direction
        self.tell(do="hold", ahead=ahead, left=left, up=up, override=override)

    def run(self, duration: float, each: Callable[[], object] = lambda: None) -> None:
        """Pass a time [s], in which something is done in each cycle."""
        for _ in range(round(duration / DT)):
            self.now += DT
            each()
            hold = self.operation.lead(self.tracker, self.q, self.scene, DT, speed=self.speed)
            step = self.tracker.step(None if hold else self.q, scene=self.scene)
            self.q = self.arm.integrate(self.q, step)
            self.speeds.append(float(np.abs(step / self.arm.joint_units).max()) / DT)

    @property
    def tip(self) -> np.ndarray:
        return self.arm.at(self.q).points[-1]


def fed_arm(modules: int = 6) -> pp.Arm:
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.2, velocity=0.1)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    return pp.Arm.from_modules([feed, *[pp.template("RyRz")] * modules])


def bent_arm() -> tuple[pp.Arm, np.ndarray]:
    arm = pp.Arm.from_template("RyRz", modules=6)
    return arm, pp.arm.smooth_configuration(arm, np.random.default_rng(2), 0.4)


def test_nothing_moves_before_something_is_held() -> None:
    desk = Desk(*bent_arm())
    desk.run(0.5)
    desk.run(0.5, lambda: desk.tell(do="release"))
    assert max(desk.speeds) == 0.0
    assert desk.operation.shown.mode == "holds"
    assert desk.operation.shown.reason.startswith("nothing is held")


@pytest.mark.long
@pytest.mark.parametrize("how", ["release", "silence", "leaves", "no measurement"])
def test_the_arm_brakes_within_a_tenth_of_a_second(how: str) -> None:
    desk = Desk(fed_arm())
    desk.run(1.0, lambda: desk.hold((1.0, 0.4, 0.0)))
    assert desk.operation.shown.mode == "runs"
    before = len(desk.speeds)
    if how == "leaves":
        desk.control.leave("page")
    measured = desk.q
    if how == "no measurement":
        for _ in range(35):
            desk.now += DT
            desk.hold((1.0, 0.4, 0.0))
            hold = desk.operation.lead(desk.tracker, None, desk.scene, DT)
            assert hold == "the joints are not measured"
            measured = desk.arm.integrate(measured, desk.tracker.step(None))
            desk.speeds.append(float(np.abs(desk.arm.difference(desk.q, measured)).max()) / DT)
            desk.q = measured
    else:
        desk.run(0.7, lambda: desk.tell(do="release") if how == "release" else None)
    speeds = np.array(desk.speeds[before - 1 :])
    braking = int(np.flatnonzero(speeds < 0.98 * speeds[0])[0])
    assert braking * DT <= WITHIN + 1e-9
    assert np.all(np.diff(speeds[braking:]) <= 1e-9)  # and goes on to brake
    assert np.all(speeds[round(0.5 / DT) :] == 0.0)
    assert desk.operation.shown.mode == "holds"


@pytest.mark.long
def test_the_body_follows_the_tip_and_comes_back_along_its_path() -> None:
    desk = Desk(fed_arm())
    start = desk.q
    desk.run(1.5, lambda: desk.hold((1.0, 1.0, 0.0)))
    there = desk.tip
    assert there[1] > 0.0003  # to the left
    assert abs(there[2]) < 1e-6
    assert len(desk.operation.shown.line) > 1
    desk.run(2.0, lambda: desk.hold((-1.0, 0.0, 0.0)))
    assert (desk.operation.shown.mode, desk.operation.shown.reason) == (
        "stands",
        "the arm is back at the entry",
    )
    desk.run(0.1, lambda: desk.hold((0.0, 1.0, 0.0)))
    assert "hold ahead as well" in desk.operation.shown.reason
    np.testing.assert_allclose(desk.q, start, atol=1e-3)


@pytest.mark.long
def test_the_override_is_a_share_of_the_speed_and_none_of_it_holds() -> None:
    depths = []
    for override in (1.0, 0.25):
        desk = Desk(fed_arm())
        desk.run(2.0, lambda desk=desk, override=override: desk.hold((1.0, 0.0, 0.0), override))
        depths.append(desk.q[0])
    assert depths[1] == pytest.approx(0.25 * depths[0], rel=0.1)  # less time to get there
    desk = Desk(fed_arm())
    desk.speed = 0.5
    desk.run(2.0, lambda: desk.hold((1.0, 0.0, 0.0), 0.5))
    assert desk.q[0] == pytest.approx(depths[1], rel=1e-6)
    assert desk.operation.shown.reason == "50 % of the speed is allowed"
    desk = Desk(fed_arm())
    desk.run(0.5, lambda: desk.hold((1.0, 0.0, 0.0), 0.0))
    assert max(desk.speeds) == 0.0
    assert "override" in desk.operation.shown.reason


@pytest.mark.long
@pytest.mark.parametrize("axis", range(3))
def test_the_tip_of_an_arm_without_a_feed_moves_along_a_straight_line(axis: int) -> None:
    arm, q = bent_arm()
    desk = Desk(arm, q)
    begin = desk.tip
    direction = -np.eye(3)[axis]
    desk.run(1.0, lambda: desk.hold(direction))
    desk.run(0.4, lambda: desk.tell(do="release"))
    moved = desk.tip - begin
    assert moved @ direction == pytest.approx(0.05 * arm.length, rel=0.05)
    assert np.linalg.norm(moved - (moved @ direction) * direction) < 0.002 * arm.length


@pytest.mark.long
def test_an_arm_without_a_feed_goes_where_it_still_can_and_says_why() -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    desk = Desk(arm)
    desk.run(0.5, lambda: desk.hold((1.0, 0.0, 0.0)))
    assert max(desk.speeds) == 0.0
    assert desk.operation.shown.reason.startswith("the tip cannot reach")
    desk.run(0.5, lambda: desk.hold((-1.0, 0.0, 0.0)))  # it is straight, where no joint leads back
    assert desk.tip[0] < arm.length * 0.995
    bent = Desk(*bent_arm())
    wall = pp.Box(tuple(bent.tip + [0.03, 0.056, 0.0]), (0.1, 0.04, 0.4))
    bent.scene = pp.Scene({"wall": wall}, margin=0.005)
    begin = bent.tip
    reasons = set()
    near = []

    def push() -> None:
        bent.hold((0.0, 1.0, 1.0))
        reasons.add(bent.operation.shown.reason.split(":")[0])
        near.append(pp.CollisionModel(arm, bent.scene).minimum(bent.q).distance)

    bent.run(1.6, push)
    assert "moves in one direction only" in reasons
    assert min(near) >= 0.005 * (1.0 - 1e-6)
    assert bent.tip[2] - begin[2] > 0.01


@pytest.mark.long
def test_a_bent_arm_on_a_feed_becomes_straight_first_while_something_is_held() -> None:
    arm = fed_arm()
    q = arm.neutral()
    q[0] = 0.3
    q[3] = 0.5
    desk = Desk(arm, q)
    desk.run(0.2, lambda: desk.tell(do="release"))
    assert "the arm goes there first" in desk.operation.shown.reason
    desk.run(0.2, lambda: desk.hold((1.0, 0.0, 0.0), 0.1))
    assert desk.operation.shown.mode == "goes to the start"
    slow = desk.limits.for_arm(arm).bound / DT * 0.1 / arm.joint_units
    assert 0.0 < max(desk.speeds) <= slow.max() * (1.0 + 1e-9)
    desk.run(0.3, lambda: desk.tell(do="release"))
    assert desk.speeds[-1] == 0.0
    desk.run(3.0, lambda: desk.hold((1.0, 0.0, 0.0)))
    assert desk.operation.shown.mode == "runs"
    assert desk.tracker.limits is desk.limits
    assert desk.q[0] > 0.3


@pytest.mark.long
def test_the_tip_waits_for_an_arm_that_is_stuck_and_says_so() -> None:
    desk = Desk(fed_arm())
    stuck = desk.q
    desk.run(1.0, lambda: (desk.hold((1.0, 0.0, 0.0)), setattr(desk, "q", stuck)))
    away = desk.tracker.target
    assert away is not None and away.q is not None
    assert desk.operation.shown.mode == "waits"
    assert away.q[0] < 0.05


HOLE = 0.05
"""Half of the width of a hole that the arm finds [m]."""


def hole_at(middle: np.ndarray, margin: float) -> pp.Scene:
    """Return a wall across x with a square hole about a point, (3,) [m]."""
    x, y, z = middle
    far = 0.5
    walls = {
        "left": pp.Box((x, y + HOLE + far, z), (0.01, 2 * far, 4 * far)),
        "right": pp.Box((x, y - HOLE - far, z), (0.01, 2 * far, 4 * far)),
        "top": pp.Box((x, y, z + HOLE + far), (0.01, 2 * HOLE, 2 * far)),
        "bottom": pp.Box((x, y, z - HOLE - far), (0.01, 2 * HOLE, 2 * far)),
    }
    return pp.Scene(walls, margin=margin, self_collision=False)


@pytest.mark.long
@pytest.mark.parametrize("margin", [0.03, 0.045])
def test_an_arm_never_leaves_what_leads_it_whatever_is_found_around_it(margin: float) -> None:
    desk = Desk(fed_arm(12))
    desk.run(2.0, lambda: desk.hold((1.0, 0.0, 0.0)))
    desk.run(3.0, lambda: desk.hold((1.0, 1.0, 1.0)))
    # What was free turns out to be a wall with a hole, in which the arm is within its margin.
    desk.scene = hole_at(desk.arm.at(desk.q).points[8] + [0.0, HOLE - 0.04, 0.0], margin)
    away: list[float] = []

    def watch(direction: Sequence[float]) -> None:
        desk.hold(direction)
        led = desk.operation.shown.led
        assert led is not None
        apart = desk.arm.at(desk.q).points - desk.arm.at(led).points
        away.append(float(np.linalg.norm(apart, axis=1).max()))

    for direction in (
        (1.0, -1.0, -1.0),
        (1.0, 1.0, 0.0),
        (1.0, -1.0, 1.0),
        (-1.0, 0.0, 0.0),
        (1.0, 0.0, -1.0),
    ):
        desk.run(1.4, lambda direction=direction: watch(direction))
    assert max(away) < 0.01 * desk.arm.length
    gap = pp.CollisionModel(desk.arm, desk.scene).minimum(desk.q).distance
    assert gap > 0.0
    desk.run(8.0, lambda: desk.hold((-1.0, 0.0, 0.0)))
    assert desk.q[0] < 0.05  # and it comes out again
