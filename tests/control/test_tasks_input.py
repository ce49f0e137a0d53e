"""What tasks refuse, and that they say why."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from task_arms import state_of, target_of

import pinposture as pp
from pinposture.control import EndEffector, JointPosture, Tangents
from pinposture.errors import ControllerError, InvalidValue, UnknownName

MIRRORED = np.diag([1.0, 1.0, -1.0, 1.0])
POINT = (0.1, 0.2, 0.3)


class Lifted:
    """A task of the user: the tip has a height; `returned` stands for its rows if it is given."""

    priority = False

    def __init__(self, returned=None, weight=1.0):
        self.returned = returned
        self.weight = weight

    def rows(self, state, target):
        if self.returned is not None:
            return self.returned(state.arm.nv) if callable(self.returned) else self.returned
        return state.jacobians[-1, 2:], [0.05 - state.points[-1, 2]]


def test_a_task_of_the_user_is_kept():
    arm = pp.Arm.from_template("RyRz", 6)
    target = pp.Target.from_configuration(arm, np.full(12, 0.1))
    high = type("High", (Lifted,), {"priority": True})()
    run = pp.track(arm, target, arm.straight(), pp.Geodesic(tasks=(high,)), max_steps=60)
    assert arm.at(run.q[-1]).points[-1, 2] == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        (3, r"Lifted\.rows\(\.\.\.\) is 3; allowed: TaskRows"),
        (np.zeros((1, 12)), r"Lifted\.rows\(\.\.\.\) is array"),
        (lambda nv: (np.zeros((1, nv - 1)), [0.0]), r"Lifted\.rows\(\.\.\.\), jacobian \(shape\)"),
        (lambda nv: (np.full((1, nv), np.nan), [0.0]), r"Lifted\.rows\(\.\.\.\), jacobian\[0, 0\] is nan"),
        (lambda nv: (np.zeros((1, nv)), [0.0, 1.0]), r"Lifted\.rows\(\.\.\.\), error \(shape\)"),
        (lambda nv: (np.zeros((1, nv)), ["high"]), r"Lifted\.rows\(\.\.\.\), error"),
    ],
)
def test_what_a_task_of_the_user_returns_is_checked_and_named(returned, words):
    arm = pp.Arm.from_template("RyRz", 6)
    target = pp.Target.from_configuration(arm, np.full(12, 0.1))
    with pytest.raises(InvalidValue, match=words):
        pp.track(arm, target, arm.straight(), pp.Geodesic(tasks=(Lifted(returned),)))


def test_an_exception_in_a_task_of_the_user_names_it_and_its_line():
    arm = pp.Arm.from_template("RyRz", 6)
    target = pp.Target.from_configuration(arm, np.full(12, 0.1))
    controller = pp.Geodesic(tasks=(Lifted(lambda nv: 1 / 0),))
    words = r"^Lifted\.rows\(state, target\) raised ZeroDivisionError: .*\(test_tasks_input\.py, line \d+\)$"
    with pytest.raises(ControllerError, match=words) as caught:
        pp.track(arm, target, arm.straight(), controller)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


@pytest.mark.parametrize(("weight", "priority"), [("big", False), (np.nan, False), (0.0, False), (1.0, 3)])
def test_weight_and_priority_of_a_task_of_the_user_are_checked(weight, priority):
    task = type("Lifted", (Lifted,), {"priority": priority})(weight=weight)
    with pytest.raises(InvalidValue, match=r"Lifted\.(weight|priority) is"):
        pp.Geodesic(tasks=(task,))


REFUSED = [
    (EndEffector, "position and pose"),
    (lambda: EndEffector(POINT, pin.SE3.Identity()), "position and pose"),
    (lambda: EndEffector((0.1, 0.2)), "position (shape)"),
    (lambda: EndEffector((0.1, np.nan, 0.3)), "position[1]"),
    (lambda: EndEffector((0.1, 0.2, -np.inf)), "position[2]"),
    (lambda: EndEffector("here"), "position"),
    (lambda: EndEffector([(1, 2), (3,)]), "position"),
    (lambda: EndEffector(pose=np.eye(3)), "pose"),
    (lambda: EndEffector(pose=MIRRORED), "pose"),
    (lambda: EndEffector(pose=2.0 * np.eye(4)), "pose"),
    (lambda: EndEffector(pose=np.full((4, 4), np.nan)), "pose"),
    (lambda: EndEffector(pose="home"), "pose"),
    (lambda: EndEffector(POINT, point=1.5), "point"),
    (lambda: EndEffector(POINT, point=True), "point"),
    (lambda: EndEffector(POINT, point=None), "point"),
    (lambda: EndEffector(POINT, point=[0]), "point"),
    (lambda: EndEffector(POINT, priority="yes"), "priority"),
    (lambda: EndEffector(POINT, priority=1), "priority"),
    (lambda: EndEffector(POINT, direction_only=True), "direction_only"),
    (lambda: EndEffector(pose=pin.SE3.Identity(), direction_only=None), "direction_only"),
    (lambda: Tangents([]), "directions (shape)"),
    (lambda: Tangents(np.zeros((0, 3)), ()), "directions (shape)"),
    (lambda: Tangents([(1, 0)]), "directions (shape)"),
    (lambda: Tangents(1.0), "directions (shape)"),
    (lambda: Tangents([(1, 0, 0), (0, 1)]), "directions"),
    (lambda: Tangents([(1, 0, 0), (0, 0, 0)]), "directions[1]"),
    (lambda: Tangents((0, 0, 0)), "directions[0]"),
    (lambda: Tangents([(1, 0, 0), (np.inf, 0, 0)]), "directions[1, 0]"),
    (lambda: Tangents("up"), "directions"),
    (lambda: Tangents((1, 0, 0), (0, 1)), "points"),
    (lambda: Tangents([(1, 0, 0)] * 2, 0), "points"),
    (lambda: Tangents((1, 0, 0), 0.5), "points"),
    (lambda: Tangents((1, 0, 0), [True]), "points"),
    (lambda: Tangents((1, 0, 0), np.array([0.0])), "points"),
    (lambda: JointPosture(None), "q"),
    (lambda: JointPosture("neutral"), "q"),
    (lambda: JointPosture([]), "q (shape)"),
    (lambda: JointPosture(np.zeros((2, 2))), "q (shape)"),
    (lambda: JointPosture([0.0, np.nan]), "q[1]"),
    (lambda: JointPosture([0.0], joints=[]), "joints"),
    (lambda: JointPosture([0.0], joints=["a", "a"]), "joints"),
    (lambda: JointPosture([0.0], joints=[1]), "joints"),
    (lambda: JointPosture([0.0], joints=3), "joints"),
]

SCALES = [0.0, -1.0, np.nan, np.inf, "1", True, [1.0]]


@pytest.mark.parametrize(("make", "name"), REFUSED)
def test_bad_input_is_refused_by_name(make: object, name: str) -> None:
    with pytest.raises(InvalidValue, match=f"(?s)^{re.escape(name)} is .*; allowed: ."):
        make()


@pytest.mark.parametrize(("name", "value"), [("weight", None), *product(("weight", "length"), SCALES)])
def test_weights_and_levers_are_numbers_above_0(name: str, value: object) -> None:
    for kind, first in ((EndEffector, POINT), (Tangents, (1, 0, 0)), (JointPosture, (0.0,))):
        with pytest.raises(InvalidValue, match=f"^{name} is"):
            kind(first, **{name: value})


@pytest.mark.parametrize(
    ("task", "kind", "message"),
    [
        (EndEffector(POINT, point=4), InvalidValue, r"^point is 4; allowed: whole numbers from 0 to 3"),
        (EndEffector(POINT, point=-5), InvalidValue, "^point is -5"),
        (EndEffector(POINT, point="module_2"), UnknownName, "control point.*module_2.*mean 'module_02'"),
        (Tangents((1, 0, 0)), InvalidValue, r"^directions \(shape\) is \(1, 3\).*each of 4"),
        (Tangents((1, 0, 0), 4), InvalidValue, "^points is 4"),
        (Tangents([(1, 0, 0)] * 2, (3, -1)), InvalidValue, "^points is .*each control point once"),
        (Tangents((1, 0, 0), "tip"), UnknownName, "control point.*tip"),
        (JointPosture(np.zeros(7)), InvalidValue, r"^q \(shape\) is \(7,\)"),
        (JointPosture(np.zeros(8), joints="m09_j1_y"), UnknownName, "joint.*m09_j1_y"),
    ],
)
def test_a_task_that_does_not_fit_the_arm_says_so(task: object, kind: type, message: str) -> None:
    state = state_of("spatial", 0)
    with pytest.raises(kind, match=message):
        task.rows(state, target_of(state.arm))


def test_a_configuration_of_continuous_joints_must_be_one() -> None:
    state = state_of("mixed", 0)
    with pytest.raises(InvalidValue, match="cosine and sine"):
        JointPosture(np.zeros(12)).rows(state, target_of(state.arm))


def test_what_cannot_be_held_is_refused() -> None:
    state = state_of("spatial", 0)
    with pytest.raises(UnknownName, match=r"'poses'.*'pose'"):
        EndEffector.held(state, "poses")
    with pytest.raises(InvalidValue, match=r"^point is 9"):
        EndEffector.held(state, point=9)
    with pytest.raises(InvalidValue, match="direction_only"):
        EndEffector.held(state, "position", direction_only=True)


def test_tangents_of_a_curve_need_one() -> None:
    arm = pp.Arm.from_template("RyRz", 4)
    with pytest.raises(InvalidValue, match=r"^target.curve is not given; allowed: .*resolve_targets"):
        Tangents.of_curve(target_of(arm))
    target = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (1, 0, 0)))
    for points in (4, -5, "module_01", [0.5]):
        with pytest.raises(InvalidValue, match=r"^points is"):
            Tangents.of_curve(target, points)
    with pytest.raises(InvalidValue, match=r"^directions"):
        Tangents.of_curve(target, [])
