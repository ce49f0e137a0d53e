"""The page in the browser: what is seen of a session, and what hands can do to it."""

from pinposture.editor.page.page import Page

__all__ = ["Page"]
