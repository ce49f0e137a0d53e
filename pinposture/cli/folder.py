"""The directory of a run: what is in it from before, and whether that was finished."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from pinposture.errors import PostureError
from pinposture.storage import check_writable, write_text

STATUS = "status.json"
"""File that says what a directory holds."""

_RESULT = re.compile(r"motion\.[a-z]+")
"""Names of files that are kept of a motion."""

_DRAFT = re.compile(r"\..+\.[0-9a-f]{32}")
"""Names of files that were being written (`pinposture.storage`)."""


class Folder:
    """A directory that is to hold the results of one run at a time.

    Args:
        path: the directory; need not exist yet.
        task: what is to be run, for whoever looks into the directory later.

    Raises:
        FileError: it cannot be written.
    """

    def __init__(self, path: Path, task: str) -> None:
        check_writable(path)
        self.path, self.task = path, task
        self._begun, self._before = _now(), list[str]()

    def found(self) -> str:
        """What is there from before, in words; empty if nothing is."""
        results, status = self._files(_RESULT), self._status()
        said = f"{self.path} holds "
        if status.get("state") == "finished":
            said += f"the results of {status.get('task')}, finished {status.get('ended')}; they are replaced"
        elif status:
            failed = status.get("state") == "failed"
            ended = f"failed ({status.get('reason')})" if failed else "was not finished"
            said += f"a run of {status.get('task')}, begun {status.get('begun')}, that {ended}"
            since = _age(self.path / STATUS)
            new = [each for each in results if _age(each) >= since]
            said += f"; it left {_listed(new)}"
            if len(new) < len(results):
                said += f", and {_listed([each for each in results if each not in new])} from before it"
        elif results:
            said += f"{_listed(results)}, to be replaced"
        drafts = len(self._files(_DRAFT))
        if drafts:
            said += f"{'; ' if status or results else ''}half-written files, removed now: {drafts}"
        return said if drafts or status or results else ""

    def begin(self) -> None:
        """Clear away what was half-written, and write down what is begun.

        Results from before stay until there are new ones in their place.
        """
        for each in self._files(_DRAFT):
            each.unlink(missing_ok=True)
        status = self._status()
        for key in ("files", "before"):
            listed = status.get(key)
            names = [each for each in listed if isinstance(each, str)] if isinstance(listed, list) else []
            self._before += [name for name in names if _RESULT.fullmatch(name)]
        self._write(state="running", before=self._before)

    def finish(self, files: list[str]) -> None:
        """Write down that these are there, and remove those of the run before that have no successor."""
        for name in set(self._before) - set(files):
            (self.path / name).unlink(missing_ok=True)
        self._write(state="finished", ended=_now(), files=files)

    def fail(self, reason: str) -> None:
        """Write down why there is no result, if that can be written."""
        with suppress(PostureError):
            self._write(state="failed", ended=_now(), reason=reason, before=self._before)

    def _files(self, names: re.Pattern[str]) -> list[Path]:
        try:
            return sorted(
                each for each in self.path.iterdir() if names.fullmatch(each.name) and each.is_file()
            )
        except OSError:
            return []

    def _status(self) -> dict[str, Any]:
        """What the last run wrote down; empty if there was none."""
        try:
            status = json.loads((self.path / STATUS).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return {}
        return status if isinstance(status, dict) else {}

    def _write(self, **more: Any) -> None:
        status = {"task": self.task, "begun": self._begun, **more}
        write_text(self.path / STATUS, json.dumps(status, indent=1) + "\n")


def _listed(files: list[Path]) -> str:
    return ", ".join(each.name for each in files) or "no result"


def _age(path: Path) -> int:
    """When a file was written last; 0 if it is gone."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _now() -> str:
    return datetime.now(timezone.utc).astimezone().isoformat(timespec="seconds")
