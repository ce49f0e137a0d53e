"""A motion in time in the browser: as a page, and by a server."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from arms import template_arm
from viz.commands import server_commands
from viz.motions import around_a_ball, five_modules, some_motion
from viz.test_view_html import Page

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.placement.target import Moved
from pinposture.viz.drawing import PLAYBACK
from pinposture.viz.palette import THEME


def page_of(motion, tmp_path, **options) -> Page:
    return Page(pp.save_html(motion.arm, motion, tmp_path / "motion", **options).read_text(encoding="utf-8"))


def words(page: Page) -> str:
    return " ".join(" ".join(page.words).split())


def clips(commands) -> dict:
    (animation,) = [command for command in commands if command["type"] == "set_animation"]
    return {item["path"]: item["clip"]["tracks"] for item in animation["animations"]}


def test_the_page_plays_as_long_as_the_motion_took(tmp_path):
    motion = some_motion()
    text = pp.save_html(five_modules(), motion, tmp_path / "motion").read_text(encoding="utf-8")
    page = Page(text)
    assert f'max="{PLAYBACK.rest_before + 3.0 + PLAYBACK.rest_after}"' in text
    times = page.constant("run")["times"]
    np.testing.assert_allclose(times, PLAYBACK.rest_before + motion.time, atol=1e-6)
    assert len(page.constant("run")["texts"]) == len(times)
    assert page.references == []
    assert "shown in real time; targets at straight S coil" in words(page)
    (animation,) = [command for command in page.commands if command["type"] == "set_animation"]
    for item in animation["animations"]:
        for track in item["clip"]["tracks"]:
            end = np.frombuffer(track["times"].data, "<f4")[-1] / item["clip"]["fps"]
            assert end == pytest.approx(PLAYBACK.rest_before + 3.0 + PLAYBACK.rest_after, abs=1e-5)


@pytest.mark.filterwarnings("ignore:dt is 4 s, long")
def test_a_motion_of_minutes_is_played_faster_and_the_page_says_so(tmp_path):
    motion = some_motion(limits=pp.Limits(step=None, dt=4.0))
    page = page_of(motion, tmp_path)
    assert "shown 5 times as fast as recorded" in words(page)
    assert page.constant("run")["times"][-1] == pytest.approx(PLAYBACK.rest_before + 240.0 / 5.0)


def test_the_caption_tells_time_place_error_and_clearance(tmp_path):
    motion = some_motion(scene=around_a_ball(), planned=1.25, start_index=10)
    texts = page_of(motion, tmp_path).constant("run")["texts"]
    near = motion.run.clearance
    assert texts[4] == (
        "0.20 of 3.00 s (0.00 of 1.25 s of the plan), moving to the first posture, mean point error "
        f"1 mm (largest 1 mm), clearance {1e3 * near[4]:.3g} mm"
    )
    assert texts[34].startswith("1.70 of 3.00 s (0.60 of 1.25 s of the plan), reached straight (1 of 3), ")
    assert "reached S (2 of 3)" in texts[35]
    assert "reached coil (3 of 3)" in texts[60]
    even = page_of(some_motion(names=()), tmp_path).constant("run")["texts"]
    assert even[20] == "1.00 of 3.00 s, mean point error 1 mm (largest 1 mm)"


def test_targets_of_the_moment_and_of_places_are_drawn_in_colours_that_the_legend_tells(tmp_path):
    motion = some_motion()
    page = page_of(motion, tmp_path)
    drawn = {c["path"]: c["object"] for c in page.commands if c["type"] == "set_object"}
    moved = clips(page.commands)
    for k in range(5):
        path = f"/pinposture/target/hoop_{k + 1:03d}"
        assert path in drawn
        position = np.frombuffer(moved[path][0]["values"].data, "<f4").reshape(-1, 3)
        np.testing.assert_allclose(position[1:-1], motion.targets[:, k], atol=1e-6)
    text = (tmp_path / "motion.html").read_text(encoding="utf-8")
    for number, place in enumerate(motion.waypoints):
        shape = drawn[f"/pinposture/target/place_{number + 1:03d}"]
        color = f"#{shape['materials'][0]['color']:06X}"
        assert f'style="background: {color}"></span>{place.name}' in text
        packed = shape["geometries"][0]["data"]["attributes"]["position"]["array"]
        rings = np.frombuffer(packed.data, "<f4").reshape(6, -1, 3)
        np.testing.assert_allclose(rings.mean(axis=1)[1:], motion.targets[place.row], atol=1e-6)
    assert "/pinposture/target/points" not in drawn


def test_a_target_that_is_asked_for_stays_where_it_is(tmp_path):
    motion = some_motion()
    page = page_of(motion, tmp_path, target=motion.run.target)
    assert "/pinposture/target/points" in {c["path"] for c in page.commands if c["type"] == "set_object"}
    assert not any("points" in path for path in clips(page.commands))


def test_ellipsoids_and_obstacles_are_shown_as_of_runs(tmp_path):
    page = page_of(some_motion(scene=around_a_ball()), tmp_path, ellipsoids=(-1,))
    drawn = {c["path"] for c in page.commands if c["type"] == "set_object"}
    assert "/pinposture/obstacles/obstacle_001" in drawn
    assert "/pinposture/ellipsoids/point_005" in clips(page.commands)
    assert "ellipsoids, 1 m/rad drawn as" in words(page)


@pytest.mark.long
@pytest.mark.parametrize(("count", "opacity"), [(3, THEME.see_through), (60, THEME.sheer)])
def test_the_walls_of_a_pipe_let_through_more_than_a_single_obstacle(tmp_path, count, opacity):
    balls = {f"ball {k}": pp.Sphere((0.1, 0.3, 0.002 * k), 0.02) for k in range(count)}
    page = page_of(some_motion(4, scene=pp.Scene(balls)), tmp_path)
    shown = [
        c["object"]["materials"][0]
        for c in page.commands
        if c["type"] == "set_object" and "/obstacles/" in c["path"]
    ]
    assert len(shown) == count
    assert {material["opacity"] for material in shown} == {opacity}


def test_names_cannot_break_the_page(tmp_path):
    names = ("</script><b>", "a & b", '"c"')
    page = page_of(some_motion(names=names), tmp_path)
    assert page.references == []
    assert len(page.commands) > 10
    assert "</script><b>" in words(page)
    assert "reached </script><b> (1 of 3)" in page.constant("run")["texts"][0]


@pytest.mark.parametrize("case", ["no step", "planar", "no place", "no target"])
def test_unusual_motions_are_written_too(tmp_path, case):
    arm = template_arm("Rz", 5, (0.1,)) if case == "planar" else None
    names = () if case in ("no place", "no step") else ("a",)
    motion = some_motion(0 if case == "no step" else 10, arm, names=names)
    if case == "no target":
        motion = replace(motion, target_mask=np.arange(5) * np.ones((11, 1)) == 4)
    page = page_of(motion, tmp_path)
    assert len(page.constant("run")["texts"]) == motion.steps + 1
    flat = json.dumps(page.constant("run"))
    assert "NaN" not in flat
    assert "Infinity" not in flat


def test_long_motions_are_thinned_out(tmp_path):
    motion = some_motion(2000, limits=pp.Limits(step=None, dt=0.002))
    assert len(page_of(motion, tmp_path).constant("run")["texts"]) == 81  # 4 s, 20 a second
    assert len(page_of(motion, tmp_path, max_frames=30).constant("run")["texts"]) == 30


def test_a_motion_of_another_arm_is_refused(tmp_path):
    with pytest.raises(InvalidValue, match=r"run\.q"):
        pp.save_html(pp.Arm.from_template("RyRz", modules=4), some_motion(), tmp_path / "motion")


def test_the_viewer_plays_a_motion_with_its_targets(running):
    motion = some_motion(scene=around_a_ball())
    with pp.view(five_modules(), motion, url=running.zmq_url) as viewer:
        commands = server_commands(running.zmq_url)
        drawn = {c["path"] for c in commands if c["type"] == "set_object"}
        assert "/pinposture/obstacles/obstacle_001" in drawn
        assert "/pinposture/target/hoop_005" in clips(commands)
        assert "/pinposture/target/points" not in drawn
        viewer.show(motion.q[-1])
        assert clips(server_commands(running.zmq_url)) == {}
        viewer.play()
        assert "/pinposture/arm/body_001" in clips(server_commands(running.zmq_url))


def test_curves_of_a_repeated_tour_are_described_once(tmp_path):
    motion = some_motion(names=("up, lap 1", "down, lap 1", "up, lap 2"))
    moves = [Moved((0.0, 0.0, height), (0.0, 0.0, 0.0)) for height in (0.1, 0.2, 0.1)]
    places = zip(motion.waypoints, moves, strict=True)
    motion = replace(motion, waypoints=tuple(place._replace(moved=moved) for place, moved in places))
    page = pp.save_html(five_modules(), motion, tmp_path / "tour").read_text()
    assert "curves: up moved by 100 mm, down moved by 200 mm<" in page
