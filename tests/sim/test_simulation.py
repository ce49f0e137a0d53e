"""Motions of every kind go in; what comes out is kept, told and drawn."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from sampling import cases
from simple_arms import inertial, joint, link, quiet, quintic, robot

import pinposture as pp
from pinposture import sim
from pinposture.errors import FileError, InvalidValue, PostureWarning
from pinposture.motion import JointTrajectory
from pinposture.motion.words import in_words
from pinposture.units import length_text
from pinposture.viz.simulation import plot_simulation

DT = 0.02
ROWS = quintic(np.zeros(8), np.linspace(-0.4, 0.5, 8), 0.6, DT)


def four_modules() -> pp.Arm:
    return template_arm("RyRz", 4)


@cache
def some_run() -> pp.Run:
    arm = four_modules()
    target = pp.Target.from_configuration(arm, ROWS[-1])
    return pp.track(arm, target, arm.neutral(), limits=pp.Limits(dt=DT, acceleration=10.0))


@cache
def open_loop() -> sim.Simulation:
    return sim.simulate(four_modules(), ROWS, dt=DT)


@cache
def closed_loop() -> sim.Simulation:
    arm = four_modules()
    run = some_run()
    tracker = pp.motion.Tracker(arm, limits=run.limits)
    return sim.simulate_closed(arm, tracker, run.target, arm.neutral(), 0.5, DT)


def test_motions_of_every_kind_come_to_the_same_set_points():
    run = some_run()
    trajectory = run.joint_trajectory()
    shuffled = JointTrajectory(
        trajectory.joint_names[::-1],
        trajectory.time,
        *(
            table[:, ::-1]
            for table in (trajectory.positions, trajectory.velocities, trajectory.accelerations)
        ),
    )
    for motion, dt in ((run, None), (run, DT), (run.q, DT), (trajectory, None), (shuffled, None)):
        found = sim.set_points(four_modules(), motion, dt)
        np.testing.assert_allclose(found.positions, run.q, atol=1e-12)
        assert found.dt == pytest.approx(DT)


def test_a_joint_trajectory_is_sampled_anew_where_its_rows_are_uneven_or_a_cycle_is_given():
    arm = four_modules()
    even = JointTrajectory.from_configurations(arm, ROWS, DT)
    uneven = JointTrajectory.from_configurations(arm, ROWS, even.time * (1.0 + 0.1 * even.time))
    found = sim.set_points(arm, uneven)
    times = np.minimum(np.arange(len(found.positions)) * found.dt, uneven.time[-1])
    np.testing.assert_allclose(found.positions, uneven.at(times), atol=1e-12)
    finer = sim.set_points(arm, even, DT / 2.0)
    np.testing.assert_allclose(finer.positions[::2], ROWS, atol=1e-12)


@pytest.mark.parametrize(
    ("motion", "dt", "name"),
    [
        (ROWS, None, "dt"),
        (some_run, 0.03, "dt"),
        (ROWS[:1], DT, "rows"),
        (ROWS[:, :3], DT, "q"),
        (lambda: JointTrajectory.from_positions(["elbow"], [[0.0], [1.0]], DT), None, "joint_names"),
        ("fast", DT, "q"),
        (np.where(ROWS > 0.4, np.nan, ROWS), DT, "q"),
    ],
)
def test_a_motion_that_is_not_one_of_the_arm_is_refused(motion, dt, name):
    motion = motion() if callable(motion) else motion
    with pytest.raises(InvalidValue, match=name):
        sim.simulate(four_modules(), motion, dt=dt)


def test_targets_after_a_motion_are_its_postures():
    arm = four_modules()
    at = sim.set_points(arm, ROWS, DT).targets(arm)
    np.testing.assert_allclose(at(5 * DT).q, ROWS[5])
    np.testing.assert_allclose(at(9.0).q, ROWS[-1])


def test_errors_are_distances_between_what_was_sent_and_what_was_taken():
    arm = four_modules()
    opened = open_loop()
    closed = closed_loop()
    for ended in (opened, closed):
        off = np.abs(ended.q - ended.commanded)
        np.testing.assert_allclose(ended.joint_error, off, atol=1e-12)
        sent = np.array([arm.at(q).points for q in ended.commanded])
        taken = np.array([arm.at(q).points for q in ended.q])
        distances = np.linalg.norm(sent - taken, axis=2)
        np.testing.assert_allclose(ended.point_errors, distances, atol=1e-12)
        np.testing.assert_allclose(ended.posture_error, distances.sum(axis=1), atol=1e-12)
        told = ended.summary()
        assert told["turning_joints"]["largest"] == pytest.approx(off.max())
        assert told["turning_joints"]["rms"] == pytest.approx(np.sqrt((off**2).mean()))
        assert told["mean_point_error"]["end"] == pytest.approx(distances[-1].mean())
        assert told["largest_point_error"]["value"] == pytest.approx(distances.max())
    np.testing.assert_allclose(opened.commanded[0], ROWS[0])
    np.testing.assert_allclose(opened.commanded[-1], ROWS[-1], atol=1e-12)
    assert opened.time[-1] == pytest.approx(0.6 + DT + 0.5)
    assert opened.target_errors is None
    to_target = np.linalg.norm(closed.points - some_run().target.points, axis=2)
    np.testing.assert_allclose(closed.target_errors, to_target, atol=1e-12)


def test_an_arm_that_falls_did_not_get_there():
    weak = sim.simulate(four_modules(), ROWS, sim.Servos(torque_limits=1e-3), dt=DT, hold=1.0)
    off = np.linalg.norm(weak.points[-1] - weak.commanded_points[-1], axis=1).mean()
    assert off > 0.1 * four_modules().length  # the servos cannot bear its weight
    assert (weak.status, weak.converged, weak.finished) == ("missed", False, True)
    assert weak.reason == (
        f"mean point error {length_text(off)} after {weak.time[-1]:.6g} s, above the tolerance of 2 mm; "
        f"{np.count_nonzero(weak.saturated)} of 8 servos were at their limit"
    )
    assert weak.verdict == f"did not reach the target (missed): {weak.reason}"
    assert weak.faults == (f"it missed a target: {weak.reason}",)
    told = weak.summary()
    assert (told["verdict"], told["converged"]) == (weak.verdict, False)
    kept = sim.simulate(four_modules(), ROWS, sim.Servos(torque_limits=1e-3), dt=DT, hold=1.0, tolerance=1.0)
    assert (kept.status, kept.faults) == ("converged", ())


def test_an_arm_that_arrives_after_it_collapsed_on_the_way_is_at_fault():
    arm = four_modules()
    # Held out horizontally the arm is too heavy for its servos; hanging down, at both ends, it is not.
    hanging = np.eye(8)[0] * np.pi / 2.0
    out = np.zeros(8)
    rows = np.concatenate([quintic(hanging, out, 0.5, DT), quintic(out, hanging, 0.5, DT)])
    servos = sim.Servos(torque_limits=0.5 * np.abs(sim.simulate(arm, rows, dt=DT).torques).max())
    ended = sim.simulate(arm, rows, servos, dt=DT, hold=3.0)
    mean = ended.point_errors.mean(axis=1).max()
    assert ended.converged and mean > 0.05 * arm.length
    (fault,) = ended.faults
    assert f"{length_text(ended.point_errors.max())} off its path at " in fault
    assert fault.endswith(f"{np.count_nonzero(ended.saturated)} of 8 servos were at their limit")
    assert ended.verdict == f"reached the target (converged), but {fault}: {ended.reason}"
    assert replace(ended, tolerance=0.99 * mean / 5.0).faults
    assert not replace(ended, tolerance=1.01 * mean / 5.0).faults


def test_distances_from_the_scene_are_those_of_the_simulated_arm():
    arm = four_modules()
    run = some_run()
    ball = pp.Sphere((0.1, 0.02, -0.1), 0.02)
    scene = pp.Scene({"ball": ball}, self_collision=False, margin=0.001, arm_radius=0.004)
    falls = sim.Servos(torque_limits=1e-3)
    for simulated in (
        sim.simulate(arm, replace(run, scene=scene), falls),
        sim.simulate_closed(
            arm, pp.Tracker(arm, limits=run.limits), run.target, arm.neutral(), 0.5, DT, falls, scene=scene
        ),
    ):
        expected = []
        for q in simulated.q:  # from each joint to the next, and to the tip, the arm is a bar of 4 mm
            data = arm.model.createData()
            pin.forwardKinematics(arm.model, data, q)
            nodes = [data.oMi[k].translation for k in range(1, arm.model.njoints)] + [arm.at(q).points[-1]]
            shares = np.linspace(0.0, 1.0, 2001)[:, None]
            bars = np.concatenate([a + shares * (b - a) for a, b in pairwise(nodes)])
            expected.append(np.linalg.norm(bars - ball.center, axis=1).min() - 0.02 - 0.004)
        np.testing.assert_allclose(simulated.clearance, expected, atol=1e-5)
        assert np.ptp(expected) > 0.01
        told = simulated.summary()["clearance"]
        assert told["smallest"] == pytest.approx(min(expected), abs=1e-5)
        assert "ball" in told["pair"]
        if min(expected) < 0.0:
            assert " penetrate by " in simulated.verdict
    assert not np.any(np.isfinite(open_loop().clearance))
    assert open_loop().summary()["clearance"] is None


def test_progress_is_told_to_the_end():
    seen = []
    sim.simulate(four_modules(), ROWS, dt=DT, hold=0.0, progress=lambda *counts: seen.append(counts))
    assert seen == [(k, len(ROWS)) for k in range(1, len(ROWS) + 1)]


@pytest.mark.parametrize("make", [open_loop, closed_loop], ids=["open", "closed"])
def test_a_file_gives_it_back(make, tmp_path):
    ended = make()
    path = pp.save(ended, tmp_path / "new" / "sim")
    back = pp.load(path, sim.Simulation)
    assert path.suffix == ".npz"
    for name, value in vars(ended).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(back, name), value)
        elif name != "arm":
            assert getattr(back, name) == value
    assert back.arm.joint_names == four_modules().joint_names
    assert back.summary() == ended.summary()
    with pytest.raises(ValueError, match="read-only"):
        back.q[0, 0] = 1.0


@pytest.mark.process
def test_a_process_that_knows_no_simulation_reads_one_without_mujoco(tmp_path):
    path = pp.save(open_loop(), tmp_path / "sim")
    code = "import sys, pinposture as pp; print(type(pp.load(sys.argv[1])).__name__, 'mujoco' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["Simulation", "False"]


def test_files_of_other_kinds_and_damaged_ones_are_refused(tmp_path):
    opened = open_loop()
    run = pp.save(some_run(), tmp_path / "run.npz")
    with pytest.raises(FileError, match="contains a run, not a simulation"):
        pp.load(run, sim.Simulation)
    path = pp.save(opened, tmp_path / "sim.npz")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(FileError, match="is not a saved simulation"):
        pp.load(path, sim.Simulation)
    with np.load(pp.save(opened, tmp_path / "sim.npz")) as stored:
        arrays = dict(stored)
    for name, array in (("torques", arrays["torques"][1:]), ("torque_limits", -arrays["torque_limits"])):
        np.savez(path, **{**arrays, name: array})
        with pytest.raises(FileError, match=name):
            pp.load(path, sim.Simulation)


@pytest.mark.parametrize("limits", [True, False])
def test_a_summary_is_json(limits):
    arm = four_modules().with_effort(100.0)
    ended = sim.simulate(arm, ROWS, sim.Servos(torque_limits=limits), dt=DT, hold=0.0)
    told = json.loads(json.dumps(ended.summary(), allow_nan=False))
    assert told["largest_torque"]["limit"] == (100.0 if limits else None)
    assert told["largest_torque"]["value"] == pytest.approx(
        ended.torques.flat[np.abs(ended.torques).argmax()]
    )
    assert told["largest_force"] is None
    assert (told["largest_share_of_limit"] is None) == (not limits)


def test_the_largest_torque_is_not_the_one_that_is_nearest_to_its_limit():
    arm = sliding_arm()
    rows = pp.JointTrajectory.from_configurations(arm, np.zeros((3, arm.nv)), DT)
    ended = sim.simulate(arm, rows, sim.Servos(torque_limits=False), hold=0.0)
    torques = np.zeros_like(ended.torques)
    torques[1] = -40.0, 3.0
    torques[2] = 10.0, -2.0
    known = replace(ended, torques=torques, torque_limits=np.array([1000.0, 4.0]))
    told = known.summary()
    force = {"joint": "feed", "value": -40.0, "unit": "N", "limit": 1000.0, "time": DT}
    torque = {"joint": "turn", "value": 3.0, "unit": "N m", "limit": 4.0, "time": DT}
    assert (told["largest_force"], told["largest_torque"]) == (force, torque)
    assert told["largest_share_of_limit"] == {"share": 0.75, **torque}
    words = in_words(told)
    assert words["force"] == f"at most 40 N (feed at {DT:.4g} s, limit 1000 N)"
    assert words["torque"] == f"at most 3 N m (turn at {DT:.4g} s, limit 4 N m)"
    assert words["of its limit"] == f"at most 75 % (turn at {DT:.4g} s, 3 of 4 N m)"


def sliding_arm() -> pp.Arm:
    return quiet(
        robot(
            link("base"),
            link("a", inertial()),
            link("b", inertial()),
            link("tip"),
            joint("feed", "base", "a", "prismatic", axis=(1, 0, 0)),
            joint("turn", "a", "b", at=(0.2, 0, 0), effort=0),
            joint("end", "b", "tip", "fixed", at=(0.3, 0, 0)),
        )
    )


def test_slides_and_turns_are_told_apart():
    arm = sliding_arm()
    told = sim.simulate(arm, [arm.neutral()] * 2, dt=DT).summary()
    assert told["turning_joints"]["joint"] == "turn"
    assert told["sliding_joints"]["joint"] == "feed"


def run_away() -> sim.Simulation:
    with pytest.warns(PostureWarning, match="5000 Hz"):
        return sim.simulate(four_modules(), ROWS, sim.Servos(frequency=5000.0), dt=DT)


CASES = {
    "open": open_loop,
    "closed": closed_loop,
    "unstable": run_away,
    "weak": lambda: sim.simulate(four_modules(), ROWS, sim.Servos(torque_limits=0.01), dt=DT),
    "no limits": lambda: sim.simulate(
        four_modules(), ROWS, sim.Servos(torque_limits=False), gravity=False, dt=DT
    ),
    "slides": lambda: sim.simulate(sliding_arm(), [sliding_arm().neutral()] * 2, dt=DT),
}


@pytest.mark.long
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", cases(CASES, quick=2))
def test_figures_show_the_data(case):
    ended = CASES[case]()
    figure = plot_simulation(ended)
    figure.savefig(io.BytesIO(), format="png")
    joints, posture, torques = figure.axes[:3]
    for k, line in enumerate(joints.get_lines()[: ended.arm.nv]):
        np.testing.assert_array_equal(line.get_xdata(), ended.time)
        np.testing.assert_array_equal(line.get_ydata(), ended.joint_error[:, k])
    assert joints.get_yscale() == "linear"
    assert figure.get_supxlabel().startswith(f"servos of {ended.servos.frequency:g} Hz, damping")
    assert joints.get_ylim()[1] > ended.joint_error.max()
    np.testing.assert_array_equal(
        posture.get_lines()[0].get_ydata(), ended.posture_error / ended.arm.n_modules
    )
    legend = posture.get_legend()
    assert next(text.get_text() for text in legend.get_texts()) == "to the set points"
    assert not legend.get_window_extent().overlaps(posture.get_window_extent())
    if ended.target_errors is not None:
        np.testing.assert_array_equal(posture.get_lines()[1].get_ydata(), ended.target_errors.sum(axis=1) / 4)
    given = torques.get_lines()[0].get_ydata()
    limit = ended.torque_limits[0]
    shown = 100.0 * ended.torques[:, 0] / limit if np.isfinite(limit) else ended.torques[:, 0]
    np.testing.assert_allclose(given, shown)
    assert ("% of limit" in torques.get_ylabel()) == bool(np.isfinite(limit))
    title = " ".join(figure.get_suptitle().split())
    assert f"{ended.loop} loop" in title
    assert ended.reason in title
