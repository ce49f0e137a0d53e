"""What the thesis claims of its methods, in our words, as data; `pinposture.study.reproduce` measures it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pinposture.thesis.claims.choosing import CHOOSING
from pinposture.thesis.claims.claim import Claim
from pinposture.thesis.claims.moving import MOVING
from pinposture.thesis.claims.postures import POSTURES
from pinposture.thesis.claims.tracking import TRACKING

CLAIMS: Mapping[str, Claim] = MappingProxyType(
    {claim.id: claim for claim in TRACKING + MOVING + CHOOSING + POSTURES}
)
"""All claims by their ids."""

__all__ = ["CHOOSING", "CLAIMS", "MOVING", "POSTURES", "TRACKING", "Claim"]
