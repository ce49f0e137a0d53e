"""Arms among obstacles: measures of runs made by hand, whether scenes are what they claim, small runs."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from arms import template_arm
from handmade import made

import pinposture as pp
from benchmarks.cases import situations
from benchmarks.cases.situations import SITUATIONS, Situation, draw_situation, situation_arm
from benchmarks.harness import Row
from benchmarks.report import Report, save_report
from benchmarks.studies.runs import arrived
from benchmarks.studies.scenes import (
    DISTANCE_ROUNDING,
    as_it_should,
    blamed,
    by_scene,
    explained,
    kept,
    measure_scene_run,
    study_scenes,
)
from pinposture.collision import Box, CollisionModel, HalfSpace, Scene
from pinposture.errors import InvalidValue, UnknownName

NAMES = tuple(SITUATIONS)
QUICK = tuple(name for name in NAMES if name not in ("narrow", "pipe"))  # these take long
LENGTH = 0.15
"""Of a link of the small planar arm [m]."""
RADIUS = 0.01


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return situation_arm()


def ceiling(height: float, margin: float = 0.02, **which: bool) -> Situation:
    """A ceiling over a small planar arm: the distance of its tip from it is known."""
    lid = HalfSpace((0.0, height, 0.0), (0.0, -1.0, 0.0))
    scene = Scene({"lid": lid}, margin=margin, arm_radius=RADIUS)
    return Situation("by hand", scene, np.zeros(2), np.zeros(2), **which)


def measured(angles: list[float], height: float, **more: object) -> Row:
    """A run of the stretched arm through headings of its first joint, under a ceiling."""
    q = np.column_stack([angles, np.zeros(len(angles))])
    which = {name: bool(more.pop(name)) for name in ("start_clear", "goal_clear") if name in more}
    return measure_scene_run(made(template_arm("Rz", 2), q, **more), ceiling(height, **which), 4, 0.5)


def gap(angle: float, height: float) -> float:
    return height - 2.0 * LENGTH * np.sin(angle) - RADIUS


def test_the_smallest_distance_is_looked_up_between_steps() -> None:
    """The arm swings past its highest point within a step; at both ends of that it is lower."""
    angles, height = [np.pi / 2 - 0.5, np.pi / 2 + 0.5], 0.5
    found = measured(angles, height)
    assert found.start == pytest.approx(gap(angles[0], height), abs=1e-9)
    assert found.end == pytest.approx(found.start, abs=1e-9)
    assert found.closest == pytest.approx(gap(np.pi / 2, height), abs=1e-9)  # the fifth of ten places
    assert (found.refused, found.reachable) == (4, True)
    assert (found.steps, found.seconds, found.margin) == (1, 0.5, 0.02)


@pytest.mark.parametrize(
    ("gaps", "loss", "keeps"),
    [
        ([0.1, 0.03, 0.02 + 1e-8, 0.1], 0.0, True),
        ([0.1, 0.03, 0.015, 0.1], 0.005, False),  # too close on the way
        ([0.1, 0.03, 0.021, -0.01], 0.03, False),  # touches at the end
        ([-0.03, -0.01, 0.01, 0.05, 0.03], 0.0, True),  # comes out
        ([-0.03, -0.01, -0.015, 0.05], 0.005, False),  # goes deeper before it has
        ([-0.03, 0.05, 0.012, 0.05], 0.008, False),  # is out, and comes back
        ([-0.03, -0.01, 0.01], 0.0, False),  # does not come out
        ([0.1], 0.0, True),
        ([-0.02], 0.0, False),
    ],
)
def test_what_it_means_to_keep_the_margin(gaps: list[float], loss: float, keeps: bool) -> None:
    height = 0.15
    angles = [float(np.arcsin((height - RADIUS - each) / (2.0 * LENGTH))) for each in gaps]
    assert max(angles) < np.pi / 2  # so that within a step the ends are nearest
    found = measured(angles, height)
    assert found.loss == pytest.approx(loss, abs=1e-7)
    assert kept(found) is keeps
    assert found.closest == pytest.approx(min(gaps), abs=1e-9)
    assert (found.start, found.end) == pytest.approx((gaps[0], gaps[-1]), abs=1e-9)


def test_paths_escapes_and_errors_of_a_run_made_by_hand() -> None:
    quarter = list(np.linspace(0.0, -np.pi / 2, 4))
    errors = np.outer([0.3, 0.2, 0.1, 0.05], [0.5, 1.5])
    escape = np.array([True, False, False])
    found = measured(quarter, 1.0, error_increasing=escape, point_errors=errors, reason="one\nline")
    assert found.path == pytest.approx(3 * 2.0 * np.sin(np.pi / 12) / np.sqrt(2.0))
    assert found.escaping == pytest.approx(1 / 3)
    assert found.error == pytest.approx(0.05 / (2.0 * LENGTH))
    assert (found.reason, arrived(found), explained(found)) == ("one line", False, False)


@pytest.mark.parametrize(
    ("error", "reason", "reachable", "right"),
    [
        (0.0, "there", True, True),
        (0.0, "there", False, False),
        (0.1, "m01_j1_z to lid: 1 mm apart", True, False),
        (0.1, "m01_j1_z to lid: 1 mm apart", False, True),
        (0.1, "lids on eyelids", False, False),
    ],
)
def test_a_run_does_as_it_should_or_says_why(error: float, reason: str, reachable: bool, right: bool) -> None:
    errors = np.full((2, 2), error * 2.0 * LENGTH)
    found = measured([0.0, 0.1], 1.0, point_errors=errors, reason=reason, goal_clear=reachable)
    assert kept(found)
    assert as_it_should(found) is right


def test_bodies_are_blamed_only_where_they_must_keep_clear_of_each_other() -> None:
    boxes = {name: Box((1, 1, 1), (1, 1, 1)) for name in ("left", "stave 1", "stave 11", "a+b")}
    text = "held by m01 to stave 11: 3 mm apart, m01 to m05: 1 mm apart, m02 to a+b: 1 mm apart; leftover"
    assert blamed(text, Scene(boxes, self_collision=False), ["m01", "m02", "m05"]) == ["stave 11", "a+b"]
    own = Scene(boxes, self_collision=True)
    assert blamed(text, own, ["m01", "m01", "m05"]) == ["stave 11", "a+b", "m01", "m05"]


@pytest.mark.parametrize("name", NAMES)
def test_starts_and_goals_are_as_clear_as_they_claim(arm: pp.Arm, name: str) -> None:
    situation = SITUATIONS[name]
    around, margin = CollisionModel(arm, situation.scene), situation.scene.margin
    seen = []
    for seed in range(4):
        draw = draw_situation(arm, situation, seed)
        again = draw_situation(arm, situation, seed)
        for q, same, middle, clear in (
            (draw.start, again.start, situation.start, situation.start_clear),
            (draw.goal, again.goal, situation.goal, situation.goal_clear),
        ):
            distance = around.minimum(q).distance
            assert distance >= margin if clear else distance < 0.0
            assert np.abs(arm.positions(q) - middle).max() == pytest.approx(situations.VARIATION, abs=1e-12)
            np.testing.assert_array_equal(q, same)
        seen += [draw.start, draw.goal]
    assert len({q.tobytes() for q in seen}) == 8


@pytest.mark.parametrize("name", NAMES)
def test_something_is_in_the_way(arm: pp.Arm, name: str) -> None:
    """The same controller that knows nothing of the scene runs into it."""
    situation = SITUATIONS[name]
    target = pp.Target.from_configuration(arm, situation.goal)
    run = pp.track(arm, target, situation.start, limits=pp.Limits(step=0.1), max_steps=400)
    found = measure_scene_run(run, situation)
    assert arrived(found)
    assert found.closest < 0.0
    assert not kept(found) or name == "out"


def test_the_slot_and_the_pipe_are_passed_at_the_goal(arm: pp.Arm) -> None:
    """Control points on both sides, the arm between the boxes; no way round the wall within its reach."""
    for name in ("slot", "narrow"):
        points = arm.at(SITUATIONS[name].goal).points
        assert points[:, 0].max() > 0.65 > 0.55 > points[0, 0]
        assert arm.at(SITUATIONS[name].start).points[:, 0].max() < 0.55
        left = SITUATIONS[name].scene.obstacles["left"]
        assert isinstance(left, Box)
        assert np.hypot(0.55, left.size[2] / 2) + 0.1 + left.size[2] / 2 > 1.2 * arm.length
        assert left.center[1] + left.size[1] / 2 > 0.9 * arm.length
    pipe = SITUATIONS["pipe"]
    for q in (pipe.start, pipe.goal):
        points = arm.at(q).points
        inside = points[(points[:, 0] > 0.2) & (np.abs(points[:, 1]) < situations.PIPE)]
        assert len(inside) >= 5
    between = 2.0 * situations.PIPE * np.sin(np.pi / situations.STAVES)
    assert between < 2.0 * situations.STAVE


def test_draws_that_are_not_clear_enough_are_counted_and_given_up(arm: pp.Arm) -> None:
    lid = Scene({"lid": HalfSpace((0.0, 0.0, 0.05), (0.0, 0.0, -1.0))}, margin=0.01)
    flat = Situation("flat", lid, np.zeros(40), np.zeros(40))
    draws = [draw_situation(arm, flat, seed) for seed in range(10)]
    assert sum(draw.refused for draw in draws) > 0
    around = CollisionModel(arm, lid)
    assert all(around.minimum(q).distance >= 0.01 for draw in draws for q in draw[:2])
    with pytest.raises(InvalidValue, match=r"(?s)goal of flat.*overlaps with something"):
        far = Scene({"lid": HalfSpace((0.0, 0.0, 2.0), (0.0, 0.0, -1.0))})
        draw_situation(arm, flat._replace(scene=far, goal_clear=False), 0)
    with pytest.raises(InvalidValue, match=r"(?s)start of flat.*keeps the margin"):
        low = Scene({"lid": HalfSpace((0.0, 0.0, -1.0), (0.0, 0.0, -1.0))})
        draw_situation(arm, flat._replace(scene=low), 0)


@pytest.fixture(scope="module")
def runs() -> list[Row]:
    return study_scenes(QUICK, seeds=1, first_seed=8).rows()  # the quickest


@pytest.mark.studies
def test_each_scene_keeps_the_margin_and_ends_where_it_should(runs: list[Row]) -> None:
    assert [run.scene for run in runs] == list(QUICK)
    for run in runs:
        assert kept(run), run
        assert arrived(run) is run.reachable, run
        if run.scene != "out":
            assert run.closest >= run.margin - DISTANCE_ROUNDING
    by_name = {run.scene: run for run in runs}
    assert (by_name["inside"].status, by_name["inside"].blamed) == ("stalled", "ball")
    assert by_name["inside"].end < 0.02  # as near as it may, and a little
    assert by_name["out"].start < 0.0 < by_name["out"].margin <= by_name["out"].end
    assert [name for name, run in by_name.items() if not run.reachable] == ["inside"]


@pytest.mark.process
def test_processes_and_company_make_no_difference() -> None:
    both = study_scenes(("inside", "coil"), seeds=2).rows(jobs=2)
    seen: list[tuple[int, int]] = []
    alone = study_scenes(["coil"], 1, first_seed=1).rows(progress=lambda *counts: seen.append(counts))
    assert [(run.scene, run.seed) for run in both] == [(n, k) for n in ("inside", "coil") for k in (0, 1)]
    assert alone[0].but(seconds=0.0) == both[3].but(seconds=0.0)
    assert seen == [(1, 1)]


@pytest.mark.studies
def test_rows_and_files_hold_what_the_runs_say(runs: list[Row], tmp_path: object) -> None:
    first = runs[0].but(scene="x", seed=0, steps=10, path=1.0, refused=2, reachable=True, error=0.0)
    first = first.but(loss=0.0, closest=0.03, margin=0.01, end=0.03, escaping=0.1, seconds=1.0)
    second = first.but(seed=1, steps=20, path=3.0, refused=1, error=0.1, blamed="")
    third = second.but(seed=2, steps=30, loss=0.002, closest=0.008, blamed="post", reachable=False)
    (row, other) = by_scene([first, second, third, first.but(scene="y")])
    assert list(row.values())[:7] == ["x", 3, 5 - 1, 2, 1, 2, 1]
    assert (row.room, row.loss) == pytest.approx((-0.002, 0.002))
    assert row.steps == pytest.approx({"median": 20.0, "high": 28.0})
    assert row.path == pytest.approx({"median": 3.0, "high": 3.0})
    assert (other.scene, other.runs, other.reached, other.kept) == ("y", 1, 1, 1)
    table, summary = save_report(tmp_path / "new", Report(runs, {"study": "scenes"}, []))
    assert json.loads(summary.read_text()) == {"study": "scenes"}
    with table.open(newline="") as file:
        lines = list(csv.DictReader(file))
    for line, run in zip(lines, runs, strict=True):
        assert list(line) == list(run)
        assert {name: type(getattr(run, name))(line[name]) for name in ("seed", "error", "closest")} == {
            "seed": run.seed,
            "error": run.error,
            "closest": run.closest,
        }
        assert (line["scene"], line["reason"]) == (run.scene, run.reason)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seeds": 0}, "seeds is 0"),
        ({"first_seed": -1}, "first_seed is -1"),
        ({"scenes": ()}, "scenes is"),
    ],
)
def test_wrong_numbers_are_named(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        study_scenes(**arguments)


def test_a_scene_that_does_not_exist_is_named_with_what_there_is() -> None:
    with pytest.raises(UnknownName, match="did you mean 'slot'"):
        study_scenes(["slto"])
