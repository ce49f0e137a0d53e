"""The loop and its result: how runs end, what they record, and that files give it all back."""

from __future__ import annotations

import gc
import logging
import re
import weakref
from dataclasses import fields
from functools import partial

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation

import pinposture as pp
from pinposture.control import controller_named
from pinposture.curve import HELIX, LINE
from pinposture.errors import FileError, InvalidValue, UnknownName
from pinposture.motion.run import path_length_ratio
from pinposture.motion.track import name_enough_steps

START = 0.4 * np.sin(np.arange(40))


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 20)


@pytest.fixture(scope="module")
def run(arm: pp.Arm) -> pp.Run:
    target = pp.resolve_targets(arm, HELIX, roll=0.4)
    return pp.track(arm, target, START, "projection", max_steps=40)


def test_a_run_records_what_happened(arm: pp.Arm, run: pp.Run) -> None:
    assert run.q.shape == (run.steps + 1, 40)
    assert run.point_errors.shape == run.points.shape[:2] == (run.steps + 1, 20)
    assert len(run.active_sets) == len(run.info["sigma_min"]) == run.steps
    for step in (0, run.steps // 2, run.steps):
        points = arm.at(run.q[step]).points
        np.testing.assert_allclose(run.points[step], points, atol=1e-14)
        errors = np.linalg.norm(points - run.target.points, axis=1)
        np.testing.assert_allclose(run.point_errors[step], errors, atol=1e-14)
        assert run.posture_error[step] == pytest.approx(errors.sum())
    largest = np.abs(np.diff(run.q, axis=0)).max(axis=1)
    assert np.all(largest <= 0.1 + 1e-12)
    assert np.all((run.info["scale"] < 1.0) <= (largest > 0.1 - 1e-9))


def test_close_targets_converge(arm: pp.Arm) -> None:
    near = arm.configuration(START + 0.01 * np.cos(np.arange(40)))
    for name in ("selection", "projection"):
        run = pp.track(arm, pp.Target.from_configuration(arm, near), START, name, max_steps=200)
        if name == "projection":
            assert run.converged
            assert run.point_errors[-1].mean() <= 1e-6
        assert run.posture_error[-1] < 0.3 * run.posture_error[0]


def test_a_run_that_begins_at_the_target_takes_no_step(arm: pp.Arm) -> None:
    run = pp.track(arm, pp.Target.from_configuration(arm, START), START)
    assert (run.status, run.steps) == ("converged", 0)
    assert run.active.shape == (0, 20)
    assert run.clipped.shape == (0, 40)


def test_every_other_ending_says_why(arm: pp.Arm) -> None:
    helix = pp.resolve_targets(arm, HELIX)
    stuck = pp.track(arm, helix, arm.straight(), "selection")
    assert stuck.status == "no_control_points"
    assert stuck.steps == 0
    assert "singular" in stuck.reason
    short = pp.track(arm, helix, START, "projection", max_steps=3)
    assert short.status == "max_steps"
    assert short.steps == 3
    assert "above the tolerance" in short.reason and "raise max_steps" in short.reason
    unreachable = pp.Target.from_points(arm, helix.points + [0.0, 5.0, 0.0])
    stalled = pp.track(arm, unreachable, START, "projection", max_steps=2000)
    assert stalled.status in ("stalled", "no_control_points")
    assert "no progress" in stalled.reason
    seen = []
    stopped = pp.track(
        arm, helix, START, "projection", callback=lambda k, state, step: seen.append((k, state.q)) or k == 5
    )
    assert (stopped.status, stopped.steps) == ("stopped", 5)
    assert [k for k, _ in seen] == [1, 2, 3, 4, 5]
    np.testing.assert_array_equal(seen[-1][1], stopped.q[-1])


def test_the_same_run_twice_is_the_same_run(arm: pp.Arm, run: pp.Run) -> None:
    again = pp.track(arm, run.target, START, "projection", max_steps=40)
    np.testing.assert_array_equal(again.q, run.q)


def test_the_library_logs_and_prints_nothing(
    arm: pp.Arm, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "pinposture"):
        pp.track(arm, pp.Target.from_configuration(arm, START), START)
    assert capsys.readouterr() == ("", "")
    assert "converged after 0 steps" in caplog.text


def test_a_file_gives_everything_back(arm: pp.Arm, run: pp.Run, tmp_path: object) -> None:
    path = pp.save(run, tmp_path / "deep" / "run")
    assert path.name == "run.npz"
    assert [file.name for file in path.parent.iterdir()] == ["run.npz"]
    loaded = pp.load(path, pp.Run)
    arrays = [field.name for field in fields(run) if isinstance(getattr(run, field.name), np.ndarray)]
    assert len(arrays) == 8
    for name in arrays:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(run, name))
    assert (loaded.status, loaded.reason, loaded.controller) == (run.status, run.reason, run.controller)
    assert loaded.limits == run.limits
    assert loaded.arm.urdf == arm.urdf
    again, once = (each.target.curve.resample(50) for each in (loaded, run))
    np.testing.assert_allclose(again, once, atol=1e-15)  # its length is measured anew
    repeated = pp.track(loaded.arm, loaded.target, loaded.q[0], "projection", loaded.limits, max_steps=40)
    np.testing.assert_array_equal(repeated.q, run.q)


