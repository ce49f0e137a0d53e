"""What the arm carries and holds, in the Arm tab: the page stays as it is, and colours tell of torques."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import arrived, wait_until
from editor.browser.window import Window

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.ui.parts import color
from pinposture.viz.arm_figure import LOADS

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


def test_payload_and_torque_limits_are_typed_and_seen(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file)
    window = look(editor)
    session = editor.session
    arrived(editor)
    window.tab("Arm")
    before = editor.session.arm
    window.field("Payload [kg]").fill("0.5")
    wait_until(lambda: session.history.undoable == "payload 0.5 kg", "the arm carries it")
    window.field("Torque [N m]").fill("2")
    wait_until(lambda: session.history.undoable == "torque limit 2", "the drives have a limit")
    assert np.all(session.arm.effort == 2.0) and session.arm is not before
    assert window.field("Payload [kg]").input_value() == "0.5"  # the page is the same, and the tab is open
    window.field("Colours").click()
    window.page.get_by_role("option", name="torque at rest").click()
    worst, fine = (color(LOADS[level][1]) for level in (3, 0))

    def painted(shade: tuple[int, int, int]) -> int:
        return int(np.all(editor.page._arm._colors == shade, axis=1).sum())

    wait_until(lambda: painted(worst) > 0, "the joints beyond their torque are seen")
    for _, _, _, meaning in LOADS:
        window.page.get_by_text(meaning, exact=True).wait_for()
    window.picture("torques")
    window.field("Torque [N m]").fill("200")
    wait_until(lambda: session.history.undoable == "torque limit 200", "they are stronger")
    wait_until(lambda: painted(fine) == session.arm.nv, "no joint is near its torque")
    window.page.get_by_text("Keep torques", exact=True).click()
    wait_until(lambda: session.task.limits.effort is True, "torques are kept")
    saved = session.whole.save(file.with_name("loaded.toml"))
    again = pp.Task.load(saved)
    assert again.arm.weight == session.arm.weight and again.limits == session.task.limits
