"""Many starts, targets and arms at once."""

from pinposture.study.arms import ArmSurvey, awkward_arms, gentle_curve, survey_arms
from pinposture.study.cases import (
    Outcome,
    arbitrary_configuration,
    bent_configuration,
    case,
    outcome,
    smooth_configuration,
    study,
)
from pinposture.study.cycles import cycle_drift, study_cycles
from pinposture.study.families import Family, Subject, built_subject, draw_case, loaded_subject
from pinposture.study.headings import Bin, by_heading, study_headings
from pinposture.study.leader import Following, study_leader
from pinposture.study.leader_picture import draw_leader
from pinposture.study.methods import MethodResult, compare_methods
from pinposture.study.pictures import draw_headings, draw_postures
from pinposture.study.postures import study_postures
from pinposture.study.record import Case, Record, record_run
from pinposture.study.record_files import keep_study, read_records, write_records
from pinposture.study.scene_record import SceneRun
from pinposture.study.scenes import SceneRow, by_scene, study_scenes
from pinposture.study.situations import SITUATIONS
from pinposture.study.table import Spread, SummaryRow, summarise
from pinposture.study.turns import largest_turn

__all__ = [
    "SITUATIONS",
    "ArmSurvey",
    "Bin",
    "Case",
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
    "smooth_configuration",
    "study",
    "study_cycles",
    "study_headings",
    "study_leader",
    "study_postures",
    "study_scenes",
    "summarise",
    "survey_arms",
    "write_records",
]
