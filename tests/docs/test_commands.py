"""The shell commands that pages show are ones: verbs, options, make targets and scripts that exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from benchmarks.__main__ import SCRIPTS
from benchmarks.__main__ import app as evidence
from pinposture.cli import app

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
FENCED = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`(pinposture(?: [^`]+)|make [^`]+|python [^`]+)`")


def lines(page: Path) -> list[str]:
    """Whole commands of a page: in fences, and indented."""
    text = page.read_text()
    shown = [line for block in FENCED.findall(text) for line in block.splitlines()]
    return [line.strip() for line in (*shown, *re.findall(r"^    (?:\w+) .*$", text, re.MULTILINE))]


def mentioned(page: Path) -> list[str]:
    """Commands in the text of a page, perhaps without all that they need."""
    return [" ".join(command.split()) for command in INLINE.findall(page.read_text())]


def resolve(words: list[str], program: typer.Typer) -> tuple[Any, list[str]]:
    """The command of a program that words name, and the words left for it."""
    command: Any = typer.main.get_command(program)
    while words and hasattr(command, "commands"):
        assert words[0] in command.commands, f"no verb {words[0]!r}"
        command = command.commands[words[0]]
        words = words[1:]
    return command, words


def check(command: str, complete: bool) -> bool:
    """Check one command; tells whether it was one of ours."""
    program, *words = shlex.split(command, comments=True)
    if program == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        target, *given = words
        assert target in (*targets, "study", "reproduce", "score"), f"no target {target!r}"
        if target in ("study", "reproduce", "score"):
            study = [word.removeprefix("STUDY=") for word in given if word.startswith("STUDY=")]
            rest = given[given.index("--") + 1 :] if "--" in given else []
            check_options([target, *study, *rest], evidence, complete)
    elif program == "python":
        if words[0] == "-m":
            words[:2] = [f"{words[1].replace('.', '/')}.py"]
        assert (ROOT / words[0]).is_file() or (ROOT / words[0]).with_suffix("").is_dir(), f"no {words[0]!r}"
    elif program == "pinposture":
        check_options(words, app, complete)
    else:
        return False
    return True


def check_options(words: list[str], program: typer.Typer, complete: bool) -> None:
    """Check that a program has a verb with such options."""
    if words and words != ["--help"]:
        found, rest = resolve(words, program)
        if found.name in SCRIPTS:  # they read their options themselves
            return
        options = {name for each in found.params for name in (*each.opts, *each.secondary_opts)}
        options.add("--help")
        for word in rest[: rest.index("--")] if "--" in rest else rest:  # behind it are those of ROS 2
            assert not re.match("--?[a-zA-Z]", word) or word.split("=")[0] in options, f"no option {word!r}"
        if complete and not hasattr(found, "commands"):
            found.make_context(found.name, list(rest))  # parses, and refuses what the verb would


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_the_commands_of_a_page_are_commands(page: Path) -> None:
    for command in lines(page):
        if command.split()[0] in ("make", "python", "pinposture"):
            assert check(command, complete=True)
    for command in mentioned(page):
        assert check(command, complete=False)


def test_commands_that_are_none_are_noticed() -> None:
    for command in (
        "pinposture trak a.urdf --curve helix",
        "pinposture track a.urdf --curve helix --sed 3",
        "pinposture nothing",
        "make study STUDY=nothing",
        "make study STUDY=clutter -- --sed 3",
        "python -m benchmarks.nothing",
        "make nothing",
        "python examples/99_nothing.py",
    ):
        with pytest.raises(AssertionError):
            check(command, complete=False)
    for command in ("pinposture track --curve helix", "pinposture batch a.urdf --curve helix --count x"):
        with pytest.raises(typer.BadParameter.__bases__[0]):
            check(command, complete=True)
    shown = [command for page in PAGES for command in (*lines(page), *mentioned(page))]
    assert sum(command.startswith("pinposture ") for command in shown) > 40
