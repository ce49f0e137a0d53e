"""Curves by name: the target curves of chapter 6 of the thesis, in metres."""

from __future__ import annotations

from pinposture.curve import Curve

LINE = Curve.line((0.0, 0.0, 0.0), (1.1, 0.0, 0.0))
"""The singular target posture (6.16): a straight line, 1.1 m long."""

HELIX = Curve.helix(radius=0.06, pitch=0.15, turns=4, handedness="left")
"""The non-singular target posture (6.17): y = 0.06 sin(8 pi t), z = 0.06 cos(8 pi t), x = 0.6 t.

The thesis does not say where t ends. A helix of four turns (t = 1) is 1.62 m long; the arm covers 1 m."""

PLANAR_LINE = Curve.line((0.0, 0.0, 0.0), (7.425, 0.0, 0.0))
"""A straight line for the planar arm of Section 6.2, like (6.16) a tenth longer than the arm."""

CURVES = {"line": LINE, "helix": HELIX}
"""The curves by the names that the command line takes."""
