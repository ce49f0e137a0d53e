"""The viewer for Foxglove: what a client of its WebSocket receives, decoded by protobuf."""

from __future__ import annotations

import base64
import json
import logging
import runpy
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arm.driven_arms import DRIVES, Robot, driven_arm

import pinposture as pp
from pinposture.errors import InvalidValue, PostureWarning, ViewerError
from pinposture.viz import FoxgloveViewer, drawing
from pinposture.viz.body import body_poses
from pinposture.viz.foxglove import ADDRESS, BACKLOG

pytest.importorskip("foxglove")
client = pytest.importorskip("websockets.sync.client")
descriptors = pytest.importorskip("google.protobuf.descriptor_pb2")
pool = pytest.importorskip("google.protobuf.descriptor_pool")
factory = pytest.importorskip("google.protobuf.message_factory")

FREE = "ws://127.0.0.1:0"
TOPICS = {"/tf", "/scene", "/joint_states", "/joint_commands", "/status"}


class Client:
    """Subscribes to everything that a viewer offers, as Foxglove does."""

    def __init__(self, viewer: FoxgloveViewer) -> None:
        address = f"ws://127.0.0.1:{viewer._server.port}"
        self._socket = client.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None)
        self._channels: dict[int, tuple[str, Callable[[bytes], Any]]] = {}
        while {topic for topic, _ in self._channels.values()} != TOPICS:
            for each in json.loads(self._socket.recv(timeout=60)).get("channels", ()):
                self._channels[int(each["id"])] = each["topic"], decoder(each)
        wanted = [{"id": number, "channelId": number} for number in self._channels]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def snapshot(self, wanted: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        """Return the next messages of a time that are wanted, by topic; /status is the last of them."""
        found: dict[str, Any] = {}
        while True:
            data = self._socket.recv(timeout=60)
            if isinstance(data, bytes) and data[0] == 1:
                number, found["time"] = struct.unpack("<IQ", data[1:13])
                topic, decode = self._channels[number]
                found[topic] = decode(data[13:])
                if topic == "/status":
                    if wanted(found):
                        return found
                    found = {}


def decoder(channel: dict[str, Any]) -> Callable[[bytes], Any]:
    if channel["encoding"] == "json":
        return json.loads
    files = descriptors.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    known = pool.DescriptorPool()
    for file in files.file:
        known.Add(file)
    return factory.GetMessageClass(known.FindMessageTypeByName(channel["schemaName"])).FromString


def matrix(transform: Any) -> np.ndarray:
    """Return the homogeneous matrix of a transform."""
    turn = transform.rotation
    at = transform.translation
    placed = pin.SE3(pin.Quaternion(turn.w, turn.x, turn.y, turn.z), np.array([at.x, at.y, at.z]))
    return placed.homogeneous


def positions(message: Any) -> dict[str, float]:
    return {each.name: each.position for each in message.joints}


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    # Links that are turned against each other and against the world, on a base that is, too.
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, 0.5, 0.6]))
    return pp.Arm.from_template("RyRz", modules=3, base_placement=placement)


@pytest.fixture
def watch() -> Iterator[Callable[..., tuple[FoxgloveViewer, Client]]]:
    opened = []

    def watch(arm: pp.Arm, run: Any = None, **options: Any) -> tuple[FoxgloveViewer, Client]:
        viewer = pp.view(arm, run, viewer="foxglove", url=FREE, **options)
        opened.append(viewer)
        return viewer, Client(viewer)

    yield watch
    for viewer in opened:
        viewer.close()


def shows(q: np.ndarray) -> Callable[[dict[str, Any]], bool]:
    """A state that is sent while topics are subscribed one by one lacks some, and is sent again."""

    def all_of_it(found: dict[str, Any]) -> bool:
        shown = {"/tf", "/joint_states"} <= set(found)
        return shown and list(positions(found["/joint_states"]).values()) == [*q]

    return all_of_it


