"""Gaps on the way of a leader: refused exactly if they are narrower than the arm and its margin."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from test_follow_leader import arc, crossed, hinged

import pinposture as pp
from pinposture.collision import HalfSpace, Scene, Sphere
from pinposture.collision.pipe import pipe
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.errors import FileError, PostureWarning, TaskError, no_warnings
from pinposture.task.follow_leader import follow_leader
from pinposture.task.perform import perform
from pinposture.task.reference import require_passage

TASK = Path(__file__).parents[2] / "examples" / "tasks" / "pipe.toml"


def through_a_pipe(radius, **options):
    path = arc(0.2, 0.9)
    reference = follow_leader(crossed(), path, 0.1, 0.1, depth=0.18)
    return reference, pipe(reference.waypoints[-1].target.curve, radius, arm_radius=0.01, **options)


@pytest.mark.parametrize(
    ("radius", "margin"), [(0.009, 0.0), (0.0125, 0.005), (0.0149, 0.005), (0.02, 0.012)]
)
def test_a_pipe_that_is_narrower_than_the_arm_and_its_margin_is_refused_with_the_amounts(radius, margin):
    """The arm is a capsule of 1 cm radius; in the pipe, nothing is farther than the radius from its axis."""
    reference, walls = through_a_pipe(radius, margin=margin)
    with pytest.raises(TaskError) as caught:
        perform(reference, "geodesic", Limits(dt=0.1), scene=walls)
    assert "is too narrow for m09_j" in str(caught.value)
    assert f"its radius is 10 mm and the margin {1e3 * margin:.4g} mm" in str(caught.value)


@examples(20)
@given(st.floats(0.3, 1.7), st.floats(0.0, 0.01), st.sampled_from(["slit", "hole"]))
def test_gaps_are_refused_exactly_if_the_arm_and_its_margin_are_wider(width, margin, kind):
    """On a straight path: half-spaces on both sides, or a straight pipe, at `width` radii from the path."""
    radius = 0.005 + margin
    path = Curve.line((0, 0, 0), (0.2, 0, 0))
    reference = follow_leader(hinged(), path, 0.2, 0.1)
    laid = reference.waypoints[-1].target.curve
    gap = width * radius
    if kind == "hole":
        scene = pipe(laid.trimmed(0.05, 0.15), gap, margin=margin, arm_radius=0.005)
    else:
        walls = {"left": HalfSpace((0, gap, 0), (0, -1, 0)), "right": HalfSpace((0, -gap, 0), (0, 1, 0))}
        scene = Scene(walls, margin=margin, arm_radius=0.005)
    if abs(width - 1.0) < 0.02:
        return
    with no_warnings():
        if width > 1.0:
            require_passage(reference, scene, 0.005)
            return
        with pytest.raises(TaskError, match="is too narrow") as caught:
            require_passage(reference, scene, 0.005)
    missing = float(re.search(r"path: ([\d.e-]+) mm are missing", str(caught.value))[1])
    assert missing == pytest.approx(1e3 * (radius - gap), abs=0.02 * 1e3 * radius)


def test_an_obstacle_beside_the_path_draws_a_warning_if_the_arm_can_give_way():
    reference, _ = through_a_pipe(0.05)
    place = reference.waypoints[-1].target.curve.at(0.1)
    ball = Sphere(tuple(place + (0, 0, 0.0145)), 0.005)
    with pytest.warns(PostureWarning, match=r"ball come within 4\.\d+ mm at .* the margin is 5 mm"):
        require_passage(reference, Scene({"ball": ball}, margin=0.005, arm_radius=0.005), 0.005)
    moving = Scene({"ball": ball}, margin=0.005, arm_radius=0.005, velocities={"ball": (0, 0, 1)})
    require_passage(reference, moving, 0.005)  # it will be elsewhere


@pytest.mark.long
@pytest.mark.parametrize(
    ("radius", "words"),
    [
        (
            "14 mm",
            "line 18: leader.pipe: is '14 mm'; allowed: 0.015 m or more: the arm has a radius of 10 mm",
        ),
        ("16 mm", "line 18: leader.pipe: is 0.016; allowed: 0.018"),
    ],
)
def test_a_narrow_pipe_of_a_task_is_refused_with_its_line(tmp_path: Path, radius: str, words: str) -> None:
    """Bends cost what the planned postures are off the path: it fits from 18.1 mm on."""
    file = tmp_path / "task.toml"
    file.write_text(TASK.read_text().replace("45 mm", radius))
    with pytest.raises(FileError, match="are missing") as caught:
        task = pp.Task.load(file)
        task.surroundings(task.reference())
    assert words in str(caught.value)
    needed = float(re.search(r"allowed: ([0-9.]+) m", str(caught.value))[1])  # type: ignore[index]
    if needed > 0.016:
        file.write_text(TASK.read_text().replace("45 mm", f"{1e3 * needed + 0.3:.2f} mm"))
        assert pp.Task.load(file).perform().run.status == "converged"


@pytest.mark.long
def test_a_check_of_a_file_names_the_gap_that_is_too_narrow(tmp_path: Path) -> None:
    """The hole of the example leaves 30 mm around the arm."""
    text = TASK.with_name("inspection.toml").read_text()
    file = tmp_path / "task.toml"
    file.write_text(text[: text.index('[[phases]]\nname = "look"')].replace('"5 mm"', '"35 mm"'))
    task = pp.Task.load(file)
    with pytest.raises(FileError, match=r"insert: inside': the gap at .* is too narrow") as caught:
        task.feasibility(task.reference())
    assert "its radius is 10 mm and the margin 35 mm" in str(caught.value)
    file.write_text(file.read_text().replace('"35 mm"', '"25 mm"'))
    task = pp.Task.load(file)
    with no_warnings():
        task.feasibility(task.reference())
