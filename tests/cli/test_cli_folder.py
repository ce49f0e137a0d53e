"""What a directory says of the run before."""

from __future__ import annotations

import json
import os
import uuid
from pathlib import Path

import pytest

from pinposture.cli.output import FILES
from pinposture.cli.run import Folder
from pinposture.errors import FileError
from pinposture.storage import write_text


def status(path: Path) -> dict[str, object]:
    return json.loads((path / FILES.status).read_text())


def run(path: Path, *files: str, finish: bool = True, task: str = "old.toml") -> None:
    """A run that leaves these files."""
    folder = Folder(path, task)
    folder.begin()
    for name in files:
        write_text(path / name, task)
    if finish:
        folder.finish(list(files))


def draft(path: Path, name: str = "motion.npz") -> Path:
    made = path / f".{name}.{uuid.uuid4().hex}"
    made.write_text("half")
    return made


def older(path: Path) -> None:
    """Make all that is there older, so that a clock that ticks slowly can tell."""
    for each in path.iterdir():
        stat = each.stat()
        os.utime(each, ns=(stat.st_atime_ns, stat.st_mtime_ns - 10**10))


@pytest.mark.parametrize("there", [False, True])
def test_of_an_empty_directory_nothing_is_said(tmp_path: Path, there: bool) -> None:
    path = tmp_path / "out"
    if there:
        path.mkdir()
        (path / "notes.txt").write_text("mine")
    folder = Folder(path, "task.toml")
    assert folder.found() == ""
    assert not (path / FILES.status).exists()  # nothing is written before it begins


def test_a_status_while_it_runs_and_when_it_is_finished(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "out"
    folder = Folder(path, "task.toml")
    folder.begin()
    running = status(path)
    assert (running["task"], running["state"]) == ("task.toml", "running")
    folder.finish(["motion.csv"])
    done = status(path)
    assert (done["task"], done["state"], done["files"]) == ("task.toml", "finished", ["motion.csv"])
    assert done["begun"] == running["begun"] <= done["ended"]


def test_what_was_finished_is_said_to_be_replaced(tmp_path: Path) -> None:
    run(tmp_path, "motion.csv", "motion.npz")
    said = Folder(tmp_path, "new.toml").found()
    assert said.startswith(f"{tmp_path} holds the results of old.toml, finished 2")
    assert said.endswith("; replaced when this run finishes")


def test_what_was_not_finished_is_told_from_what_is_older(tmp_path: Path) -> None:
    run(tmp_path, "motion.csv", "motion.npz", "motion.png")
    older(tmp_path)
    run(tmp_path, "motion.png", finish=False, task="killed.toml")
    said = Folder(tmp_path, "new.toml").found()
    assert "a run of killed.toml, begun 2" in said
    assert said.endswith("was not finished; it left motion.png, and motion.csv, motion.npz from before it")


def test_a_run_that_left_nothing(tmp_path: Path) -> None:
    run(tmp_path, finish=False)
    assert Folder(tmp_path, "new.toml").found().endswith("that was not finished; it left no result")


def test_a_run_that_failed_says_why(tmp_path: Path) -> None:
    folder = Folder(tmp_path, "task.toml")
    folder.begin()
    folder.fail("no way")
    assert (status(tmp_path)["state"], status(tmp_path)["reason"]) == ("failed", "no way")
    assert "that failed (no way); it left no result" in Folder(tmp_path, "new.toml").found()


def test_drafts_are_counted_and_removed_and_nothing_else(tmp_path: Path) -> None:
    drafts = [draft(tmp_path), draft(tmp_path, "status.json")]
    others = [tmp_path / name for name in (".hidden", f".{uuid.uuid4().hex}", "motion.csv", "notes.txt")]
    for each in others:
        each.write_text("mine")
    folder = Folder(tmp_path, "task.toml")
    said = folder.found()
    replaced = f"{tmp_path} holds motion.csv; replaced when this run finishes"
    assert said == f"{replaced}; half-written files, removed now: 2"
    folder.begin()
    assert not any(each.exists() for each in drafts)
    assert [each.read_text() for each in others] == ["mine"] * 4


def test_results_that_have_no_successor_go_when_the_new_ones_are_there(tmp_path: Path) -> None:
    run(tmp_path, "motion.html", "motion.npz")
    (tmp_path / "motion.txt").write_text("mine")  # of another origin
    run(tmp_path, "motion.npz", finish=False, task="killed.toml")
    assert (tmp_path / "motion.html").exists()
    run(tmp_path, "motion.npz", "motion.csv", task="new.toml")
    assert {each.name for each in tmp_path.iterdir()} == {
        "motion.npz",
        "motion.csv",
        "motion.txt",
        FILES.status,
    }


def test_a_status_cannot_name_files_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.mkdir()
    (tmp_path / "motion.npz").write_text("mine")
    (path / FILES.status).write_text(
        json.dumps({"state": "finished", "files": ["../motion.npz", 3, None], "before": 7})
    )
    run(path)
    assert (tmp_path / "motion.npz").read_text() == "mine"


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", "null", "\0", "[" * 100_000, '{"state": 7, "files": {}}']
)
def test_a_status_that_is_none_does_no_harm(tmp_path: Path, text: str) -> None:
    (tmp_path / FILES.status).write_text(text)
    folder = Folder(tmp_path, "task.toml")
    assert "\n" not in folder.found()
    folder.begin()
    folder.finish([])
    assert status(tmp_path)["state"] == "finished"


def test_directories_that_cannot_be_written_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(FileError, match="is a file; allowed: a directory"):
            Folder(path, "task.toml")
    (tmp_path / FILES.status).mkdir()
    with pytest.raises(FileError, match="is a directory"):
        Folder(tmp_path, "task.toml").begin()
    monkeypatch.setattr(os, "access", lambda *_: False)  # who is root may write anywhere
    with pytest.raises(FileError, match="permission denied"):
        Folder(tmp_path, "task.toml")


def test_why_it_failed_is_not_lost_where_it_cannot_be_written(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "out", "task.toml")
    folder.begin()
    (tmp_path / "out" / FILES.status).unlink()
    (tmp_path / "out").rmdir()
    (tmp_path / "out").touch()
    folder.fail("no way")  # says nothing of its own
