"""What a notebook shows: HTML from the formatters that are registered with IPython."""

from __future__ import annotations

import base64
import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib import import_module
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture import notebook
from pinposture.motion.words import in_words

IPython = pytest.importorskip("IPython")


@pytest.fixture(scope="module")
def shown() -> Any:
    from IPython.core.formatters import DisplayFormatter

    class Shell:
        display_formatter = DisplayFormatter()

    notebook.register(Shell())

    def show(value: object) -> str:
        data, _ = Shell.display_formatter.format(value)
        return data.get("text/html", "")

    return show


@pytest.mark.long
def test_notebook_figure_and_page_say_the_same_words(shown: Any, tmp_path: Any) -> None:
    arm = pp.Arm.from_template("RyRz", modules=3)
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.4))
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0)
    ended = pp.track(arm, target, arm.straight(), limits=limits)
    broken_off = pp.track(arm, target, arm.straight(), limits=limits, max_steps=3)
    for run in (ended, broken_off):
        words = in_words(run.summary())
        said = words["verdict"], words["steps"]
        title = " ".join(pp.plot(run).get_suptitle().split())
        page = pp.save_html(arm, run, tmp_path / "run").read_text(encoding="utf-8")
        head = " ".join(re.sub("<[^>]*>", " ", page[page.index("<h1>") : page.index('id="stage"')]).split())
        for each in said:
            assert each in title
            assert each in re.sub("<[^>]*>", "", shown(run))
        assert f"{run.verdict.removesuffix(run.reason).rstrip(': ')} {run.reason}" in head
        assert words["steps"] in head


