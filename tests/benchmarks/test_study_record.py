"""Each measure of a run, against runs made by hand whose answer is known; and records as files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from arms import template_arm
from handmade import made
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from benchmarks.studies.arms import Subject
from benchmarks.studies.record import (
    Case,
    Record,
    keep_study,
    read_records,
    record_run,
    run_case,
    write_records,
)
from pinposture.errors import FileError, InvalidValue

CASE = Case("arm", "smooth", "random", 5)


@pytest.fixture(scope="session")
def arm():
    return template_arm("Rz", 3)


def test_rises_are_counted_beyond_rounding_and_escapes_apart(arm):
    errors = np.array([2.0, 3.0, 1.0, 1.0 + 1e-9, 1.5, 0.3])
    escape = np.array([False, True, False, True, False])
    shares = np.array([0.2, 0.3, 0.5])  # of the three control points
    run = made(arm, np.zeros((6, 3)), point_errors=np.outer(errors, shares), error_increasing=escape)
    found = record_run(run, CASE, "geodesic", seconds=0.5)
    assert found[:5] == (*CASE, "geodesic")
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
    run = pp.Trajectory(**{**vars(run), "target": target})
    found = record_run(run, CASE, "lm")
    assert found.error == pytest.approx(0.15 / 0.45)
    assert found.peak == 1.0  # there was no error to begin with
    assert found.turn is None


def test_points_on_an_arc_go_that_much_farther_than_straight(arm):
    q = np.zeros((4, 3))
    q[:, 0] = np.linspace(0.0, np.pi / 2, 4)  # a quarter turn about the base in three steps
    found = record_run(made(arm, q), CASE, "joint")
    assert found.path == pytest.approx(3 * 2.0 * np.sin(np.pi / 12) / np.sqrt(2.0))
    assert found.stride == pytest.approx(np.pi / 6 / 0.1)
    assert not found.lawful
    there_and_back = record_run(made(arm, [*q, *q[::-1]]), CASE, "joint")
    assert there_and_back.path == 1.0  # nobody could say how long the direct way was


def test_the_worst_joint_outside_its_limits_counts():
    arm = pp.Arm.from_modules([pp.template("Rz").with_limits(-0.5, 0.4)] * 3)
    q = np.array([[0.0, 0.0, 0.0], [0.1, -0.5, 0.4], [0.1, -0.57, 0.43], [0.1, -0.5, 0.4]])
    assert record_run(made(arm, q), CASE, "joint").violation == pytest.approx(0.07)
    inside = record_run(made(arm, q[:2]), CASE, "joint")
    assert inside.violation == 0.0
    assert inside.stride == pytest.approx(5.0)
    slow = record_run(made(arm, q[:2] * 0.2), CASE, "joint")
    assert slow.lawful


def test_slides_are_measured_in_their_unit_and_steps_against_the_limit_of_each_joint():
    joints = (pp.JointSpec("z"), pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.1))
    arm = pp.Arm.from_modules([pp.ModuleTemplate("s", joints, (0.1, 0.1))] * 2).with_characteristic_length(
        0.2
    )
    q = np.array([[0.0, 0.1, 0.0, 0.1], [0.02, 0.13, 0.0, 0.1]])
    limits = pp.Limits(step=np.array([0.1, 0.05, 0.1, 0.1]))
    found = record_run(made(arm, q, limits=limits), CASE, "joint")
    assert found.violation == pytest.approx(0.03 / 0.2)
    assert found.stride == pytest.approx(0.03 / 0.05)
    free = record_run(made(arm, q, limits=pp.Limits(step=None)), CASE, "joint")
    assert free.stride == 0.0


def test_the_turn_is_that_between_start_and_target(arm):
    target = pp.Target.from_configuration(arm, [1.0, 1.0, -0.5])
    run = made(arm, np.array([[0.0, -0.5, 0.0], [0.1, 0.0, 0.0]]))
    run = pp.Trajectory(**{**vars(run), "target": target})
    assert record_run(run, CASE, "joint").turn == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("error", "arrived", "near"),
    [(0.0, True, True), (1e-6, True, True), (1.01e-6, False, True), (1e-3, False, False)],
)
def test_when_a_run_is_there(arm, error, arrived, near):
    run = made(arm, np.zeros((2, 3)), point_errors=np.full((2, 3), error * arm.length))
    found = record_run(run, CASE, "joint")
    assert (found.arrived, found.near) == (arrived, near)


def test_a_run_without_steps(arm):
    found = record_run(made(arm, np.zeros((1, 3))), CASE, "joint", seconds=0.1)
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
    subject = Subject("small", arm, ("random",))
    refused, joint = run_case(subject, CASE, start, target, [Unwilling(), pp.Projection()])
    assert (refused.status, refused.controller, refused.steps) == ("refused", "unwilling", 0)
    assert refused.reason == "arm is 3; allowed: an arm of another kind"
    away = np.linalg.norm(arm.at(start).points - arm.at(goal).points, axis=1).mean() / arm.length
    assert refused.error == pytest.approx(away)
    assert not refused.near
    run = pp.track(arm, target, start, "projection", max_steps=400)
    assert joint.steps == run.steps
    assert joint.error == pytest.approx(run.point_errors[-1].mean() / arm.length, rel=1e-12)
    assert joint.turn == refused.turn > 0.0
    assert joint.seconds > 0.0


words = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0\r"), max_size=20)
numbers = st.floats(allow_nan=False, allow_infinity=False)
records = st.builds(
    Record,
    *(words, words, words, st.integers(0, 10**9), words, words, words, st.integers(0, 400)),
    *([numbers] * 5),
    st.none() | numbers,
    *([numbers] * 3),
)


@examples(40)
@given(st.lists(records, max_size=3))
def test_a_table_of_runs_reads_back_as_it_was_written(tmp_path_factory, runs):
    path = tmp_path_factory.mktemp("records") / "cases.csv"
    assert write_records(runs, path) == path
    assert read_records(path) == runs


def test_a_table_that_is_none_names_what_is_wrong(arm, tmp_path):
    path = tmp_path / "cases.csv"
    with pytest.raises(FileError, match="no such file"):
        read_records(path)
    run = record_run(made(arm, np.zeros((2, 3))), CASE, "joint")
    write_records([run, run], path)
    whole = path.read_text()
    lines = whole.splitlines()
    assert lines[0].split(",") == list(Record._fields)
    for text, message in (
        ("", "columns arm, start"),
        (whole.replace("arm,start", "arm,begin", 1), "columns"),
        ("\n".join([*lines[:2], lines[2].replace(",5,", ",five,")]), "line 3"),
        ("\n".join([*lines[:2], lines[2] + ",1"]), "line 3"),
        ("\n".join([lines[0], lines[1][: lines[1].index(",made")]]), "line 2"),
    ):
        path.write_text(text)
        with pytest.raises(FileError, match=message):
            read_records(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(FileError, match="UTF-8"):
        read_records(path)


def test_a_study_is_kept_whole(arm, tmp_path):
    from matplotlib.figure import Figure

    run = record_run(made(arm, np.zeros((2, 3))), CASE, "joint")
    files = keep_study(tmp_path / "new" / "out", [run], {"cases": 1}, {"a.png": Figure()})
    assert sorted(file.name for file in files) == ["a.png", "cases.csv", "summary.json"]
    assert sorted((tmp_path / "new" / "out").iterdir()) == sorted(files)
    assert read_records(files[0]) == [run]
