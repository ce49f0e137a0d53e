"""Paths among obstacles that have to be searched: judged by dense sampling, and by what cannot be reached."""

from __future__ import annotations

import signal
import warnings
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from arms import template_arm
from sampling import cases, seeds

import pinposture as pp
from pinposture.collision import CollisionModel
from pinposture.control.controller import call_own
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import PlanningProblem
from pinposture.control.planner.geodesic import PromptGeodesic, plan_from
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import JointPath
from pinposture.control.planner.path_search import FoundPath, PathSearch
from pinposture.control.planner.plan import PLAN, PlanNeeded, repair
from pinposture.control.planner.trajectory_optimization import Penalties, relax_path
from pinposture.errors import ControllerError

MARGIN = 0.005


def arm() -> pp.Arm:
    return template_arm("RyRz", 20)


def wall_with_hole(place: float, y: float, z: float, width: float = 0.15) -> dict[str, pp.Box]:
    """Four boxes around a square hole, across x."""
    wide = 1.2
    side = 0.5 * width
    return {
        "left": pp.Box((place, y - side - 0.5 * wide, z), (0.02, wide, 2.0 * wide)),
        "right": pp.Box((place, y + side + 0.5 * wide, z), (0.02, wide, 2.0 * wide)),
        "below": pp.Box((place, y, z - side - 0.5 * wide), (0.02, width, wide)),
        "above": pp.Box((place, y, z + side + 0.5 * wide), (0.02, width, wide)),
    }


def through_a_hole(seed: int) -> tuple[pp.Scene, np.ndarray, np.ndarray]:
    """A wall, a posture in front of it, and one through its hole: both clear, by code that plans nothing."""
    rng = np.random.default_rng(seed)
    while True:
        y, z = rng.uniform(-0.1, 0.1, 2)
        scene = pp.Scene(wall_with_hole(0.45, y, z), self_collision=False, margin=MARGIN)
        tail = [(0.65, y, z + rng.uniform(-0.1, 0.1)), (1.0, y + rng.uniform(-0.3, 0.3), z)]
        curve = pp.Curve.spline(
            np.array([(0, 0, 0), (0.12, 0, 0), (0.3, 0.8 * y, 0.8 * z), (0.45, y, z), *tail])
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pp.PostureWarning)
            try:
                goal = pp.resolve_targets(arm(), curve, placement="as_is").q
            except pp.PostureError:
                continue
        start = pp.arm.smooth_configuration(arm(), rng, 1.2)
        model = CollisionModel(arm(), scene)
        if min(model.minimum(start).distance, model.minimum(goal).distance) > 1.5 * MARGIN:
            return scene, start, goal


def smallest_distance(scene: pp.Scene, q: np.ndarray) -> float:
    """On the straight motions between configurations, every 0.01 rad."""
    model = CollisionModel(arm(), scene)
    least = np.inf
    for one, other in pairwise(q):
        count = max(int(np.ceil(np.abs(other - one).max() / 0.01)), 1)
        for share in np.arange(1, count + 1) / count:
            least = min(least, model.minimum(one + share * (other - one)).distance)
    return least


def search(
    scene: pp.Scene,
    start: np.ndarray,
    goal: np.ndarray,
    seed: int = 0,
    constraints: Sequence[pp.control.Constraint] = (),
) -> PathSearch:
    bounds = pp.Limits().for_arm(arm())
    objective = Objective(arm(), pp.Target.from_configuration(arm(), goal), constraints=tuple(constraints))
    avoidance = Avoidance(CollisionModel(arm(), scene), objective, bounds)
    problem = PlanningProblem(objective, arm().chain_at(start), bounds.position_limits, avoidance)
    return PathSearch(problem, arm().chain_at(goal), MARGIN, seed)


def find(given: PathSearch) -> FoundPath:
    """A path by tree search or withdrawal, shortened."""
    found = given.connect() or given.withdraw()
    assert found is not None
    return given.shorten(found)


@pytest.mark.long
@pytest.mark.parametrize("seed", cases(range(5), 2))
@pytest.mark.parametrize("inwards", [True, False])
def test_the_arm_finds_its_way_through_a_hole_and_back(seed: int, inwards: bool) -> None:
    scene, start, goal = through_a_hole(seed)
    start, goal = (start, goal) if inwards else (goal, start)
    path = pp.plan(arm().at(start), pp.Target.from_configuration(arm(), goal), scene)
    assert path.blocked_by == ""
    np.testing.assert_array_equal(path.configurations[0], start)
    np.testing.assert_allclose(path.configurations[-1], goal, atol=1e-9)
    assert all(arm().within_limits(q) for q in path.configurations)
    assert smallest_distance(scene, path.configurations) > MARGIN - 1e-3


