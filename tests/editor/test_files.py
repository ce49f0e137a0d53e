"""Files of a session: what was not saved is found again, and nobody's changes are lost in silence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from edited_tasks import six_modules, task
from page_client import until

import pinposture as pp
from pinposture.editor import edits
from pinposture.editor.files import (
    Autosave,
    Files,
    autosave_path,
    first_task,
    recover,
    restore,
    task_files,
    within,
)
from pinposture.editor.session import Session
from pinposture.errors import FileError, no_warnings
from pinposture.task import Task
from pinposture.task.follow_leader import Leader


class Desk:
    """A session and its files, and the requests that were left for the loop."""

    def __init__(self, path: Path) -> None:
        self.session = Session(Task.load(path), path)
        restore(self.session)
        self.requests: list[Callable[[Session], None]] = []
        self.files = Files(self.requests.append, path)
        self.files.watch(self.session)

    def rename(self, name: str) -> None:
        self.session.edit(edits.with_keyframe(0, name=name), "renamed")
        self.files.watch(self.session)

    def open(self, path: Path) -> None:
        self.files.open(self.session, path)
        until(lambda: bool(self.requests))
        self.requests.pop()(self.session)
        self.files.watch(self.session)

    @property
    def name(self) -> str:
        return name_in(self.session.task)


def of_no_template() -> pp.Arm:
    """An arm that is written beside a task."""
    urdf = six_modules().urdf
    assert urdf is not None
    return pp.Arm.load(urdf.replace("RyRz_6", "snake"), split=2)


def name_in(task: Task) -> str:
    return edits.keyframes_of(task)[0].name


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return task().save(tmp_path / "höhle 1.toml")


@pytest.fixture
def desk(path: Path) -> Iterator[Desk]:
    made = Desk(path)
    yield made
    made.files.close()


def test_the_last_of_many_changes_is_kept_and_taken_up(desk: Desk, path: Path) -> None:
    for k in range(200):
        desk.rename(f"the {k}th")
    desk.files.close()
    again = Desk(path)
    assert again.name == "the 199th"
    assert again.session.arm.urdf == six_modules().urdf
    again.session.undo()
    assert again.name == "straight"
    again.files.close()


def test_what_is_taken_up_goes_on_with_the_arm_that_is_there(path: Path) -> None:
    task().edited(name="kept").save(autosave_path(path))
    session = Session(Task.load(path), path)
    arm = session.arm
    restore(session)
    assert session.task.name == "kept"
    assert session.arm is arm
    session.task.save(path)
    assert 'template = "RyRz"' in path.read_text()


def test_saving_leaves_nothing_beside_the_file(desk: Desk, path: Path) -> None:
    desk.rename("a")
    until(autosave_path(path).exists)
    desk.files.save(desk.session)
    desk.files.watch(desk.session)
    desk.files.close()
    assert list(path.parent.iterdir()) == [path]
    assert name_in(Task.load(path)) == "a"


def test_changes_of_one_file_are_kept_though_another_is_opened(desk: Desk, path: Path) -> None:
    other = task().save(path.with_name("other.toml"))
    for k in range(3):  # the last of them is waiting to be written when the other file comes
        desk.rename(f"{k}")
    desk.open(other)
    assert desk.session.path == other
    desk.files.close()
    assert name_in(Task.load(autosave_path(path))) == "2"
    assert not autosave_path(other).exists()


def test_what_waits_to_be_written_is_not_lost_to_another_file(path: Path) -> None:
    saved = Autosave()
    saved.keep(task(), path)
    until(autosave_path(path).exists)
    saved.keep(task().edited(name="last"), path)  # waits: one was written only now
    saved.keep(None, path.with_name("other.toml"))
    saved.close()
    assert Task.load(autosave_path(path)).name == "last"


def test_a_file_that_is_opened_again_keeps_the_last_change(desk: Desk, path: Path) -> None:
    for k in range(3):
        desk.rename(f"{k}")
    desk.open(path)
    assert desk.name == "2"


def test_a_file_that_somebody_else_changed_is_not_written_over_in_silence(desk: Desk, path: Path) -> None:
    task().edited(name="by somebody else").save(path)
    desk.rename("mine")
    with pytest.raises(FileError, match="was changed by another program; save again"):
        desk.files.save(desk.session)
    assert Task.load(path).name == "by somebody else"
    desk.files.save(desk.session)  # whoever has been told, means it
    assert name_in(Task.load(path)) == "mine"
    desk.files.save(desk.session)


def test_a_file_that_is_gone_is_written_again(desk: Desk, path: Path) -> None:
    path.unlink()
    desk.rename("mine")
    desk.files.save(desk.session)
    assert name_in(Task.load(path)) == "mine"


def test_another_file_is_not_written_over(desk: Desk, path: Path) -> None:
    other = task().save(path.with_name("other.toml"))
    with pytest.raises(FileError, match="already exists"):
        desk.files.save(desk.session, other)
    assert desk.session.path == path


def test_a_session_of_a_relative_path_saves_that_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(path.parent)
    session = Session(Task.load(path), Path(path.name))
    files = Files(lambda _: None, path)
    session.edit(edits.with_keyframe(0, name="mine"), "renamed")
    files.save(session)
    files.close()
    assert name_in(Task.load(path)) == "mine"


def test_where_the_file_is_newer_it_counts_and_redo_takes_the_changes_up(path: Path) -> None:
    kept = task().edited(name="kept").save(autosave_path(path))
    os.utime(kept, ns=(0, path.stat().st_mtime_ns - 1))
    desk = Desk(path)
    assert desk.session.task.name == ""
    assert "older than the task file" in desk.session.notice.text
    desk.session.redo()
    assert desk.session.task.name == "kept"
    desk.files.close()


@pytest.mark.parametrize("content", ["no [ toml", 'version = 1\nkind = "follow_leader"\n', ""])
def test_what_cannot_be_read_is_put_aside(content: str, path: Path) -> None:
    autosave_path(path).write_text(content)
    desk = Desk(path)
    assert desk.name == "straight"
    assert "cannot be read" in desk.session.notice.text
    desk.rename("mine")
    desk.files.close()
    assert path.with_name("höhle 1.autosave.1.toml").read_text() == content
    assert name_in(Task.load(autosave_path(path))) == "mine"


def test_a_leader_that_was_left_is_no_task_to_edit(path: Path) -> None:
    leader = Leader(pp.Curve.line((0, 0, 0), (1, 0, 0)), 0.1)
    Task(six_modules(), leader, pp.Limits(dt=0.02)).save(autosave_path(path))
    left = recover(path)
    assert left is not None
    assert left.task is None
    assert "leader" in left.complaint


def test_two_editors_of_one_file_are_told_of(path: Path) -> None:
    one = Desk(path)
    other = Desk(path)
    one.rename("one")
    until(autosave_path(path).exists)
    other.rename("other")
    until(lambda: name_in(Task.load(autosave_path(path))) == "other")
    one.rename("one again")
    one.files.close()
    one.files.watch(one.session)
    assert "another program also writes höhle 1.autosave.toml" in one.session.notice.text
    other.files.close()


def test_what_cannot_be_kept_is_told_and_tried_again(desk: Desk, path: Path) -> None:
    autosave_path(path).mkdir()
    desk.rename("a")

    def told() -> bool:
        desk.files.watch(desk.session)
        return "cannot be autosaved" in desk.session.notice.text

    until(told)
    autosave_path(path).rmdir()
    desk.rename("b")
    desk.files.close()
    assert name_in(Task.load(autosave_path(path))) == "b"


def test_an_arm_that_is_kept_beside_the_task_goes_with_it(path: Path) -> None:
    arm = of_no_template()
    saved = Autosave()
    kept = autosave_path(path)
    saved.keep(task(arm=arm), path)
    saved.finish()
    assert {each.name for each in path.parent.iterdir()} == {
        path.name,
        kept.name,
        kept.with_suffix(".urdf").name,
    }
    session = Session(task(), path)
    restore(session)
    assert session.arm.urdf == arm.urdf
    assert session.arm not in session.task.described  # what is beside it goes
    saved.keep(None, path)
    saved.close()
    assert list(path.parent.iterdir()) == [path]
    session.task.save(path)
    assert Task.load(path).arm.control_points == session.arm.control_points


def test_a_file_that_cannot_be_opened_is_told(desk: Desk, path: Path) -> None:
    for name in ("missing.toml", "folder.toml", "x\0y.toml", "n" * 300 + ".toml"):
        (path.parent / "folder.toml").mkdir(exist_ok=True)
        desk.open(path.parent / name)
        assert desk.session.notice.text.startswith("cannot open it:")


SPELLED_OUTSIDE = (
    "/etc/passwd",
    "{root}/outside.toml",
    "{root}/desk/own.toml",  # it would be inside, but no name from the root is taken
    "~/new.toml",
    "~",
    "~nobody_of_this_name/x.toml",
    "../outside.toml",
    "..",
    "sub/../own.toml",
    "sub/../../outside.toml",
)
"""Names that lead out of the folder `desk`, or look as if they might."""

LINKED_OUTSIDE = ("way/x.toml", "way/sub/x.toml", "link.toml", "to nothing.toml", "sub/far.toml")
"""Names in it that links lead out of it."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder, with links out of it and inside it."""
    made = tmp_path / "desk"
    other = tmp_path / "other"
    for each in (made / "sub", other):
        each.mkdir(parents=True)
    task().save(other / "foreign.toml")
    (made / "way").symlink_to(other)
    (made / "link.toml").symlink_to(other / "foreign.toml")
    (made / "to nothing.toml").symlink_to(other / "nothing.toml")
    (made / "sub" / "far.toml").symlink_to("../../other/foreign.toml")
    (made / "near.toml").symlink_to("sub/near.toml")
    (made / "circle.toml").symlink_to("circle.toml")
    return made


