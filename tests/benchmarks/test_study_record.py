"""Each measure of a run, against runs made by hand whose answer is known; and reports as files."""

from __future__ import annotations

import csv
import json
import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from arms import template_arm
from handmade import made

import pinposture as pp
from benchmarks.harness import Problem, Row
from benchmarks.report import Report, save_report
from benchmarks.studies.runs import arrived, lawful, measure_controller, measure_run, near
from pinposture.errors import InvalidValue


@pytest.fixture(scope="session")
def arm():
    return template_arm("Rz", 3)


def test_rises_are_counted_beyond_rounding_and_escapes_apart(arm):
    errors = np.array([2.0, 3.0, 1.0, 1.0 + 1e-9, 1.5, 0.3])
    escape = np.array([False, True, False, True, False])
    shares = np.array([0.2, 0.3, 0.5])  # of the three control points
    run = made(arm, np.zeros((6, 3)), point_errors=np.outer(errors, shares), error_increasing=escape)
    found = measure_run(run, "geodesic", seconds=0.5)
    assert found.controller == "geodesic"
    assert (found.status, found.reason, found.steps) == ("max_steps", "made by hand", 5)
    assert found.rising == pytest.approx(2 / 5)  # the third step rises by less than 2e-9
    assert found.escaping == pytest.approx(1 / 5)  # of the two flagged, one falls
    assert found.peak == pytest.approx(1.5)
    assert found.error == pytest.approx(0.1 / 0.45)
    assert found.seconds == pytest.approx(0.1)


def test_the_mean_is_over_points_that_have_a_target(arm):
    target = pp.Target.from_points(arm, np.zeros((3, 3)), [1.0, 0.0, 1.0])
    errors = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.2]])
    run = made(arm, np.zeros((2, 3)), point_errors=errors, target=np.zeros((3, 3)))
    run = pp.Run(**{**vars(run), "target": target})
    found = measure_run(run, "lm")
    assert found.error == pytest.approx(0.15 / 0.45)
    assert found.peak == 1.0  # there was no error to begin with
    assert found.turn is None


def test_points_on_an_arc_go_that_much_farther_than_straight(arm):
    q = np.zeros((4, 3))
    q[:, 0] = np.linspace(0.0, np.pi / 2, 4)  # a quarter turn about the base in three steps
    found = measure_run(made(arm, q), "joint")
    assert found.path == pytest.approx(3 * 2.0 * np.sin(np.pi / 12) / np.sqrt(2.0))
    assert found.stride == pytest.approx(np.pi / 6 / 0.1)
    assert not lawful(found)
    there_and_back = measure_run(made(arm, [*q, *q[::-1]]), "joint")
    assert there_and_back.path == 1.0  # nobody could say how long the direct way was


def test_the_worst_joint_outside_its_limits_counts():
    arm = pp.Arm.from_modules([pp.template("Rz").with_limits(-0.5, 0.4)] * 3)
    q = np.array([[0.0, 0.0, 0.0], [0.1, -0.5, 0.4], [0.1, -0.57, 0.43], [0.1, -0.5, 0.4]])
    assert measure_run(made(arm, q), "joint").violation == pytest.approx(0.07)
    inside = measure_run(made(arm, q[:2]), "joint")
    assert inside.violation == 0.0
    assert inside.stride == pytest.approx(5.0)
    slow = measure_run(made(arm, q[:2] * 0.2), "joint")
    assert lawful(slow)


def test_slides_are_measured_in_their_unit_and_steps_against_the_limit_of_each_joint():
    joints = (pp.JointSpec("z"), pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.1))
    arm = pp.Arm.from_modules([pp.ModuleTemplate("s", joints, (0.1, 0.1))] * 2).with_characteristic_length(
        0.2
    )
    q = np.array([[0.0, 0.1, 0.0, 0.1], [0.02, 0.13, 0.0, 0.1]])
    limits = pp.Limits(step=np.array([0.1, 0.05, 0.1, 0.1]))
    found = measure_run(made(arm, q, limits=limits), "joint")
    assert found.violation == pytest.approx(0.03 / 0.2)
    assert found.stride == pytest.approx(0.03 / 0.05)
    free = measure_run(made(arm, q, limits=pp.Limits(step=None)), "joint")
    assert free.stride == 0.0