@pytest.mark.long
def test_a_run_through_a_hole_keeps_margin_and_limits() -> None:
    scene, start, goal = through_a_hole(0)
    limits = pp.Limits(step=None, velocity=1.0, dt=0.02, acceleration=5.0)
    target = pp.Target.from_configuration(arm(), goal)
    run = pp.track(arm(), target, start, limits=limits, scene=scene, max_steps=4000)
    assert run.converged and run.excess is None
    assert smallest_distance(scene, run.q) > MARGIN - 1e-4


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(2))
def test_the_search_is_the_same_for_the_same_seed(seed: int) -> None:
    scene, start, goal = through_a_hole(3)
    first, second = (find(search(scene, start, goal, seed)) for _ in range(2))
    assert first.found_by == second.found_by == "withdrawal"
    np.testing.assert_array_equal(first.offsets, second.offsets)


@pytest.mark.long
def test_where_there_is_no_path_the_plan_says_what_is_in_the_way() -> None:
    """Two walls from near the base to beyond its reach part the plane of a planar arm."""
    planar = template_arm("Rz", 5)
    reach = planar.length
    walls = {
        name: pp.Box((side * (0.6 * reach + 0.06), 0.0, 0.0), (1.2 * reach, 0.02, 0.2))
        for name, side in (("east wall", 1.0), ("west wall", -1.0))
    }
    scene = pp.Scene(walls, self_collision=False, margin=MARGIN, arm_radius=0.01)
    start = np.array([0.5 * np.pi, 0.2, 0.1, 0.1, 0.1])
    goal = np.array([-0.5 * np.pi, 0.2, 0.1, 0.1, 0.1])
    model = CollisionModel(planar, scene)
    assert min(model.minimum(q).distance for q in (start, goal)) > MARGIN
    path = pp.plan(planar.at(start), pp.Target.from_configuration(planar, goal), scene)
    assert "wall" in path.blocked_by
    np.testing.assert_allclose(path.configurations[-1], goal, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("seed", cases(range(6), 2))
def test_a_path_that_was_found_becomes_direct_and_stays_clear(seed: int) -> None:
    scene, start, goal = through_a_hole(seed)
    found = find(search(scene, start, goal, seed))
    bounds = pp.Limits().for_arm(arm())
    state = arm().chain_at(start)
    objective = Objective(arm(), pp.Target.from_configuration(arm(), goal))
    avoidance = Avoidance(CollisionModel(arm(), scene), objective, bounds)
    penalties = Penalties(None, avoidance, PLAN.searched_root, MARGIN)
    _, relaxed = relax_path(objective, state, found.offsets, bounds.position_limits, penalties)
    assert relaxed.length < 0.8 * JointPath(objective, start, found.offsets).length
    assert smallest_distance(scene, relaxed.configurations) > MARGIN - 1e-3


def cut_in_the_open(seed: int) -> tuple[JointPath, pp.Scene]:
    """A direct path, and a ball on it that is clear of its ends."""
    rng = np.random.default_rng(seed)
    while True:
        start, goal = (pp.arm.smooth_configuration(arm(), rng, 0.8) for _ in range(2))
        path = pp.plan(arm().at(start), pp.Target.from_configuration(arm(), goal))
        middle = arm().at(path.configuration(0.5 * path.end)).points[rng.integers(10, 20)]
        scene = pp.Scene({"ball": pp.Sphere(tuple(middle), 0.05)}, self_collision=False, margin=MARGIN)
        model = CollisionModel(arm(), scene)
        if min(model.minimum(start).distance, model.minimum(goal).distance) > 2.0 * MARGIN:
            return path, scene


@pytest.mark.parametrize("seed", seeds(3))
def test_a_path_that_is_cut_is_repaired_and_the_curve_through_it_is_clear(seed: int) -> None:
    before, scene = cut_in_the_open(seed)
    goal = before.configuration(before.end)
    problem = search(scene, before.start, goal).problem
    path = repair(problem, before.offsets)
    assert path is not None and path.scene is scene
    assert np.abs(path.configuration(path.end) - goal).max() < 1e-12
    assert smallest_distance(scene, path.configurations) >= MARGIN - 1e-4
    timed = pp.retime(path, pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.02))
    assert smallest_distance(scene, timed.configurations) >= MARGIN - 1e-4
    # What is clear is handed over again once.
    again = repair(problem, path.offsets, attempt=1)
    assert again is not None and np.array_equal(again.offsets, path.offsets)
    assert repair(problem, path.offsets) is None