@pytest.mark.parametrize("name", (*SPELLED_OUTSIDE, *LINKED_OUTSIDE))
def test_names_that_lead_out_of_the_folder_are_refused(name: str, folder: Path) -> None:
    for start in (None, folder / "sub") if name in SPELLED_OUTSIDE else (None,):
        with pytest.raises(FileError) as refused:
            within(folder, name.format(root=folder.parent), start)
        told = str(refused.value)
        assert f"is not a file in {folder}; allowed: files in that folder; --folder chooses another" in told


@pytest.mark.parametrize("name", ["own.toml", "sub/a/b.toml", "a..b.toml", "near.toml", "höhle 1.toml"])
def test_names_in_the_folder_are_taken(name: str, folder: Path) -> None:
    assert within(folder, name) == folder / name
    assert within(folder, "x.ply", folder / "sub") == folder / "sub" / "x.ply"
    way = folder.parent / "desk by a link"
    way.symlink_to(folder)
    assert within(way, name) == way / name


@pytest.mark.parametrize("name", ["x\0y.toml", "circle.toml/x.toml"])
def test_names_that_no_file_can_have_are_refused(name: str, folder: Path) -> None:
    try:
        found = within(folder, name)
    except FileError:
        return
    assert found.parent.parent == folder  # newer Pythons take a circle for a name like another


