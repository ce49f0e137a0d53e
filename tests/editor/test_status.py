"""What the status says, and in which colour, of situations whose figures are known by construction."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from editor.edited_tasks import L, bent_spline, six_modules, straight_line, task
from editor.played import Clock, done, live_of, short
from scipy.spatial.transform import Rotation

import pinposture as pp
from pinposture.editor.playback import Playback
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, Solver, VerdictCache, judge, review
from pinposture.editor.surroundings import ClearanceQuery, MarksQuery, marks_of, nearest
from pinposture.editor.ui.keyframes import row_label
from pinposture.editor.ui.page import DIRECTIONS, PAGE, framing, status_of, viewpoint
from pinposture.task import Keyframe, Task

THICK = 0.01


def settled(given: Task) -> tuple[Session, Live]:
    """The first keyframe of a task, and the arm when it has done with it."""
    session = Session(given, selected=0)
    solver = Solver(session.problem._replace(at_once=True), session.arm.straight())
    solver.start()
    try:
        end = time.monotonic() + 20.0
        while solver.live.status not in ("converged", "stalled") and not solver.live.verdict.reason:
            assert time.monotonic() < end
            time.sleep(0.01)
        live = solver.live
    finally:
        solver.close()
    session.nearest = nearest(ClearanceQuery(live.arm, live.state.q, given.effective_scene, {}))
    return session, live._replace(number=session.number)


def told_of(*keyframes: Keyframe, **values: object) -> tuple[str, str, str]:
    return status_of(*settled(task(*keyframes, Keyframe(straight_line(), time=9.0), **values)))


def crossing() -> tuple[pp.Arm, np.ndarray]:
    """An arm whose hinges turn by a right angle, four of them in a plane: its links lie in each other."""
    arm = six_modules()
    positions = np.zeros(arm.nv)
    positions[1::2] = 1.55
    return arm, arm.configuration(positions)


def test_a_shape_that_is_taken_is_green() -> None:
    kind, head, _ = told_of(Keyframe(straight_line()))
    assert kind == "good"
    assert head == "On the curve"


def test_a_motion_that_is_paused_is_not_said_to_play() -> None:
    session = Session(short())
    clock = Clock()
    playback = session.playback = Playback(clock)
    playback.preview.ask(session.task)
    done(playback.preview, session.task)
    playback.play(session.task)
    session.update_playback()
    clock.now += 0.2
    live = playback.seen(live_of(session))
    assert status_of(session, live)[1].startswith("Playing the motion, ")
    playback.pause()
    clock.now += 50.0
    assert status_of(session, live)[1].startswith("Motion at 0.2 s, ")


@pytest.mark.long
def test_the_lap_that_is_shown_is_named() -> None:
    session = Session(short(repeat=3))
    playback = session.playback
    task = session.task
    playback.preview.ask(task)
    motion = done(playback.preview, task).motion
    assert motion is not None
    playback.seek(task, 0.0)
    session.update_playback()
    for passed in motion.waypoints:
        assert passed.row is not None
        playback.seek(task, float(motion.time[passed.row]) + 0.06)
        lap = passed.name.rsplit(", ")[-1]
        assert f", {lap} of 3, " in status_of(session, playback.seen(live_of(session)))[1]


def test_a_tip_that_is_elsewhere_is_amber_and_says_how_far() -> None:
    tip = pp.EndEffector((0.8 * L, 0.1 * L, 0.0), weight=1e-6)
    kind, head, _ = told_of(Keyframe(straight_line(), tip=tip))
    assert kind == "warning"
    off = float(head.split("tip ")[1].split(" mm off")[0])
    assert off == pytest.approx(1e3 * L * np.hypot(0.2, 0.1), rel=0.05)


def test_a_tip_that_is_met_is_green() -> None:
    assert told_of(Keyframe(straight_line(), tip=pp.EndEffector((L, 0.0, 0.0))))[0] == "good"


def test_an_arm_far_from_its_curve_is_amber() -> None:
    session, live = settled(task(Keyframe(straight_line()), Keyframe(straight_line(), time=9.0)))
    away = live.verdict._replace(distance_from_curve=0.021 * live.arm.length)
    assert status_of(session, live._replace(verdict=away))[0] == "warning"
    near = live.verdict._replace(distance_from_curve=0.019 * live.arm.length)
    assert status_of(session, live._replace(verdict=near))[0] == "good"


def test_the_curve_in_an_obstacle_and_the_arm_in_an_obstacle_are_two_things() -> None:
    ball = pp.Scene({"ball": pp.Sphere((0.5 * L, 0.0, 0.0), 0.02)}, arm_radius=THICK)
    session, live = settled(task(Keyframe(straight_line()), Keyframe(straight_line(), time=9.0)))
    led = review(live.arm, session.keyframe, live.verdict.target, ball)
    assert status_of(session, live._replace(verdict=led))[:2] == (
        "warning",
        "At rest on this curve, the arm would collide",
    )
    session.nearest = nearest(ClearanceQuery(live.arm, live.state.q, ball, {}))
    kind, head, more = status_of(session, live._replace(verdict=led))
    assert (kind, head) == ("error", "The arm is in collision")
    assert "inside ball" in more


def test_links_inside_each_other_are_red() -> None:
    arm, q = crossing()
    found = nearest(ClearanceQuery(arm, q, pp.Scene(), {}))
    assert found is not None and found.distance < -1e-3
    session, live = settled(task(Keyframe(straight_line()), Keyframe(straight_line(), time=9.0)))
    assert session.nearest is None  # straight links touch nothing
    session.nearest = found
    assert status_of(session, live)[:2] == ("error", "The arm is in collision")
    verdict = review(arm, session.keyframe, pp.Target.from_configuration(arm, q), None)
    assert verdict.collision
    assert verdict.mark == "collides"
    assert verdict.notes[0].startswith("in collision with itself: ")


def test_marks_of_keyframes_are_those_of_their_verdicts() -> None:
    arm = six_modules()
    scene = pp.Scene({"ball": pp.Sphere((0.5 * L, 0.0, 0.0), 0.02)}, arm_radius=THICK)
    short = Keyframe(pp.Curve.line((0, 0, 0), (0.5 * L, 0, 0)), time=1.0)
    keyframes = (Keyframe(straight_line()), short, Keyframe(bent_spline(), time=2.0, trim=True))
    verdicts = VerdictCache()
    for around in (None, scene):
        expected = tuple(judge(arm, keyframe, around).mark for keyframe in keyframes)
        assert marks_of(MarksQuery(arm, keyframes, around), verdicts) == expected
    assert expected[:2] == ("collides", "refused")
    assert row_label(keyframes, [0.0, 1.0, 2.0], 1, "refused").endswith("1 s  ·  refused")


def test_a_keyframe_is_judged_again_only_when_it_is_another() -> None:
    arm = six_modules()
    keyframe = Keyframe(straight_line())
    verdicts = VerdictCache()
    first = verdicts.judge(arm, keyframe, None)
    assert first.mark == "fine"
    assert verdicts.judge(arm, keyframe, None).target is first.target
    ball = pp.Scene({"ball": pp.Sphere((0.5 * L, 0.0, 0.0), 0.02)}, arm_radius=THICK)
    assert verdicts.judge(arm, keyframe, ball).target is first.target
    assert verdicts.judge(arm, keyframe, ball).mark == "collides"
    other = replace(keyframe, time=1.0)
    assert verdicts.judge(arm, other, None).target is not first.target
    assert verdicts.judge(pp.Arm.from_template("RyRz", 6), keyframe, None).target is not first.target
    assert len(verdicts._known) == 2
    del other
    assert len(verdicts._known) == 1  # those of keyframes that are gone are forgotten


@pytest.mark.parametrize("heading", [(1, 0, 0), (0, -1, 0), (-1, 1, 0.5), (0, 0, 1)])
def test_a_new_page_shows_the_whole_arm_with_its_base_at_the_left(heading: tuple[float, ...]) -> None:
    turn = Rotation.align_vectors([heading], [(1.0, 0.0, 0.0)])[0].as_matrix()
    arm = pp.Arm.from_template("RyRz", 6, base_placement=pin.SE3(turn, np.array([0.5, 0.2, 0.1])))
    curve = pp.Curve.spline(arm.chain.base + L * np.outer([0.0, 1.0, 2.0, 3.0], heading), degree=1)
    curve = curve.trimmed(0.0, 1.2 * arm.length)
    view = viewpoint(task(Keyframe(curve), Keyframe(curve, time=1.0), arm=arm))
    ahead = view.look_at - view.position
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    axes = np.array([each / np.linalg.norm(each) for each in (right, np.cross(right, ahead), ahead)])
    x, y, z = axes @ (np.vstack([arm.chain.base, arm.at(arm.straight()).points]) - view.position).T
    half = np.tan(0.5 * view.opening) * z
    assert np.all(np.abs(x) < half) and np.all(np.abs(y) < half)
    assert x[0] < x[-1] - 0.5 * arm.length or heading[:2] == (0, 0)


@pytest.mark.parametrize("direction", list(DIRECTIONS.values()))
@pytest.mark.parametrize("size", [(0.6, 0.2, 0.3), (0.9, 0.9, 0.1), (0.1, 0.1, 0.9)])
@pytest.mark.parametrize(("aspect", "covered"), [(1.3, 0.33), (0.76, 0.43), (2.2, 0.2)])
def test_what_is_framed_is_seen_above_the_plots(
    direction: np.ndarray, size: tuple[float, float, float], aspect: float, covered: float
) -> None:
    rng = np.random.default_rng(0)
    radius = 0.1
    centres = rng.uniform(-1.0, 1.0, (30, 3)) * size + [0.4, 0.1, 0.2]
    view = framing(centres, radius, direction, aspect, covered)
    outward = rng.normal(size=(3000, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = (centres[:, None] + radius * outward).reshape(-1, 3)  # of the surfaces of the balls
    # A pinhole camera: right, up and depth of each point, and its place in the picture in [-1, 1].
    ahead = view.look_at - view.position
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = (points - view.position) @ np.array([right, np.cross(right, ahead), ahead]).T
    scale = 1.0 / (np.tan(view.opening / 2.0) * seen[:, 2])
    assert (seen[:, 2] > 0.0).all()
    across = seen[:, 0] * scale / aspect
    above = (seen[:, 1] * scale - covered) / (1.0 - covered)
    # As near as it can be: a small margin is left on both sides of one of the two directions.
    edges = [-across.min(), across.max(), -above.min(), above.max()]
    assert max(edges) <= 1.0 - PAGE.frame_margin + 1e-9
    assert max(min(edges[:2]), min(edges[2:])) == pytest.approx(1.0 - PAGE.frame_margin, abs=0.005)
