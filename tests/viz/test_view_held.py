"""What an arm holds on a part of a motion is drawn where the arm has it, in each viewer."""

from __future__ import annotations

from dataclasses import replace
from time import sleep
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from meshcat import Visualizer

import pinposture as pp
from pinposture.editor.playback import Playback
from pinposture.motion.held import HeldObject
from pinposture.viz import drawing
from pinposture.viz.foxglove import FoxgloveViewer
from pinposture.viz.meshcat import CommandRecorder, draw_scene

BALL = pp.Sphere((0.2, 0.3, 0.1), 0.05)


@pytest.fixture(scope="module")
def run() -> pp.Run:
    """A run in which the third module holds a ball from the third row to the one before the last."""
    arm = template_arm("RyRz", 3, (0.1, 0.1))
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.3))
    made = pp.track(arm, target, np.zeros(arm.nv), limits=pp.Limits(step=0.05))
    scene = pp.Scene({"far": pp.Sphere((0.0, 0.5, 0.0), 0.02), "ball": BALL})
    held = HeldObject("ball", arm.control_points[2], begin=2, end=len(made.q) - 2)
    return replace(made, scene=scene, clearance=np.ones(len(made.q)), held=(held,))


def middle(run: pp.Run, row: int) -> np.ndarray:
    """Where the ball is: fixed to the control point while it is held."""
    (held,) = run.held
    states = (run.arm.at(run.q[at]) for at in (held.begin, min(max(row, held.begin), held.end)))
    taken, now = (pin.SE3(np.array(each.rotations[2]), np.array(each.points[2])) for each in states)
    return np.asarray(now.act(taken.actInv(np.array(BALL.center))))


@pytest.mark.long
def test_an_animation_moves_it(run: pp.Run) -> None:
    shown = drawing.playback(run, 20.0, 1000)
    viewer = Visualizer(window=CommandRecorder())
    tracks = draw_scene(viewer, run.arm, shown, None, run.scene, ()).tracks
    moved = [each for each in tracks if each.path == drawing.obstacle_path(1)]
    assert not [each for each in tracks if each.path == drawing.obstacle_path(0)]
    places, turns = (each.values for each in moved)
    rows = shown.rows[shown.key_rows]
    found = [
        pin.XYZQUATToSE3(np.append(*each)).act(np.array(BALL.center))
        for each in zip(places, turns, strict=True)
    ]
    np.testing.assert_allclose(found, [middle(run, row) for row in rows], atol=1e-9)
    assert np.linalg.norm(found[-1] - found[0]) > 0.05


def test_foxglove_draws_it_where_it_is(run: pp.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    short = drawing.PLAYBACK._replace(rest_before=0.0, rest_after=0.0, shortest=0.1)
    monkeypatch.setattr(drawing, "PLAYBACK", short)
    played: list[tuple[Any, ...]] = []
    monkeypatch.setattr(FoxgloveViewer, "_put", lambda _, *state: played.append(state))
    drawn: list[tuple[Any, ...]] = []
    monkeypatch.setattr(FoxgloveViewer, "_log", lambda _, topic, *about: drawn.append((topic, *about)))
    with pp.view(run.arm, run, viewer="foxglove", url="ws://127.0.0.1:0", fps=100.0) as viewer:
        while len(played) < len(run.q):
            sleep(0.01)
        for q, target, scene, command, status in played[: len(run.q)]:
            viewer._publish(0, q, target, scene, command, status, True)
    scenes = [about[4] for about in drawn if about[0] == "/scene"]
    rows = [int(np.flatnonzero((run.q == state[0]).all(axis=1))[0]) for state in played[: len(run.q)]]
    found = [scene.obstacles["ball"].center for scene in scenes]
    np.testing.assert_allclose(found, [middle(run, row) for row in rows], atol=1e-9)


def test_the_editor_shows_it_there_while_it_plays(run: pp.Run) -> None:
    keyframes = [pp.Keyframe(joints=tuple(run.q[0])), pp.Keyframe(joints=tuple(run.q[-1]), time=1.0)]
    motion = pp.move_through(run.arm, keyframes, limits=pp.Limits(step=None, dt=0.05, velocity=1.0))
    held = HeldObject("ball", run.arm.control_points[2], begin=2, end=len(motion.run.q))
    performed = replace(motion.run, scene=run.scene, held=(held,))
    playback = Playback()
    assert playback.carried == {}
    playback.motion = replace(motion, run=performed)
    for row in (0, 5):
        playback._from = float(motion.time[row])
        found = playback.carried["ball"].translation
        np.testing.assert_allclose(found, middle(performed, row), atol=1e-9)