def test_an_autosave_is_not_written_through_a_link(folder: Path) -> None:
    path = task().save(folder / "own.toml")
    prey = folder.parent / "prey"
    prey.write_text("of somebody else")
    autosave_path(path).symlink_to(prey)
    saved = Autosave()
    saved.keep(task().edited(name="mine"), path)
    saved.finish()
    assert "is a link" in saved.complaint
    saved.close()
    assert prey.read_text() == "of somebody else"


def test_an_arm_is_not_written_through_a_link(folder: Path) -> None:
    path = task().save(folder / "own.toml")
    prey = folder.parent / "prey.urdf"
    made = Desk(path)
    made.session.replace(task(arm=of_no_template()), path, saved=False)
    (folder / "own.urdf").symlink_to(prey)
    with pytest.raises(FileError, match="is a broken link"):
        made.files.save(made.session)
    assert not prey.exists()
    (folder / "own.urdf").unlink()
    made.files.save(made.session)
    assert (folder / "own.urdf").is_file()
    made.files.close()


def test_a_task_file_is_in_the_folder_to_edit_in(folder: Path) -> None:
    path = task().save(folder / "sub" / "own.toml")
    assert Session(Task.load(path), path).folder == path.parent
    assert Session(Task.load(path), path, folder=folder).folder == folder
    with pytest.raises(FileError, match="is not in the folder to edit in"):
        Session(task(), folder / "own.toml", folder=folder / "sub")
    with pytest.raises(FileError, match="no such folder"):
        Session(task(), None, folder=folder / "nowhere")


