"""Studies over many starts, targets and arms."""

from pinposture.study.arms import (
    ArmSurvey,
    Family,
    Subject,
    awkward_arms,
    built_subject,
    draw_case,
    gentle_curve,
    loaded_subject,
    survey_arms,
)
from pinposture.study.baselines import BASELINES, register_baselines
from pinposture.study.clutter import ClutterRow, ClutterRun, by_kind, study_clutter
from pinposture.study.cycles import cycle_drift, study_cycles
from pinposture.study.leader import Following, study_leader
from pinposture.study.methods import MethodResult, compare_methods
from pinposture.study.pictures import draw_headings, draw_leader, draw_postures
from pinposture.study.postures import Bin, by_heading, study_headings, study_postures
from pinposture.study.record import (
    Case,
    Record,
    Spread,
    SummaryRow,
    keep_study,
    read_records,
    record_run,
    summarise,
    write_records,
)
from pinposture.study.scenarios import (
    Outcome,
    arbitrary_configuration,
    bent_configuration,
    case,
    largest_turn,
    outcome,
    study,
)
from pinposture.study.scenes import SITUATIONS, SceneRow, SceneRun, by_scene, study_scenes

__all__ = [
    "BASELINES",
    "SITUATIONS",
    "ArmSurvey",
    "Bin",
    "Case",
    "ClutterRow",
    "ClutterRun",
    "Family",
    "Following",
    "MethodResult",
    "Outcome",
    "Record",
    "SceneRow",
    "SceneRun",
    "Spread",
    "Subject",
    "SummaryRow",
    "arbitrary_configuration",
    "awkward_arms",
    "bent_configuration",
    "built_subject",
    "by_heading",
    "by_kind",
    "by_scene",
    "case",
    "compare_methods",
    "cycle_drift",
    "draw_case",
    "draw_headings",
    "draw_leader",
    "draw_postures",
    "gentle_curve",
    "keep_study",
    "largest_turn",
    "loaded_subject",
    "outcome",
    "read_records",
    "record_run",
    "register_baselines",
    "study",
    "study_clutter",
    "study_cycles",
    "study_headings",
    "study_leader",
    "study_postures",
    "study_scenes",
    "summarise",
    "survey_arms",
    "write_records",
]
