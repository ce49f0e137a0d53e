"""The directory of a run: what is in it from before, and whether that was finished."""

from __future__ import annotations

import json
import re
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from pinposture.errors import PostureError
from pinposture.storage import check_writable, write_text

STATUS = "status.json"
"""File that says what a directory holds."""

_DRAFT = re.compile(r"\..+\.[0-9a-f]{32}")
"""Names of files that were being written (`pinposture.storage`)."""


class Folder:
    """A directory that is to hold the results of a run.

    Args:
        path: the directory; need not exist yet.

    Raises:
        FileError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        check_writable(path)
        self.path = path
        self._begun = _now()

    def found(self) -> str:
        """What is there from before, in words; empty if nothing is."""
        drafts = [each for each in self._files() if _DRAFT.fullmatch(each.name)]
        names = sorted(each.name for each in self._files() if each not in drafts and each.name != STATUS)
        held = f"there {'are' if len(names) > 1 else 'is'} {', '.join(names)}" if names else "there is no result"
        left = f", and {len(drafts)} half-written files, which are removed" if drafts else ""
        status = self._status()
        if status is None:
            return f"{self.path}: {held}{left}" if names or drafts else ""
        task, begun = status.get("task"), status.get("begun")
        if status.get("state") == "finished":
            return f"{self.path} holds the results of {task}, finished {status.get('ended')}; they are replaced"
        return f"{self.path}: a run of {task}, begun {begun}, was not finished; {held}{left}"

    def begin(self, task: str) -> None:
        """Clear away what was half-written, and write down what is begun.

        Results from before stay until there are new ones in their place.
        """
        for each in self._files():
            if _DRAFT.fullmatch(each.name):
                each.unlink(missing_ok=True)
        self._write({"task": task, "state": "running", "begun": self._begun})

    def finish(self, task: str, files: list[str]) -> None:
        """Write down that all is there."""
        ended = {"task": task, "state": "finished", "begun": self._begun, "ended": _now(), "files": files}
        self._write(ended)

    def _files(self) -> list[Path]:
        try:
            return [each for each in self.path.iterdir() if each.is_file()]
        except OSError:
            return []

    def _status(self) -> dict[str, Any] | None:
        try:
            status = json.loads((self.path / STATUS).read_text(encoding="utf-8"))
        except (OSError, ValueError, PostureError):
            return None
        return status if isinstance(status, dict) else None

    def _write(self, status: dict[str, Any]) -> None:
        write_text(self.path / STATUS, json.dumps(status, indent=1) + "\n")


def _now() -> str:
    return datetime.now(timezone.utc).astimezone().isoformat(timespec="seconds")
