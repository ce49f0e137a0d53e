"""Every snippet in Python runs, those of a page one after the other, as a reader would type them."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import pytest
import trimesh

import pinposture as pp
from pinposture import viz
from pinposture.collision.obstacles import OBSTACLE_TYPES
from pinposture.control.planner.geodesic import MODES

DOCS = Path(__file__).parents[2] / "docs"
PAGES = (
    *(
        "index.md",
        "quickstart.md",
        "concepts.md",
        "controllers.md",
        "urdf.md",
        "coupled_joints.md",
        "your_own_module.md",
        "scenes.md",
        "reach.md",
        "retreat.md",
        "weight.md",
        "identification.md",
        "robot.md",
    ),
    "streaming.md",
    "operate.md",
    "your_own_controller.md",
    "evidence.md",
    *(f"design/{page.name}" for page in sorted(DOCS.glob("design/*.md"))),
)
ELSEWHERE = {"tasks.md", "follow_leader.md", "trajectories.md", "physics.md"}  # in test_motion_pages.py
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def fenced(page: Path, language: str) -> list[str]:
    """The snippets of a page in a language."""
    return [code for kind, code in FENCE.findall(page.read_text()) if kind == language]


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # any free port
    original = viz.view
    foxglove = {"viewer": "foxglove", "url": "ws://127.0.0.1:0"}

    def view(*shown: Any, viewer: str = "") -> viz.Viewer | None:
        return original(*shown, **foxglove) if viewer else None

    for module in (pp, viz):  # pp looks it up in viz when it is first asked
        monkeypatch.setattr(module, "view", view)


def test_no_page_with_snippets_is_forgotten() -> None:
    pages = [*DOCS.glob("*.md"), *DOCS.glob("design/*.md")]
    with_python = {page.relative_to(DOCS).as_posix() for page in pages if fenced(page, "python")}
    assert with_python == {*PAGES, *ELSEWHERE}
    for page in DOCS.rglob("*.md"):
        assert all(kind for kind, _ in FENCE.findall(page.read_text())), f"{page.name}: say the language"


@pytest.mark.tutorial
@pytest.mark.parametrize("page", PAGES)
def test_the_snippets_of_a_page_run(page: str, capsys: pytest.CaptureFixture) -> None:
    names: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pp.PostureWarning)
        for code in fenced(DOCS / page, "python"):
            exec(compile(code, page, "exec"), names)
    printed = capsys.readouterr().out
    assert printed
    assert "nan" not in printed
    for shown in fenced(DOCS / page, "text"):
        assert shown in printed
    if "run" in names:
        assert names["run"].converged


def test_the_scene_file_is_one_with_every_kind_of_obstacle(tmp_path: Path) -> None:
    text, surfaces = fenced(DOCS / "scenes.md", "toml")
    (tmp_path / "scene.toml").write_text(text)
    example = DOCS.parent / "examples/scene.toml"
    assert example.read_text().split("\n", 2)[2] == text  # after what it is for
    scene = pp.Scene.load(example)
    assert (scene.margin, scene.self_collision) == (0.01, True)
    kinds = {each.type for each in scene.obstacles.values()}
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    trimesh.PointCloud(1000.0 * box.vertices).export(tmp_path / "machine.ply")
    box.export(tmp_path / "housing.stl")
    (tmp_path / "surfaces.toml").write_text(surfaces)
    others = pp.Scene.load(tmp_path / "surfaces.toml").obstacles
    assert kinds | {each.type for each in others.values()} == set(OBSTACLE_TYPES)
    assert others["machine"].bounds == pytest.approx(others["housing"].bounds)
    (radius,) = re.findall(r"^# (arm_radius = \S+)", text, re.MULTILINE)
    (tmp_path / "scene.toml").write_text(f"{radius}\n{text}")
    assert pp.Scene.load(tmp_path / "scene.toml").arm_radius == 0.012


def test_the_design_note_lists_all_modes_of_a_step() -> None:
    page = (DOCS / "design/modes.md").read_text()
    rows = [f"| {mode.name} | {mode.when} |" for mode in MODES]
    places = [page.index(row) for row in rows]
    assert places == sorted(places)


def test_contributors_are_sent_to_all_design_notes() -> None:
    listed = set(re.findall(r"`(\w+\.md)` \|$", (DOCS.parent / "CONTRIBUTING.md").read_text(), re.MULTILINE))
    assert listed == {page.name for page in DOCS.glob("design/*.md")}
