"""The page: complete in itself, and holding the run."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import umsgpack

from pinposture import Arm, Curve, Run, Target, resolve_targets, save_html, track
from pinposture.errors import FileError, InvalidValue
from pinposture.units import length_text
from pinposture.viz.body import body_poses


class Page(HTMLParser):
    """The elements of a page: what they refer to, the scripts, and the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.scripts: list[str] = []
        self.words: list[str] = []
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self._inside = tag
        if tag == "script":
            self.scripts.append("")
        self.references += [value for name, value in attrs if name in ("src", "href", "data", "action")]

    def handle_data(self, data):
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.words.append(data)

    def handle_endtag(self, tag):
        self._inside = ""

    def constant(self, name: str):
        return json.loads(re.search(rf"^const {name} = (.*);$", self.scripts[1], re.MULTILINE)[1])

    @property
    def commands(self) -> list[dict]:
        return [umsgpack.unpackb(base64.b64decode(packed)) for packed in self.constant("commands")]


def spatial_run(steps: int = 12) -> Run:
    arm = Arm.from_template("RyRz", modules=6)
    target = resolve_targets(arm, Curve.helix(0.1, 0.3, 1.0), placement="align")
    start = arm.configuration(np.random.default_rng(0).uniform(-0.3, 0.3, arm.nv))
    return track(arm, target, start, "selection", max_steps=steps)


def numbers(track: dict) -> np.ndarray:
    return np.frombuffer(track["values"].data, "<f4")


def test_the_page_refers_to_nothing_outside_itself(tmp_path):
    run = spatial_run()
    page = Page(save_html(run.arm, run, tmp_path / "run.html").read_text(encoding="utf-8"))
    assert page.references == []
    assert not re.search(r"@import|url\(|\bfetch\(|WebSocket\(|\.connect\(", page.scripts[1])
    assert "MeshCat" in page.scripts[0]
    assert len(page.scripts[0]) > 500_000


def test_the_page_holds_the_motion_of_every_body(tmp_path):
    run = spatial_run()
    page = Page(save_html(run.arm, run, tmp_path / "run.html").read_text(encoding="utf-8"))
    *drawn, animation = page.commands
    assert animation["type"] == "set_animation"
    objects = {command["path"] for command in drawn if command["type"] == "set_object"}
    poses = body_poses(run.arm, run.q)
    clips = {item["path"]: item["clip"]["tracks"] for item in animation["animations"]}
    for u in range(run.arm.nv):
        path = f"/pinposture/arm/body_{u + 1:03d}"
        assert f"{path}/link" in objects
        position = numbers(clips[path][0]).reshape(-1, 3)
        np.testing.assert_allclose(position[1:-1], poses[:, u, :3, 3], atol=1e-6)
    # Nothing moves that was not drawn.
    moved = {path.removesuffix("/<object>") for path in clips}
    assert all(any(name.startswith(path) for name in objects) for path in moved)


def test_the_target_is_drawn_where_it_is(tmp_path):
    run = spatial_run()
    page = Page(save_html(run.arm, run, tmp_path / "run.html").read_text(encoding="utf-8"))
    drawn = {command["path"]: command for command in page.commands if command["type"] == "set_object"}
    packed = drawn["/pinposture/target/points"]["object"]["geometries"][0]["data"]["attributes"]["position"]
    vertices = np.frombuffer(packed["array"].data, "<f4").reshape(6, -1, 3)
    np.testing.assert_allclose(vertices.mean(axis=1), run.target.points, atol=1e-6)
    assert "/pinposture/target/covered" in drawn


def test_each_configuration_shown_is_described(tmp_path):
    run = spatial_run()
    page = Page(save_html(run.arm, run, tmp_path / "run.html").read_text(encoding="utf-8"))
    texts = page.constant("run")["texts"]
    assert len(texts) == run.steps + 1
    errors = np.linalg.norm(run.points[3] - run.target.points, axis=1)
    assert f"mean point error {length_text(errors.mean())} (largest {length_text(errors.max())})" in texts[3]
    assert f"{run.active[3].sum()} of 6 control points" in texts[3]


