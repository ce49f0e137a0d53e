"""What is kept of values that are expensive to compute: the most recent ones."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


class HasCache(Protocol):
    """An arm."""

    cache: dict[object, Any]


class RecentValues(dict[Key, Value]):
    """A dictionary of bounded size: a new value replaces the oldest one.

    Args:
        size: largest number of values.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size

    def keep(self, key: Key, value: Value) -> Value:
        """Add a value and return it."""
        self[key] = value
        for oldest in list(self)[: -self.size]:
            self.pop(oldest, None)  # another thread may have done so
        return value


def recent_values(arm: HasCache, kind: object, size: int) -> RecentValues[Any, Any]:
    """Return the values of a kind that are kept in the cache of an arm, at most `size` of them."""
    known: RecentValues[Any, Any] | None = arm.cache.get(kind)
    return arm.cache.setdefault(kind, RecentValues(size)) if known is None else known
