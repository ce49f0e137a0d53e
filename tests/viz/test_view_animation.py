"""What an animation shows of a run, and when."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from viz.commands import recorded_commands

from pinposture import Arm, Run, Target, track
from pinposture.errors import InvalidValue
from pinposture.viz import palette
from pinposture.viz.body import body_poses
from pinposture.viz.drawing import arm_tracks, playback
from pinposture.viz.meshcat import play_animation
from pinposture.viz.palette import THEME


def four_modules() -> Arm:
    return template_arm("RyRz", 4)


@cache
def some_run(steps: int = 25) -> Run:
    """A run whose active sets are known, so that colours can be told from them."""
    arm = four_modules()
    rng = np.random.default_rng(0)
    start = arm.configuration(rng.uniform(-0.5, 0.5, arm.nv))
    goal = arm.configuration(rng.uniform(-0.5, 0.5, arm.nv))
    run = track(arm, Target.from_configuration(arm, goal), start, "projection", max_steps=2)
    rows = np.linspace(0.0, 1.0, steps + 1)[:, None]
    q = (1.0 - rows) * start + rows * goal
    active = rng.random((steps, 4)) < 0.5
    points = np.array([arm.at(row).points for row in q])
    return replace(run, q=q, points=points, active=active)


def values_at(listed, path, name):
    (found,) = [item for item in listed if (item.path, item.name) == (path, name)]
    return found


def value_while(item, times):
    """What a track that holds its values shows at some times."""
    return item.values[np.searchsorted(item.times, times, side="right") - 1]


@given(steps=st.integers(0, 60), most=st.integers(2, 40), fps=st.floats(0.5, 60.0))
def test_playback_goes_from_the_first_to_the_last_configuration_in_even_strides(steps, most, fps):
    shown = playback(some_run(steps), fps, most)
    assert len(shown.rows) <= most
    assert shown.rows[0] == 0
    assert shown.rows[-1] == steps
    strides = np.diff(shown.rows)
    assert np.all(strides >= 1)
    assert np.ptp(strides) <= 1 if len(strides) else steps == 0
    if steps < most:
        assert np.all(strides == 1)
    assert 0.0 < shown.fps <= fps
    assert shown.end > shown.times[-1] >= shown.times[0] > 0.0


@pytest.mark.parametrize(("steps", "fps", "seconds"), [(4, 20.0, 2.0), (100, 20.0, 5.0), (100, 10.0, 10.0)])
def test_a_motion_lasts_as_long_as_its_steps_but_at_least_two_seconds(steps, fps, seconds):
    shown = playback(some_run(steps), fps, 240)
    assert (shown.times[-1] - shown.times[0]) / shown.fps == pytest.approx(seconds)


def test_bodies_are_where_they_were_in_the_run():
    arm = four_modules()
    run = some_run()
    shown = playback(run, 20.0, 240)
    listed = arm_tracks(arm, shown)
    poses = body_poses(arm, run.q)
    for u in range(arm.nv):
        path = f"/pinposture/arm/body_{u + 1:03d}"
        position = values_at(listed, path, "position")
        turn = values_at(listed, path, "quaternion")
        np.testing.assert_array_equal(position.times[1:-1], shown.times)
        np.testing.assert_allclose(position.values[1:-1], poses[:, u, :3, 3], atol=1e-15)
        matrices = Rotation.from_quat(turn.values[1:-1]).as_matrix()
        np.testing.assert_allclose(matrices, poses[:, u, :3, :3], atol=1e-12)
        # Still at both ends.
        np.testing.assert_array_equal(position.values[[0, -1]], position.values[[1, -2]])
        assert (position.times[0], position.times[-1]) == (0.0, shown.end)


def test_control_points_are_coloured_and_large_while_they_are_active():
    run = some_run()
    shown = playback(run, 20.0, 240)
    listed = arm_tracks(four_modules(), shown)
    active = np.vstack([run.active, run.active[-1:]])
    for k in range(4):
        path = f"/pinposture/arm/body_{2 * k + 2:03d}/point"
        color = values_at(listed, f"{path}/<object>", "material.color")
        size = values_at(listed, path, "scale")
        assert not color.smooth
        assert not size.smooth
        seen = value_while(color, shown.times)
        np.testing.assert_array_equal(np.all(seen == palette.rgb(THEME.active), axis=1), active[:, k])
        np.testing.assert_array_equal(np.all(seen == palette.rgb(THEME.idle), axis=1), ~active[:, k])
        np.testing.assert_array_equal(value_while(size, shown.times)[:, 0] == 1.0, active[:, k])


def test_all_tracks_begin_and_end_together_so_that_they_stay_in_step_when_repeated():
    shown = playback(some_run(), 20.0, 240)
    listed = arm_tracks(four_modules(), shown)
    assert {(item.times[0], item.times[-1]) for item in listed} == {(0.0, shown.end)}
    assert all(np.all(np.diff(item.times) > 0.0) for item in listed)


def test_playback_with_skipped_steps_shows_the_active_set_of_the_configuration_shown():
    run = some_run(50)
    shown = playback(run, 20.0, 12)
    listed = arm_tracks(four_modules(), shown)
    color = values_at(listed, "/pinposture/arm/body_004/point/<object>", "material.color")
    on = np.all(value_while(color, shown.times) == palette.rgb(THEME.active), axis=1)
    np.testing.assert_array_equal(on, run.active[np.minimum(shown.rows, 49), 1])


def test_packed_tracks_hold_their_numbers_as_flat_single_precision_floats():
    shown = playback(some_run(), 20.0, 240)
    listed = arm_tracks(four_modules(), shown)
    (command,) = recorded_commands(play_animation, listed, shown.fps)
    assert command["options"] == {"play": True, "repetitions": np.inf}
    clips = {item["path"]: item["clip"] for item in command["animations"]}
    assert len(clips) == len({item.path for item in listed})
    for item in listed:
        (lowered,) = [x for x in clips[item.path]["tracks"] if x["name"] == f".{item.name}"]
        assert lowered["times"].type == lowered["values"].type == 0x17
        np.testing.assert_allclose(np.frombuffer(lowered["times"].data, "<f4"), item.times, rtol=1e-6)
        np.testing.assert_allclose(
            np.frombuffer(lowered["values"].data, "<f4"), item.values.ravel(), atol=1e-6
        )
        assert clips[item.path]["fps"] == shown.fps


@pytest.mark.parametrize("fps", [0.0, -1.0, np.nan, np.inf])
def test_impossible_speeds_are_refused(fps):
    with pytest.raises(InvalidValue, match="fps"):
        playback(some_run(), fps, 240)


@pytest.mark.parametrize("most", [1, 0, True, 2.5])
def test_impossible_numbers_of_frames_are_refused(most):
    with pytest.raises(InvalidValue, match="max_frames"):
        playback(some_run(), 20.0, most)
