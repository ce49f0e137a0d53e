"""Ellipsoids in the browser are those of the arm, and move as it moves."""

from __future__ import annotations

import base64
import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import umsgpack
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation
from viz.commands import recorded_commands, server_commands
from viz.ellipsoid_shapes import gram, levels, planar, some_run, spatial

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName
from pinposture.units import length_text
from pinposture.viz import palette
from pinposture.viz.drawing import playback
from pinposture.viz.meshcat import add_ellipsoids
from pinposture.viz.postures import (
    INDEX_LABELS,
    EllipsoidMotion,
    axis_ends,
    continue_axes,
    drawn_length,
    ellipsoid_motion,
    ellipsoid_tracks,
)


@pytest.fixture
def rng():
    return np.random.default_rng(12)


def vertices(command: dict) -> np.ndarray:
    packed = command["object"]["geometries"][0]["data"]["attributes"]["position"]["array"]
    return np.frombuffer(packed.data, "<f4").reshape(-1, 3)


def by_kind(commands: list[dict], kind: str) -> dict[str, dict]:
    return {c["path"]: c for c in commands if c["type"] == kind and "/ellipsoids/" in c["path"]}


@pytest.mark.parametrize("make", [spatial, planar])
def test_the_ball_that_is_drawn_has_the_surface_of_the_ellipsoid(rng, make):
    arm = make()
    q = arm.configuration(rng.uniform(0.6, 1.0, arm.nv))
    chosen = (2, 5) if make is spatial else (2, 4)
    commands = recorded_commands(add_ellipsoids, ellipsoid_motion(arm, chosen, q[None]))
    scale = drawn_length(arm, chosen)
    for point, color in zip(chosen, arm.at(q).ellipsoids(chosen), strict=True):
        path = f"/pinposture/ellipsoids/point_{point + 1:03d}"
        drawing = by_kind(commands, "set_object")[path]
        placing = by_kind(commands, "set_transform")[path]
        matrix = np.reshape(placing["matrix"], (4, 4)).T
        surface = vertices(drawing) @ matrix[:3, :3].T + matrix[:3, 3]
        inside = levels(surface, arm, q, point, scale)
        if make is spatial:
            np.testing.assert_allclose(inside, 1.0, atol=1e-4)
        else:
            assert inside.max() == pytest.approx(1.0, abs=1e-4)
            assert 0.0 < np.abs(surface[:, 2]).max() < 0.02 * arm.length  # a thin plate
        material = drawing["object"]["materials"][0]
        assert f"#{material['color']:06X}" == palette.index_color(color.index)
        assert (material["transparent"], material["depthWrite"]) == (True, False)
        assert 0.2 < material["opacity"] < 0.8


def test_a_flat_ellipsoid_is_a_plate_and_no_degenerate_surface():
    arm = spatial()
    shown = ellipsoid_motion(arm, (0, 5), arm.neutral()[None])
    assert shown.radii.min() > 0.0005 * arm.length
    assert shown.radii[0, 1].min() < 0.05 * shown.radii[0, 1].max()
    np.testing.assert_allclose(np.abs(shown.frames[0, 1, 2]), [1.0, 0.0, 0.0], atol=1e-12)
    assert np.all(np.linalg.det(shown.frames) > 0.0)


def track_of(listed, point: int, name: str):
    path = f"/pinposture/ellipsoids/point_{point + 1:03d}"
    (found,) = [item for item in listed if item.path.removesuffix("/<object>") == path and item.name == name]
    return found


@pytest.mark.parametrize("make", [spatial, planar])
def test_tracks_carry_the_ellipsoid_of_every_configuration(make):
    arm = make()
    run = some_run(arm)
    point = arm.n_modules - 1
    shown = playback(run, 20.0, 240)
    listed = ellipsoid_tracks(ellipsoid_motion(arm, (point,), run.q[shown.rows]), shown)
    place, turn, size, color = (
        track_of(listed, point, name) for name in ("position", "quaternion", "scale", "material.color")
    )
    scale = drawn_length(arm, [point])
    np.testing.assert_allclose(place.values[1:-1], run.points[:, point], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(turn.values, axis=1), 1.0)
    for row in range(0, run.steps + 1, 5):
        axes = Rotation.from_quat(turn.values[row + 1]).as_matrix() * size.values[row + 1]
        # Where it is thinner than it can be drawn, and across the plane of a planar arm, it is thicker.
        wanted = scale**2 * gram(arm, run.q[row], point)
        thin = size.values.min()
        assert np.linalg.norm(axes @ axes.T - wanted, 2) < 1.001 * thin**2
        index = arm.at(run.q[row]).manipulability()[0, point + 1]
        np.testing.assert_allclose(color.values[row + 1], palette.rgb(palette.index_color(index)), atol=0.05)
    for item in listed:
        assert (item.times[0], item.times[-1]) == (0.0, shown.end)
        np.testing.assert_array_equal(item.times[1:-1], shown.times)
        np.testing.assert_array_equal(item.values[[0, -1]], item.values[[1, -2]])


