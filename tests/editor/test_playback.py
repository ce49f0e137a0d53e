"""Motions pass before the eyes by the clock, and are right between their cycles too."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from played import Clock, bent_spline, by_hand, done, four_modules, half_line, live_of, moved, short

import pinposture as pp
from pinposture.editor.edits import with_keyframe
from pinposture.editor.playback import Playback, sample_at
from pinposture.editor.session import Session
from pinposture.task import Keyframe, Task


@pytest.fixture(scope="session")
def endless() -> pp.Arm:
    joints = (pp.JointSpec("z", type="continuous"), pp.JointSpec("y"))
    return pp.Arm.from_modules([pp.ModuleTemplate("endless", joints, (0.05, 0.05))] * 2)


def begun(task: Task | None = None) -> tuple[Session, Playback, Clock]:
    """A session whose motion is there, as soon as it is asked for."""
    session = Session(task or short())
    clock = Clock()
    session.playback = Playback(clock)
    session.playback.preview.ask(session.task)
    done(session.playback.preview, session.task)
    return session, session.playback, clock


def playing(task: Task | None = None) -> tuple[Session, Playback, Clock]:
    """A session whose motion has just begun to play."""
    session, playback, clock = begun(task)
    playback.play(session.task)
    session.update_playback()
    return session, playback, clock


def test_nothing_is_shown_before_somebody_asks() -> None:
    session, playback, _ = begun()
    session.update_playback()
    assert playback.q is None
    assert not playback.shown
    live = live_of(session)
    assert playback.seen(live) is live


@pytest.mark.parametrize("speed", [0.25, 1.0, 4.0])
def test_it_goes_by_the_clock_however_often_it_is_looked_at(speed: float) -> None:
    session, playback, clock = playing()
    playback.at_speed(speed)
    for wait in (0.001, 0.1, 0.0005):
        clock.now += wait
        session.update_playback()
    assert playback.time == pytest.approx(speed * 0.1015, abs=1e-9)


def test_the_clock_only_counts_from_when_the_motion_is_there() -> None:
    session = Session(short())
    clock = Clock()
    playback = session.playback = Playback(clock)
    playback.play(session.task)
    assert playback.waiting
    clock.now += 17.0
    done(playback.preview, session.task)
    session.update_playback()
    assert playback.shown
    assert playback.time == 0.0
    clock.now += 0.3
    assert playback.time == pytest.approx(0.3)


def test_another_speed_goes_on_from_where_it_is() -> None:
    _, playback, clock = playing()
    clock.now += 0.2
    playback.at_speed(2.0)
    assert playback.time == pytest.approx(0.2)
    clock.now += 0.1
    assert playback.time == pytest.approx(0.4)


def test_a_pause_holds_and_playing_goes_on_from_there() -> None:
    session, playback, clock = playing()
    clock.now += 0.2
    playback.pause()
    clock.now += 50.0
    assert playback.time == pytest.approx(0.2)
    playback.play(session.task)
    clock.now += 0.1
    assert playback.time == pytest.approx(0.3)


def test_at_its_end_it_stays_and_playing_begins_again() -> None:
    session, playback, clock = playing()
    clock.now += 1000.0
    session.update_playback()
    assert not playback.playing
    assert playback.time == playback.lasting == moved().time[-1]
    np.testing.assert_array_equal(playback.q, moved().q[-1])
    playback.play(session.task)
    assert playback.time == 0.0


def test_in_a_loop_it_begins_again_by_itself() -> None:
    session, playback, clock = playing()
    playback.in_loop(True)
    clock.now += 2.0 * playback.lasting + 0.125
    session.update_playback()
    assert playback.playing
    assert playback.time == pytest.approx(0.125)


def test_stopping_goes_back_to_the_arm_of_the_moment() -> None:
    session, playback, clock = playing()
    clock.now += 0.4
    playback.stop()
    assert playback.q is None
    assert not playback.playing
    playback.play(session.task)
    session.update_playback()
    assert playback.time == 0.0


def test_any_moment_can_be_looked_at_and_none_beyond_the_end() -> None:
    session, playback, clock = begun()
    playback.seek(session.task, 0.51)
    session.update_playback()
    clock.now += 3.0
    assert playback.time == pytest.approx(0.51)
    playback.seek(session.task, 1e6)
    assert playback.time == moved().time[-1]
    playback.seek(session.task, -1.0)
    assert playback.time == 0.0


def test_editing_stops_it_and_the_next_motion_is_that_of_the_new_task() -> None:
    session, playback, _ = playing()
    assert session.edit(with_keyframe(1, name="other"), "named")
    session.update_playback()
    assert not playback.shown
    assert not playback.playing
    playback.play(session.task)
    assert playback.waiting
    assert done(playback.preview, session.task).motion is not moved()


def test_a_proposal_stops_it_too() -> None:
    session, playback, _ = playing()
    session.reshape(lambda arm, shape: shape.inserted(arm, 1), "inserted", final=False)
    assert session.proposal is not None
    session.update_playback()
    assert not playback.shown


def test_a_task_that_cannot_be_performed_is_told_again_whenever_it_is_played() -> None:
    task = short(motion=(Keyframe(bent_spline(), trim=True), Keyframe(half_line(), time=1.0)))
    session, playback, _ = begun(task)
    numbers = []
    for _ in range(2):
        playback.play(session.task)
        session.update_playback()
        session.update_playback()
        assert session.notice.kind == "error"
        assert "keyframe 2" in session.notice.text
        assert not playback.playing
        numbers.append(session.notice.number)
    assert numbers[1] == numbers[0] + 1


def test_a_motion_that_does_not_converge_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    run = replace(moved().run, status="stalled", reason="something stood in the way")
    monkeypatch.setattr(Task, "perform", lambda *_: replace(moved(), run=run))
    session, playback, _ = playing()
    assert playback.shown
    assert session.notice.kind == "warning"
    assert "does not arrive at its last posture: something stood in the way" in session.notice.text


def test_keyframes_that_a_motion_does_not_reach_stay_on_the_timeline() -> None:
    pytest.importorskip("viser", reason="viser is not installed")
    from pinposture.editor.ui.player import _schedule

    task = short()
    for until in (0.0, 0.5):
        motion = task.perform(progress=lambda seconds, _, until=until: seconds >= until)
        assert motion.run.status == "stopped"
        duration, drawn = _schedule(task, SimpleNamespace(motion=motion, lasting=float(motion.time[-1])))
        assert [(each.at.keyframe, each.reached) for each in drawn] == [(0, True), (1, False)]
        left = 1.0 - motion.plan_time[-1]  # of the plan, when it ended
        assert drawn[1].at.time == pytest.approx(motion.time[-1] + left)
        assert duration >= drawn[1].at.time
        lost = replace(motion, waypoints=motion.waypoints[:1])
        assert _schedule(task, SimpleNamespace(motion=lost, lasting=float(motion.time[-1])))[1] == drawn
    missed = replace(moved(), waypoints=tuple(each._replace(missed=True) for each in moved().waypoints))
    duration, drawn = _schedule(task, SimpleNamespace(motion=missed, lasting=float(missed.time[-1])))
    assert [each.reached for each in drawn] == [False, False]


def test_a_motion_that_converges_tells_how_long_it_is() -> None:
    session, _, _ = playing()
    assert session.notice.kind == "info"
    assert f"{moved().time[-1]:.4g} s" in session.notice.text


def test_at_a_cycle_it_is_exactly_the_motion() -> None:
    motion = moved()
    for row in range(motion.steps + 1):
        sample = sample_at(motion, motion.time[row])
        np.testing.assert_array_equal(sample.state.q, motion.q[row])
        np.testing.assert_allclose(sample.target.points, motion.targets[row], atol=1e-15)


@given(st.floats(0.0, 1.0))
def test_between_cycles_joints_move_evenly(share: float) -> None:
    motion = moved()
    row = motion.steps // 3
    sample = sample_at(motion, (row + share) * motion.dt)
    wanted = (1.0 - share) * motion.q[row] + share * motion.q[row + 1]  # its joints are hinges: q are angles
    np.testing.assert_allclose(sample.state.q, wanted, atol=1e-10)


def test_continuous_joints_go_the_short_way_past_pi(endless: pp.Arm) -> None:
    q = np.array([endless.configuration([angle, 0.1, angle, 0.0]) for angle in (3.0, 2.0 * np.pi - 3.0)])
    motion = by_hand(endless, q, np.zeros((2, endless.n_modules, 3)))
    half = sample_at(motion, 0.05).state.q
    np.testing.assert_allclose(half, endless.configuration([np.pi, 0.1, np.pi, 0.0]), atol=1e-12)


def test_errors_between_cycles_are_between_those_of_the_cycles(endless: pp.Arm) -> None:
    q = np.array([endless.configuration([angle, 0.3, 0.0, 0.0]) for angle in (0.0, 1.5)])
    off = np.zeros((2, endless.n_modules, 3))
    off[1, :, 2] = 0.004
    motion = by_hand(endless, q, off)
    for share in (0.0, 0.25, 0.5, 1.0):
        state, target, _ = sample_at(motion, 0.1 * share)
        errors = np.linalg.norm(target.points - state.points, axis=1)
        np.testing.assert_allclose(errors, 0.004 * share, atol=1e-15)


def test_the_arm_that_is_seen_is_that_of_the_moment() -> None:
    session, playback, clock = playing()
    live = live_of(session)
    clock.now += 0.5 * playback.lasting
    seen = playback.seen(live)
    np.testing.assert_array_equal(seen.state.q, playback.q)
    assert seen.status == "moving"
    assert seen.verdict is live.verdict
    clock.now += 0.01
    assert playback.seen(live).steps != seen.steps
    clock.now += 1000.0
    assert playback.seen(live).status == "converged"


def test_joints_at_their_speed_limit_are_seen(endless: pp.Arm) -> None:
    angles = (0.0, 0.2, 0.3)  # the limit is 2 rad/s, and a cycle 0.1 s
    q = np.array([endless.configuration([angle, 0.0, 0.0, 0.0]) for angle in angles])
    motion = by_hand(endless, q, np.zeros((3, endless.n_modules, 3)))
    session = Session(short())
    playback = Playback(Clock())
    live = live_of(session)._replace(arm=endless)
    playback.motion = motion
    for at, first in ((0.05, True), (0.15, False)):
        playback._set_time(at)
        np.testing.assert_array_equal(playback.seen(live).at_limit, [first, False, False, False])


def test_a_motion_of_another_arm_is_not_shown_on_this_one(endless: pp.Arm) -> None:
    session, playback, _ = playing()
    live = live_of(session)._replace(arm=endless)
    assert four_modules() is not endless
    assert playback.seen(live) is live
