"""Many starts, targets and arms at once."""

from pinposture.study.arms import ArmSurvey, gentle_curve, survey_arms
from pinposture.study.cases import (
    Outcome,
    arbitrary_configuration,
    bent_configuration,
    case,
    outcome,
    smooth_configuration,
    study,
)
from pinposture.study.methods import MethodResult, compare_methods

__all__ = [
    "ArmSurvey",
    "MethodResult",
    "Outcome",
    "arbitrary_configuration",
    "bent_configuration",
    "case",
    "compare_methods",
    "gentle_curve",
    "outcome",
    "smooth_configuration",
    "study",
    "survey_arms",
]
