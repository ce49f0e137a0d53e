"""Reproduction of the experiments of chapter 6, with numbers instead of pictures, and of the claims."""

from pinposture.study.reproduce.evaluate import Evidence, JudgedClaim, gather, judge_claims
from pinposture.study.reproduce.page import update_page
from pinposture.study.reproduce.reproduction import (
    NAMES,
    FigureRuns,
    FigureSettings,
    Reproduction,
    draw_figure,
    reproduce,
    run_figures,
)

__all__ = [
    "NAMES",
    "Evidence",
    "FigureRuns",
    "FigureSettings",
    "JudgedClaim",
    "Reproduction",
    "draw_figure",
    "gather",
    "judge_claims",
    "reproduce",
    "run_figures",
    "update_page",
]
