"""What is shown of a motion in time, and when: in real time, with the current targets."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation
from viz.commands import recorded_commands
from viz.motions import five_modules, some_motion

import pinposture as pp
from pinposture.motion.trajectory import Trajectory, WaypointResult
from pinposture.viz.body import body_poses
from pinposture.viz.drawing import PLAYBACK, arm_tracks, hoop_turns, moving_target_tracks, playback
from pinposture.viz.meshcat import add_moving_targets
from pinposture.viz.palette import WAYPOINT_MARKS, group_alike, shown_waypoints

pytestmark = pytest.mark.filterwarnings("ignore:dt is .* long for a control cycle")


@cache
def known_motion(steps: int = 60, dt: float = 0.05) -> Trajectory:
    return some_motion(steps, limits=pp.Limits(step=None, dt=dt))


def track_of(listed, path, name):
    (found,) = [each for each in listed if (each.path, each.name) == (path, name)]
    return found


@given(
    steps=st.sampled_from([0, 1, 2, 7, 60, 400]),
    dt=st.sampled_from([0.001, 0.02, 0.1, 0.5]),
    fps=st.floats(1.0, 60.0),
    most=st.integers(2, 300),
)
@examples(40)
def test_each_configuration_is_seen_when_it_was(steps, dt, fps, most):
    motion = known_motion(steps, dt)
    shown = playback(motion, fps, most)
    assert (shown.rows[0], shown.rows[-1]) == (0, steps)
    assert len(shown.rows) <= most
    seconds = shown.times / shown.fps - PLAYBACK.rest_before
    np.testing.assert_allclose(seconds * shown.speedup, dt * shown.rows, atol=1e-9)
    assert np.all(np.diff(shown.rows) >= 1)
    # As smooth as asked for, where that many configurations are there and allowed.
    if steps and len(shown.rows) < most:
        assert np.diff(seconds).max() <= max(1.0 / fps, dt) + dt / shown.speedup + 1e-9
    assert shown.end > shown.times[-1]


@pytest.mark.parametrize(
    ("seconds", "speedup"),
    [
        (1.0, 1),
        (60.0, 1),
        (61.0, 2),
        (120.0, 2),
        (130.0, 5),
        (300.0, 5),
        (301.0, 10),
        (1000.0, 20),
        (2e4, 500),
    ],
)
def test_only_what_takes_longer_than_a_minute_is_shown_faster(seconds, speedup):
    motion = known_motion(60, seconds / 60)
    shown = playback(motion, 20.0, 1200)
    assert shown.speedup == speedup
    assert (shown.times[-1] - shown.times[0]) / shown.fps == pytest.approx(seconds / speedup)


def test_bodies_are_where_they_were_in_the_rows_that_are_shown():
    arm = five_modules()
    motion = known_motion()
    shown = playback(motion, 7.0, 1200)
    assert 2 < len(shown.rows) < 60
    poses = body_poses(arm, motion.q[shown.rows])
    for u in range(arm.nv):
        position = track_of(arm_tracks(arm, shown), f"/pinposture/arm/body_{u + 1:03d}", "position")
        np.testing.assert_allclose(position.values[1:-1], poses[:, u, :3, 3], atol=1e-12)


def test_hoops_are_where_the_targets_of_the_moment_are_and_play_along_with_the_arm():
    arm = five_modules()
    motion = known_motion()
    shown = playback(motion, 20.0, 1200)
    listed = moving_target_tracks(motion, shown)
    for k in range(arm.n_modules):
        position = track_of(listed, f"/pinposture/target/hoop_{k + 1:03d}", "position")
        np.testing.assert_array_equal(position.values[1:-1], motion.targets[shown.rows, k])
    ends = {(each.times[0], each.times[-1]) for each in [*listed, *arm_tracks(arm, shown)]}
    assert ends == {(0.0, shown.end)}
    assert {each.name for each in listed} == {"position", "quaternion"}


def test_everything_that_moves_was_drawn_where_it_starts():
    motion = known_motion()
    commands = recorded_commands(add_moving_targets, motion, [])
    drawn = {command["path"] for command in commands if command["type"] == "set_object"}
    assert {each.path for each in moving_target_tracks(motion, playback(motion, 20.0, 1200))} == drawn
    placed = {c["path"]: np.reshape(c["matrix"], (4, 4)).T for c in commands if c["type"] == "set_transform"}
    for k in range(5):
        matrix = placed[f"/pinposture/target/hoop_{k + 1:03d}"]
        np.testing.assert_allclose(matrix[:3, 3], motion.targets[0, k])
        np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)


def test_hoops_of_points_without_a_target_are_not_seen():
    motion = known_motion()
    asked = np.ones_like(motion.target_mask)
    asked[:, 0] = False
    asked[20:40, 2] = False
    motion = replace(motion, target_mask=asked)
    shown = playback(motion, 20.0, 1200)
    listed = moving_target_tracks(motion, shown)
    assert not any("hoop_001" in each.path for each in listed)
    size = track_of(listed, "/pinposture/target/hoop_003", "scale")
    assert not size.smooth
    np.testing.assert_array_equal(size.values[1:-1, 0] == 1.0, asked[shown.rows, 2])
    assert np.all(size.values[1:-1][~asked[shown.rows, 2]] < 0.01)


@given(seed=st.integers(0, 10_000))
@examples(20)
def test_a_hoop_stands_across_the_line_through_the_targets(seed):
    arm = five_modules()
    rng = np.random.default_rng(seed)
    targets = np.cumsum(rng.normal(size=(4, arm.n_modules, 3)), axis=0)
    turns = hoop_turns(arm, targets, np.ones(targets.shape[:2], dtype=bool))
    for row, points in enumerate(targets):
        line = np.vstack([arm.chain.base, points])
        for k in range(arm.n_modules):
            legs = [line[k + 1] - line[k]]
            if k + 2 < len(line):
                legs.append(line[k + 2] - line[k + 1])
            across = sum(leg / np.linalg.norm(leg) for leg in legs)
            normal = Rotation.from_quat(turns[row, k]).as_matrix()[:, 2]
            np.testing.assert_allclose(normal, across / np.linalg.norm(across), atol=1e-9)
    # Neighbours in time are on the same side: what lies between them goes the shorter way.
    assert np.all(np.sum(turns[1:] * turns[:-1], axis=2) >= 0.0)


def test_hoops_turn_no_more_than_the_line_does():
    arm = five_modules()
    angles = np.linspace(0.0, np.pi / 2, 30)
    ways = np.stack([np.cos(angles), np.sin(angles), np.zeros(30)], axis=1)
    targets = arm.chain.base + ways[:, None] * np.arange(1, 6)[None, :, None]
    turns = Rotation.from_quat(hoop_turns(arm, targets, np.ones((30, 5), dtype=bool))[:, 3])
    steps = (turns[1:] * turns[:-1].inv()).magnitude()
    np.testing.assert_allclose(steps, np.diff(angles), atol=1e-9)


@pytest.mark.parametrize("case", ["reversed", "at one place", "nowhere"])
def test_lines_without_a_direction_still_have_hoops_that_can_be_drawn(case):
    arm = five_modules()
    targets = np.tile(arm.chain.base + np.arange(1.0, 6.0)[:, None] * [1.0, 0.0, 0.0], (3, 1, 1))
    asked = np.ones((3, 5), dtype=bool)
    if case == "reversed":
        targets[1:, :, 0] *= -1.0
    elif case == "at one place":
        targets[:] = arm.chain.base
    else:
        asked[1] = False
    turns = hoop_turns(arm, targets, asked)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=2), 1.0, atol=1e-12)
    if case == "reversed":
        normals = Rotation.from_quat(turns.reshape(-1, 4)).as_matrix()[:, :, 2].reshape(3, 5, 3)
        np.testing.assert_allclose(normals[:, 4, 0], [1.0, -1.0, -1.0], atol=1e-9)


def test_of_many_places_the_first_the_last_and_some_between_are_shown():
    motion = some_motion(names=tuple(f"place {k}" for k in range(31)))
    places = shown_waypoints(motion)
    assert len(places) == WAYPOINT_MARKS.most
    assert (places[0].name, places[-1].name) == ("place 0", "place 30")
    assert len({place.color for place in places}) == WAYPOINT_MARKS.most


def test_places_that_were_not_reached_are_left_out_and_long_names_keep_both_ends():
    motion = some_motion(names=("the beginning of it all, and the end", "b"))
    motion = replace(motion, waypoints=(*motion.waypoints, WaypointResult("never", 9.0, None, None, None)))
    first, last = shown_waypoints(motion)
    assert first.name.startswith("the begin")
    assert first.name.endswith("the end")
    assert len(first.name) <= 22
    assert last.name == "b"


def test_places_where_the_arm_looked_the_same_go_together():
    motion = some_motion(names=("a", "b", "c"))
    points = motion.run.points.copy()
    points[-1] = points[0]
    motion = replace(motion, run=replace(motion.run, points=points))
    groups = group_alike(motion, shown_waypoints(motion))
    assert [[place.name for place in group] for group in groups] == [["a", "c"], ["b"]]
