"""Reproduction of the experiments of chapter 6, with numbers instead of pictures, and of the claims."""

from benchmarks.reproduce.evaluate import Evidence, JudgedClaim, gather, judge_claims
from benchmarks.reproduce.page import update_page
from benchmarks.reproduce.reproduction import (
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
