"""A whole task file: what stands in it, and that it gives the task back before it is put in its place."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinposture.errors import FileError, PostureError
from pinposture.storage import check_writable, write_text
from pinposture.task.checks import FORMATS
from pinposture.task.keyframe import usual_placement
from pinposture.task.leader import Leader
from pinposture.task.paths import relative
from pinposture.task.reading.content import check_format, content_of
from pinposture.task.reading.document import Document
from pinposture.task.reading.tasks import VERSION, read_task
from pinposture.task.writing.arms import WrittenArm, write_arm
from pinposture.task.writing.json import json_text
from pinposture.task.writing.motions import write_keyframe, write_leader
from pinposture.task.writing.robots import write_controller, write_limits, write_scene, write_start
from pinposture.task.writing.same import differences
from pinposture.task.writing.toml import toml_text
from pinposture.task.writing.wording import Wording

if TYPE_CHECKING:
    from pinposture.task.task import Task


def write_task(task: Task, path: Path) -> Path:
    """Write a task file, and a URDF file beside it if it takes one; see `Task.save`."""
    check_format(path)
    with _naming(path), _folder(path.parent):  # ways to other files lead through it
        wording = Wording(path, task.described)
        arm = write_arm(task.arm, wording)
        text = _text(path, _contents(task, arm, wording))
        _read_back(task, path, text)
        if arm.file is not None:
            write_text(arm.file, arm.text)
        try:
            write_text(path, text)
        except BaseException:
            if arm.file is not None:  # which nobody needs without the task
                arm.file.unlink(missing_ok=True)
            raise
    return path


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Refuse a name that no file can have: too long, with a null byte, or links that lead in a circle."""
    try:
        yield
    except PostureError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(path, f"cannot be written ({reason})") from error


@contextmanager
def _folder(folder: Path) -> Iterator[None]:
    """Make a folder if there is none; it goes again if nothing comes into it."""
    check_writable(folder)
    new = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(folder, f"cannot be made ({error.strerror or error})") from error
    try:
        yield
    except BaseException:
        for each in new:
            with suppress(OSError):
                each.rmdir()
        raise


def _contents(task: Task, arm: WrittenArm, wording: Wording) -> dict[str, Any]:
    """All tables, in the order in which they stand in the file; without those that say what is as usual."""
    leader = isinstance(task.motion, Leader)
    contents: dict[str, Any] = {"version": VERSION, "kind": "follow_leader" if leader else "keyframes"}
    if task.name != wording.file.stem:
        contents["name"] = task.name
    if task.continuity != "velocity":
        contents["continuity"] = task.continuity
    contents["arm"] = arm.table
    contents["limits"] = write_limits(task.limits, task.arm)
    controller = write_controller(task.controller, wording)
    if controller:
        contents["controller"] = controller
    if task.start is not None:
        contents["start"] = write_start(task.start, task.arm)
    if task.scene is not None:
        contents["scene"] = write_scene(task.scene, wording)
    usual = usual_placement(task.scene)
    if isinstance(task.motion, Leader):
        contents["leader"] = write_leader(task.motion, usual, wording)
    else:
        contents["keyframes"] = [write_keyframe(each, usual, wording) for each in task.motion]
    if task.formats != FORMATS:
        contents["output"] = {"formats": list(task.formats)}
    if task.scans:
        contents["editor"] = {"scans": [relative(scan, wording.folder) for scan in task.scans]}
    plain: dict[str, Any] = _plain(contents)
    return plain


def _plain(value: Any) -> Any:
    """The same without what numpy or a number of another kind has put in."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, bool | int | str):
        return value
    return float(value)


def _text(path: Path, contents: dict[str, Any]) -> str:
    text = toml_text(contents) if path.suffix.lower() == ".toml" else json_text(contents)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        reason = (
            f"{text[error.start]!r} in a text of the task, half of a surrogate pair, is nothing for a file"
        )
        raise FileError(path, reason) from None
    return text


def _read_back(task: Task, path: Path, text: str) -> None:
    """Refuse to write what would be read as something else.

    Raises:
        FileError: it would.
    """
    parts = read_task(Document(path, content_of(path, text)), task.arm)
    wrong = differences(task, parts)
    if wrong:
        raise FileError(path, f"cannot hold the task: {', '.join(wrong)} would be read as something else")
