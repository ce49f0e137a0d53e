"""Claims on where the arm gets to."""

from __future__ import annotations

from pinposture.thesis.claims.claim import Claim

TRACKING = (
    Claim(
        "tracks-arbitrary",
        "Abstract; 1.2; 6.3 (1); 7",
        "Both methods take the arm from one arbitrary non-singular posture to another.",
        "runs that end with a mean point error of at most 1 % of the arm length",
        "usually",
        ("selection", "projection"),
    ),
    Claim(
        "tracks-singular",
        "4.7; 6.3 (2); 7",
        "Both methods also reach target postures that are singular or nearly so.",
        "runs that end with a mean point error of at most 1 % of the arm length",
        "usually",
        ("selection", "projection"),
    ),
    Claim(
        "similar-performance",
        "6.3 (1)",
        "Both methods track non-singular targets with similar performance.",
        "seeds whose final errors by the two methods differ by at most a factor of 2, or are both at most "
        "0.1 % of the arm length",
        "rather",
        ("selection", "projection"),
    ),
    Claim(
        "projection-lower-non-singular",
        "5.3; 6.1.2",
        "On non-singular targets Projection ends with a lower posture error than Selection.",
        "seeds with a lower final error by Projection, or both at most 1e-6 of the arm length",
        "rather",
        ("selection", "projection"),
    ),
    Claim(
        "projection-lower-singular",
        "4.7; 6.3 (2); 7 (3)",
        "On singular targets Projection ends with a lower posture error than Selection.",
        "seeds with a lower final error by Projection, or both at most 1e-6 of the arm length",
        "rather",
        ("selection", "projection"),
    ),
    Claim(
        "projection-converges",
        "6.1.2",
        "The posture error of Projection eventually converges to zero.",
        "runs that end with a mean point error of at most 0.1 % of the arm length",
        "usually",
        ("projection",),
    ),
    Claim(
        "selection-few-steps",
        "6.2.1",
        "On the planar arm Selection converges within a few iterations, with little residual error.",
        "runs that come to a mean point error of 1 % of the arm length within 50 steps, and end there",
        "usually",
        ("selection",),
    ),
    Claim(
        "selection-cannot-start",
        "5; 6.1.4; 6.2.3; 7 (1)",
        "Selection cannot start at a singular posture.",
        "runs from the straight posture that find no control point for their first step",
        "always",
        ("selection",),
    ),
    Claim(
        "selection-cannot-start-near",
        "5; 7 (1)",
        "Selection cannot start in the vicinity of a singular posture either.",
        "runs from postures whose joints are within 1e-3 rad of straight that find no control point for "
        "their "
        "first step",
        "usually",
        ("selection",),
    ),
    Claim(
        "projection-departs",
        "6.1.4; 6.2.3; 6.3 (3)",
        "Projection departs from a singular posture.",
        "runs from the straight posture that at least halve the posture error",
        "usually",
        ("projection",),
    ),
    Claim(
        "projection-converges-from-singular",
        "6.1.4",
        "From a singular posture Projection converges to the target.",
        "runs from the straight posture that end with a mean point error of at most 1 % of the arm length",
        "usually",
        ("projection",),
    ),
    Claim(
        "selection-cannot-pass",
        "6.3 (3); 7 (2)",
        "Selection cannot traverse a singular posture or pass near one.",
        "runs to the posture with all joints reversed, on the other side of the straight one, that do "
        "not end "
        "with a mean point error of at most 1 % of the arm length",
        "usually",
        ("selection",),
    ),
    Claim(
        "projection-passes",
        "6.3 (3)",
        "Projection can traverse a singular posture.",
        "runs to the posture with all joints reversed, on the other side of the straight one, that end "
        "with a "
        "mean point error of at most 1 % of the arm length",
        "usually",
        ("projection",),
    ),
    Claim(
        "targets-on-curve",
        "4.1; 4.2; 4.6",
        "An adequate segmentation, one joint per module in the plane and two in space, puts the end of every "
        "module on the target curve.",
        "cases with all control point targets within 1e-5 of the arm length of the curve, which is sampled",
        "always",
    ),
)
"""Where the arm gets to."""