@pytest.mark.parametrize("make", [spatial, planar])
def test_axes_do_not_jump_from_one_frame_to_the_next(make):
    arm = make()
    run = some_run(arm, 400)
    chosen = tuple(range(1, arm.n_modules))
    shown = playback(run, 20.0, 500)
    moving = ellipsoid_motion(arm, chosen, run.q[shown.rows])
    axes = moving.frames * moving.radii[..., None]
    largest = moving.radii.max()
    assert np.linalg.norm(np.diff(axes, axis=0), axis=-1).max() < 0.1 * largest
    np.testing.assert_allclose(np.linalg.det(moving.frames), 1.0)
    for point in chosen:
        turns = track_of(ellipsoid_tracks(moving, shown), point, "quaternion").values
        assert np.einsum("fi,fi->f", turns[1:], turns[:-1]).min() > 0.0


def test_axes_keep_their_names_where_radii_pass_each_other():
    # Two links, l1 = sqrt(2) l2: the ellipse is a circle at 135 degrees, longer the other way beyond.
    arm = pp.Arm.from_modules([pp.template("Rz").with_lengths([x]) for x in (np.sqrt(2.0), 1.0)])
    rows = np.column_stack([np.zeros(200), np.radians(np.linspace(115.0, 155.0, 200))])
    moving = ellipsoid_motion(arm, (1,), rows)
    raw = [arm.at(q).ellipsoids(1)[0] for q in rows]
    turned = [abs(before.directions[0] @ after.directions[0]) for before, after in itertools.pairwise(raw)]
    assert min(turned) < 0.1  # the longer axis is another one from there on
    kept = np.einsum("fij,fij->fi", moving.frames[:-1, 0], moving.frames[1:, 0])
    assert kept.min() > np.cos(np.radians(2.0))
    first, second, _ = moving.radii[:, 0].T
    assert first[0] > second[0]
    assert first[-1] < second[-1]


@given(seed=st.integers(0, 10**6))
@examples(40)
def test_axes_in_whatever_order_and_sign_are_carried_on_as_they_were(seed):
    rng = np.random.default_rng(seed)
    frame = Rotation.random(random_state=seed).as_matrix()
    radii = rng.uniform(0.1, 1.0, 3)
    frames = np.empty((8, 1, 3, 3))
    lengths = np.empty((8, 1, 3))
    for k in range(8):
        order = rng.permutation(3)
        signs = rng.choice([-1.0, 1.0], 3)
        frames[k, 0] = signs[:, None] * frame[order]
        lengths[k, 0] = radii[order]
        frames[k, 0, 0] *= np.linalg.det(frames[k, 0])
    again, along = continue_axes(frames, lengths)
    np.testing.assert_allclose(again, np.broadcast_to(frames[0], again.shape), atol=1e-12)
    np.testing.assert_array_equal(along, np.broadcast_to(lengths[0], along.shape))


def test_quaternions_do_not_jump_while_an_ellipsoid_turns_round_twice():
    run = some_run(spatial())
    shown = playback(run, 20.0, 240)
    count = len(shown.rows)
    for axis in np.vstack([np.eye(3), [0.6, 0.0, 0.8], [-0.48, 0.6, 0.64]]):
        turns = Rotation.from_rotvec(np.linspace(0.0, 4.0 * np.pi, count)[:, None] * axis).as_matrix()
        frames = turns.transpose(0, 2, 1)[:, None]
        moving = EllipsoidMotion(
            (5,), np.zeros((count, 1, 3)), frames, np.ones((count, 1, 3)), np.zeros((count, 1))
        )
        values = track_of(ellipsoid_tracks(moving, shown), 5, "quaternion").values[1:-1]
        assert np.einsum("fi,fi->f", values[1:], values[:-1]).min() > np.cos(2.0 * np.pi / (count - 1)) - 1e-9
        np.testing.assert_allclose(Rotation.from_quat(values).as_matrix(), turns, atol=1e-12)


def test_the_camera_steps_back_so_that_they_are_in_the_picture(tmp_path):
    arm = spatial()
    straight = replace(some_run(arm), q=np.zeros((41, 12)), points=np.tile(arm.chain.points, (41, 1, 1)))
    at_rest = replace(straight, target=pp.Target.from_configuration(arm, np.zeros(12)))
    far = []
    for chosen in ([], [5]):
        path = pp.save_html(arm, at_rest, tmp_path / "run.html", ellipsoids=chosen)
        commands = page_commands(path.read_text(encoding="utf-8"))
        (place,) = [
            c["value"] for c in commands if c["path"].startswith("/Cameras") and c["property"] == "position"
        ]
        far.append(np.linalg.norm(place))
    assert far[1] > 1.02 * far[0]


