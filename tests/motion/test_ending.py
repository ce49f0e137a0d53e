"""One vocabulary of endings, and one place that decides what may be handed to a robot."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.control import Memory
from pinposture.editor.files import export
from pinposture.errors import MotionError
from pinposture.motion.run import ENDINGS


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return template_arm("RyRz", 4)


@pytest.fixture(scope="module")
def goal(arm: pp.Arm) -> pp.Target:
    return pp.Target.from_configuration(arm, np.full(8, 0.3))


def swept(arm: pp.Arm, goal: pp.Target, steps: int, scene: pp.Scene | None = None) -> pp.Run:
    """A run by a controller that looks at no scene."""
    return pp.track(arm, goal, arm.neutral(), "joint", pp.Limits(dt=0.1), scene, max_steps=steps)


def test_a_run_that_stopped_early_is_exported_only_by_force(arm: pp.Arm, goal: pp.Target) -> None:
    run = swept(arm, goal, 2)
    assert run.faults == (f"it ran out of steps: {run.reason}",)
    assert run.verdict == f"did not reach the target (max_steps): {run.reason}"
    with pytest.raises(MotionError, match=r"it ran out of steps: mean point.*force=True") as caught:
        run.joint_trajectory()
    assert caught.value.faults == run.faults
    assert len(run.joint_trajectory(force=True).time) == 3


def test_a_run_that_gets_there_is_exported_as_it_is(arm: pp.Arm, goal: pp.Target) -> None:
    run = swept(arm, goal, 50)
    assert (run.faults, run.verdict) == ((), f"reached the target (converged): {run.reason}")
    assert len(run.joint_trajectory().time) == run.steps + 1


@dataclass(frozen=True)
class Counting(Memory):
    number: int = 0


class Reckless:
    """Goes where it is told in three steps, however hard that is."""

    name = "reckless"

    def step(self, state, target, limits=None, memory=None):
        number = 0 if memory is None else memory.number + 1
        dq = np.full(8, (0.05, 0.2, 0.05)[number])
        step = pp.Geodesic().step(state, target, limits)
        return step._replace(dq=dq, memory=Counting(dq, number=number))


def test_a_run_that_exceeds_a_limit_is_exported_only_by_force(arm: pp.Arm, goal: pp.Target) -> None:
    run = pp.track(arm, goal, arm.neutral(), Reckless(), pp.Limits(dt=0.1, acceleration=5.0, step=0.25))
    # From 0.05 to 0.2 rad and back, where steps may differ by 0.05.
    assert run.converged and run.steps == 3
    (fault,) = run.faults
    assert "limits are exceeded in 2 steps, most in " in fault and fault.endswith(
        " exceeds it by a factor of 3"
    )
    assert run.verdict == f"reached the target (converged): {run.reason}" and fault in run.reason
    with pytest.raises(MotionError, match=r"factor of 3.*force=True"):
        run.joint_trajectory()
    peak = run.joint_trajectory(force=True).peaks.accelerations.max()
    assert peak == pytest.approx(3.0 * 5.0)


@pytest.mark.filterwarnings("ignore:.*does not avoid obstacles:pinposture.errors.PostureWarning")
def test_a_run_through_an_obstacle_is_no_good_although_it_gets_there(arm: pp.Arm, goal: pp.Target) -> None:
    tips = np.array([arm.at(np.full(8, share)).points[-1] for share in np.linspace(0.0, 0.3, 50)])
    ball = pp.Sphere(tuple(tips[25]), 0.035)  # where the tip passes half-way
    run = swept(arm, goal, 50, pp.Scene({"ball": ball}, margin=0.0))
    assert run.converged
    assert np.linalg.norm(run.points[:, -1] - tips[25], axis=1).min() < 0.035
    (fault,) = run.faults
    assert "ball" in fault and f" mm after {run.clearance.argmin()} steps" in fault
    assert run.verdict.startswith("reached the target (converged), but ")
    with pytest.raises(MotionError, match="ball"):
        run.joint_trajectory()
    assert len(run.joint_trajectory(force=True).time) == run.steps + 1


def test_a_batch_tells_whether_all_got_there(arm: pp.Arm, goal: pp.Target) -> None:
    starts = [arm.neutral(), goal.q]
    some = pp.track_many(arm, goal, starts, "joint", max_steps=2)
    assert some.faults == ("1 of 2 runs did not reach the target",) == (some.verdict,)
    every = pp.track_many(arm, goal, starts, "joint", max_steps=50)
    assert (every.faults, every.verdict) == ((), "reached the target in all 2 runs")


def test_every_way_to_end_is_in_the_vocabulary(arm: pp.Arm, goal: pp.Target) -> None:
    found = {swept(arm, goal, steps).status for steps in (2, 50)}
    found.add(pp.track(arm, goal, arm.neutral(), callback=lambda *_: True).status)
    tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.1))
    tracker.update(goal)
    tracker.step(goal.q)
    found.add(tracker.report.status)
    assert found == {"converged", "max_steps", "stopped"} < set(ENDINGS)


class TestAnArmThatClosesOnItself:
    """Five links of 0.2 m, 40 mm thick: three right angles bring the fourth and the fifth to the base."""

    q = np.array([0.0, np.pi / 2, np.pi / 2, np.pi / 2, 0.0])
    limits = pp.Limits(step=None, dt=0.1, velocity=1.0)
    off = pp.Scene(self_collision=False)

    @cached_property
    def arm(self) -> pp.Arm:
        return pp.Arm.from_template("Rz", 5, (0.2,))

    @cached_property
    def goal(self) -> pp.Target:
        return pp.Target.from_configuration(self.arm, self.q)

    @cached_property
    def frames(self) -> tuple[pp.Keyframe, ...]:
        return pp.Keyframe(joints=tuple(self.arm.straight())), pp.Keyframe(joints=tuple(self.q), time=3.0)

    def track(self, scene: pp.Scene | None, controller: str = "geodesic") -> pp.Run:
        return pp.track(self.arm, self.goal, self.arm.straight(), controller, self.limits, scene)

    def check(self, faults: tuple[str, ...], row: int) -> None:
        (fault,) = faults
        assert f"and m01_l1 penetrate by 40 mm after {row} steps" in fault
        assert fault.split()[0] in ("m04_l1", "m05_l1")

    @pytest.mark.parametrize("controller", ["geodesic", "joint"])
    def test_a_run_without_a_scene_is_judged_all_the_same(self, controller: str) -> None:
        run = self.track(None, controller)
        assert run.converged and np.isinf(run.clearance).all()
        self.check(run.faults, run.steps)
        assert "in a scene, such as Scene(), the arm keeps clear of itself" in run.verdict
        with pytest.raises(MotionError, match="penetrate by 40 mm"):
            run.joint_trajectory()

    def test_one_may_say_that_it_does_not_matter(self) -> None:
        free = self.track(None)
        run = self.track(self.off)
        np.testing.assert_array_equal(run.q, free.q)  # and it plans as without a scene
        assert (run.converged, run.faults) == (True, ())
        assert len(run.joint_trajectory().time) == run.steps + 1

    def test_in_a_scene_it_stops_before(self) -> None:
        run = self.track(pp.Scene())
        assert not run.converged and run.clearance.min() >= 0.0
        assert "the target posture is in collision" in run.reason and "overlapping by 40 mm" in run.reason
        assert len(run.faults) == 1 and run.faults[0].startswith("it stalled")

    def test_a_batch_says_what_its_runs_say(self) -> None:
        starts = [self.arm.straight(), 0.5 * self.q]
        for keep in ("motions", "ends"):
            batch = pp.track_many(self.arm, self.goal, starts, keep=keep, jobs=1)
            (fault,) = batch.faults
            found = re.fullmatch(
                r"bodies penetrate in 2 of 2 runs, most (m0[45]_l1 and m01_l1), by 40 mm in run (\d)", fault
            )
            assert found is not None
            assert batch.closest[int(found[2])] == found[1]
            np.testing.assert_allclose(batch.clearance, -0.04, atol=1e-9)
            assert pp.track_many(self.arm, self.goal, starts, scene=self.off, keep=keep, jobs=1).faults == ()

    def test_a_motion_and_its_export_in_the_editor_are_judged_by_the_same(self, tmp_path) -> None:
        motion = pp.move_through(self.arm, self.frames, limits=self.limits)
        (fault,) = motion.faults
        assert "and m01_l1 penetrate by 40 mm after " in fault
        for kind in ("CSV", "ROS JSON"):
            with pytest.raises(MotionError, match="penetrate by 40 mm"):
                export(motion, kind, "ring")
        assert "penetrate by 40 mm" in export(motion, "npz", "ring").summary
        again = pp.load(pp.save(motion, tmp_path / "motion.npz"))
        assert again.faults == motion.faults
        free = pp.move_through(self.arm, self.frames, limits=self.limits, scene=self.off)
        assert free.faults == ()
        assert export(free, "CSV", "ring").name == "ring.csv"

    def test_a_task_keeps_clear_of_itself_unless_told_otherwise(self, tmp_path) -> None:
        task = pp.Task(self.arm, self.frames, self.limits)
        with pytest.warns(pp.PostureWarning, match=r"keyframe 2.*and m01_l1 would penetrate by 40 mm"):
            motion = task.perform()
        assert not motion.converged and motion.run.clearance.min() >= 0.0
        free = pp.Task.load(task.edited(scene=self.off).save(tmp_path / "free.toml"))
        assert free.scene == self.off
        assert free.perform().faults == ()
        assert pp.Task.load(task.save(tmp_path / "task.toml")).scene is None
