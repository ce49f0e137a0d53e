"""Names that are typed into the page: wherever one becomes a path, it stays in the folder of the editor."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import free_port
from editor.edited_tasks import task
from editor.page_client import Client, until, visiting

from pinposture import editor as package
from pinposture.editor import Editor
from pinposture.editor.files import within
from pinposture.errors import FileError
from pinposture.task import Task

NAMES = (
    "{root}/abs.{end}",
    "~/new.{end}",
    "~/.config/a/b.{end}",
    "../other/foreign.{end}",
    "way/foreign.{end}",
)

WAYS = {
    "ui/files.py": 2,  # save, open
    "ui/scene.py": 1,  # load, as a scan or as an obstacle
}
"""Where a name that was typed becomes a path, and how often. An upload has the last part of its name only."""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("desk", "home", "other"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    task().save(tmp_path / "desk" / "own.toml")
    task().save(tmp_path / "other" / "foreign.toml")
    task().save(tmp_path / "abs.toml")
    (tmp_path / "other" / "foreign.xyz").write_text("1 1 1\n2 2 2\n")
    (tmp_path / "desk" / "way").symlink_to(tmp_path / "other")
    return tmp_path


@pytest.fixture
def editor(root: Path) -> Iterator[Editor]:
    path = root / "desk" / "own.toml"
    made = Editor(Task.load(path), path, port=free_port())
    made.start()
    yield made
    made.close()


def says(editor: Editor, words: str) -> None:
    until(lambda: words in editor.session.notice.text, f"says {words}")


def press(client: Client, label: str, name: str, button: str) -> None:
    client.set(label, name)
    client.set(button, True)


def test_a_file_without_a_name_is_refused(root: Path) -> None:
    with pytest.raises(FileError, match="has no name yet"):
        within(root, "")


def test_nothing_outside_is_saved_opened_or_loaded(editor: Editor, root: Path) -> None:
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    asked = editor.session.task
    with visiting(editor.url) as client:
        for name in NAMES:
            for button in ("Save under this name", "Open this file"):
                editor.session.say("nothing yet")
                typed = name.format(root=root, end="toml")
                press(client, "Task file", typed, button)
                told = f"{typed}: is not a file in {root / 'desk'}; allowed: files in that folder"
                says(editor, told)
            for kind in ("scan", "obstacle"):
                editor.session.say("nothing yet")
                client.set("Load as", kind)
                typed = name.format(root=root, end="xyz")
                press(client, "File", typed, "Load")
                says(editor, f"{typed}: is not a file in {root / 'desk'}")
    assert editor.session.task is asked
    assert editor.session.path == root / "desk" / "own.toml"
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before


def test_folders_in_the_folder_can_be_used(editor: Editor, root: Path) -> None:
    with visiting(editor.url) as client:
        press(client, "Task file", "sub/deep/new.toml", "Save under this name")
        says(editor, "saved as new.toml")
        assert Task.load(root / "desk" / "sub" / "deep" / "new.toml")
        with visiting(editor.url) as other:
            until(lambda: "sub/deep/new.toml" in other.shown("value"), "it is shown from the folder on")
        press(client, "Task file", "own.toml", "Open this file")
        says(editor, "opened own.toml")
        (root / "desk" / "cloud.xyz").write_text("1 1 1\n2 2 2\n")
        press(client, "File", "cloud.xyz", "Load")
        says(editor, "added the scan cloud.xyz")


def test_all_ways_from_a_name_to_a_path_are_listed() -> None:
    root = Path(str(package.__file__)).parent
    pages = {file: file.read_text(encoding="utf-8") for file in sorted(root.glob("ui/*.py"))}
    ways = {
        file.relative_to(root).as_posix(): len(re.findall(r"\bwithin\(", text))
        for file, text in pages.items()
    }
    assert {file: count for file, count in ways.items() if count} == WAYS
    assert not [
        file.name for file, text in pages.items() if re.search(r"(?<![.\w])(Path|open)\(|expanduser", text)
    ]
