"""Names of files, keyframes, obstacles, robots, links and joints: none is taken for markup."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import partial
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import free_port
from editor.edited_tasks import bent_spline, six_modules, straight_line, task
from editor.page_client import until, visiting
from viz.motions import some_motion

import pinposture as pp
from pinposture import editor as package
from pinposture.editor import Editor
from pinposture.editor.ui.keyframes import rename
from pinposture.motion import Trajectory
from pinposture.task import Keyframe, Task
from pinposture.viz.meshcat import _viewer_script

HOSTILE = '<iframe id=hostile srcdoc="&lt;script&gt;parent.ran=1&lt;%2Fscript&gt;"></iframe>'
"""Markup that runs a script where it is shown as it is. A slash would be none of a file's name."""

MARKS = ("![x](hostile)", "[x](javascript:hostile)", "</b></div><script>hostile()</script>", "\"'><hostile>")
"""Other markup, of Markdown too: its pictures are read by the server, from wherever they say."""

SINKS = ("add_html", "add_markdown", "add_modal", "add_notification", "add_label", "add_plotly", "add_image")
"""What viser shows as HTML, or as Markdown in which HTML counts, and what it may come to show so."""

PLACES = {
    # What is wrong with joint states: their text; numbers; our texts.
    "ui/arm.py": ["add_html", "add_markdown", "add_html"],
    "ui/curve.py": ["add_markdown", "add_html"],  # our texts
    "ui/files.py": [
        "add_modal",
        "add_markdown",
        "add_html",
        "add_markdown",
    ],  # the name of the task file; our texts
    "ui/keyframes.py": ["add_html"],  # what is asked of the tip, a control point by its name
    "ui/phases.py": ["add_label"],  # our text
    "ui/player.py": ["add_html", "add_html"],  # numbers, and the names of the keyframes at the timeline
    "ui/page.py": ["add_html", "add_html"],  # verdicts, what was last said, the name of the keyframe
    "ui/scene.py": ["add_markdown", "add_html"],  # our texts; which link is near which obstacle or scan
}
"""Where the page makes HTML or Markdown. All of it is looked at below."""

SENT = ("content", "_markdown", "title", "body", "text")
"""Properties of what is sent that may be HTML or Markdown."""


