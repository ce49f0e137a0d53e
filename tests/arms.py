"""Arms that many tests use, built once in each process when first asked for."""

from __future__ import annotations

from functools import cache

import pinposture as pp


@cache
def template_arm(name: str, modules: int, link_lengths: tuple[float, ...] | None = None) -> pp.Arm:
    """An arm of equal modules; shared, which is safe because arms do not change."""
    return pp.Arm.from_template(name, modules, link_lengths)