def test_the_ends_of_the_axes_are_what_the_camera_must_see(rng):
    arm = spatial()
    q = arm.configuration(rng.uniform(-1.0, 1.0, arm.nv))
    ends = axis_ends(ellipsoid_motion(arm, (5,), q[None]))
    np.testing.assert_allclose(levels(ends, arm, q, 5, drawn_length(arm, [5])), 1.0, atol=1e-4)
    np.testing.assert_allclose(ends.mean(axis=0), arm.at(q).points[5], atol=1e-12)
    assert axis_ends(ellipsoid_motion(arm, (), q[None])).shape == (0, 3)


def page_commands(text: str) -> list[dict]:
    packed = json.loads(re.search(r"^const commands = (.*);$", text, re.MULTILINE)[1])
    return [umsgpack.unpackb(base64.b64decode(one)) for one in packed]


def test_the_page_holds_the_ellipsoids_their_tracks_and_a_legend(tmp_path):
    arm = spatial()
    run = some_run(arm)
    path = pp.save_html(arm, run, tmp_path / "run.html", ellipsoids=["module_03", -1])
    text = path.read_text(encoding="utf-8")
    commands = page_commands(text)
    paths = {f"/pinposture/ellipsoids/point_00{k}" for k in (3, 6)}
    assert set(by_kind(commands, "set_object")) == paths
    (animation,) = [c for c in commands if c["type"] == "set_animation"]
    clips = {item["path"]: item["clip"]["tracks"] for item in animation["animations"]}
    for path in paths:
        assert [track["name"] for track in clips[path]] == [".position", ".quaternion", ".scale"]
        assert [track["name"] for track in clips[f"{path}/<object>"]] == [".material.color"]
    assert f"1 m/rad drawn as {length_text(drawn_length(arm, [2, 5]))}" in text
    assert all(f"index {meaning}" in text and color in text for color, meaning in INDEX_LABELS.items())


def test_without_ellipsoids_the_page_is_what_it_was(tmp_path):
    arm = spatial()
    run = some_run(arm)
    plain = pp.save_html(arm, run, tmp_path / "a.html")
    none = pp.save_html(arm, run, tmp_path / "b.html", ellipsoids=[])
    assert plain.read_bytes() == none.read_bytes()
    assert "m/rad drawn as" not in plain.read_text(encoding="utf-8")
    assert by_kind(page_commands(plain.read_text(encoding="utf-8")), "set_object") == {}


def test_the_live_viewer_shows_them_wherever_the_arm_goes_and_keeps_nothing_of_before(rng, running):
    arm = spatial()
    with pp.view(arm, url=running.zmq_url, ellipsoids=[5]) as viewer:
        at_first = len(server_commands(running.zmq_url))
        scale = drawn_length(arm, [5])
        for _ in range(3):
            q = arm.configuration(rng.uniform(-1.0, 1.0, arm.nv))
            viewer.show(q)
            commands = server_commands(running.zmq_url)
            (drawing,) = by_kind(commands, "set_object").values()
            (placing,) = by_kind(commands, "set_transform").values()
            matrix = np.reshape(placing["matrix"], (4, 4)).T
            surface = vertices(drawing) @ matrix[:3, :3].T + matrix[:3, 3]
            np.testing.assert_allclose(levels(surface, arm, q, 5, scale), 1.0, atol=1e-4)
            index = arm.at(q).manipulability()[0, 6]
            assert f"#{drawing['object']['materials'][0]['color']:06X}" == palette.index_color(index)
            assert len(commands) == at_first


def test_the_live_viewer_plays_them_and_stops_when_told_to_show(running):
    arm = spatial()
    run = some_run(arm)
    with pp.view(arm, run, url=running.zmq_url, ellipsoids=[0, 5]) as viewer:
        assert viewer.ellipsoids == (0, 5)
        (animation,) = [c for c in server_commands(running.zmq_url) if c["type"] == "set_animation"]
        moved = {item["path"] for item in animation["animations"]}
        assert {f"/pinposture/ellipsoids/point_00{k}" for k in (1, 6)} <= moved
        viewer.show(run.q[-1])
        (animation,) = [c for c in server_commands(running.zmq_url) if c["type"] == "set_animation"]
        assert animation["animations"] == []


@pytest.mark.parametrize(
    ("points", "kind"), [([6], InvalidValue), ("tip", UnknownName), ([1, 1], InvalidValue)]
)
def test_points_that_there_are_not_are_refused_everywhere(points, kind, tmp_path, running):
    arm = spatial()
    with pytest.raises(kind):
        pp.plot_arm(arm, ellipsoids=points)
    with pytest.raises(kind):
        pp.save_html(arm, some_run(arm), tmp_path / "run.html", ellipsoids=points)
    with pytest.raises(kind):
        pp.view(arm, url=running.zmq_url, ellipsoids=points)
    assert list(tmp_path.iterdir()) == []
