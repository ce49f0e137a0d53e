"""A motion as files to take away: the same that `pinposture run` and `pinposture export` write."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from pinposture.errors import UnknownName
from pinposture.motion import Motion, save


class Kind(NamedTuple):
    """A kind of file.

    Attributes:
        suffix: what its name ends in.
        noun: what it is, in words.
        write: makes one of a motion, at a path.
    """

    suffix: str
    noun: str
    write: Callable[[Motion, Path], object]


class Export(NamedTuple):
    """A file to take away.

    Attributes:
        name: of the file.
        content: what is in it.
        told: what it is and how long the motion is, in words.
    """

    name: str
    content: bytes
    told: str


def exported(motion: Motion, kind: str, stem: str) -> Export:
    """A motion as a file.

    Args:
        motion: the motion.
        kind: one of `KINDS`.
        stem: what to call the file; letters that are not good in names of files are replaced.

    Raises:
        UnknownName: no such kind.
        MotionError: joints of a motion that is not fit for a robot; `pinposture export --force` writes them.
        FileError: it cannot be made.
        InvalidValue: times that the format cannot hold.
    """
    if kind not in KINDS:
        raise UnknownName("kind of export", kind, KINDS)
    suffix, noun, write = KINDS[kind]
    name = f"{re.sub(r'[^A-Za-z0-9._-]+', '_', stem).strip('._') or 'motion'}{suffix}"
    with TemporaryDirectory(prefix="pinposture-") as folder:
        path = Path(folder) / f"motion{suffix}"
        write(motion, path)
        content = path.read_bytes()
    size = f"{len(content) / 1000.0:,.0f} kB" if len(content) >= 1000 else f"{len(content)} bytes"
    ended = "" if motion.converged else "; it does not end as it should"
    return Export(
        name, content, f"{name}: {noun} of {motion.time[-1]:.4g} s, {motion.steps} cycles, {size}{ended}"
    )


def _write_joints(motion: Motion, path: Path) -> None:
    save(motion.joint_trajectory(), path)


def _write_picture(motion: Motion, path: Path) -> None:
    from pinposture.viz import plot  # takes a while to import

    picture = io.BytesIO()
    plot(motion).savefig(picture, format="png")
    path.write_bytes(picture.getvalue())


def _write_animation(motion: Motion, path: Path) -> None:
    from pinposture.viz import save_html

    save_html(motion.arm, motion, path)


KINDS = {
    "npz": Kind(".npz", "the motion", save),
    "CSV": Kind(".csv", "joint positions, speeds and accelerations", _write_joints),
    "ROS JSON": Kind(".json", "a JointTrajectory message", _write_joints),
    "Picture": Kind(".png", "a picture", _write_picture),
    "Animation": Kind(".html", "an animation", _write_animation),
}
"""What a motion can be taken away as, by the names of its buttons."""
