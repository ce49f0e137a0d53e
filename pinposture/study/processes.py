"""Work on several processes: where `motion.track_many` has it, too."""

from __future__ import annotations

from pinposture.motion.processes import check_jobs, in_order

__all__ = ["check_jobs", "in_order"]
