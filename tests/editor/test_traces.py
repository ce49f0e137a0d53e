"""Plots show what a motion records, the last seconds of the arm, and upright lines where they belong."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from played import LIMITS, Clock, by_hand, four_modules, live_of, moved, short

from pinposture.editor.session import Session
from pinposture.editor.solver import LIVE_ARM
from pinposture.editor.ui.player import TRACE, Recent, trace_of, with_lines


def test_the_trace_of_a_motion_is_what_it_records() -> None:
    motion = moved()
    trace = trace_of(moved())
    np.testing.assert_array_equal(trace.time, motion.time)
    np.testing.assert_array_equal(trace.mean, motion.mean_error)
    for row in range(motion.steps + 1):
        off = np.linalg.norm(motion.targets[row] - motion.run.points[row], axis=1)
        assert trace.largest[row] == pytest.approx(off.max(), abs=1e-12)
    speeds = np.abs(np.diff(motion.q, axis=0)).max(axis=1) / motion.dt / LIMITS.velocity
    assert trace.speed is not None
    np.testing.assert_allclose(trace.speed[1:-1], 0.5 * (speeds[1:] + speeds[:-1]), atol=1e-9)
    rates = np.diff(np.concatenate([motion.q[:1], motion.q, motion.q[-1:]]), axis=0) / motion.dt
    assert trace.acceleration is not None
    hard = np.abs(np.diff(rates, axis=0)).max(axis=1) / motion.dt / 20.0
    np.testing.assert_allclose(trace.acceleration, hard, atol=1e-9)


def test_long_motions_keep_their_peaks() -> None:
    arm = four_modules()
    rows = 3 * TRACE.most_rows + 7
    off = np.zeros((rows, arm.n_modules, 3))
    off[1234, 2, 0] = 0.5
    trace = trace_of(by_hand(arm, np.zeros((rows, arm.nq)), off))
    assert len(trace.time) <= TRACE.most_rows
    assert trace.largest.max() == 0.5
    assert trace.time[0] == 0.0
    assert trace.time[-1] == pytest.approx(0.1 * (rows - 1))
    assert trace.time[int(np.argmax(trace.largest))] == pytest.approx(123.4, abs=0.5)


def test_the_arm_of_the_moment_is_kept_for_some_seconds() -> None:
    arm = four_modules()
    session = Session(short())
    clock = Clock()
    recent = Recent(clock)
    live = live_of(session)
    step = np.zeros(arm.nv)
    step[3] = 0.5 * LIMITS.velocity * LIVE_ARM.step_time  # half of what it may
    for count in range(1, 900):
        q = live.state.q + (step if count > 600 else 0.0)
        live = live._replace(steps=count, state=arm.at(q), errors=np.full(arm.n_modules, 0.001 * count))
        recent.add(live, LIMITS)
        clock.now += 0.02
    trace = recent.trace
    assert trace.time[0] == -TRACE.live_span
    assert trace.time[-1] == 0.0
    assert trace.at(-0.02)[1] == pytest.approx(0.899)
    assert trace.at(-1.0)[2] == pytest.approx(0.5)
    assert trace.at(-8.0)[2] == 0.0
    assert trace.acceleration is None


def test_nothing_changes_while_the_arm_rests() -> None:
    session = Session(short())
    clock = Clock()
    recent = Recent(clock)
    live = live_of(session)
    for count in range(1, 20):
        recent.add(live._replace(steps=count), LIMITS)
        clock.now += 0.2
    assert not recent.changing
    recent.add(live._replace(steps=99, errors=live.errors + 0.1), LIMITS)
    assert recent.changing


@given(st.lists(st.floats(0.0, 5.0), min_size=0, max_size=6, unique=True), st.floats(0.0, 5.0))
def test_lines_stand_at_their_moments_and_nowhere_else(moments: list[float], at: float) -> None:
    times = np.linspace(0.0, 5.0, 51)
    marks = np.array(sorted(moments))
    x, column, lines, shown = with_lines(times, [times**2], (marks, np.array([at])), -1.0, 1.0)
    assert len(x) == len(column) == len(lines) == len(shown)
    assert np.all(np.diff(x) >= 0.0)
    for values, wanted in ((lines, marks), (shown, np.array([at]))):
        flanks = np.flatnonzero(np.diff(values))
        np.testing.assert_array_equal(x[flanks], wanted)
        np.testing.assert_allclose(x[flanks + 1], wanted, atol=1e-12)
        assert set(values) <= {-1.0, 1.0}
    np.testing.assert_allclose(column, np.interp(x, times, times**2), atol=1e-12)
