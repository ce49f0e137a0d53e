"""Claims on which control points are used, and on switching between the methods."""

from __future__ import annotations

from pinposture.thesis.claims.claim import Claim

POINTS = (
    Claim(
        "many-points",
        "6.2.1",
        "On the planar arm both methods use a lot of control points in every step.",
        "steps with at least a quarter of all control points active",
        "usually",
        ("selection", "projection"),
    ),
    Claim(
        "selection-runs-out",
        "5; 6.1.3; 6.2.2",
        "Selection runs out of control points as it approaches a singular posture.",
        "runs to singular targets that end with at most half of the control points they began with",
        "usually",
        ("selection",),
    ),
    Claim(
        "selection-stranded",
        "6.1.3",
        "Near a singular target Selection finds no control point any more, and is stranded.",
        "runs to singular targets that end for want of a control point",
        "usually",
        ("selection",),
    ),
    Claim(
        "projection-keeps-points",
        "6.1.3; 6.2.2",
        "Projection keeps many control points near a singular target, and after it got there.",
        "runs to singular targets with at least half of all control points active in every step",
        "always",
        ("projection",),
    ),
    Claim(
        "projection-uses-all",
        "6.1.2",
        "Projection uses all control points, always.",
        "steps with all control points active",
        "always",
        ("projection",),
    ),
    Claim(
        "projection-more-points",
        "5.3",
        "Projection uses more control points at a time than Selection.",
        "seeds with more active control points, on average over the steps",
        "always",
        ("selection", "projection"),
    ),
    Claim(
        "selection-full-rank",
        "4.3; 4.5; 7",
        "The posture control matrix of Selection always has full row rank.",
        "steps whose posture control matrix has full row rank",
        "always",
        ("selection",),
    ),
    Claim(
        "projection-full-rank",
        "5; 5.2; 7",
        "The posture control matrix of Projection always has full row rank.",
        "steps whose posture control matrix has full row rank",
        "always",
        ("projection",),
    ),
)
"""Which control points it uses."""

SWITCHING = (
    Claim(
        "switching-lower",
        "6.2.4; 6.3 (5)",
        "Switching between the methods ends with a smaller error than either of them alone.",
        "seeds with a smaller final error than by both, or all at most 1e-6 of the arm length",
        "rather",
        ("switching",),
    ),
    Claim(
        "switching-predictable",
        "6.3 (5)",
        "Switching keeps the predictable nature of Selection.",
        "seeds on which the control points take a way at most 1.2 times that under Selection; and seeds "
        "on which a "
        "nudge of the start leads at most 10 times as far away, or at most 0.1 % of the arm length",
        "rather",
        ("switching",),
    ),
    Claim(
        "switching-mostly-selection",
        "4.6.2",
        "Projection takes over only briefly.",
        "runs in which Projection makes at most half of the steps",
        "usually",
        ("switching",),
    ),
)
"""What comes of switching between the two."""

CHOOSING = POINTS + SWITCHING
"""Both."""
