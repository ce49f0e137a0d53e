"""The benchmarks run, in small, and judge everybody by kinematics that are right."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image

import pinposture as pp
from benchmarks.peers import problem
from benchmarks.studies import moving_obstacles, torque_cost

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("modules", [1, 2, 7, 20])
def test_the_judge_the_arm_and_the_urdf_of_the_peers_agree(modules: int) -> None:
    q = np.random.default_rng(modules).uniform(-np.pi, np.pi, 2 * modules)
    judged = problem.points_at(q)
    arm = pp.Arm.from_template("RyRz", modules, (problem.LINK, problem.LINK))
    np.testing.assert_allclose(judged, arm.at(q).points, atol=1e-12)
    model = pin.buildModelFromXML(problem.urdf_text(modules))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for k, point in enumerate(judged):
        frame = model.getFrameId(problem.point_name(k))
        np.testing.assert_allclose(data.oMf[frame].translation, point, atol=1e-12)
    given = problem.problem(modules, 1)
    assert model.velocityLimit == pytest.approx(given.speed)
    assert model.upperPositionLimit == pytest.approx(np.pi)


def test_cases_are_reachable_and_the_same_for_everybody(tmp_path: Path) -> None:
    given = problem.problem(30, 2, seed=3)
    problem.save(tmp_path / "problem.npz", given)
    read = problem.load(tmp_path / "problem.npz")
    assert [case.family for case in read.cases] == ["near", "random", "near", "random"]
    for case, before in zip(read.cases, given.cases, strict=True):
        np.testing.assert_array_equal(case.start, before.start)
        np.testing.assert_array_equal(case.points, problem.points_at(case.q))
        assert np.abs(case.q).max() < np.pi
        if case.family == "near":
            assert np.abs(case.q - case.start).max() <= problem.NEAR
    again = problem.problem(30, 2, seed=3)
    np.testing.assert_array_equal(again.cases[-1].q, given.cases[-1].q)
    assert np.abs(np.diff(problem.stream(30, 50), axis=0)).max() < given.bound


@pytest.mark.studies
def test_a_tiny_run_without_peers(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "benchmarks.peers.bench", "--here", "--steps-only", "--sizes", "8"]
    command += ["--seconds", "0.5", "--methods", "joint", "numpy-lm", "placo", "--out", str(tmp_path)]
    saved = tmp_path / "saved.json"
    subprocess.run([*command, "--save", str(saved)], check=True, capture_output=True, timeout=120, cwd=ROOT)
    found = json.loads(saved.read_text())
    results = {(each["method"], each["dof"]): each for each in found["results"]}
    assert len(results) == 3
    for (method, dof), each in results.items():
        if method == "placo":
            assert each["reason"]  # whatever is not installed is named, and the rest goes on
            continue
        assert each["reason"] == ""
        assert each["excess"] <= 1e-9
        assert each["times"]["step"]["p50"] <= each["times"]["step"]["p99"]
        assert [run["family"] for run in each["runs"]].count("near") == len(each["runs"]) / 2 == 30
        near = [run for run in each["runs"] if run["family"] == "near"]
        assert all(run["fine"] and run["fine"][0] >= run["coarse"][0] for run in near), (method, dof)
    assert (tmp_path / "steps.png").stat().st_size > 1000
    command[command.index("joint") : command.index("placo") + 1] = ["numpy-lm"]
    ran = subprocess.run(
        [*command, "--compare", str(saved)], check=True, capture_output=True, text=True, timeout=120, cwd=ROOT
    )
    assert "before" in ran.stdout


@pytest.mark.studies
def test_planners_that_are_not_installed_are_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    rows = printed("peers.clutter", "--here", "--kinds", "coil", "--seeds", "1")
    assert "ompl is left out: no ompl here" in capsys.readouterr().err
    assert [(row["planner"], row["solved"], row["kept_margin"]) for row in rows] == [("ours", 1, 1)]
    assert 0.0 < rows[0]["first_time"][0] <= rows[0]["time"][0]
    assert 1.0 <= rows[0]["ratio"] <= rows[0]["first_ratio"] + 1e-9


@pytest.mark.long
def test_a_problem_with_more_joints_has_the_same_postures() -> None:
    from benchmarks.peers.clutter import drawn

    (_, coarse), (_, fine) = (next(drawn("hole", 0, 1, joints)) for joints in (40, 80))
    assert fine.arm.nv == 80
    for one, other in ((coarse.start, fine.start), (coarse.target.q, fine.target.q)):
        points = coarse.arm.chain_at(one).points
        finer = fine.arm.chain_at(other).points
        apart = np.linalg.norm(points[:, None] - finer, axis=2).min(axis=1)
        assert apart.max() < 0.02  # of an arm of 1 m, in steps of 25 mm


def printed(script: str, *options: str) -> Any:
    """What a script of the benchmarks prints as JSON."""
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out):
        patch.setattr(sys, "argv", [script, "--json", *options])
        assert not import_module(f"benchmarks.{script}").main()
    return json.loads(out.getvalue())


@pytest.mark.studies
def test_every_problem_with_many_joints_is_solved_and_drawn(tmp_path: Path) -> None:
    plot = tmp_path / "joints.png"
    rows = printed("studies.obstacle_joints", "--joints", "20,40", "--draws", "1", "-o", str(plot))
    assert [(row["joints"], row["boxes"]) for row in rows] == [(20, 30), (40, 30), (20, 150), (40, 150)]
    assert all(row["found"] == row["of"] == 1 for row in rows)
    assert all(0.0 < row["cycle_ms"] <= row["cycle_p99_ms"] for row in rows)
    assert min(Image.open(plot).size) > 200


@pytest.mark.studies
@pytest.mark.skipif(sys.platform != "linux", reason="the scheduler of Linux tells what processes did")
def test_many_runs_use_both_processes() -> None:
    command = [sys.executable, "-m", "benchmarks.studies.many_runs", "--json"]  # it counts its own children
    command += ["--runs", "9", "--portion", "4", "--modules", "2"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300, cwd=ROOT)
    found = json.loads(done.stdout)
    assert found["reached"] == found["runs"] == 9
    assert found["processes"] == 2
    assert 0.0 < found["cores_used"] <= 2.1  # what is read one after the other may overlap a little
    assert len(found["memory"]) == len(found["child_memory"]) == 4  # at first, and after each portion


@pytest.mark.studies
def test_boxes_and_scans_of_them_are_equally_far() -> None:
    boxes, points, triangles = printed("studies.scan_obstacles", "--boxes", "5", "--items", "4000").values()
    assert set(boxes) == set(points) == set(triangles)
    assert triangles["clearance"] == pytest.approx(boxes["clearance"], abs=0.5)
    assert -0.5 < points["clearance"] - boxes["clearance"] < 5.0  # there is nothing between the points


class Recorder:
    """Stands in for the tracker of an arm that stays where it is, and records what it is given."""

    def __init__(self, arm: pp.Arm) -> None:
        self.command, self.goals, self.measured = np.zeros(arm.nq), [], []

    def update(self, target: pp.Target) -> None:
        self.goals.append(target.q)

    def step(self, measured: np.ndarray, scene: pp.Scene) -> np.ndarray:
        self.measured.append(measured)
        return np.zeros(len(measured))


@pytest.mark.long
@pytest.mark.parametrize("swing", [0.0, 0.15])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_goals_swing_and_measurements_are_noisy_as_asked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], swing: float, noise: float
) -> None:
    made: list[Recorder] = []

    def make(arm: pp.Arm, **_: object) -> Recorder:
        made.append(Recorder(arm))
        return made[-1]

    asked = ["", "--draws", "1", "--json", "--swing", str(swing), "--noise", str(noise)]
    monkeypatch.setattr(pp, "Tracker", make)
    monkeypatch.setattr(sys, "argv", asked)
    assert moving_obstacles.main() == 0
    assert json.loads(capsys.readouterr().out)["arrived"] == 0  # it never moves
    [tracker], cycles = made, moving_obstacles.CYCLES
    errors = np.array(tracker.measured[1:])  # after the first cycle the command is zero
    assert errors.shape == (cycles - 1, 40)
    np.testing.assert_allclose([errors.mean(), errors.std()], [0.0, noise], atol=0.03 * noise)
    goals = np.array(tracker.goals)
    if not swing:
        assert len(goals) == 1
        return
    shares = goals / goals[0] - 1.0  # it begins in the middle
    np.testing.assert_allclose(shares, np.broadcast_to(shares[:, :1], (cycles, 40)), atol=1e-9)
    assert [shares.min(), shares.max()] == pytest.approx([-swing, swing], rel=1e-3)


@pytest.mark.studies
def test_the_margin_to_a_moving_ball_is_kept() -> None:
    found = printed("studies.moving_obstacles", "--draws", "1", "--swing", "0.15", "--noise", "0.002")
    assert (found["draws"], found["margin_kept"], found["arrived"]) == (1, 1, 1)
    assert found["smallest_distance"] > 0.0048
    assert 0.5 < found["largest_acceleration"] <= 1.0 + 1e-9
    assert 0.0 < found["cycle_ms"]["p50"] <= found["cycle_ms"]["p99"] <= found["cycle_ms"]["p99.9"]


@pytest.mark.studies
def test_what_torque_limits_cost_is_measured_on_the_same_motion() -> None:
    without, limited = torque_cost.draw(3, 0)
    assert without.limits.effort is None
    arm = without.arm
    for q, same in zip(without[1:3], limited[1:3], strict=True):
        np.testing.assert_array_equal(q, same)
        held = np.abs(pin.computeGeneralizedGravity(arm.model, arm.model.createData(), q)).max()
        assert 1.3 * held <= float(limited.limits.effort) * (1.0 + 1e-9)
        assert pp.CollisionModel(arm, without.scene).minimum(q).distance > 0.0
    found = printed("studies.torque_cost", "--draws", "1", "--modules", "3")
    assert set(found) == set(torque_cost.WAYS)
    for each in found.values():
        assert each["median_us"] > 0.0
        assert each["median_with_torque_limits_us"] > 0.0


@pytest.mark.studies
def test_an_arm_that_maps_its_way_into_a_box_keeps_the_margin() -> None:
    found = printed("studies.mapping", "--draws", "1", "--first", "3")
    assert (found["draws"], found["margin_kept"], found["arrived"]) == (1, 1, 1)
    assert found["smallest_distance"] > 0.01


@pytest.mark.soak
@pytest.mark.parametrize("options", [(), ("--free", "--seed", "3")])
def test_limits_hold_in_a_loop_where_everything_goes_wrong(options: tuple[str, ...]) -> None:
    found = printed("studies.soak", "--steps", "400", "--modules", "4", *options)
    assert found["steps"] == 400 and len(found["memory [MB], ten times on the way"]) == 10
    assert found["largest speed, of its limit"] <= 1.0 + 1e-9
    hardest = found["largest acceleration that was not reported, of its limit"]
    assert hardest is None if "--free" in options else 0.5 < hardest <= 1.0 + 1e-9
    assert found["farthest beyond a position limit [rad]"] <= 1e-9
    cycles = {name: count for name, count in found.items() if name.startswith("cycles ")}
    assert sum(cycles.values()) == 400 and cycles["cycles moving"] > 20 and cycles["cycles holding"] > 2
