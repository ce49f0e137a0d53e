"""The base of all specifications: what something is made from, as plain data that files hold."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from pinposture.errors import InvalidValue


class Specification(BaseModel):
    """Plain data in SI units that does not change; two are equal if all their values are.

    Raises:
        InvalidValue: a value that is missing, unknown or of another kind; names the first.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            first = error.errors()[0]
            name = ".".join(map(str, first["loc"])) or type(self).__name__
            raise InvalidValue(name, first["input"], first["msg"]) from None

    def said(self) -> dict[str, Any]:
        """The values that are not the default, by their names."""
        return self.model_dump(exclude_defaults=True)
