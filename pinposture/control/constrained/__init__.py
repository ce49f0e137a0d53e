"""The constrained controller: where to go, the most direct way there, a quadratic program for each step."""

from pinposture.control.constrained.constrained_qp import ConstrainedQP

__all__ = ["ConstrainedQP"]