class Elements(HTMLParser):
    """Names of the elements in HTML, and what they say."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.ids: set[str] = set()
        self.scripts = 0
        self.words = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.ids |= {value for name, value in attrs if name == "id" and value}
        self.scripts += tag == "script"

    def handle_data(self, data: str) -> None:
        self.words += data


def hostile_arm() -> pp.Arm:
    """An arm of a robot, links and joints with such names."""
    urdf = six_modules().urdf
    assert urdf is not None
    written = escape(HOSTILE)
    for kind in ("link", "joint", "robot"):
        urdf = re.sub(rf'<{kind} name="', f'<{kind} name="{written}', urdf)
    arm = pp.Arm.load(re.sub(r'(?<= link=")', written, urdf), split=2)
    assert all(name.startswith(HOSTILE) for name in (arm.model.name, *list(arm.model.names)[1:]))
    return arm


def hostile_scene() -> pp.Scene:
    """A scene of obstacles with such names."""
    names = (HOSTILE, *MARKS)
    balls = {name: pp.Sphere((0.2, 0.1 + 0.1 * k, 0.1), 0.03) for k, name in enumerate(names)}
    return pp.Scene(balls, self_collision=True)


def hostile_motion() -> Trajectory:
    """A motion of such an arm in such a scene, past places with such names."""
    return some_motion(arm=hostile_arm(), scene=hostile_scene(), names=(HOSTILE, *MARKS[2:]))


def hostile_task(folder: Path) -> Task:
    """A task of such an arm, with keyframes, a scan and obstacles with such names."""
    arm = hostile_arm()
    cloud = folder / f"scan {HOSTILE}.npy".replace("/", "")
    np.save(cloud, np.random.default_rng(0).uniform(0.3, 0.4, (20, 3)))
    tip = pp.EndEffector(position=(0.25, 0.0, 0.0), point=arm.control_points[1])
    keyframes = [
        Keyframe(straight_line(), name=HOSTILE, tip=tip),
        *(Keyframe(bent_spline(), time=1.0 + k, trim=True, name=mark) for k, mark in enumerate(MARKS)),
    ]
    return task(*keyframes, arm=arm, scene=hostile_scene(), scans=(cloud,), name=HOSTILE)


@pytest.fixture
def hostile(tmp_path: Path) -> Iterator[Editor]:
    """An editor of such a task, in a file with such a name, and of joint states that are wrong."""
    path = tmp_path / f"y{HOSTILE}.toml".replace("/", "")
    made = hostile_task(tmp_path)
    states = tmp_path / "states.jsonl"
    states.write_text(json.dumps({"name": [made.arm.model.names[1]], "position": [0.1]}) + "\n")
    made.save(path)
    editor = Editor(Task.load(path), path, port=free_port(), joint_states=states)
    editor.start()
    yield editor
    editor.close()


def test_all_places_that_make_html_are_listed() -> None:
    root = Path(str(package.__file__)).parent
    found: dict[str, list[str]] = {}
    for file in sorted(root.rglob("*.py")):
        calls = re.findall(rf"\.({'|'.join(SINKS)})\(", file.read_text(encoding="utf-8"))
        if calls:
            found[file.relative_to(root).as_posix()] = calls
    assert found == PLACES


@pytest.mark.long
def test_no_name_becomes_markup_of_the_page(hostile: Editor) -> None:
    session = hostile.session
    with visiting(hostile.url) as client:

        def said(words: str) -> None:
            until(
                lambda: any(words in Elements(each).words for each in client.shown("content")),
                f"says {words}",
            )

        said(f"{session.path.stem}: saved".replace(": ", ".toml: "))  # File
        said(f"shown at zero: {list(session.arm.model.names)[2]!r}")  # Arm
        hostile.post(lambda each: each.select(0))
        said("Control point 'module_02' goes to")  # Keyframes
        said("Keyframe 1/")  # Toolbar, with its name
        said(f" mm from {HOSTILE}")  # Scene
        for name in (HOSTILE, *MARKS):
            hostile.post(partial(rename, 1, name + "!"))
            said(f"named keyframe 2 {name + '!'!r}")
        client.set("Task file", f"{HOSTILE}.toml")
        client.set("Open this file", True)
        said(f"{HOSTILE}.toml: no such file")
        sent = client.shown(*SENT)
        markdown = client.shown("_markdown")
    names = set().union(*(Elements(each).names for each in sent))
    assert names <= {"div", "b", "br", "span", "style"}
    assert markdown
    assert not [each for each in markdown if "hostile" in each]


def test_no_name_becomes_markup_of_a_page_that_is_saved(tmp_path: Path) -> None:
    motion = hostile_motion()
    text = pp.save_html(motion.arm, motion, tmp_path / "motion").read_text(encoding="utf-8")
    own = text.replace(_viewer_script(), "")
    assert "hostile" in own
    elements = Elements(own)
    assert elements.ids <= {"caption", "stage", "meshcat-pane", "controls", "play", "time", "readout"}
    assert elements.names.isdisjoint({"iframe", "hostile", "img", "a"})
    assert elements.scripts == 2


@pytest.mark.long
def test_no_name_becomes_markup_of_a_picture(tmp_path: Path) -> None:
    motion = hostile_motion()
    picture = tmp_path / "picture.svg"
    pp.plot(motion).savefig(picture)
    names = {each.tag.rpartition("}")[2] for each in ElementTree.parse(picture).iter()}
    assert names.isdisjoint({"iframe", "hostile", "script", "a", "image"})
