"""Claims and figures of the thesis as data; `study.reproduce` measures them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Literal


@dataclass(frozen=True)
class Claim:
    """One claim of the thesis.

    Attributes:
        rule: required share: "always" for guarantees and statements about every case, "usually" for how a
            method works in general, "rather" for comparisons and tendencies.
        id: short name.
        where: where the thesis makes the claim.
        text: the claim in our words.
        measured: the cases in which it is true, whose share is measured.
        methods: the methods concerned: of "selection", "projection", "switching".
        general: whether it applies to any controller.
        construction: why the best reading cannot fail in any case; empty if it can.
    """

    rule: Literal["always", "usually", "rather"]
    id: str
    where: str
    text: str
    measured: str
    methods: tuple[str, ...] = ()
    general: bool = False
    construction: str = ""


always, usually, rather = partial(Claim, "always"), partial(Claim, "usually"), partial(Claim, "rather")

ALL_POINTS = (
    "a module has a singular value of at least half its length in every posture, so that no point is left "
    "out while kappa is below 0.5"
)
HALF_THE_POINTS = f"Selection never has two neighbours, half of the points at most; and {ALL_POINTS}"

_CLAIMS = (
    # Postures that the arm reaches.
    usually(
        "tracks-arbitrary",
        "Abstract; 1.2; 6.3 (1); 7",
        "Both methods take the arm from one arbitrary non-singular posture to another.",
        "runs that end with a mean point error of at most 1 % of the arm length",
        ("selection", "projection"),
        general=True,
    ),
    usually(
        "tracks-singular",
        "4.7; 6.3 (2); 7",
        "Both methods also reach target postures that are singular or nearly so.",
        "runs that end with a mean point error of at most 1 % of the arm length",
        ("selection", "projection"),
        general=True,
    ),
    rather(
        "similar-performance",
        "6.3 (1)",
        "Both methods track non-singular targets with similar performance.",
        "seeds whose final errors by the two methods differ by at most a factor of 2, or are both at most "
        "0.1 % of the arm length",
        ("selection", "projection"),
    ),
    rather(
        "projection-lower-non-singular",
        "5.3; 6.1.2",
        "On non-singular targets Projection ends with a lower posture error than Selection.",
        "seeds with a lower final error by Projection, or both at most 1e-6 of the arm length",
        ("selection", "projection"),
    ),
    rather(
        "projection-lower-singular",
        "4.7; 6.3 (2); 7 (3)",
        "On singular targets Projection ends with a lower posture error than Selection.",
        "seeds with a lower final error by Projection, or both at most 1e-6 of the arm length",
        ("selection", "projection"),
    ),
    usually(
        "projection-converges",
        "6.1.2",
        "The posture error of Projection eventually converges to zero.",
        "runs that end with a mean point error of at most 0.1 % of the arm length",
        ("projection",),
        general=True,
    ),
    usually(
        "selection-few-steps",
        "6.2.1",
        "On the planar arm Selection converges within a few iterations, with little residual error.",
        "runs that come to a mean point error of 1 % of the arm length within 50 steps, and end there",
        ("selection",),
        general=True,
    ),
    always(
        "selection-cannot-start",
        "5; 6.1.4; 6.2.3; 7 (1)",
        "Selection cannot start at a singular posture.",
        "runs from the straight posture that find no control point for their first step",
        ("selection",),
    ),
    usually(
        "selection-cannot-start-near",
        "5; 7 (1)",
        "Selection cannot start in the vicinity of a singular posture either.",
        "runs from postures whose joints are within 1e-3 rad of straight that find no control point for "
        "their first step",
        ("selection",),
    ),
    usually(
        "projection-departs",
        "6.1.4; 6.2.3; 6.3 (3)",
        "Projection departs from a singular posture.",
        "runs from the straight posture that at least halve the posture error",
        ("projection",),
        general=True,
    ),
    usually(
        "projection-converges-from-singular",
        "6.1.4",
        "From a singular posture Projection converges to the target.",
        "runs from the straight posture that end with a mean point error of at most 1 % of the arm length",
        ("projection",),
        general=True,
    ),
    usually(
        "selection-cannot-pass",
        "6.3 (3); 7 (2)",
        "Selection cannot traverse a singular posture or pass near one.",
        "runs to targets clear of singular postures that come near one (smallest singular value of the tip's "
        "Jacobian at most 0.03 of the arm length per rad, from 0.06 or more) and do not leave it again (to "
        "0.06); seen if 10 % of the runs come near",
        ("selection",),
    ),
    usually(
        "projection-passes",
        "6.3 (3)",
        "Projection can traverse a singular posture.",
        "runs to targets clear of singular postures that come near one (as above) and leave it again; seen "
        "if 10 % of the runs come near",
        ("projection",),
        general=True,
    ),
    always(
        "targets-on-curve",
        "4.1; 4.2; 4.6",
        "An adequate segmentation, one joint per module in the plane and two in space, puts the end of "
        "every module on the target curve.",
        "cases with all control point targets within 1e-5 of the arm length of the curve, which is sampled",
    ),
    # Motion of the arm.
    usually(
        "selection-monotone",
        "6.1.2; 6.2.1",
        "The posture error of Selection falls monotonically.",
        "runs on none of whose steps the posture error rises",
        ("selection",),
        general=True,
    ),
    always(
        "null-space-descends",
        "4.5 (4.7)",
        "The null-space term of (4.7) makes the posture error fall with each iteration.",
        "steps on which the posture error does not rise",
        ("selection", "projection"),
    ),
    always(
        "active-points-descend",
        "4.5 (4.7); 6.1.2",
        "Active control points move so that their own errors fall.",
        "active control points whose errors do not rise in a step, over all steps",
        ("selection",),
    ),
    usually(
        "point-errors-not-monotone",
        "6.1.2",
        "The errors of single control points do not fall monotonically under Selection.",
        "runs in which the error of some control point rises in some step",
        ("selection",),
    ),
    usually(
        "projection-not-monotone",
        "6.1.2; 6.2.1",
        "The posture error of Projection is not monotone.",
        "runs in which the posture error rises on some step",
        ("projection",),
    ),
    usually(
        "selection-predictable",
        "6.3 (5); 7",
        "The intermediate postures of Selection are predictable.",
        "runs whose control points move at most 1.5 times the direct distances, and from which a start "
        "nudged by 1e-6 rad leads at most 0.1 % of the arm length away",
        ("selection",),
        general=True,
    ),
    usually(
        "projection-unpredictable",
        "6.2.1; 6.3 (4); 7",
        "The intermediate postures of Projection are unpredictable.",
        "runs whose control points move more than 1.5 times the direct distances, or from which a start "
        "nudged by 1e-6 rad leads more than 0.1 % of the arm length away",
        ("projection",),
    ),
    rather(
        "selection-more-predictable",
        "6.3 (4, 5); 7",
        "The intermediate postures of Selection are more predictable than those of Projection.",
        "seeds on which the control points take a shorter way under Selection; and seeds on which a nudge "
        "of the start leads less far away under Selection",
        ("selection", "projection"),
    ),
    always(
        "stable-near-singular",
        "Abstract; 1.2; 3; 6.1.3",
        "Near singular postures no unacceptably large joint velocities are asked for.",
        "steps near a singular posture (smallest singular value of the tip's Jacobian at most 0.03 of the "
        "arm length per rad) that ask no joint for more than half a turn",
        ("selection", "projection"),
        general=True,
    ),
    usually(
        "no-blow-up",
        "Abstract; 1.2; 3.4",
        "Operation is stable in the vicinity of singular postures.",
        "runs to singular targets, with a step limit and without, that come near a singular posture and "
        "whose posture error never again exceeds twice what it was there",
        ("selection", "projection"),
        general=True,
    ),
    usually(
        "smooth-near-singular",
        "1.2",
        "Operation is smooth in and around singular postures.",
        "steps near a singular posture whose joint displacement differs from the one before by at most half "
        "of the larger of the two",
        ("selection", "projection"),
        general=True,
    ),
    usually(
        "stable-without-step-limit",
        "4.5; 4.7; 5",
        "The methods need no step limit to approach a singular posture safely; (4.7) has none.",
        "runs without a step limit, at gains of 1, that end with a mean point error of at most 1 % of the "
        "arm length",
        ("selection", "projection"),
        general=True,
    ),
    # Control points in use.
    usually(
        "many-points",
        "6.2.1",
        "On the planar arm both methods use a lot of control points in every step.",
        "steps with at least a quarter of all control points active",
        ("selection", "projection"),
    ),
    usually(
        "selection-runs-out",
        "5; 6.1.3; 6.2.2",
        "Selection runs out of control points as it approaches a singular posture.",
        "runs to singular targets that end with at most half of the control points they began with",
        ("selection",),
    ),
    usually(
        "selection-stranded",
        "6.1.3",
        "Near a singular target Selection finds no control point any more, and is stranded.",
        "runs to singular targets that end for want of a control point",
        ("selection",),
    ),
    always(
        "projection-keeps-points",
        "6.1.3; 6.2.2",
        "Projection keeps many control points near a singular target, and after it got there.",
        "runs to singular targets with at least half of all control points active in every step",
        ("projection",),
        construction=ALL_POINTS,
    ),
    always(
        "projection-uses-all",
        "6.1.2",
        "Projection uses all control points, always.",
        "steps with all control points active",
        ("projection",),
        construction=ALL_POINTS,
    ),
    always(
        "projection-more-points",
        "5.3",
        "Projection uses more control points at a time than Selection.",
        "seeds with more active control points, on average over the steps",
        ("selection", "projection"),
        construction=HALF_THE_POINTS,
    ),
    always(
        "selection-full-rank",
        "4.3; 4.5; 7",
        "The posture control matrix of Selection always has full row rank.",
        "steps whose control set has a posture control matrix of full row rank before any point is dropped "
        "for conditioning",
        ("selection",),
    ),
    always(
        "projection-full-rank",
        "5; 5.2; 7",
        "The posture control matrix of Projection always has full row rank.",
        "steps whose posture control matrix has full row rank",
        ("projection",),
    ),
    # Switching between the methods.
    rather(
        "switching-lower",
        "6.2.4; 6.3 (5)",
        "Switching between the methods ends with a smaller error than either of them alone.",
        "seeds with a smaller final error than by both, or all at most 1e-6 of the arm length",
        ("switching",),
    ),
    rather(
        "switching-predictable",
        "6.3 (5)",
        "Switching keeps the predictable nature of Selection.",
        "seeds on which the control points take a way at most 1.2 times that under Selection; and seeds on "
        "which a nudge of the start leads at most 10 times as far away, or at most 0.1 % of the arm length",
        ("switching",),
    ),
    usually(
        "switching-mostly-selection",
        "4.6.2",
        "Projection takes over only briefly.",
        "runs in which Projection makes at most half of the steps",
        ("switching",),
    ),
    # Postures and sets of control points, independent of the controller.
    always(
        "absolute-carries-over",
        "4.3",
        "If one control point clears the absolute manipulability condition, all later ones do.",
        "random postures and thresholds for which no control point fails the condition after an earlier one "
        "cleared it",
    ),
    always(
        "neighbours-suffice",
        "4.3",
        "If neighbours in a set clear the relative manipulability condition, all pairs in it do.",
        "random candidate control sets of which all pairs clear the condition",
    ),
    always(
        "conditions-give-full-rank",
        "4.3",
        "The posture control matrix of a set that clears both conditions has full row rank.",
        "random candidate control sets whose matrix has full row rank",
    ),
    always(
        "conditions-keep-away",
        "4.3; 4.4",
        "The posture control matrix of a set that clears both conditions is far from singular.",
        "random candidate control sets whose matrix has no singular value below 1e-4 of the arm length per "
        "rad",
    ),
    always(
        "singular-section-planar",
        "Appendix A",
        "Planar arms: if the section between two neighbours of a set is singular, so is the posture control "
        "matrix.",
        "random postures at which the Jacobians of two control points with a singular section between them "
        "stack to a matrix of less than full row rank",
    ),
    always(
        "singular-section-spatial",
        "4.3, which refers to Appendix A",
        "Spatial arms: if the section between two neighbours of a set is singular, so is the posture control "
        "matrix.",
        "random postures at which the Jacobians of the two ends of a module stack to a matrix of less than "
        "full row rank",
    ),
)

CLAIMS: Mapping[str, Claim] = MappingProxyType({claim.id: claim for claim in _CLAIMS})
"""All claims by id."""


Layout = Literal["postures", "errors", "planar"]


@dataclass(frozen=True)
class ThesisFigure:
    """One of Figures 6.3 to 6.12 of the thesis.

    Attributes:
        number: its number in the thesis.
        title: its content in our words.
        section: where the thesis discusses it.
        layout: "postures" shows initial posture, target and final postures; "errors" shows errors and control
            points against steps; "planar" shows all of these.
        scenario: name of the scenario, one of `benchmarks.cases.scenarios.SCENARIOS`.
        controllers: names of the controllers, one run each.
        compared: names of controllers whose posture error is shown for comparison.
        seed: seed of start and target. The thesis does not specify its own.
    """

    number: str
    title: str
    section: str
    layout: Layout
    scenario: str
    controllers: tuple[str, ...]
    compared: tuple[str, ...] = ()
    seed: int = 0


BOTH = ("selection", "projection")
ALONE = ("projection",)

SPATIAL_SEED = 17
PLANAR_SEED = 84
"""Seeds whose runs end near the medians of 100 seeds."""

SPATIAL_LAYOUTS: tuple[Layout, ...] = ("postures", "errors")
"""Layouts of the two figures of each experiment with the spatial arm."""

_LISTED = tuple(
    ThesisFigure(number, f"Spatial arm, {case}", section, layout, scenario, controllers, seed=SPATIAL_SEED)
    for numbers, case, section, scenario, controllers in (
        (("6.3", "6.4"), "non-singular target", "6.1.2", "helix", BOTH),
        (("6.5", "6.6"), "singular target", "6.1.3", "line", BOTH),
        (("6.7", "6.8"), "singular start", "6.1.4", "from-straight", ALONE),
    )
    for number, layout in zip(numbers, SPATIAL_LAYOUTS, strict=True)
) + tuple(
    ThesisFigure(
        number, f"Planar arm, {case}", section, "planar", scenario, controllers, compared, PLANAR_SEED
    )
    for number, case, section, scenario, controllers, compared in (
        ("6.9", "non-singular target", "6.2.1", "planar-random", BOTH, ()),
        ("6.10", "nearly singular target", "6.2.2", "planar-near-line", BOTH, ()),
        ("6.11", "singular start", "6.2.3", "planar-from-straight", ALONE, ()),
        ("6.12", "nearly singular target, switching", "6.2.4", "planar-near-line", ("switching",), BOTH),
    )
)

FIGURES: Mapping[str, ThesisFigure] = MappingProxyType({figure.number: figure for figure in _LISTED})
"""The figures by number in the thesis."""