@pytest.mark.parametrize("seed", seeds(3))
def test_a_path_whose_end_is_no_longer_allowed_is_bent_to_a_goal_nearby(seed: int) -> None:
    """The ball touches the tip at the goal, so that the nearest goal is as far off as the margin takes it."""
    before, _ = cut_in_the_open(seed)
    goal = before.configuration(before.end)
    tip = arm().at(goal).points[-1]
    away = np.random.default_rng(seed).normal(size=3)
    center = tip + (0.05 + 0.5 * MARGIN) * away / np.linalg.norm(away)
    scene = pp.Scene({"ball": pp.Sphere(tuple(center), 0.05)}, self_collision=False, margin=MARGIN)
    problem = search(scene, before.start, goal).problem
    assert not problem.avoidance.allows(arm().chain_at(goal))
    path = repair(problem, before.offsets)
    assert path is not None
    end = arm().at(path.configuration(path.end))
    moved = np.linalg.norm(end.points - arm().at(goal).points, axis=1)
    assert 0.0 < moved.mean() < 2.0 * MARGIN
    assert smallest_distance(scene, path.configurations) >= MARGIN - 1e-4


@pytest.mark.long
def test_a_path_that_a_map_cuts_on_the_way_is_repaired_and_not_planned_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, scene = cut_in_the_open(0)
    ball = scene.obstacles["ball"]
    assert isinstance(ball, pp.Sphere)
    mapped = pp.Map(0.02, reach=1.2)
    among = pp.Scene({"map": mapped.cells}, self_collision=False, margin=MARGIN)
    limits = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.02)
    controller = pp.Geodesic(scene=among)
    target = before.objective.target
    q = before.start
    memory = None
    for _ in range(5):
        step = controller.step(arm().at(q), target, limits, memory)
        memory = step.memory
        q = arm().integrate(q, step.dq)
    monkeypatch.setattr("pinposture.control.planner.geodesic.find_path", None)
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    around = directions / np.linalg.norm(directions, axis=1)[:, None]
    mapped.add_cloud(np.array(ball.center) + (ball.radius - 0.01) * around, None, 0.0)
    now = among.updated({"map": mapped.cells})
    step = controller.with_scene(now).step(arm().at(q), target, limits, memory)
    path = step.memory.progress.path
    assert path.found_by == "tree search" and path.scene is now
    assert np.array_equal(path.start, q)
    assert np.abs(path.configuration(path.end) - target.q).max() < 1e-12
    assert smallest_distance(now, path.configurations) >= MARGIN - 1e-4
    # In another process, it is repaired from where the arm will be.
    prompt = PromptGeodesic(scene=now)
    with pytest.raises(PlanNeeded) as raised:
        prompt.step(arm().at(q), target, limits, memory)
    after = arm().integrate(q, memory.dq)
    planned = plan_from(controller.with_scene(now), arm(), after, target, limits, memory.dq, raised.value)
    assert planned.path.found_by == "tree search"
    ways = arm().integrate(planned.path.start, planned.path.offsets)
    assert smallest_distance(now, ways) >= MARGIN - 1e-4


def test_a_paused_tree_search_goes_on_where_it_stopped() -> None:
    before, scene = cut_in_the_open(0)
    ends = before.start, before.configuration(before.end)
    paused = search(scene, *ends)
    assert paused.connect(most=1) is None  # the straight motion alone
    found = paused.connect()
    whole = search(scene, *ends).connect()
    assert found is not None and whole is not None
    np.testing.assert_array_equal(found.offsets, whole.offsets)


def test_a_repaired_path_leaves_out_waypoints_that_are_not_needed() -> None:
    goal = np.full(40, 0.05)
    searched = search(pp.Scene({"far": pp.Sphere((0, 0, 5.0), 0.1)}, self_collision=False), 0.0 * goal, goal)
    aside = 0.3 * np.random.default_rng(0).normal(size=(3, 40))
    np.testing.assert_array_equal(searched._pruned(np.vstack([0.0 * goal, aside, goal])), [0.0 * goal, goal])


def test_in_the_open_it_is_one_straight_motion() -> None:
    goal = np.full(40, 0.05)
    scene = pp.Scene({"far": pp.Sphere((0, 0, 5.0), 0.1)}, self_collision=False)
    found = find(search(scene, np.zeros(40), goal))
    assert found.found_by == "tree search"
    middle = found.offsets / np.linalg.norm(goal)
    np.testing.assert_allclose(middle, (middle @ middle[-1])[:, None] * middle[-1], atol=1e-12)


def test_a_budget_ends_the_search() -> None:
    scene, start, goal = through_a_hole(1)
    target = pp.Target.from_configuration(arm(), goal)
    path = pp.plan(arm().at(start), target, scene, budget=1e-3)
    assert path.blocked_by  # the most direct one alone was tried
    with pytest.raises(pp.PostureError, match="budget"):
        pp.plan(arm().at(start), target, scene, budget=0.0)


