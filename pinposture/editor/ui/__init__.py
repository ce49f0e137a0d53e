"""The page in the browser: what is seen of a session, and what hands can do to it."""

from pinposture.editor.ui.page import Page

__all__ = ["Page"]