def test_files_that_are_no_runs_are_named(tmp_path: object, run: pp.Run) -> None:
    with pytest.raises(FileError, match="no such file"):
        pp.load(tmp_path / "missing.npz", pp.Run)
    text = tmp_path / "text.npz"
    text.write_text("hello")
    with pytest.raises(FileError, match=r"not a saved run \(it is no \.npz archive\)"):
        pp.load(text, pp.Run)
    table = pp.save(run.joint_trajectory(0.1, force=True), tmp_path / "joints.csv")
    with pytest.raises(FileError, match=r"not a saved run; .* reads joint trajectories"):
        pp.load(table, pp.Run)
    other = tmp_path / "other.npz"
    np.savez(other, q=np.zeros(3))
    with pytest.raises(FileError, match="not a saved run"):
        pp.load(other, pp.Run)
    cut = pp.save(run, tmp_path / "cut.npz")
    cut.write_bytes(cut.read_bytes()[:2000])
    with pytest.raises(FileError, match="not a saved run"):
        pp.load(cut, pp.Run)
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(FileError, match="is a file"):
        pp.save(run, blocked / "run.npz")


def test_a_target_without_any_point_is_refused(arm: pp.Arm) -> None:
    nothing = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.01, 0, 0)), incomplete="partial")
    with pytest.raises(InvalidValue, match=r"target\.weights.*at least one"):
        pp.track(arm, nothing, START)


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        (lambda: {"q0": np.zeros(39)}, InvalidValue, r"q0 \(shape\)"),
        (lambda: {"q0": np.full(40, np.nan)}, InvalidValue, r"q0\[0\] is nan"),
        (lambda: {"controller": "simplex"}, UnknownName, "selection, projection, switching"),
        (lambda: {"max_steps": 0}, InvalidValue, "max_steps"),
        (lambda: {"tolerance": -1.0}, InvalidValue, "tolerance"),
        (
            lambda: {"target": pp.Target.from_configuration(template_arm("RyRz", 3), np.zeros(6))},
            InvalidValue,
            "target",
        ),
    ],
)
def test_bad_arguments_are_named(arm: pp.Arm, change: object, kind: type, message: str) -> None:
    arguments = {"arm": arm, "target": pp.Target.from_configuration(arm, START), "q0": START} | change()
    with pytest.raises(kind, match=message):
        pp.track(**arguments)


def test_partial_targets_are_tracked_by_the_points_that_have_one(arm: pp.Arm) -> None:
    target = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.52, 0, 0)), incomplete="partial")
    run = pp.track(arm, target, START, "projection", max_steps=100)
    assert not run.point_errors[:, 10:].any()
    assert run.posture_error[-1] < 0.5 * run.posture_error[0]
    assert LINE.length > 1.0


def test_a_run_that_does_not_get_there_for_want_of_a_configuration_says_so(arm: pp.Arm) -> None:
    known = pp.resolve_targets(arm, HELIX)
    bare = pp.Target.from_points(arm, known.points)
    run = pp.track(arm, bare, START, "selection", max_steps=3)
    assert "fit_points" in run.reason
    assert "fit_points" not in pp.track(arm, known, START, "selection", max_steps=3).reason
    assert pp.track(arm, pp.fit_points(arm, known.points), START).converged


def test_nothing_keeps_an_arm_alive_after_it_was_used() -> None:
    """Pinocchio's scratch data of an arm grows with the cube of its joints."""
    arm = pp.Arm.from_template("RyRz", 3)
    pp.track(arm, pp.resolve_targets(arm, HELIX, placement="align"), arm.straight(), max_steps=3)
    gone = weakref.ref(arm)
    del arm
    gc.collect()
    assert gone() is None


def straight_motion(steps=7, m=3):
    ends = np.random.default_rng(0).normal(size=(2, m, 3))
    shares = np.sort(np.r_[0.0, np.random.default_rng(1).uniform(size=steps - 1), 1.0])
    return ends[0] + shares[:, None, None] * (ends[1] - ends[0])


