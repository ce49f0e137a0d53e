"""The task files in `examples/tasks`, and what becomes of them within their limits."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from nearest import distances_to_nearest
from task_texts import LEADER, VALID

import pinposture as pp

FOLDER = Path(__file__).parents[2] / "examples" / "tasks"


class Done(NamedTuple):
    task: pp.Task
    reference: pp.Reference
    motion: pp.Trajectory


def done(path: Path, *changes: tuple[str, str]) -> Done:
    """A task performed, with changes that spare time."""
    text = path.read_text()
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text)
    task = pp.Task.load(path)
    reference = task.reference()
    return Done(task, reference, task.perform(reference))


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Done]:
    folder = tmp_path_factory.mktemp("tasks")
    for path in FOLDER.iterdir():
        (folder / path.name).write_text(path.read_text())
    shorter = (
        ("modules = 20", "modules = 10"),
        ('pipe = "', 'depth = "0.45 m"\npipe = "'),
        ("100 ms", "900 ms"),
    )
    return {
        "keyframes": done(folder / "keyframes.toml"),
        "around": done(folder / "around.toml", ("20 ms", "40 ms")),
        "pipe": done(folder / "pipe.toml", *shorter),
        "inspection": done(folder / "inspection.toml", ("50 ms", "100 ms")),
        "wrap": done(folder / "wrap.toml", ("20 ms", "50 ms")),
    }


# From the files, in SI units, for the joints that turn and the one that slides.
SPEEDS = {
    "keyframes": (np.pi / 2, None),
    "around": (2.0, None),
    "pipe": (2.0, 0.1),
    "inspection": (1.0, 0.1),
    "wrap": (1.0, None),
}
ACCELERATIONS = {
    "keyframes": (2 * np.pi, None),
    "around": (10.0, None),
    "pipe": (2.0, 1.0),
    "inspection": (4.0, 1.0),
    "wrap": (2.0, None),
}
NAMES = ("keyframes", "around", "pipe", "inspection", "wrap")


def test_every_example_is_tested() -> None:
    assert {path.stem for path in FOLDER.iterdir()} == set(NAMES)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_the_arm_takes_every_posture(examples: dict[str, Done], name: str) -> None:
    task, reference, motion = examples[name]
    assert motion.converged, motion.run.reason
    assert not motion.deviations
    assert len(motion.waypoints) == len(reference.waypoints)
    for place, waypoint in zip(motion.waypoints, reference.waypoints, strict=True):
        # One that is passed through is between two cycles, unless time runs exactly as planned.
        rows = range(max(place.row - 1, 0), min(place.row + 2, motion.steps + 1))
        near = np.array([task.arm.at(motion.q[row]).points for row in rows])
        moved = np.linalg.norm(np.diff(near, axis=0), axis=2).mean(axis=1).max()
        assert place.mean_error < 0.6 * moved + 1e-6 * task.arm.length
        missed = np.inf
        for before, after in pairwise(near):
            step = after - before
            left = waypoint.target.points - before
            share = np.clip((step * left).sum() / max((step**2).sum(), 1e-12), 0.0, 1.0)
            missed = min(missed, np.abs(before + share * step - waypoint.target.points).max())
        assert missed < 3e-4 * task.arm.length


@pytest.mark.parametrize("name", NAMES)
def test_limits_hold_on_what_comes_out(examples: dict[str, Done], name: str) -> None:
    motion = examples[name].motion
    slides = motion.arm.slides
    dt = motion.dt
    still = np.zeros((1, motion.arm.nv))
    speeds = np.vstack([still, np.diff(motion.q, axis=0) / dt, still])  # none of these joints is continuous
    for values, limits in ((speeds, SPEEDS), (np.diff(speeds, axis=0) / dt, ACCELERATIONS)):
        turning, sliding = limits[name]
        assert np.abs(values[:, ~slides]).max() <= turning * (1 + 1e-9)
        assert sliding is None or np.abs(values[:, slides]).max() <= sliding * (1 + 1e-9)
    assert motion.arm.limits.lower.min() <= motion.q.min() <= motion.q.max() <= motion.arm.limits.upper.max()


def test_keyframes_lie_on_the_curves_of_the_file(examples: dict[str, Done]) -> None:
    task, reference, motion = examples["keyframes"]
    rows = [place.row for place in motion.waypoints]
    straight, _, _, helix, ring = (task.arm.at(motion.q[row]).points for row in rows)
    np.testing.assert_allclose(straight, [[0.05 * k, 0, 0] for k in range(1, 21)], atol=1e-9)
    # A circle through the base, of the radius in the file: all points have one distance from its centre.
    tangent = np.array([1.0, 0, 0])
    relative_position_weight = ring[0]
    normal = relative_position_weight - (relative_position_weight @ tangent) * tangent
    centre = 0.17 * normal / np.linalg.norm(normal)
    np.testing.assert_allclose(np.linalg.norm(ring - centre, axis=1), 0.17, atol=1e-6)
    # The helix (6.17) has the radius 0.06 and the pitch 0.15, so all its chords over a turn are that long.
    curve = reference.waypoints[3].target.curve
    near = curve.at(np.linspace(0, curve.length, 20_000))
    # The arm passes it within half a cycle of the nearest row.
    assert distances_to_nearest(helix, near).max() < 3e-4
    turn = 2 * np.pi * np.hypot(0.06, 0.15 / (2 * np.pi))
    assert curve.length == pytest.approx(4 * turn, rel=1e-9)


def test_the_arm_keeps_clear(examples: dict[str, Done]) -> None:
    motion = examples["around"].motion
    assert motion.run.clearance.min() > 0.01  # the margin
    points = np.array([motion.arm.at(q).points for q in motion.q])
    assert np.linalg.norm(points - (0.5, 0.28, 0.0), axis=2).min() > 0.08 + 0.015 + 0.01
    assert points[:, :, 2].min() > -0.4 + 0.015 + 0.01


def test_the_arm_touches_no_wall_of_its_pipe(examples: dict[str, Done]) -> None:
    task, reference, motion = examples["pipe"]
    assert motion.run.clearance.min() > 0
    path = reference.waypoints[0].target.curve
    entry = task.arm.at(reference.start).points[-1]
    near = path.at(np.linspace(0, path.length, 4000))
    for q in motion.q[:: max(1, motion.steps // 5)]:
        inside = [point for point in task.arm.at(q).points if point[0] > entry[0] + 1e-3]
        assert np.all(distances_to_nearest(np.reshape(inside, (-1, 3)), near) < 0.01 * task.arm.length)
    assert motion.q[-1][0] - motion.q[0][0] == pytest.approx(0.45)


def test_a_start_elsewhere_comes_first(examples: dict[str, Done]) -> None:
    task, reference, motion = examples["around"]
    np.testing.assert_array_equal(motion.q[0], task.arm.straight())
    assert motion.start_index > 0
    np.testing.assert_allclose(motion.q[motion.start_index], reference.start, atol=1e-4)
    assert motion.waypoints[0].reached == 0.0


def test_the_tip_comes_to_where_it_was_asked_to_be_as_far_as_that_weighs(examples: dict[str, Done]) -> None:
    task, reference, motion = examples["around"]
    aim = np.array([0.62, 0.52, 0.3])
    row = motion.waypoints[2].row
    assert np.linalg.norm(motion.arm.at(motion.q[row]).points[-1] - aim) < 0.005
    assert motion.waypoints[2].tip_off < 0.005 and motion.waypoints[2].off_curve > 1e-3
    assert np.array_equal(reference.weights[-1] > 0, [True] * 5 + [False] * 7)
    assert task.continuity == "acceleration"


@pytest.mark.filterwarnings("ignore:.*does not avoid obstacles")
@pytest.mark.parametrize("name", ["selection", "projection", "switching"])
def test_other_controllers_do_the_same_task(tmp_path: Path, name: str) -> None:
    (tmp_path / "task.toml").write_text(VALID)
    motion = done(
        tmp_path / "task.toml",
        ('"geodesic"\njoint_weight = 0.2', f'"{name}"'),
        ("modules = 6", "modules = 6"),
    ).motion
    assert np.all(np.isfinite(motion.q))
    assert f"name='{name}'" in motion.run.controller
    assert np.abs(motion.velocities).max() <= np.pi / 2 * (1 + 1e-9)
    assert np.abs(motion.accelerations).max() <= 10 * (1 + 1e-9)


def test_progress_is_told_and_can_stop_the_motion(tmp_path: Path) -> None:
    file = tmp_path / "task.toml"
    file.write_text(LEADER)
    task = pp.Task.load(file)
    placed = []
    moved = []
    reference = task.reference(lambda done, rows: placed.append((done, rows)))
    assert placed[-1] == (reference.rows, reference.rows)
    motion = task.perform(reference, lambda time, lasts: moved.append((time, lasts)))
    assert motion.converged
    assert moved == sorted(moved)
    assert {lasts for _, lasts in moved} == {reference.duration}
    stopped = task.perform(reference, lambda time, _: time > 0.5 * reference.duration)
    assert stopped.run.status == "stopped"
    assert 0 < stopped.steps < motion.steps


def test_a_motion_that_begins_inside_of_something_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "task.toml"
    file.write_text(
        (FOLDER / "around.toml").read_text().replace("center = [0.5, 0.28, 0.0]", "center = [0.5, 0, 0.1]")
    )
    with pytest.raises(
        pp.PostureError, match=r"line \d+: keyframe 1 .*: .* and ball would penetrate by .* mm"
    ):
        pp.Task.load(file).perform()
