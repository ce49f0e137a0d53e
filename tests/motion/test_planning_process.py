"""A tracker with a deadline: its paths are planned in another process, and no cycle waits for them."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import traceback
import warnings

import numpy as np
import pytest

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.collision import model, shapes
from pinposture.control.planner import geodesic, plan
from pinposture.errors import PostureWarning, UnknownName
from pinposture.motion.processes import BackgroundProcess, Interrupted

LIMITS = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.01)
PATIENCE = 60.0  # for a process to start on a busy machine [s]


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=6)


@pytest.fixture(autouse=True)
def plans_in_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths of so short an arm would be found in the loop."""
    monkeypatch.setattr(plan, "PLAN", plan.PLAN._replace(most_short_motion=6.0))


def refuse(*_: object) -> None:
    raise AssertionError("a path was planned in the process of the loop")


class Loop:
    """An arm that follows each command exactly; every output is checked."""

    def __init__(self, tracker: pp.Tracker, q: np.ndarray) -> None:
        self.tracker = tracker
        self.q = q
        self.before = np.zeros(tracker.arm.nv)
        self.passed = []

    def run(self, until: str, pause: float = 0.001) -> int:
        """Step until the tracker has that status; return the number of steps with another one."""
        end = time.monotonic() + PATIENCE
        count = 0
        while time.monotonic() < end:
            dq = self.tracker.step(self.q)
            assert np.abs(dq).max() <= LIMITS.velocity * LIMITS.dt + 1e-9
            assert np.abs(dq - self.before).max() <= LIMITS.acceleration * LIMITS.dt**2 + 1e-9
            self.q = self.tracker.arm.integrate(self.q, dq)
            self.before = dq
            self.passed.append(self.q)
            if self.tracker.report.status == until:
                return count
            count += 1
            if self.tracker.report.status == "holding":
                time.sleep(pause)
        raise AssertionError(f"{self.tracker.report.status} after {PATIENCE} s, not {until}")