def test_links_are_where_pinocchio_places_them(arm: pp.Arm, watch: Any) -> None:
    viewer, client = watch(arm)
    q = arm.random(np.random.default_rng(0))
    data = arm.model.createData()
    viewer.show(q)
    found = client.snapshot(shows(q))
    assert list(positions(found["/joint_states"])) == list(arm.joint_names)
    pin.framesForwardKinematics(arm.model, data, q)
    frames = {each.child_frame_id: each for each in found["/tf"].transforms}
    assert list(frames) == [f"m0{k}_l{j}" for k in (1, 2, 3) for j in (1, 2)]
    for name, each in frames.items():
        assert each.parent_frame_id == "world"
        assert each.timestamp.ToNanoseconds() == found["time"]
        expected = data.oMf[arm.model.getFrameId(name)].homogeneous
        np.testing.assert_allclose(matrix(each), expected, atol=1e-12)
    assert abs(found["time"] - time.time_ns()) < 60e9


def test_joints_are_those_that_drives_move(watch: Any) -> None:
    with pytest.warns(PostureWarning, match="locked"):
        driven = driven_arm()
    robot = Robot(dict(zip(DRIVES, (0.2, -0.05, 0.7, 0.1, -0.3), strict=True)))
    viewer, client = watch(driven)
    viewer.show(driven.configuration(driven.drives.joint_positions(robot.states())))

    def arrived(found: dict[str, Any]) -> bool:
        shown = "/joint_states" in found
        return shown and positions(found["/joint_states"]) == pytest.approx(robot.driven)

    assert list(positions(client.snapshot(arrived)["/joint_states"])) == list(DRIVES)


def test_links_may_have_the_names_of_the_world_and_of_drawings(arm: pp.Arm, watch: Any) -> None:
    text = arm.urdf
    for name, new in {"base": "obstacles", "m01_l1": "world", "m01_l2": "target", "m02_l1": "base"}.items():
        text = text.replace(f'"{name}"', f'"{new}"')
    other = pp.Arm.load(text, base_placement=arm.base_placement)
    viewer, first = watch(other, target=pp.Target.from_configuration(other, other.random(1)))
    q = other.random(2)
    viewer.show(q)
    first.snapshot(shows(q))
    found = Client(viewer).snapshot(lambda found: TOPICS - {"/joint_commands"} <= set(found))
    frames = {each.child_frame_id: each for each in found["/tf"].transforms}
    assert {each.parent_frame_id for each in frames.values()} == {"map"}
    assert {"world", "target", "base"} <= set(frames)
    ids = [each.id for each in found["/scene"].entities]
    assert len(ids) == len(set(ids)) == len(frames) + 3


def test_who_comes_late_sees_the_arm_as_meshcat_draws_it(arm: pp.Arm, watch: Any) -> None:
    target = pp.Target.from_configuration(arm, arm.random(1))
    scene = pp.Scene({"ball": pp.Sphere(center=(0.0, 0.0, 0.0), radius=0.1)})
    viewer, first = watch(arm, target=target, scene=scene)
    q = arm.random(2)
    viewer.show(q)
    first.snapshot(shows(q))
    found = Client(viewer).snapshot(lambda found: TOPICS - {"/joint_commands"} <= set(found))
    frames = {each.child_frame_id: matrix(each) for each in found["/tf"].transforms}
    base, *links, drawn, solid = found["/scene"].entities
    assert base.frame_id == "world"
    for entity, pose, mesh in zip(links, body_poses(arm, q), drawing.arm_surfaces(arm).bodies, strict=True):
        [surface] = entity.triangles
        points = np.array([[at.x, at.y, at.z] for at in surface.points])
        turn = frames[entity.frame_id][:3, :3]
        shift = frames[entity.frame_id][:3, 3]
        expected = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(points @ turn.T + shift, expected, atol=1e-12)
        assert list(surface.indices) == mesh.faces.ravel().tolist()
    line = np.array([[at.x, at.y, at.z] for each in drawn.lines for at in each.points])
    assert all(np.linalg.norm(line - point, axis=1).min() < 1e-9 for point in target.points)
    corners = np.array([[at.x, at.y, at.z] for at in solid.triangles[0].points])
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 0.1, atol=1e-9)


