"""Runs and measurements made by hand, whose figures are known without running anything."""

from __future__ import annotations

import numpy as np

import pinposture as pp
from benchmarks.harness import Row
from benchmarks.reproduce.runs import Descent, Steps


def made(arm, q, target=None, active=None, **fields) -> pp.Run:
    """A run through configurations q, towards control points `target` (or the last posture)."""
    q = np.asarray(q, dtype=float)
    steps, m = len(q) - 1, arm.n_modules
    points = np.array([arm.at(row).points for row in q])
    goals = points[-1] if target is None else np.asarray(target, dtype=float)
    known = {
        "arm": arm,
        "target": pp.Target.from_points(arm, goals),
        "controller": "Selection()",
        "limits": pp.Limits(),
        "status": "max_steps",
        "reason": "made by hand",
        "q": q,
        "points": points,
        "point_errors": np.linalg.norm(points - goals, axis=2),
        "active": np.ones((steps, m), dtype=bool) if active is None else np.array(active, dtype=bool),
        "clipped": np.zeros((steps, arm.nv), dtype=bool),
        "error_increasing": np.zeros(steps, dtype=bool),
        "violated_constraints": np.full(steps, ""),
        "clearance": np.full(steps + 1, np.inf),
        "info": {
            "manipulability": np.full(steps, 0.5),
            "sigma_min": np.full(steps, 0.1),
            "sigma_max": np.full(steps, 1.0),
            "rows": np.full(steps, 2, dtype=np.intp),
            "scale": np.ones(steps),
        },
    }
    info = {**known["info"], **fields.pop("info", {})}
    return pp.Run(**{**known, **fields, "info": info})


def one(
    errors=(1.0, 0.5),
    points=(10, 10),
    status="max_steps",
    modules=20,
    path_length_ratio=1.0,
    separation=None,
    descent=None,
    nearness=None,
    asked=None,
    turn=None,
    by_projection=0.0,
    off_curve=0.0,
    deficient=0,
    dropping=0,
    goal_nearness=0.3,
) -> Row:
    """A measurement of one run; errors are mean point errors per arm length."""
    errors, count = np.array(errors, dtype=float), len(errors) - 1
    counts = np.array(points[:count], dtype=int)

    def row(values, default):
        return np.array([default] * count if values is None else values, dtype=float)

    rose = int(np.count_nonzero(np.diff(errors) > 0))
    return Row(
        outcome=Row(
            start_error=errors[0],
            final_error=errors[-1],
            ratio=errors[-1] / errors[0] if errors[0] else 0.0,
            steps=count,
            status=status,
            first_points=int(counts[0]) if count else 0,
            last_points=int(counts[-1]) if count else 0,
            rising=rose / max(count, 1),
        ),
        mean_errors=errors,
        off_curve=off_curve,
        points=counts,
        modules=modules,
        descent=descent or Descent(count, rose, 0, 0, int(counts.sum()), 0, int(counts.sum()), 0, 0),
        deficient=deficient,
        dropping=dropping,
        path_length_ratio=path_length_ratio,
        steps=Steps(row(nearness, 0.1), row(asked, 0.1), row(turn, 0.0), np.zeros(count)),
        by_projection=by_projection,
        separation=separation,
        goal_nearness=goal_nearness,
    )