class Rows(HTMLParser):
    """The rows of a table, and the tags that were left open."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag != "img":
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("th", "td"):
            self.rows[-1].append(data)


def table(page: str) -> dict[str, str]:
    parsed = Rows(page)
    assert not parsed.open
    return {row[0]: row[1] for row in parsed.rows if len(row) == 2}


def picture(page: str) -> bytes:
    [data] = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    return base64.b64decode(data)


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=4)


def test_every_class_is_where_its_formatter_looks_for_it() -> None:
    for module, name, _ in notebook.SHOWN:
        assert getattr(import_module(module), name).__module__ == module


def test_an_arm_shows_what_it_is_and_a_picture(shown: Any, arm: pp.Arm) -> None:
    page = shown(arm)
    rows = table(page)
    assert rows["degrees of freedom"] == "8, spatial"
    assert rows["length"] == "200 mm"
    assert rows["angle limits"] == f"{arm.limits.lower[0]:.4g} to {arm.limits.upper[0]:.4g} rad"
    assert picture(page).startswith(b"\x89PNG")


def test_names_cannot_break_the_page(shown: Any) -> None:
    model = pin.Model()
    model.name = "<script>alert(1)</script>"
    end = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "a<b")
    placement = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("end&", end, 0, placement, pin.FrameType.OP_FRAME))
    page = shown(pp.Arm.from_model(model, ["end&"]))
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "end&amp;" in page


@pytest.mark.long
def test_a_target_and_a_run_show_how_well_they_did(shown: Any, arm: pp.Arm) -> None:
    target = pp.resolve_targets(arm, pp.Curve.helix(0.2, 0.0, 0.5), placement="align")
    rows = table(shown(target))
    assert rows["control points"] == "4 of 4 have a target"
    assert rows["placed"] == target.method
    run = pp.track(arm, target, arm.straight())
    page = shown(run)
    assert table(page)["verdict"] == f"reached the target (converged): {run.reason}"
    first, last = np.linalg.norm(run.points[[0, -1]] - target.points, axis=2)
    errors = table(page)["point errors"]
    assert errors.startswith(f"mean {1e3 * first.mean():.3g} mm at the start")
    assert last.max() < 1e-9 * arm.length
    assert errors.endswith("largest below rounding")
    assert table(page)["steps"] == str(run.steps)
    assert picture(page).startswith(b"\x89PNG")
    bare = table(shown(pp.Target.from_points(arm, target.points)))
    assert bare["configuration"] == "not known"
    assert "placed" not in bare


@pytest.mark.long
def test_motions_and_joint_trajectories_show_their_time(shown: Any, arm: pp.Arm) -> None:
    bows = [pp.Curve.helix(radius, 0.0, 0.5) for radius in (0.4, 0.2)]
    frames = [pp.Keyframe(each, time=1.0 * k, placement="align", trim=True) for k, each in enumerate(bows)]
    motion = pp.move_through(arm, frames, limits=pp.Limits(step=None, velocity=2.0, dt=0.02))
    rows = table(shown(motion))
    assert rows["duration"].startswith(f"{motion.duration:.4g} s, ")
    joints = motion.joint_trajectory()
    page = shown(joints)
    assert picture(page).startswith(b"\x89PNG")
    size = f"{arm.nv} joints, {len(joints.time)} points, {joints.duration:.4g} s"
    assert table(page)["motion"] == size


@pytest.mark.long
def test_a_run_in_a_scene_shows_its_duration_and_what_came_closest(shown: Any, arm: pp.Arm) -> None:
    scene = pp.Scene({"ball": pp.Sphere((0.4, 0.0, 0.0), 0.05)}, margin=0.01)
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.1))
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0)
    run = pp.track(arm, target, arm.straight(), limits=limits, scene=scene)
    rows = table(shown(run))
    assert rows["steps"] == f"{run.steps}, {0.02 * run.steps:.4g} s"
    least = min(pp.CollisionModel(arm, scene).minimum(q) for q in run.q)
    said = f"{1e3 * least.distance:.3g} mm where it is smallest, {' to '.join(least.pair)}, after "
    assert rows["clearance"].startswith(said)
    assert rows == in_words(run.summary())


@pytest.mark.long
def test_a_figure_shows_its_picture(shown: Any, arm: pp.Arm) -> None:
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.1))
    assert picture(shown(pp.plot(pp.track(arm, target, arm.straight())))).startswith(b"\x89PNG")


def test_what_a_user_makes_shows_a_table(shown: Any, arm: pp.Arm) -> None:
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0)
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.1))
    tracker = pp.Tracker(arm, limits=limits)
    tracker.update(target)
    tracker.step(arm.straight())
    assert table(shown(limits))["velocity"] == "1 rad/s or m/s"
    assert table(shown(tracker))["status"] == "moving"
    assert table(shown(pp.Curve.line((0, 0, 0), (2, 0, 0))))["length"] == "2 m"
    scene = pp.Scene({"<b>": pp.Sphere((0.4, 0.0, 0.0), 0.05)}, margin=0.01)
    assert table(shown(scene))["margin"] == "10 mm"
    assert table(shown(scene))["<b>"].startswith("Sphere(")
    batch = pp.track_many(arm, target, np.zeros((2, arm.nq)), limits=limits)
    assert table(shown(batch))["runs"] == "2: 2 converged"
    (reached,) = pp.reach(arm, (0.1, 0.05, 0.05))
    assert table(shown(reached))["path"] == "not asked for"
    assert len(repr(reached)) < 120


@pytest.mark.process
def test_importing_the_package_in_a_shell_registers_it_and_imports_no_viewer() -> None:
    code = (
        "from IPython.core.interactiveshell import InteractiveShell\n"
        "shell = InteractiveShell.instance()\n"
        "import sys, pinposture as pp\n"
        "assert 'matplotlib.figure' not in sys.modules and 'pinocchio' not in sys.modules\n"
        "data, _ = shell.display_formatter.format(pp.Arm.from_template('RyRz', modules=2))\n"
        "print(data['text/html'][:20])\n"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip().endswith("<div><b>RyRz_2</b><t")


def test_an_animation_is_a_page_in_a_frame(shown: Any, arm: pp.Arm, tmp_path: Any) -> None:
    run = pp.track(arm, pp.Target.from_configuration(arm, arm.configuration([0.2] * arm.nv)), arm.straight())
    made = pp.animate(arm, run)
    frame = shown(made)
    parsed = HTMLParser()
    found: list[str] = []
    parsed.handle_starttag = lambda tag, attrs: found.append(dict(attrs)["srcdoc"])  # type: ignore[method-assign]
    parsed.feed(frame)
    assert found == [made.html]
    assert (
        made.html
        == pp.save_html(arm, run, tmp_path / "run").read_text()
        == made.save(tmp_path / "b").read_text()
    )