def test_long_runs_are_thinned_out_and_stay_small(tmp_path):
    arm = Arm.from_template("RyRz", modules=20)
    run = spatial_run()
    rows = np.linspace(0.0, 1.0, 1001)[:, None] * np.full(arm.nv, 0.2)
    big = replace(
        run,
        arm=arm,
        target=Target.from_configuration(arm, rows[-1]),
        q=rows,
        points=np.array([arm.at(q).points for q in rows]),
        point_errors=np.ones((1001, 20)),
        active=np.random.default_rng(0).random((1000, 20)) < 0.5,
    )
    path = save_html(arm, big, tmp_path / "long.html")
    assert path.stat().st_size < 5_000_000
    assert len(Page(path.read_text(encoding="utf-8")).constant("run")["texts"]) == 240


def test_words_of_the_run_cannot_break_the_page(tmp_path):
    run = replace(
        spatial_run(),
        reason="</script><script src='http://example.com/x.js'></script> & so",
        controller="<b>(1)",
    )
    page = Page(save_html(run.arm, run, tmp_path / "run.html").read_text(encoding="utf-8"))
    assert page.references == []
    assert any("</script><script src=" in words for words in page.words)
    assert len(page.commands) > 10


def test_the_same_run_gives_the_same_file(tmp_path):
    run = spatial_run(3)
    first = save_html(run.arm, run, tmp_path / "a.html").read_bytes()
    assert save_html(run.arm, run, tmp_path / "b.html").read_bytes() == first


@pytest.mark.parametrize("case", ["no step", "one module", "partial", "points only", "planar", "no target"])
def test_unusual_runs_are_written_too(tmp_path, case):
    arm = Arm.from_template("Rz" if case == "planar" else "RyRz", modules=1 if case == "one module" else 6)
    goal = np.full(arm.nv, 0.3)
    target = Target.from_configuration(arm, goal)
    if case == "partial":
        target = resolve_targets(arm, Curve.helix(0.1, 0.3, 0.3), placement="align", incomplete="partial")
        assert not target.has_target.all()
    elif case == "points only":
        target = Target.from_points(arm, arm.at(goal).points, [1, 1, 0, 0, 1, 1])
    elif case == "no target":
        target = replace(target, weights=np.zeros(6))
    start = goal if case == "no step" else np.zeros(arm.nv) + 0.1
    run = track(arm, Target.from_configuration(arm, goal), start, "projection", max_steps=5)
    run = replace(run, target=target)
    page = Page(save_html(arm, run, tmp_path / "run").read_text(encoding="utf-8"))
    assert (tmp_path / "run.html").is_file()
    assert len(page.constant("run")["texts"]) == run.steps + 1
    flat = json.dumps(page.constant("run"))
    assert "NaN" not in flat
    assert "Infinity" not in flat


def test_a_file_that_cannot_be_written_is_an_error_and_leaves_nothing_behind(tmp_path):
    run = spatial_run(2)
    occupied = tmp_path / "taken.html"
    (occupied / "inside").mkdir(parents=True)
    with pytest.raises(FileError, match=r"taken\.html"):
        save_html(run.arm, run, occupied)
    assert [path.name for path in tmp_path.iterdir()] == ["taken.html"]
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(FileError):
        save_html(run.arm, run, file / "run.html")


def test_a_failed_write_leaves_the_old_file_alone(tmp_path, monkeypatch):
    run = spatial_run(2)
    path = tmp_path / "run.html"
    path.write_text("old")

    def fail(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(FileError, match="No space left"):
        save_html(run.arm, run, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_of_another_arm_is_refused(tmp_path):
    run = spatial_run(2)
    with pytest.raises(InvalidValue, match=r"run\.q"):
        save_html(Arm.from_template("RyRz", modules=5), run, tmp_path / "run.html")
    other = Target.from_configuration(Arm.from_template("RyRz", modules=5), np.zeros(10))
    with pytest.raises(InvalidValue, match=r"target\.points"):
        save_html(run.arm, run, tmp_path / "run.html", target=other)
    with pytest.raises(InvalidValue, match=r"run is .*Target.*allowed: a Run"):
        save_html(run.arm, run.target, tmp_path / "run.html")
    longer = Arm.from_template("RyRz", run.arm.n_modules, link_lengths=[0.04, 0.03])  # as many joints
    with pytest.raises(InvalidValue, match=r"^run\.arm is Arm.*allowed: the arm that is given, Arm"):
        save_html(longer, run, tmp_path / "run.html")
