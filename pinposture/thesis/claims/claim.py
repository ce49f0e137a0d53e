"""What a claim of the thesis is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        id: short name.
        where: where the thesis says so.
        text: what it says, in our words.
        measured: in what share of which cases it is true.
        rule: how large that share must be: "always" for what is guaranteed or said of every case, "usually"
            for how a method works in general, "rather" for comparisons and tendencies.
        methods: the methods that it speaks of: of "selection", "projection", "switching".
    """

    id: str
    where: str
    text: str
    measured: str
    rule: Literal["always", "usually", "rather"]
    methods: tuple[str, ...] = ()
