"""What was decided while an arm was loaded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from pinposture.arm.segmentation import Segmentation


@dataclass(frozen=True)
class LoadReport:
    """What was decided while an arm was loaded.

    Attributes:
        base: link at which the arm begins.
        tip: link at which it ends.
        package_dirs: folders in which viewers look for meshes, the file's own last.
        warnings: what was settled in a way that the user may not expect.
        segmentation: how the joints were grouped into modules.
    """

    base: str
    tip: str
    package_dirs: tuple[str, ...]
    warnings: tuple[str, ...]
    segmentation: Segmentation

    def to_dict(self) -> dict[str, Any]:
        """The report as data that JSON can hold."""
        return asdict(self)

    @classmethod
    def from_dict(cls, described: Mapping[str, Any]) -> LoadReport:
        """The report that `to_dict` described."""
        cut = dict(described["segmentation"])
        cut["sizes"] = tuple(cut["sizes"])
        return cls(
            described["base"],
            described["tip"],
            tuple(described["package_dirs"]),
            tuple(described["warnings"]),
            Segmentation(**cut),
        )
