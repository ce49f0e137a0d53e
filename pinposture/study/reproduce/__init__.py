"""The experiments of chapter 6 once more, with numbers where the thesis has pictures, and its claims."""

from pinposture.study.reproduce.evaluate import Evidence, JudgedClaim, gather, judge_claims
from pinposture.study.reproduce.figures import FigureRuns, draw_figure, run_figures
from pinposture.study.reproduce.reproduction import NAMES, Reproduction, reproduce

__all__ = [
    "NAMES",
    "Evidence",
    "FigureRuns",
    "JudgedClaim",
    "Reproduction",
    "draw_figure",
    "gather",
    "judge_claims",
    "reproduce",
    "run_figures",
]
