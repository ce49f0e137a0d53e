"""The editor in the browser: drag the curve, watch the arm. Needs the extra `editor`, which is viser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pinposture.editor.editor import Editor

__all__ = ["Editor"]


def __getattr__(name: str) -> Any:
    if name != "Editor":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        import viser  # noqa: F401
    except ImportError as error:
        from pinposture.errors import ViewerError, install

        advice = install("editor")
        raise ViewerError("viser", f"is needed for the editor: {advice} ({error})") from error
    from pinposture.editor.editor import Editor

    return Editor
