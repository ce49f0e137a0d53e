"""A run on file is shown again as it was."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="foxglove is not installed")
pytest.importorskip("mcap", reason="mcap is not installed")

from operate.test_operation import Desk, bent_arm

import pinposture as pp
from pinposture.collision.mapping import SEEN
from pinposture.collision.scan import Cells
from pinposture.errors import FileError
from pinposture.operate.record import Recorder, Replay, read_recording


@pytest.mark.long
def test_a_run_on_file_is_shown_again_as_it_was(tmp_path: Path) -> None:
    desk = Desk(*bent_arm())
    file = tmp_path / "run.mcap"
    recorder = Recorder(desk.arm, file)
    shown = []
    desk.operation.watch = lambda each: (shown.append(each), recorder.add(each))
    known = pp.Scene({"ball": pp.Sphere((0.0, 0.9, 0.0), 0.05)}, margin=0.005)
    first = Cells.of(np.array([[0.9, 0.5, 0.1], [0.9, 0.5, 0.12]]), 0.02)
    desk.scene = known.with_obstacles({**known.obstacles, SEEN: first})
    desk.run(0.2, lambda: desk.hold((-1.0, 0.0, 0.5)))
    desk.scene = desk.scene.updated({SEEN: Cells.of(np.array([[0.8, 0.5, 0.1]]), 0.02)})
    desk.run(0.2, lambda: desk.tell(do="release"))
    recorder.close()
    again = list(read_recording(desk.arm, file, known))
    assert len(again) == len(shown) == 20
    for one, other in zip(again, shown, strict=True):
        assert (one.mode, one.reason, one.planned.text) == (other.mode, other.reason, other.planned.text)
        np.testing.assert_array_equal(one.measured, other.measured)
        np.testing.assert_allclose(
            one.scene.obstacles[SEEN].points, other.scene.obstacles[SEEN].points, atol=1e-6
        )
        assert one.scene.obstacles[SEEN].point_radius == pytest.approx(
            other.scene.obstacles[SEEN].point_radius
        )
        assert "ball" in one.scene.obstacles
        assert one.time == pytest.approx(other.time - shown[0].time, abs=1e-6)
    assert np.array_equal(again[-1].commanded, shown[-1].commanded)
    replay = Replay(desk.arm, file, known)
    assert replay.shown.mode == shown[0].mode
    topics = _orders(file)
    assert topics[3]["order"]["ahead"] == -1.0
    assert topics[-1]["order"] is None
    with pytest.raises(FileError, match="is no recording of this arm"):
        Replay(pp.Arm.from_template("RyRz", modules=3), file, known)
    with pytest.raises(FileError, match="new file"):
        Recorder(desk.arm, file)


def _orders(file: Path) -> list[dict[str, object]]:
    """The cycles on file, read by nothing of ours."""
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        read = make_reader(stream).iter_messages(topics=["/operation"])
        return [json.loads(message.data) for _, _, message in read]


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    arm = pp.Arm.from_template("RyRz", modules=2)
    for name, content in (("no.mcap", None), ("text.mcap", b"hello, this is no recording at all")):
        file = tmp_path / name
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(FileError, match=name):
            Replay(arm, file, pp.Scene())
