"""Arms that many tests use, built once in each process when first asked for."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Mapping
from functools import cache

import pinposture as pp

MADE_AGAIN: Mapping[str, Callable[[pp.Arm], pp.Arm]] = {
    "pickle": lambda arm: pickle.loads(pickle.dumps(arm)),
    "copy": copy.deepcopy,
    "dict": lambda arm: pp.Arm.from_dict(arm.to_dict()),
    "specification": lambda arm: pp.Arm.from_spec(arm.spec),
    "another length": lambda arm: arm.with_characteristic_length(0.3),
    "torque limits": lambda arm: arm.with_effort(arm.weight.effort),
}
"""Ways to the same arm, with all that is known of its weight."""


@cache
def template_arm(name: str, modules: int, link_lengths: tuple[float, ...] | None = None) -> pp.Arm:
    """An arm of equal modules; shared, which is safe because arms do not change."""
    return pp.Arm.from_template(name, modules, link_lengths)
