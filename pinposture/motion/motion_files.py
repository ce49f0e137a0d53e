"""Motions as files: one `.npz` that holds the run, and what it should have done when."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pinposture.control import Limits
from pinposture.errors import InvalidValue
from pinposture.motion.archive import Kind, read_archive, write_archive
from pinposture.motion.files import check_shapes, pack_run, unpack_moved, unpack_run
from pinposture.motion.motion import Motion, Passed

_ADVICE = {
    "pinposture-run": "holds a run that knows of no time; read it by pp.Trajectory.load(file)",
    "pinposture-batch": "holds many runs; read them by pp.Batch.load(file)",
}
KIND = Kind("pinposture-motion", 1, "motion", _ADVICE)

_ARRAYS = ("targets", "asked", "clock")


def save_motion(motion: Motion, path: Path) -> Path:
    """Write a motion; see `Motion.save`."""
    about, arrays = pack_run(motion.run)
    about["motion"] = {
        "set_out": motion.set_out,
        "planned": motion.planned,
        "passed": [list(place) for place in motion.passed],
        "detours": list(motion.detours),
    }
    arrays |= {f"motion_{name}": getattr(motion, name) for name in _ARRAYS}
    return write_archive(path, KIND, motion.run.limits, about, arrays)


def load_motion(path: Path) -> Motion:
    """Read a motion; see `Motion.load`."""
    return read_archive(path, KIND, _unpacked)


def _unpacked(about: dict[str, Any], arrays: dict[str, Any], limits: Limits) -> Motion:
    run, timed = unpack_run(about, arrays, limits), about["motion"]
    if limits.dt is None:
        raise InvalidValue("dt", None, "the duration of a cycle")
    rows, m = run.steps + 1, run.arm.n_modules
    check_shapes(arrays, {"motion_targets": (rows, m, 3), "motion_asked": (rows, m), "motion_clock": (rows,)})
    return Motion(
        run=run,
        **{name: arrays[f"motion_{name}"] for name in _ARRAYS},
        set_out=timed["set_out"],
        planned=timed["planned"],
        passed=tuple(
            Passed(*place[:7])._replace(moved=unpack_moved(place[7] if len(place) > 7 else None))
            for place in timed["passed"]
        ),
        detours=tuple(timed["detours"]),
    )
