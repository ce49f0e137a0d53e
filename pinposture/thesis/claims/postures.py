"""Claims on postures and sets of control points, whatever moves the arm."""

from __future__ import annotations

from pinposture.thesis.claims.claim import Claim

POSTURES = (
    Claim(
        "absolute-carries-over",
        "4.3",
        "If one control point clears the absolute manipulability condition, all later ones do.",
        "random postures and thresholds for which no control point fails the condition after an earlier one "
        "cleared it",
        "always",
    ),
    Claim(
        "neighbours-suffice",
        "4.3",
        "If neighbours in a set clear the relative manipulability condition, all pairs in it do.",
        "random candidate control sets of which all pairs clear the condition",
        "always",
    ),
    Claim(
        "conditions-give-full-rank",
        "4.3",
        "The posture control matrix of a set that clears both conditions has full row rank.",
        "random candidate control sets whose matrix has full row rank",
        "always",
    ),
    Claim(
        "conditions-keep-away",
        "4.3; 4.4",
        "The posture control matrix of a set that clears both conditions is far from singular.",
        "random candidate control sets whose matrix has no singular value below 1e-4 of the arm length "
        "per rad",
        "always",
    ),
    Claim(
        "singular-section",
        "Appendix A",
        "If the section between two neighbours of a set is singular, so is the posture control matrix.",
        "random postures at which the Jacobians of two control points with a singular section between "
        "them stack "
        "to a matrix of less than full row rank",
        "always",
    ),
)
"""What is true of postures and sets of control points, whatever moves the arm."""