WRITER = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[2:]
from test_files import Desk
desk = Desk(Path(sys.argv[1]))
print("ready", flush=True)
for k in range(10**6):
    desk.rename(str(k))
    if k % 5 == 4:
        desk.files.save(desk.session)
"""


@pytest.mark.process
@pytest.mark.parametrize("delay", [0.0, 0.05, 0.11, 0.34])
def test_files_are_whole_whenever_it_is_killed(delay: float, path: Path) -> None:
    command = [sys.executable, "-c", WRITER, str(path), *map(str, Path(__file__).parents[:2])]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    Task.load(path)
    left = recover(path)
    assert left is None or left.task is not None


def test_task_files_to_choose_from_are_those_of_the_folder_the_latest_first(tmp_path: Path) -> None:
    left_out = ("new.autosave.toml", "motion.json", ".git/x.toml", "a/b/c.toml")
    names = ("old.toml", "new.toml", "sub/in.toml", *left_out)
    for number, name in enumerate(names):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
        os.utime(tmp_path / name, (0.0, 1000.0 + number))
    (tmp_path / "gone.toml").symlink_to(tmp_path / "nowhere.toml")
    (tmp_path / "folder.toml").mkdir()
    assert task_files(tmp_path) == ("sub/in.toml", "new.toml", "old.toml")


@pytest.mark.long
@pytest.mark.parametrize("joint", [pp.JointSpec("z", "prismatic", 0.0, 0.1), pp.JointSpec("z", lower=0.9)])
def test_the_keyframes_of_an_arm_that_takes_no_line_are_taught(joint: pp.JointSpec) -> None:
    arm = pp.Arm.from_modules([pp.ModuleTemplate("module", (joint,), (0.1,))] * 3)
    first = first_task(arm)
    straight, bent = first.motion  # type: ignore[misc]
    assert (straight.curve, bent.curve, straight.joints == bent.joints) == (None, None, False)
    assert first.perform().converged
    line = edits.keyframes_of(first_task(six_modules()))[0].curve
    assert line is not None


@pytest.mark.parametrize("modules", [1, 3])
def test_an_arm_of_roll_joints_only_is_opened_straight(modules: int) -> None:
    roll = pp.ModuleTemplate("Rx", (pp.JointSpec("x"),), (0.1,))
    with no_warnings():  # it is one module
        arm = pp.Arm.from_modules([roll] * modules)
    shapes = [each.curve for each in first_task(arm).motion]  # type: ignore[union-attr]
    for curve in shapes:
        assert curve is not None
        np.testing.assert_allclose(curve.at([0.0, arm.length]), [[0, 0, 0], [arm.length, 0, 0]], atol=1e-9)
