"""Many starts, targets and arms at once."""

from pinposture.study.arms import ArmSurvey, gentle_curve, survey_arms
from pinposture.study.cases import Outcome, case, outcome, smooth_configuration, study

__all__ = [
    "ArmSurvey",
    "Outcome",
    "case",
    "gentle_curve",
    "outcome",
    "smooth_configuration",
    "study",
    "survey_arms",
]