@pytest.mark.long
def test_progress_tells_what_is_tried_and_may_end_the_search() -> None:
    scene, start, goal = through_a_hole(1)
    target = pp.Target.from_configuration(arm(), goal)
    told = []

    def note(trying: str, elapsed: float, best: JointPath | None) -> bool:
        told.append((trying, elapsed, best))
        return False

    whole = pp.plan(arm().at(start), target, scene, progress=note)
    assert not whole.blocked_by
    assert told[0][0] == "tree search"
    assert any("withdrawing start and goal by" in each for each, *_ in told)
    _, _, first = next(each for each in told if each[2] is not None)
    assert told[[best for *_, best in told].index(first)][0] == "shortening a path found by withdrawal"
    assert not first.blocked_by and first.length > 1.5 * whole.length
    assert smallest_distance(scene, first.configurations) > MARGIN - 1e-3
    times = [each for _, each, _ in told]
    assert times == sorted(times)

    early = pp.plan(arm().at(start), target, scene, progress=lambda *_: True)
    assert early.blocked_by


def test_a_clear_straight_motion_is_told_before_the_most_direct_path() -> None:
    scene = pp.Scene({"far": pp.Sphere((0, 0, 5.0), 0.1)}, self_collision=False)
    start = np.zeros(40)
    goal = np.resize([0.15, -0.1, 0.05], 40)
    told = []
    target = pp.Target.from_configuration(arm(), goal)
    path = pp.plan(
        arm().at(start), target, scene, progress=lambda trying, _, best: told.append((trying, best))
    )
    (trying, first), *_ = told
    assert trying == "the most direct path"
    share = np.linspace(0.0, 1.0, len(first.configurations))
    np.testing.assert_allclose(first.configurations, share[:, None] * goal, atol=1e-12)
    assert path.length < first.length  # the most direct one is returned


def test_a_straight_motion_through_an_obstacle_is_not_told() -> None:
    scene, start, goal = through_a_hole(1)
    told = []

    def note(_: str, __: float, best: JointPath | None) -> bool:
        told.append(best)
        return True

    pp.plan(arm().at(start), pp.Target.from_configuration(arm(), goal), scene, progress=note)
    assert told == [None]


def interrupt_in_compiled_code(*_: object) -> None:
    """Raise what numba makes of an interruption while it hands over a result."""
    raise SystemError("returned a result with an exception set") from KeyboardInterrupt()


def test_an_interruption_in_compiled_code_is_one() -> None:
    scene, start, goal = through_a_hole(1)
    target = pp.Target.from_configuration(arm(), goal)
    assert pp.plan(arm().at(start), target, scene, progress=interrupt_in_compiled_code).blocked_by
    with pytest.raises(KeyboardInterrupt):
        call_own("Own", "step(...)", interrupt_in_compiled_code)
    with pytest.raises(ControllerError, match="SystemError"):
        call_own("Own", "step(...)", exec, "raise SystemError")


@pytest.mark.long
def test_an_interrupted_relaxation_keeps_the_path_that_was_found() -> None:
    scene, start, goal = through_a_hole(1)

    def interrupt(trying: str, *_: object) -> None:
        if trying.startswith("relaxation of a path found"):
            signal.setitimer(signal.ITIMER_REAL, 0.02)

    before = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        found = pp.plan(arm().at(start), pp.Target.from_configuration(arm(), goal), scene, progress=interrupt)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert not found.blocked_by
    assert found.found_by == "withdrawal"
    assert smallest_distance(scene, found.configurations) > MARGIN - 1e-3


def test_in_a_control_loop_an_interruption_is_passed_on() -> None:
    scene, start, goal = through_a_hole(1)
    before = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    try:
        with pytest.raises(KeyboardInterrupt):
            pp.track(arm(), pp.Target.from_configuration(arm(), goal), start, scene=scene)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


class FirstJointWithin:
    """A constraint that the compiled search does not know: the first joint stays within an angle of zero."""

    def __init__(self, angle: float) -> None:
        self.angle = angle

    def rows(self, state: pp.ArmState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        matrix = np.zeros((1, state.arm.nv))
        matrix[0, 0] = state.arm.length
        place = state.arm.length * state.q[:1]
        return matrix, -state.arm.length * self.angle - place, state.arm.length * self.angle - place


@pytest.mark.long
def test_edges_that_a_constraint_refuses_are_taken_back() -> None:
    scene = pp.Scene({"ball": pp.Sphere((0.7, 0.0, 0.0), 0.08)}, self_collision=False, margin=MARGIN)
    bend = np.zeros(40)
    bend[1::2] = 0.06
    free = find(search(scene, -bend, bend))
    most = 0.5 * np.abs(free.offsets[:, 0]).max()
    assert most > 0.01
    kept = find(search(scene, -bend, bend, constraints=[FirstJointWithin(most)]))
    assert np.abs(kept.offsets[:, 0]).max() <= most + 1e-6
    np.testing.assert_allclose(kept.offsets[-1], 2.0 * bend, atol=1e-12)
    assert smallest_distance(scene, kept.offsets - bend) > MARGIN - 1e-3
