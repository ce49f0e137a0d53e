"""Curves as plain data: which descriptions there are and what each may say."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from pinposture.errors import CurveError, UnknownName


class Call(NamedTuple):
    """A constructor and its arguments.

    Attributes:
        type: which kind of description this is.
        arguments: by the constructor's names for them.
    """

    type: str
    arguments: dict[str, Any]


def read_call(description: object, constructors: Mapping[str, Callable[..., object]]) -> Call:
    """Check a description, which is a constructor's name under "type" and its arguments under their names.

    Args:
        description: for example {"type": "line", "a": [0, 0, 0], "b": [1, 0, 0]}.
        constructors: by type.

    Raises:
        CurveError: not a mapping, or a key that is needed is missing.
        UnknownName: a type or a key that does not exist.
    """
    if not isinstance(description, Mapping):
        raise CurveError("description", f"{type(description).__name__}; allowed: an object with a 'type'")
    if "type" not in description:
        raise CurveError("description", f"needs the key 'type'; allowed: {', '.join(constructors)}")
    kind = description["type"]
    if not isinstance(kind, str) or kind not in constructors:
        raise UnknownName("type of curve", kind, constructors)
    keys = {
        name: parameter.default is inspect.Parameter.empty
        for name, parameter in inspect.signature(constructors[kind]).parameters.items()
    }
    for key in description:
        if key != "type" and key not in keys:
            raise UnknownName(f"key of a {kind!r} curve", key, keys)
    for key, needed in keys.items():
        if needed and key not in description:
            raise CurveError(f"{kind!r} curve", f"needs the key {key!r}")
    return Call(kind, {key: description[key] for key in keys if key in description})