def test_a_control_loop_is_seen_with_its_status_clearance_and_command(arm: pp.Arm, watch: Any) -> None:
    scene = pp.Scene({"ball": pp.Sphere(center=(2.0, 0.0, 0.0), radius=0.1)})
    limits = pp.Limits(step=None, dt=0.01, velocity=2.0, acceleration=10.0)
    tracker = pp.Tracker(arm, limits=limits, scene=scene)
    viewer, client = watch(arm, tracker)
    viewer.show(None)  # nothing is known yet
    found = client.snapshot()
    assert found["/status"] == {"status": "holding", "reason": "no step yet", "time": 0.0}
    assert "/tf" not in found
    assert "/joint_commands" not in found
    q = arm.straight()
    target = pp.Target.from_configuration(arm, 0.1 * np.ones(arm.nv))
    tracker.update(target)
    for _ in range(3):
        q = arm.integrate(q, tracker.step(q))
        viewer.show(q)
    found = client.snapshot(shows(q))
    report = tracker.report
    near = pp.CollisionModel(arm, scene).minimum(q)
    assert found["/status"] == {
        "status": "moving",
        "reason": "",
        "mean_error": report.mean_error,
        "tracking_error": report.tracking_error,
        "target_age": report.target_age,
        "clearance": near.distance,
        "nearest": " to ".join(near.pair),
        "time": report.time,
    }
    assert list(positions(found["/joint_commands"]).values()) == [*tracker.command]
    broken = np.full(arm.nq, np.nan)
    tracker.step(broken)
    viewer.show(broken)
    found = client.snapshot(lambda found: found["/status"]["status"] == "holding")
    assert "is not finite" in found["/status"]["reason"]
    assert "/tf" not in found


def test_a_new_target_is_drawn_once(arm: pp.Arm, watch: Any) -> None:
    tracker = pp.Tracker(arm, limits=pp.Limits(step=None, dt=0.01, velocity=2.0, acceleration=10.0))
    viewer, client = watch(arm, tracker)
    drawn = [True]
    while any(drawn[-5:]):  # until the last subscription has been noticed
        viewer.show(arm.neutral())
        drawn.append("/scene" in client.snapshot())
    drawn.clear()
    for k in (1, 2):
        tracker.update(pp.Target.from_configuration(arm, 0.1 * k * np.ones(arm.nv)))
        for j in range(3):
            q = (k + 0.1 * j) * np.ones(arm.nv)
            viewer.show(q)
            drawn.append("/scene" in client.snapshot(shows(q)))
    assert drawn == 2 * [True, False, False]


def test_the_loop_never_waits_and_never_fails(
    arm: pp.Arm, watch: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    viewer, client = watch(arm)
    published = []

    def slow(_: FoxgloveViewer, stamp: int, q: np.ndarray, *known: Any) -> None:
        time.sleep(0.01)
        published.append(q)
        raise RuntimeError("out of order")

    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
        patch.setattr(FoxgloveViewer, "_publish", slow)
        rows = np.linspace(0.0, 1.0, 500)[:, None] * np.ones(arm.nv)
        begun = time.perf_counter()
        for q in rows:
            viewer.show(q)
        took = time.perf_counter() - begun
        assert took < 2.0  # it would take 5 s to send them all
        while not (published and np.array_equal(published[-1], rows[-1])):
            time.sleep(0.01)
    assert len(published) <= BACKLOG + 2 + took / 0.01
    assert [each.message for each in caplog.records] == ["foxglove: out of order"]
    for wrong in (None, "nonsense", [1.0, [2.0]], np.zeros(arm.nq + 1), object()):
        viewer.show(wrong)
    viewer.show(rows[3])
    client.snapshot(shows(rows[3]))
    viewer.close()
    viewer.close()
    viewer.show(rows[4])


def test_what_is_shown_is_what_was_given_then(arm: pp.Arm, watch: Any) -> None:
    viewer, client = watch(arm)
    q = arm.random(0)
    viewer.show(q)
    given = q.copy()
    q += 1.0  # a loop may reuse its array
    client.snapshot(shows(given))


def test_runs_and_motions_are_played_until_a_configuration_is_shown(
    watch: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = drawing.PLAYBACK._replace(rest_before=0.1, rest_after=0.1, shortest=0.1)
    monkeypatch.setattr(drawing, "PLAYBACK", short)
    arm = pp.Arm.from_template("Rz", modules=3)
    run = pp.track(arm, pp.Target.from_configuration(arm, [0.4, -0.3, 0.2]), arm.straight())
    viewer, client = watch(arm, run, fps=100.0)
    for _ in range(2):  # over and over
        client.snapshot(shows(run.q[0]))
        found = client.snapshot(shows(run.q[-1]))
    assert found["/status"]["mean_error"] == pytest.approx(run.point_errors[-1].mean())
    assert found["/status"]["status"] == "converged"
    viewer.show(np.ones(arm.nq))
    client.snapshot(shows(np.ones(arm.nq)))
    viewer.play()
    client.snapshot(shows(run.q[0]))
    bow = pp.Curve.helix(radius=0.3, pitch=0.0, turns=0.5)
    keyframes = [pp.Keyframe(bow, trim=True), pp.Keyframe(joints=[0.1, 0.2, 0.3], duration=1.0)]
    motion = pp.move_through(arm, keyframes, limits=pp.Limits(step=None, dt=0.02, velocity=2.0))
    _, client = watch(arm, motion)
    for row in (0, -1):
        shown = shows(motion.run.q[row])
        found = client.snapshot(lambda found, shown=shown: "/scene" in found and shown(found))
        [drawn] = (each for each in found["/scene"].entities if each.id == "target")
        balls = np.array([[at.x, at.y, at.z] for at in drawn.triangles[0].points])
        near = [np.linalg.norm(balls - point, axis=1).min() for point in motion.targets[row]]
        np.testing.assert_allclose(near, 0.84 * drawing.link_radius(arm), rtol=1e-6)


def test_meshcat_takes_the_target_and_the_scene_of_a_tracker(arm: pp.Arm, running: Any) -> None:
    scene = pp.Scene({"ball": pp.Sphere(center=(2.0, 0.0, 0.0), radius=0.1)})
    tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.01, velocity=2.0), scene=scene)
    tracker.update(pp.Target.from_configuration(arm, arm.straight()))
    with pp.view(arm, tracker, url=running.zmq_url) as viewer:
        assert (viewer.run, viewer.target, viewer.scene) == (None, tracker.target, scene)
        viewer.show(tracker.arm.straight())


