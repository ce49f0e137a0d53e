"""MuJoCo, where it is installed: it is an extra, and the rest of the library does without."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from pinposture.errors import PostureError

COMMAND = "pip install 'pinposture[sim]'"
"""What installs it."""


class MujocoMissing(PostureError, ImportError):
    """MuJoCo is not installed, or cannot be loaded here.

    Attributes:
        reason: what the import said.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"physics needs MuJoCo ({reason}); install it with: {COMMAND}")


def load_mujoco() -> Any:
    """The module `mujoco`.

    Raises:
        MujocoMissing: there is none.
    """
    try:
        return import_module("mujoco")
    except ImportError as error:
        raise MujocoMissing(str(error)) from None


@contextmanager
def no_log_file(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT where the user happens to be; divergence is told otherwise."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