def test_the_sweep_of_a_straight_motion_is_one_and_of_a_corner_its_two_sides():
    assert path_length_ratio(straight_motion()) == pytest.approx(1.0, abs=1e-12)
    corner = np.array([[[0, 0, 0]], [[3, 0, 0]], [[3, 4, 0]]], dtype=float)
    assert path_length_ratio(corner) == pytest.approx(7 / 5)
    # Long ways count for more than short ones: (7 + 1) / (5 + 1).
    straight = np.array([[[0, 0, 0]], [[0.5, 0, 0]], [[1, 0, 0]]], dtype=float)
    assert path_length_ratio(np.concatenate([corner, straight], axis=1)) == pytest.approx(8 / 6)


def test_the_sweep_of_nothing_and_of_a_way_back_is_one():
    assert path_length_ratio(np.zeros((4, 2, 3))) == 1.0
    assert path_length_ratio(np.zeros((1, 2, 3))) == 1.0
    assert path_length_ratio(np.array([[[0, 0, 0]], [[1, 0, 0]], [[0, 0, 0]]], dtype=float)) == 1.0


@given(seed=st.integers(0, 10_000), scale=st.floats(1e-3, 1e3))
@examples(30)
def test_the_sweep_does_not_depend_on_where_things_are_nor_on_the_unit(seed, scale):
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(size=(6, 4, 3)), axis=0)
    moved = scale * points @ Rotation.random(random_state=seed).as_matrix().T + rng.normal(size=3)
    assert path_length_ratio(points) >= 1.0
    assert path_length_ratio(moved) == pytest.approx(path_length_ratio(points), rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("acceleration", [None, 1.0])
def test_with_time_limits_a_run_gets_the_steps_that_it_needs(acceleration) -> None:
    arm = pp.Arm.from_template("RyRz", modules=3)
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.6))
    start = np.full(arm.nv, -0.6)
    limits = pp.Limits(step=None, dt=0.02, velocity=0.1, acceleration=acceleration)
    run = pp.track(arm, target, start, limits=limits)
    assert run.converged and run.steps >= 600  # 1.2 rad at 0.1 rad/s in steps of 20 ms
    direct = pp.track(arm, target, start, "joint", limits)  # which takes the straight path
    assert direct.converged and 600 <= direct.steps <= 700
    (one,) = pp.track_many(arm, target, start, limits=limits, jobs=1)
    assert one.converged
    assert pp.track(arm, target, start, limits=pp.Limits(step=0.001)).steps == 300


@examples(4)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["geodesic", "joint"]),
    st.sampled_from([None, 1.0]),
    st.booleans(),
)
def test_the_number_of_steps_that_a_short_run_names_is_enough(seed, controller, acceleration, around) -> None:
    rng = np.random.default_rng(seed)
    arm = template_arm("RyRz", 4)
    target = pp.Target.from_configuration(arm, rng.uniform(-1.0, 1.0, arm.nv))
    limits = pp.Limits(step=None, dt=0.05, velocity=0.3, acceleration=acceleration)
    scene = pp.Scene({"ball": pp.Sphere((0.3, 0.3, 0.3), 0.01)}) if around else None
    if controller == "joint":
        scene = None
    start = rng.uniform(-1.0, 1.0, arm.nv)
    chosen = controller_named(controller)
    asked = partial(pp.track, arm, target, start, chosen, limits, scene)
    short = asked(max_steps=3)
    assert short.reason.endswith("; raise max_steps to continue")
    short = name_enough_steps(short, chosen, lambda steps: asked(max_steps=steps))
    needed = re.findall(r"; raise max_steps to (\d+)$", short.reason)
    assert needed or "more steps do not help: after " in short.reason
    for number in map(int, needed):
        again = asked(max_steps=number)
        assert (again.converged, again.steps) == (True, number)


@pytest.mark.long
def test_a_run_that_more_steps_do_not_help_says_so() -> None:
    arm = template_arm("Rz", 5, (0.2,))
    closed = pp.Target.from_configuration(arm, [0.0, np.pi / 2, np.pi / 2, np.pi / 2, 0.0])
    chosen = pp.Geodesic()
    asked = partial(pp.track, arm, closed, arm.straight(), chosen, scene=pp.Scene())
    run = name_enough_steps(asked(max_steps=2), chosen, lambda steps: asked(max_steps=steps))
    assert run.status == "max_steps"
    assert re.search(
        r"; more steps do not help: after \d+ it stalled: the target posture is in collision", run.reason
    )
