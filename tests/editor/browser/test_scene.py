"""What is around the arm: an obstacle is put there, dragged and resized; a scan is loaded."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import arrived, wait_until
from editor.browser.window import Window

import pinposture as pp
from pinposture.collision import CollisionModel, Scan, Scene
from pinposture.editor import Editor
from pinposture.editor.obstacles import ArmScale, obstacles_of, size_handles

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


def millimetres(window: Window) -> float:
    """The clearance that the page tells, negative inside; infinite if it tells of none."""
    text = window.page.locator("#clearance").inner_text()
    found = re.search(r"([\d.]+) mm (inside|from)", text)
    return float("inf") if found is None else float(found[1]) * (-1.0 if found[2] == "inside" else 1.0)


def clear(editor: Editor) -> float:
    """The clearance as the library tells it [mm]."""
    scene = editor.session.task.scene
    assert scene is not None
    around = pp.Scene(dict(scene.obstacles), margin=scene.margin, self_collision=False)
    return 1000.0 * float(pp.CollisionModel(editor.session.arm, around).minimum(editor.live.state.q).distance)


def test_a_box_is_put_there_dragged_and_resized(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    window.tab("Scene")
    window.press("Box")
    window.says("added box_1")
    before = session.task
    first = obstacles_of(session.task)["box_1"]
    assert isinstance(first, pp.Box)
    arrived(editor)
    wait_until(
        lambda: abs(millimetres(window) - clear(editor)) < 0.01 * clear(editor), "the page tells how near"
    )
    far = millimetres(window)
    window.picture("12-box")

    # Dragged by the mouse, beside its axes; what is told changes while the hand is at it.
    corner = np.add(first.center, np.multiply(first.size, [-0.3, -0.5, 0.35]))
    nearer = editor.live.state.points[np.linalg.norm(editor.live.state.points - corner, axis=1).argmin()]
    window.drag(corner, corner + 0.3 * (nearer - corner))
    wait_until(lambda: abs(millimetres(window) - far) > 1.0, "the clearance changes")
    assert session.task is before
    window.drop()
    wait_until(lambda: session.history.undoable == "moved box_1", "it counts")
    second = obstacles_of(session.task)["box_1"]
    assert second.size == first.size
    assert np.linalg.norm(np.subtract(second.center, first.center)) > 0.02

    # Resized by a handle: the face across stays where it is.
    arrived(editor)
    grip = size_handles(second, ArmScale.of(session.arm))[2]
    wait_until(lambda: window.says("moved box_1"), "it is over")
    window.drag(grip.position, grip.position - [0.0, 0.0, 0.06])
    window.drop()
    wait_until(lambda: session.history.undoable == "resized box_1", "it counts")
    third = obstacles_of(session.task)["box_1"]
    assert third.size[2] > second.size[2] + 0.03
    assert third.size[:2] == second.size[:2]
    top = second.center[2] + 0.5 * second.size[2]
    assert abs(third.center[2] + 0.5 * third.size[2] - top) < 1e-5
    arrived(editor)
    wait_until(
        lambda: abs(millimetres(window) - clear(editor)) < 0.01 * abs(clear(editor)) + 0.1, "it is told"
    )
    window.picture("13-box-resized")

    window.aside()
    for told in ("undone: resized box_1", "undone: moved box_1"):
        window.key("Control+z")
        window.says(told)
    assert session.task is before
    wait_until(lambda: abs(millimetres(window) - far) < 0.01 * far, "the clearance is what it was")


def test_a_scan_is_shown_and_told_of(edit: Edit, look: Look, file: Path) -> None:
    rng = np.random.default_rng(0)
    cloud = np.column_stack(
        [rng.uniform(-0.1, 1.1, 4000), rng.uniform(-0.3, 0.4, 4000), np.full(4000, -0.12)]
    )
    np.savetxt(file.with_name("floor.xyz"), cloud, fmt="%.5f")
    alone = pp.Scene(self_collision=False)  # the arm is nearer to itself than to the floor
    editor = edit(pp.Task.load(file).edited(scene=alone), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    window.tab("Scene")
    window.page.get_by_text("Meshes and scans").click()
    window.field("File").fill("floor.xyz")
    window.press("Load")
    window.says("added the scan floor.xyz")
    wait_until(lambda: session.nearest is not None, "the clearance is known")
    q = editor.live.state.q
    floor = Scene({"floor": Scan.load(file.with_name("floor.xyz"))}, margin=0.01, self_collision=False)
    gap = CollisionModel(session.arm, floor).minimum(q).distance
    wait_until(lambda: abs(millimetres(window) - 1000.0 * gap) < 1.0, "the page tells how near it is")
    assert "floor.xyz" in window.page.locator("#clearance").inner_text()
    window.picture("14-scan")
    window.field("File").fill("nothing.ply")
    window.press("Load")
    window.says("nothing.ply")
    assert len(session.task.scans) == 1
