"""The page in the browser: what is shown of a session, and the controls to edit it."""

from pinposture.editor.ui.page import Page

__all__ = ["Page"]