@pytest.mark.long
def test_no_path_is_planned_in_the_loop_and_the_arm_takes_each_posture(
    arm: pp.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(geodesic, "find_path", refuse)
    rng = np.random.default_rng(0)
    ball = pp.Scene(
        {"ball": pp.Sphere((0.1, 0.1, 0.5), 0.05)}, self_collision=False, margin=0.005, arm_radius=0.01
    )
    tracker = pp.Tracker(arm, pp.Geodesic(joint_weight=0.3), LIMITS, scene=ball, deadline=0.002)
    start, one, other = (smooth_configuration(arm, rng, spread) for spread in (0.1, 0.5, 0.6))
    loop = Loop(tracker, start)
    targets = [pp.Target.from_configuration(arm, one), pp.Target.from_points(arm, arm.at(other).points)]
    for target in targets:
        tracker.update(target)
        assert loop.run("moving") >= 1  # the arm held while the path was planned
        loop.run("converged")
        assert np.abs(arm.at(loop.q).points - target.points).max() <= 1e-5 * arm.length
    # Targets that jump while the arm moves: it brakes, and goes on from there.
    for target in (*targets, *targets):
        tracker.update(target)
        for _ in range(15):
            loop.run("moving")
    loop.run("converged")
    assert np.abs(arm.at(loop.q).points - targets[-1].points).max() <= 1e-5 * arm.length


@pytest.mark.long
def test_no_goal_is_sought_in_the_loop_while_an_obstacle_passes_over_it(
    arm: pp.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(geodesic, "find_path", refuse)
    monkeypatch.setattr(plan, "find_goal", refuse)
    goal = smooth_configuration(arm, np.random.default_rng(1), 1.0)
    ball = pp.Scene(
        {"ball": pp.Sphere((0.0, 0.0, 0.0), 0.03)}, self_collision=False, margin=0.005, arm_radius=0.005
    )
    tracker = pp.Tracker(arm, limits=LIMITS, scene=ball, deadline=0.002)
    tracker.update(pp.Target.from_configuration(arm, goal))
    tip = arm.at(goal).points[-1]
    q = arm.neutral()
    statuses = set()
    end = time.monotonic() + PATIENCE
    for cycle in range(1500):
        ahead = np.array([0.5 - 0.0005 * cycle, 0.0, 0.02])  # over the tip of the goal, and on
        moment = ball.moved({"ball": tip + ahead}, velocities={"ball": (-0.05, 0.0, 0.0)})
        tracker.step(q, scene=moment)
        q = q + 0.3 * (tracker.command - q)  # drives that lag, so that the target moves in each cycle
        statuses.add(tracker.report.status)
        if tracker.report.status == "holding" and time.monotonic() < end:
            time.sleep(0.002)
    assert "moving" in statuses and tracker.report.status != "holding"
    assert np.abs(q - goal).max() < 0.05


@pytest.mark.long
def test_an_arm_whose_goal_is_blocked_goes_on_along_its_path(
    arm: pp.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "find_goal", refuse)
    goal = smooth_configuration(arm, np.random.default_rng(1), 1.0)
    place = tuple(arm.at(goal).points[-1])
    scene = pp.Scene({"ball": pp.Sphere(place, 0.02)}, self_collision=False, margin=0.005, arm_radius=0.005)
    tracker = pp.Tracker(arm, limits=LIMITS, scene=scene, deadline=0.002)
    tracker.update(pp.Target.from_configuration(arm, goal))
    q = arm.neutral()
    end = time.monotonic() + PATIENCE
    taken = 0
    while taken < 250 and time.monotonic() < end:
        tracker.step(q)
        q = q + 0.3 * (
            tracker.command - q
        )  # the target moves in each cycle, and is blocked from the first on
        waits = tracker.report.status == "holding"
        taken += not waits
        time.sleep(0.002 if waits else 0.0)
    there = arm.at(goal).points
    apart = [np.linalg.norm(arm.at(each).points - there, axis=1).mean() for each in (arm.neutral(), q)]
    assert apart[1] < 0.3 * apart[0]


@pytest.mark.long
def test_the_result_is_that_of_planning_in_the_loop(arm: pp.Arm) -> None:
    start, goal = (smooth_configuration(arm, np.random.default_rng(seed), 0.6) for seed in (1, 2))
    target = pp.Target.from_configuration(arm, goal)
    reached = []
    for deadline in (np.inf, 0.002):
        loop = Loop(pp.Tracker(arm, limits=LIMITS, deadline=deadline), start)
        loop.tracker.update(target)
        held = loop.run("moving")
        loop.run("converged")
        reached.append(loop.passed[held:])
    np.testing.assert_allclose(*reached, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    "scene",
    [None, pp.Scene({"far": pp.Sphere((0.0, 0.0, 0.6), 0.05)}, self_collision=False, arm_radius=0.01)],
)
def test_short_clear_paths_are_found_in_the_loop_within_the_first_cycle(
    arm: pp.Arm, scene: pp.Scene | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    goal = smooth_configuration(arm, np.random.default_rng(1), 1.0)
    loop = Loop(pp.Tracker(arm, limits=LIMITS, scene=scene, deadline=0.002), arm.neutral())
    loop.tracker.update(pp.Target.from_configuration(arm, goal))
    assert loop.run("moving") == 0
    loop.run("converged")
    assert np.abs(loop.q - goal).max() < 1e-6


@pytest.mark.long
def test_a_planning_process_that_is_killed_is_replaced(arm: pp.Arm) -> None:
    tracker = pp.Tracker(arm, limits=LIMITS, deadline=0.002)
    loop = Loop(tracker, arm.neutral())
    goal = smooth_configuration(arm, np.random.default_rng(3), 1.0)
    tracker.update(pp.Target.from_configuration(arm, goal))
    loop.run("holding")
    os.kill(tracker._steps._process.pid, signal.SIGKILL)
    loop.run("converged")


@pytest.mark.long
def test_a_cycle_does_not_wait_for_another_process_to_start(
    arm: pp.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = pp.Tracker(arm, limits=LIMITS, deadline=0.002)
    line = tracker._steps._process._line
    begun = threading.Event()
    started = line._start
    go_on = threading.Event()

    def start() -> None:
        begun.set()
        assert go_on.wait(PATIENCE)
        started()

    monkeypatch.setattr(line, "_start", start)
    os.kill(tracker._steps._process.pid, signal.SIGKILL)
    assert begun.wait(PATIENCE)  # although no cycle asks for a plan
    goal = smooth_configuration(arm, np.random.default_rng(3), 1.0)
    tracker.update(pp.Target.from_configuration(arm, goal))
    for _ in range(20):  # while there is no process, cycles go on
        tracker.step(arm.neutral())
        assert tracker.report.status == "holding"
    go_on.set()
    Loop(tracker, arm.neutral()).run("converged")


@pytest.mark.long
def test_a_tracker_that_plans_in_a_process_is_pickled_with_a_process_of_its_own(arm: pp.Arm) -> None:
    tracker = pp.Tracker(arm, limits=LIMITS, deadline=0.002)
    tracker.update(
        pp.Target.from_configuration(arm, smooth_configuration(arm, np.random.default_rng(3), 1.0))
    )
    tracker.step(arm.neutral())
    other = pickle.loads(pickle.dumps(tracker))
    assert other._steps._process.pid != tracker._steps._process.pid
    Loop(other, arm.neutral()).run("converged")


def test_what_cycles_need_is_made_in_the_constructor(arm: pp.Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    wall = pp.Scan(rng.uniform(-0.5, 0.5, (3000, 3)) * [1.0, 1.0, 0.01] - [0.0, 0.0, 0.3])
    scene = pp.Scene({"wall": wall, "ball": pp.Sphere((0.3, 0.3, 0.0), 0.02)})
    tracker = pp.Tracker(arm, limits=LIMITS, scene=scene)
    monkeypatch.setattr(model, "_choose_pairs", refuse)
    monkeypatch.setattr(shapes, "Tree", refuse)
    monkeypatch.setattr(shapes.coal, "BVHModelOBBRSS", refuse)
    goal = smooth_configuration(arm, rng, 0.5)
    tracker.update(pp.Target.from_configuration(arm, goal))
    for cycle in range(5):  # also when the obstacle moves for the first time
        tracker.step(arm.neutral(), scene=scene.moved({"ball": (0.0, 0.0, 0.01 * cycle)}) if cycle else None)
        assert not tracker.report.reason


@pytest.fixture(scope="module")
def process() -> BackgroundProcess:
    return BackgroundProcess()


@pytest.mark.long
def test_errors_and_results_come_back_in_order(process: BackgroundProcess) -> None:
    process.submit(divmod, 7, 3)
    assert process.result() == (2, 1)
    process.submit(divmod, 7, 0)
    with pytest.raises(ZeroDivisionError):
        process.result()
    process.submit(divmod, 9, 2)
    assert process.result() == (4, 1)


def warn() -> None:
    warnings.warn("given before", PostureWarning, stacklevel=1)


@pytest.mark.long
def test_warnings_are_not_repeated(capfd: pytest.CaptureFixture[str]) -> None:
    process = BackgroundProcess()
    process.submit(warn)
    process.result()
    assert capfd.readouterr().err == ""


def test_a_call_is_interrupted_and_the_next_one_answered(process: BackgroundProcess) -> None:
    process.submit(divmod, 7, 3)
    assert process.result() == (2, 1)
    process.interrupt()  # of no call: nothing happens
    for _ in range(20):
        began = time.monotonic()
        process.submit(time.sleep, PATIENCE)
        while not process.done():
            process.interrupt()
            time.sleep(0.001)
        with pytest.raises(Interrupted):
            process.result()
        assert time.monotonic() - began < PATIENCE / 2
        process.submit(divmod, 9, 2)
        assert process.result() == (4, 1)


class EndlessPlanning:
    """A planning process whose plans end only when they are interrupted."""

    def __init__(self) -> None:
        self.targets: list[pp.Target] = []
        self.interrupted = False

    def submit(self, _plan: object, _shared: object, _q: object, target: pp.Target, *_: object) -> None:
        self.targets.append(target)
        self.interrupted = False

    def interrupt(self) -> None:
        self.interrupted = True

    def done(self) -> bool:
        return self.interrupted

    def result(self) -> None:
        raise Interrupted


@pytest.mark.long
def test_a_plan_for_an_outdated_target_is_interrupted_but_not_the_one_after_it(arm: pp.Arm) -> None:
    rng = np.random.default_rng(5)
    tracker = pp.Tracker(arm, limits=LIMITS, deadline=0.002)
    process = EndlessPlanning()
    tracker._steps._process = process
    q = smooth_configuration(arm, rng, 1.0)
    targets = [pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 1.0)) for _ in range(3)]
    nearly = pp.Target.from_configuration(arm, arm.integrate(targets[0].q, np.full(arm.nv, 1e-4)))
    for target, plans in ((targets[0], 1), (nearly, 1), (targets[1], 2), (targets[2], 2)):
        tracker.update(target)
        for _ in range(3):
            tracker.step(q)
        assert len(process.targets) == plans
    assert process.targets == targets[:2]


def test_where_to_plan_is_checked(arm: pp.Arm) -> None:
    with pytest.raises(UnknownName, match="planning"):
        pp.Tracker(arm, limits=LIMITS, deadline=0.002, planning="elsewhere")


class Faulty:
    """A constraint that fails in the process that plans, away from this one."""

    name = "faulty"

    def __init__(self, home: int) -> None:
        self.home = home

    def rows(self, state: object) -> object:
        if os.getpid() == self.home:
            return np.zeros((1, state.arm.nv)), [-1.0], [1.0]
        return 1.0 / 0.0


@pytest.mark.long
def test_what_fails_in_the_process_reaches_the_loop_with_its_traceback(
    arm: pp.Arm, caplog: pytest.LogCaptureFixture
) -> None:
    controller = pp.Geodesic(constraints=(Faulty(os.getpid()),))
    tracker = pp.Tracker(arm, controller, LIMITS, deadline=0.002)
    tracker.update(
        pp.Target.from_configuration(arm, smooth_configuration(arm, np.random.default_rng(1), 0.8))
    )
    end = time.monotonic() + PATIENCE
    while "faulty" not in tracker.report.reason and time.monotonic() < end:
        tracker.step(arm.straight())
        time.sleep(0.001)
    assert tracker.report.status == "holding"
    assert "faulty.rows(state) raised ZeroDivisionError" in tracker.report.reason
    assert "return 1.0 / 0.0" in caplog.text


class Unread:
    """It can be pickled, and not be made again."""

    def __init__(self, wanted: str) -> None:
        self.wanted = wanted

    def __reduce__(self) -> tuple:
        return (unreadable, ())


def unreadable() -> None:
    raise LookupError("it is not here")


def fail(error: BaseException) -> None:
    raise error


class Unsendable(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__("more than one")
        self.lock = threading.Lock()


@pytest.mark.long
def test_every_exception_of_a_call_comes_back() -> None:
    process = BackgroundProcess()
    pid = process.pid
    for call, kind, words in (
        ((fail, LookupError("mine")), LookupError, "mine"),
        ((fail, SystemExit(3)), SystemExit, "3"),
        ((raise_unsendable,), RuntimeError, "Unsendable"),
        ((threading.Lock,), RuntimeError, "lock cannot be sent"),
        ((str, Unread("x")), LookupError, "it is not here"),
    ):
        process.submit(*call)
        with pytest.raises(kind, match=words) as caught:
            process.result()
        if call[0] is not threading.Lock:
            told = "".join(traceback.format_exception(caught.value))
            assert "in another process" in told and "raise" in told
    process.submit(pow, 2, 5)
    assert process.result() == 32
    assert process.pid == pid  # it lives on


def raise_unsendable() -> None:
    raise Unsendable(1, 2)


@pytest.mark.long
def test_what_the_process_cannot_prepare_or_have_is_told_at_once(arm: pp.Arm) -> None:
    with pytest.raises(LookupError, match="it is not here"):
        BackgroundProcess(unreadable)
    held = Faulty(os.getpid())
    held.lock = threading.Lock()
    with pytest.raises(pp.PostureError, match="can be pickled"):
        pp.Tracker(arm, pp.Geodesic(constraints=(held,)), LIMITS, deadline=0.002)


LEAVING = """
import time
from multiprocessing import util

from pinposture.motion.processes import BackgroundProcess

kept = BackgroundProcess()
kept.submit(time.sleep, 60.0)
util.Finalize(None, lambda: time.sleep(1.2), exitpriority=-100)  # after processes were ended
"""


@pytest.mark.long
def test_a_process_that_ends_leaves_none_behind_and_says_nothing() -> None:
    command = [sys.executable, "-c", LEAVING]
    left = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (left.returncode, left.stdout, left.stderr) == (0, "", "")
