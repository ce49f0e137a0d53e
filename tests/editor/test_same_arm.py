"""What is saved is what is opened again: the arm of the moment, opened, played and run is the same arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from edited_tasks import L, task
from sampling import seeds
from typer.testing import CliRunner

import pinposture as pp
from pinposture.cli.app import app
from pinposture.editor.session import Session
from pinposture.editor.solver import Solver
from pinposture.errors import PostureWarning
from pinposture.motion import Trajectory
from pinposture.task import Task
from pinposture.task.reference import Reference

TASKS = Path(__file__).parents[2] / "examples" / "tasks"
SAME = 1e-6
"""How far joints of the same arm may be apart [rad]."""

MOVES = 4
"""How many places a hand passes in a drag."""


class Bench:
    """An editor without a page: a session, and a solver that does what it is asked when it is asked."""

    def __init__(self, task: Task, path: Path | None = None) -> None:
        self.session = Session(task, path, selected=0)
        self.session.at_once = True
        self.solver = Solver(self.session.problem, task.arm.straight())
        self.look()

    def look(self) -> None:
        """Look at what is asked, decide on what is proposed, and look at what counts then."""
        for _ in range(2):
            self.solver._take(self.session.problem)
            self.solver._step()
            self.session.settle(self.solver.live)

    def drag(self, keyframe: int, point: int, to: np.ndarray) -> bool:
        """Drag a control point to a place; whether the arm could take that."""
        self.session.select(keyframe)
        self.look()
        begin = self.session.shape.points[point].copy()
        before = self.session.task
        for share in np.arange(1, MOVES + 1) / MOVES:
            place = begin + share * (to - begin)
            self.session.reshape(
                lambda arm, shape, at=place: shape.moved(arm, point, at), "moved it", bool(share == 1.0)
            )
            self.look()
        return self.session.task is not before

    def seen(self, keyframe: int) -> np.ndarray:
        """The configuration of the arm at a keyframe."""
        self.session.select(keyframe)
        self.look()
        assert self.solver.live.verdict.target is not None, self.solver.live.verdict.reason
        return self.solver.live.state.q


def run_by_command(path: Path, out: Path) -> tuple[Trajectory, Reference]:
    """The motion that the command line makes of a task file, and how it planned that."""
    planned: list[Reference] = []
    plan = Task.reference
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            Task, "reference", lambda task, *given: planned.append(plan(task, *given)) or planned[0]
        )
        ended = CliRunner().invoke(app, ["run", str(path), "-o", str(out)])
    assert ended.exit_code == 0, ended.output
    (reference,) = planned
    return pp.load(out / "motion.npz", Trajectory), reference


def assert_same(bench: Bench, folder: Path, *keyframes: int) -> None:
    """The arm at keyframes: of the moment, opened again, played, and as the command line runs the file."""
    path = folder / "saved.toml"
    edited = bench.session.task
    edited.save(path)
    opened = Bench(Task.load(path), path)
    played = edited.perform()
    ran, planned = run_by_command(path, folder / "out")
    assert np.array_equal(ran.q, played.q)
    for keyframe in keyframes:
        live = bench.seen(keyframe)
        for other in (opened.seen(keyframe), planned.waypoints[keyframe].target.q):
            assert np.abs(edited.arm.difference(live, other)).max() <= SAME
        away = np.abs([edited.arm.difference(live, q) for q in ran.q]).max(axis=1)
        assert away.min() <= SAME


def five_postures() -> Task:
    """The example, each posture held for a moment, so that the arm comes to it in full."""
    example = Task.load(TASKS / "keyframes.toml")
    held = tuple(replace(each, hold=0.2) for each in example.motion)  # type: ignore[union-attr]
    return example.edited(motion=held, formats=("npz",))


@pytest.mark.long
def test_a_posture_that_was_dragged_to_is_the_one_that_is_saved_opened_played_and_run(tmp_path: Path) -> None:
    bench = Bench(five_postures())
    assert bench.drag(1, 1, np.array([-0.130, -0.083, 0.083]))
    assert_same(bench, tmp_path, 0, 1, 2, 3, 4)


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(3))
def test_random_drags_with_undo_and_redo_and_keyframes_between_give_the_same_arm(
    seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    keyframes = tuple(replace(each, hold=0.2) for each in task().motion)  # type: ignore[arg-type]
    bench = Bench(task(*keyframes, formats=("npz",)))
    dragged: set[int] = set()
    for keyframe in (1, 3, 1, 2):
        bench.session.select(keyframe)
        points = bench.session.shape.points
        point = int(rng.integers(1, len(points)))
        if bench.drag(keyframe, point, points[point] + rng.uniform(-0.3 * L, 0.3 * L, 3)):
            dragged.add(keyframe)
    assert dragged
    before = {keyframe: bench.seen(keyframe) for keyframe in dragged}
    bench.session.undo()
    bench.session.redo()
    for keyframe in dragged:
        assert np.array_equal(bench.seen(keyframe), before[keyframe])
    assert_same(bench, tmp_path, *dragged)


@pytest.mark.long
def test_a_posture_with_a_task_of_its_tip_is_the_same_arm(tmp_path: Path) -> None:
    bench = Bench(Task.load(TASKS / "around.toml").edited(formats=("npz",)))
    assert_same(bench, tmp_path, 2)
    assert bench.drag(2, 3, bench.session.shape.points[3] + np.array([0.02, 0.02, 0.03]))
    assert_same(bench, tmp_path, 2)


@pytest.mark.parametrize(
    ("joints", "why"),
    [((0.1, 0.2), "has 2 values; needed: 12"), ((0.0,) * 11 + (9.0,), "is 9 rad for joint 12")],
)
def test_joints_that_do_not_fit_the_arm_are_ignored_with_a_warning(
    joints: tuple[float, ...], why: str, tmp_path: Path
) -> None:
    path = task().save(tmp_path / "task.toml")
    text = path.read_text().replace('name = "coil"', f'name = "coil"\njoints = {list(joints)}')
    path.write_text(text)
    with pytest.warns(PostureWarning, match=f"keyframe 3 'coil': joints {why}"):
        read = Task.load(path)
    assert read.motion[2].joints is None  # type: ignore[index]


def test_joints_are_read_with_units_and_written_again(tmp_path: Path) -> None:
    path = task().save(tmp_path / "task.toml")
    listed = ["30 deg", *[0.5] * 11]
    path.write_text(path.read_text().replace('name = "coil"', f'name = "coil"\njoints = {listed}'))
    read = Task.load(path)
    assert read.motion[2].joints == pytest.approx((np.pi / 6, *[0.5] * 11))  # type: ignore[index]
    assert Task.load(read.save(tmp_path / "again.toml")).motion == read.motion
