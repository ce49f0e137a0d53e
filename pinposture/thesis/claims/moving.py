"""Claims on how the arm moves."""

from __future__ import annotations

from pinposture.thesis.claims.claim import Claim

MOVING = (
    Claim(
        "selection-monotone",
        "6.1.2; 6.2.1",
        "The posture error of Selection falls monotonically.",
        "runs on none of whose steps the posture error rises",
        "usually",
        ("selection",),
    ),
    Claim(
        "null-space-descends",
        "4.5 (4.7)",
        "The null-space term of (4.7) makes the posture error fall with each iteration.",
        "steps on which the posture error does not rise",
        "always",
        ("selection", "projection"),
    ),
    Claim(
        "active-points-descend",
        "4.5 (4.7); 6.1.2",
        "Active control points move so that their own errors fall.",
        "active control points whose errors do not rise in a step, over all steps",
        "always",
        ("selection",),
    ),
    Claim(
        "point-errors-not-monotone",
        "6.1.2",
        "The errors of single control points do not fall monotonically under Selection.",
        "runs in which the error of some control point rises in some step",
        "usually",
        ("selection",),
    ),
    Claim(
        "projection-not-monotone",
        "6.1.2; 6.2.1",
        "The posture error of Projection is not monotone.",
        "runs in which the posture error rises on some step",
        "usually",
        ("projection",),
    ),
    Claim(
        "selection-predictable",
        "6.3 (5); 7",
        "The intermediate postures of Selection are predictable.",
        "runs whose control points move at most 1.5 times the direct distances, and from which a start "
        "nudged by "
        "1e-6 rad leads at most 0.1 % of the arm length away",
        "usually",
        ("selection",),
    ),
    Claim(
        "projection-unpredictable",
        "6.2.1; 6.3 (4); 7",
        "The intermediate postures of Projection are unpredictable.",
        "runs whose control points move more than 1.5 times the direct distances, or from which a start "
        "nudged "
        "by 1e-6 rad leads more than 0.1 % of the arm length away",
        "usually",
        ("projection",),
    ),
    Claim(
        "selection-more-predictable",
        "6.3 (4, 5); 7",
        "The intermediate postures of Selection are more predictable than those of Projection.",
        "seeds on which the control points take a shorter way under Selection; and seeds on which a "
        "nudge of the "
        "start leads less far away under Selection",
        "rather",
        ("selection", "projection"),
    ),
    Claim(
        "stable-near-singular",
        "Abstract; 1.2; 3; 6.1.3",
        "Near singular postures no unacceptably large joint velocities are asked for.",
        "steps near a singular posture (smallest singular value of the tip's Jacobian at most 0.03 of "
        "the arm "
        "length per rad) that ask no joint for more than half a turn",
        "always",
        ("selection", "projection"),
    ),
    Claim(
        "no-blow-up",
        "Abstract; 1.2; 3.4",
        "Operation is stable in the vicinity of singular postures.",
        "runs to singular targets that come near a singular posture and whose posture error never again "
        "exceeds "
        "twice what it was there",
        "usually",
        ("selection", "projection"),
    ),
    Claim(
        "smooth-near-singular",
        "1.2",
        "Operation is smooth in and around singular postures.",
        "steps near a singular posture whose joint displacement differs from the one before by at most "
        "half of "
        "the larger of the two",
        "usually",
        ("selection", "projection"),
    ),
    Claim(
        "stable-without-step-limit",
        "4.5; 4.7; 5",
        "The methods need no step limit to approach a singular posture safely; (4.7) has none.",
        "runs without a step limit, at gains of 1, that end with a mean point error of at most 1 % of "
        "the arm length",
        "usually",
    ),
)
"""How it moves."""
