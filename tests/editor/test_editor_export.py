"""What is taken away loads again, and is the motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from played import four_modules, moved

import pinposture as pp
from pinposture.editor.files import EXPORT_KINDS, export
from pinposture.errors import MotionError, UnknownName
from pinposture.motion import JointTrajectory, Trajectory


def test_the_archive_is_the_motion(tmp_path: Path) -> None:
    made = export(moved(), "npz", "walk")
    assert made.name == "walk.npz"
    (tmp_path / made.name).write_bytes(made.content)
    loaded = pp.load(tmp_path / made.name, Trajectory)
    for field in ("q", "targets", "plan_time", "mean_error"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(moved(), field))
    assert [place.name for place in loaded.waypoints] == [place.name for place in moved().waypoints]


@pytest.mark.parametrize("kind", ["CSV", "ROS JSON"])
def test_joints_come_back_at_their_times(tmp_path: Path, kind: str) -> None:
    made = export(moved(), kind, "walk")
    (tmp_path / made.name).write_bytes(made.content)
    loaded = pp.load(tmp_path / made.name, JointTrajectory).matched(four_modules())
    still = np.concatenate([moved().q[:1], moved().q, moved().q[-1:]])  # a cycle at rest before and after
    np.testing.assert_allclose(loaded.configurations(four_modules()), still, atol=1e-12)
    np.testing.assert_allclose(np.diff(loaded.time), moved().dt, atol=2e-9)


@pytest.mark.long
def test_the_picture_is_one(tmp_path: Path) -> None:
    made = export(moved(), "Picture", "walk")
    assert made.name == "walk.png"
    assert made.content.startswith(b"\x89PNG\r\n\x1a\n")
    assert int.from_bytes(made.content[16:20], "big") == 1200  # as wide as `plot` says


def test_the_animation_is_a_page_by_itself() -> None:
    made = export(moved(), "Animation", "walk")
    text = made.content.decode()
    assert made.name == "walk.html"
    assert text.lstrip().lower().startswith("<!doctype html>")
    assert text.rstrip().endswith("</html>")


@pytest.mark.parametrize("kind", EXPORT_KINDS)
def test_it_is_told_what_was_written_and_how_long_the_motion_is(kind: str) -> None:
    made = export(moved(), kind, "walk")
    assert made.summary.startswith(f"{made.name}: ")
    assert f"{moved().time[-1]:.4g} s, {moved().steps} cycles" in made.summary
    assert f"{len(made.content) / 1000.0:,.0f} kB" in made.summary


@pytest.mark.parametrize(
    ("stem", "name"), [("my walk/2", "my_walk_2.csv"), ("../..", "motion.csv"), ("", "motion.csv")]
)
def test_names_of_files_are_plain(stem: str, name: str) -> None:
    assert export(moved(), "CSV", stem).name == name


def test_other_kinds_are_refused() -> None:
    with pytest.raises(UnknownName, match="kind of export"):
        export(moved(), "gif", "walk")


def test_joints_of_a_motion_that_did_not_get_there_are_refused() -> None:
    lost = replace(moved(), run=replace(moved().run, status="stalled", reason="something stood in the way"))
    for kind in ("CSV", "ROS JSON"):
        with pytest.raises(MotionError, match="it stalled: something stood in the way"):
            export(lost, kind, "walk")
    assert "does not arrive at its last posture" in export(lost, "npz", "walk").summary