def test_the_turn_is_that_between_start_and_target(arm):
    target = pp.Target.from_configuration(arm, [1.0, 1.0, -0.5])
    run = made(arm, np.array([[0.0, -0.5, 0.0], [0.1, 0.0, 0.0]]))
    run = pp.Run(**{**vars(run), "target": target})
    assert measure_run(run, "joint").turn == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("error", "there", "close"),
    [(0.0, True, True), (1e-6, True, True), (1.01e-6, False, True), (1e-3, False, False)],
)
def test_when_a_run_is_there(arm, error, there, close):
    run = made(arm, np.zeros((2, 3)), point_errors=np.full((2, 3), error * arm.length))
    found = measure_run(run, "joint")
    assert (arrived(found), near(found)) == (there, close)


def test_a_run_without_steps(arm):
    found = measure_run(made(arm, np.zeros((1, 3))), "joint", seconds=0.1)
    assert (found.steps, found.rising, found.escaping, found.stride) == (0, 0.0, 0.0, 0.0)
    assert (found.peak, found.path, found.seconds) == (1.0, 1.0, 0.1)


@dataclass(frozen=True)
class Unwilling:
    name: str = "unwilling"

    def step(self, state, target, limits=None, memory=None):
        raise InvalidValue("arm", 3, "an arm\r\nof another kind")


def test_a_controller_that_refuses_spoils_its_own_run_only():
    arm = pp.Arm.from_template("RyRz", 3)
    start, goal = np.zeros(6), np.full(6, 0.3)
    target = pp.Target.from_configuration(arm, goal)
    problem = Problem(arm, start, target)
    refused, joint = (measure_controller(problem, each) for each in (Unwilling(), pp.Projection()))
    assert list(refused) == list(joint)
    assert (refused.status, refused.controller, refused.steps) == ("refused", "unwilling", 0)
    assert refused.reason == "arm is 3; allowed: an arm of another kind"
    away = np.linalg.norm(arm.at(start).points - arm.at(goal).points, axis=1).mean() / arm.length
    assert refused.error == pytest.approx(away)
    assert not near(refused)
    run = pp.track(arm, target, start, "projection", max_steps=400)
    assert joint.steps == run.steps
    assert joint.error == pytest.approx(run.point_errors[-1].mean() / arm.length, rel=1e-12)
    assert joint.turn == refused.turn > 0.0
    assert joint.seconds > 0.0


def test_a_report_is_saved_whole(arm, tmp_path):
    from matplotlib.figure import Figure

    rows = [Row(arm="arm", seed=5) | measure_run(made(arm, np.zeros((2, 3))), "joint")]
    report = Report(rows, {"cases": 1}, [], {"a": lambda _: Figure()})
    files = save_report(tmp_path / "new" / "out", report)
    assert sorted(file.name for file in files) == ["a.png", "cases.csv", "summary.json"]
    assert sorted((tmp_path / "new" / "out").iterdir()) == sorted(files)
    with files[0].open(newline="") as file:
        heads, line = csv.reader(file)
    assert heads == list(rows[0])
    assert line == ["" if value is None else str(value) for value in rows[0].values()]
    assert json.loads(files[-1].read_text()) == {"cases": 1}
    save_report(tmp_path / "none", Report([], {}, []))


def test_a_row_is_a_mapping_whose_values_are_attributes():
    row = Row(steps=3)
    assert row.steps == row["steps"] == pickle.loads(pickle.dumps(row)).steps == 3
    assert row.but(path=1.0) == {"steps": 3, "path": 1.0}
    with pytest.raises(AttributeError, match="path"):
        _ = row.path