def test_what_does_not_fit_is_refused(arm: pp.Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    for address in ("nonsense", "tcp://127.0.0.1:0", "ws://127.0.0.1:99999", "ws://192.0.2.1:0"):
        with pytest.raises(ViewerError, match=f"{address}.*an address is, for instance, {ADDRESS}"):
            pp.view(arm, viewer="foxglove", url=address)
    with pp.view(arm, viewer="foxglove", url=FREE) as viewer:
        taken = f"ws://127.0.0.1:{viewer._server.port}"
        with pytest.raises(ViewerError, match="in use"):
            pp.view(arm, viewer="foxglove", url=taken)
        with pytest.raises(InvalidValue, match="run is not given"):
            viewer.play()
    for _ in range(100):  # it is free again, as soon as the server has stopped
        with suppress(ViewerError):
            pp.view(arm, viewer="foxglove", url=taken).close()
            break
        time.sleep(0.05)
    else:
        pytest.fail("the port stays in use")
    with pytest.raises(InvalidValue, match="none in Foxglove"):
        pp.view(arm, viewer="foxglove", url=FREE, ellipsoids=[0])
    with pytest.raises(InvalidValue, match="target"):
        other = pp.Arm.from_template("Rz", modules=2)
        pp.view(arm, viewer="foxglove", url=FREE, target=pp.Target.from_configuration(other, [0.1, 0.1]))
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(ViewerError, match=r"pip install 'pinposture\[foxglove\]'"):
        pp.view(arm, viewer="foxglove", url=FREE)


@pytest.mark.long
def test_the_example_goes_from_one_shape_to_another(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = []

    class Recorder(FoxgloveViewer):
        def show(self, q: np.ndarray) -> None:
            shown.append((q, self.tracker.report.status))
            if len(shown) > 1000:
                raise KeyboardInterrupt

    monkeypatch.setattr("pinposture.viz.FoxgloveViewer", Recorder)
    monkeypatch.setattr("pinposture.viz.foxglove.ADDRESS", FREE)
    monkeypatch.setattr(time, "sleep", lambda _: None)
    with pytest.raises(KeyboardInterrupt):
        runpy.run_path(str(Path(__file__).parents[2] / "examples" / "foxglove_loop.py"))
    assert "ws%3A%2F%2F127.0.0.1" in capsys.readouterr().out
    assert [status for _, status in shown[498::500]] == ["converged", "converged"]
    assert np.abs(shown[998][0] - shown[498][0]).max() > 0.1
