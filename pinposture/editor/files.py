"""Task files: a first task, saving, opening, autosave and recovery; and motions exported as files."""

from __future__ import annotations

import io
import logging
import operator
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_known
from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.control.limits import CYCLES
from pinposture.curve import Curve
from pinposture.editor.edits import SHAPE, Shape, joints_at, keyframes_of
from pinposture.editor.phases import editable
from pinposture.editor.postures import arm_line
from pinposture.editor.session import Session
from pinposture.editor.solver import judge
from pinposture.errors import FileError, PostureError, no_warnings
from pinposture.motion import Trajectory, save
from pinposture.motion.latest import EXPECTED_ERRORS, Done, Latest
from pinposture.placement.target import arm_axis
from pinposture.storage import settled
from pinposture.task import Keyframe, Task

logger = logging.getLogger(__name__)


class Version(NamedTuple):
    """Identity of a file, which differs from that of a file that had its name before."""

    number: int  # inode
    written: int  # time of the last change [ns]
    size: int  # of the file [bytes]


def version_of(path: Path) -> Version | None:
    """Return which file has a name now; None if there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return Version(status.st_ino, status.st_mtime_ns, status.st_size)


class Recovered(NamedTuple):
    """What was autosaved by an editor that ended before it saved."""

    task: Task | None  # the task; None if it cannot be read
    complaint: str  # why not
    path: Path  # of the autosave file
    older: bool = False  # whether the task file was written after it


def autosave_path(path: Path) -> Path:
    """Return the autosave file of a task file, in the same folder."""
    suffix = path.suffix if path.suffix in (".toml", ".json") else ".toml"
    return path.with_name(f"{path.stem}.autosave{suffix}")


def recover(path: Path) -> Recovered | None:
    """Read the autosave of a task file; None if there is none."""
    kept = autosave_path(path)
    left = version_of(kept)
    file = version_of(path)
    if left is None:
        return None
    try:
        task = editable(Task.load(kept))
        keyframes_of(task)
    except PostureError as error:
        return Recovered(None, str(error), kept)
    return Recovered(task, "", kept, file is not None and file.written > left.written)


class Autosave:
    """Writes the latest states of tasks beside the editor's loop; each file is written whole or not at all.

    Attributes:
        complaint: why the last state could not be written; empty if it could.
    """

    def __init__(self) -> None:
        self.complaint = ""
        self._written: dict[Path, Version | None] = {}
        self._wanted: Latest[dict[Path, Task | None], None] = Latest(
            self._write_all, "pinposture-autosave", merge=operator.or_, period=0.3
        )

    def keep(self, task: Task | None, path: Path) -> None:
        """Write a state of the task of a file; None: it is saved, so the autosave is removed."""
        self._wanted.ask({autosave_path(path): task})

    def finish(self) -> None:
        """Wait until everything is written."""
        self._wanted.finish(10.0)  # [s]

    def close(self) -> None:
        """Write what is waiting, and end."""
        self.finish()
        self._wanted.close()

    def _write_all(self, states: dict[Path, Task | None], _: Event) -> None:
        for path, task in states.items():
            self._write(task, path)

    def _write(self, task: Task | None, path: Path) -> None:
        """Write a state, or remove the file."""
        version = version_of(path)
        foreign = path in self._written and version not in (None, self._written[path])
        complaint = f"another program also writes {path.name}: is the task open twice?" if foreign else ""
        files = (path, path.with_suffix(".urdf"))  # an arm that nothing else describes is written beside it
        try:
            if task is not None:
                for file in files:
                    if file.is_symlink():  # which we never make; it would be written through
                        raise FileError(file, "is a link; remove it")
                task.save(path)
                self._written[path] = version_of(path)
            elif not foreign:
                self._written.pop(path, None)
                for file in files:
                    file.unlink(missing_ok=True)
        except Exception as error:  # of any kind: the next state is tried again
            complaint = f"your changes cannot be autosaved: {error}"
            level = logging.WARNING if isinstance(error, EXPECTED_ERRORS) else logging.ERROR
            logger.log(level, "%s: %s", path, error, exc_info=level == logging.ERROR)
        self.complaint = complaint


class Files:
    """The task file of a session, and its autosave."""

    def __init__(self, post: Callable[[Callable[[Session], None]], None], path: Path | None = None) -> None:
        self._autosave = Autosave()
        self._opening: Latest[Path, tuple[Task, Version | None]] = Latest(
            self._load, "pinposture-open", deliver=lambda done: post(partial(self._take, done))
        )
        self._kept: Task | None = None
        self._complaint = ""
        self._version = None if path is None else version_of(path)  # the last one read or written here

    def watch(self, session: Session) -> None:
        """Autosave changes; called by the loop."""
        if self._kept is None:
            self._kept = session.task
        if session.path is not None and session.task is not self._kept:
            self._kept = session.task
            self._autosave.keep(session.task if session.changed else None, session.path)
        if self._autosave.complaint != self._complaint:
            self._complaint = self._autosave.complaint
            if self._complaint:
                session.say(self._complaint, "error")

    def save(self, session: Session, path: Path | None = None) -> None:
        """Save the task in its file, or in another one, which then becomes its file.

        Raises:
            FileError: it cannot be written, another file has that name, or another program changed the file:
                that is reported once, and saving again overwrites it. Nothing changes.
        """
        path = session.path if path is None else path
        if path is None:
            raise FileError("the task", "has no file yet; enter a file name, such as task.toml")
        path = path.absolute()
        there = version_of(path)
        if path != session.path and there is not None:
            raise FileError(path, "already exists; allowed: a new name, or that of the file being edited")
        if there is not None and there != self._version:
            self._version = there
            raise FileError(path, "was changed by another program; save again to overwrite it")
        arm = path.with_suffix(".urdf")
        if arm.is_symlink() and not arm.exists():  # the arm may be written there
            raise FileError(arm, "is a broken link; remove it, or save elsewhere")
        session.task.save(path)
        before = session.path
        session.path = path
        session.saved = session.task
        self._version = version_of(path)
        self._autosave.keep(None, path)
        if before is not None and before != path:
            self._autosave.keep(None, before)
        session.say(f"saved as {path.name}")

    def open(self, session: Session, path: Path) -> None:
        """Open another task file, beside the editor's loop; of several, the last one."""
        path = path.absolute()
        session.say(f"opening {path.name} ...")
        self._opening.ask(path)

    def _load(self, path: Path, _: Event) -> tuple[Task, Version | None]:
        self._autosave.finish()  # perhaps of the same file
        version = version_of(path)
        task = editable(Task.load(path))
        keyframes_of(task)
        return task, version

    def _take(self, done: Done[Path, tuple[Task, Version | None]], session: Session) -> None:
        if done.answer is None:
            session.say(f"cannot open it: {done.error}", "error")
            return
        path = done.request
        task, version = done.answer
        session.replace(task, path, saved=True)
        session.say(f"opened {path.name}")
        restore(session)
        self._version = version

    def close(self) -> None:
        """Finish writing."""
        self._opening.close()
        self._autosave.close()


def restore(session: Session) -> None:
    """Restore the autosaved changes of an editor that ended before it saved the same file.

    Undo discards them. If the task file is newer, the file wins, and redo restores the changes.
    """
    left = None if session.path is None else recover(session.path)
    if left is None:
        return
    if left.task is None:
        try:
            name = _rename_aside(left.path).name
        except OSError as error:
            name = f"{left.path.name} (about to be overwritten: {error.strerror or error})"
        text = f"the unsaved changes in {name} cannot be read: {left.complaint}"
        session.say(text, "error")
        return
    task = _with_same_arm(left.task, session.task, left.path)
    session.take_up(task, min(session.selected, len(keyframes_of(task)) - 1))
    if left.older:
        session.undo()
        text = f"{left.path.name} holds changes older than the task file; redo restores them"
    else:
        back = "discards them" if session.saved is None else "returns to the file"
        text = f"recovered unsaved changes (from {left.path.name}); undo {back}"
    session.say(text, "warning")


def _rename_aside(kept: Path) -> Path:
    """Rename an unreadable autosave file, so that it is not overwritten; returns the new name."""
    free = (kept.with_name(f"{kept.stem}.{k}{kept.suffix}") for k in count(1))
    return kept.rename(next(path for path in free if not path.exists()))


def _with_same_arm(task: Task, current: Task, kept: Path) -> Task:
    """Return an autosaved task with the current arm if it is the same one, so that it need not start anew.

    A URDF file beside the autosave is removed when the task is saved, and is not relied on.
    """
    arm = task.arm
    other = current.arm
    if arm.spec is None or other.spec is None:
        return task
    ignored: dict[str, Any] = {"urdf": arm.urdf, "package_dirs": (), "xacro_args": {}}
    specs = [spec if spec.urdf is None else replace(spec, **ignored) for spec in (arm.spec, other.spec)]
    if arm.urdf == other.urdf and specs[0] == specs[1]:
        return task.edited(arm=other)
    if arm.spec.urdf == settled(kept.with_suffix(".urdf")):
        return task.edited(arm=arm.with_spec(replace(arm.spec, urdf=arm.urdf)))
    return task


def within(folder: Path, name: str, start: Path | None = None) -> Path:
    """Return the file that a name from the page means: the only path from what is typed to a file.

    Args:
        folder: the folder that it has to be in, directly or in folders in there.
        name: the name, which may lead through folders.
        start: the folder that the name counts from; `folder` itself if None.

    Raises:
        FileError: a name that leads, or might lead, out of the folder: from the root, from a home directory,
            by "..", or by a link; or one that no file can have.
    """
    if not name:
        raise FileError("the file", "has no name yet; enter one, such as task.toml")
    named = Path(name)
    path = (folder if start is None else start) / name
    outside = bool(named.anchor) or name.startswith("~") or ".." in named.parts
    try:
        outside = outside or not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # a null byte, links in a circle
        raise FileError(name, f"cannot be found ({error})") from None
    if outside:
        allowed = "allowed: files in that folder; --folder chooses another"
        raise FileError(name, f"is not a file in {folder}; {allowed}")
    return path


def task_files(folder: Path) -> tuple[str, ...]:
    """Return the task files in a folder and its subfolders, as names from there, the latest first.

    Autosaves and hidden folders are left out.
    """
    times: dict[str, float] = {}
    for path in (*folder.glob("*.toml"), *folder.glob("[!.]*/*.toml")):
        with suppress(OSError):  # it may be gone already
            if path.is_file() and not path.stem.endswith(".autosave"):
                times[path.relative_to(folder).as_posix()] = path.stat().st_mtime
    return tuple(sorted(times, key=lambda name: (-times[name], name))[:500])  # more is no choice


class ExportKind(NamedTuple):
    """A file format of motions."""

    suffix: str  # of the file name
    noun: str  # what the file is, in words
    write: Callable[[Trajectory, Path], object]  # writes a motion to a path


class Export(NamedTuple):
    """A file to download."""

    name: str  # of the file
    content: bytes  # of the file
    summary: str  # what it is and how long the motion is, in words


def export(motion: Trajectory, kind: str, stem: str) -> Export:
    """Export a motion, as `pinposture run` and `pinposture export` do.

    Args:
        motion: the motion.
        kind: one of `EXPORT_KINDS`.
        stem: of the file name; letters that are not portable are replaced.

    Raises:
        UnknownName: no such kind.
        MotionError: the motion has faults; `pinposture export --force` writes it all the same.
        FileError: it cannot be written.
        InvalidValue: times that the format cannot hold.
    """
    require_known("kind of export", kind, EXPORT_KINDS)
    suffix, noun, write = EXPORT_KINDS[kind]
    name = f"{re.sub(r'[^A-Za-z0-9._-]+', '_', stem).strip('._') or 'motion'}{suffix}"
    with TemporaryDirectory(prefix="pinposture-") as folder:
        path = Path(folder) / f"motion{suffix}"
        write(motion, path)
        content = path.read_bytes()
    size = f"{len(content) / 1000.0:,.0f} kB" if len(content) >= 1000 else f"{len(content)} bytes"
    end = "" if motion.converged else "; it does not arrive at its last posture"
    if motion.faults:
        end += f"; not for a robot: {'; '.join(motion.faults)}"
    return Export(
        name, content, f"{name}: {noun} of {motion.time[-1]:.4g} s, {motion.steps} cycles, {size}{end}"
    )


def _write_joints(motion: Trajectory, path: Path) -> None:
    save(motion.joint_trajectory(), path)


def _write_picture(motion: Trajectory, path: Path) -> None:
    from pinposture.viz import plot  # slow to import

    picture = io.BytesIO()
    plot(motion).savefig(picture, format="png")
    path.write_bytes(picture.getvalue())


def _write_animation(motion: Trajectory, path: Path) -> None:
    from pinposture.viz import save_html

    save_html(motion.arm, motion, path)


EXPORT_KINDS = {
    "npz": ExportKind(".npz", "the motion", save),
    "CSV": ExportKind(".csv", "joint positions, speeds and accelerations", _write_joints),
    "ROS JSON": ExportKind(".json", "a JointTrajectory message", _write_joints),
    "Picture": ExportKind(".png", "a picture", _write_picture),
    "Animation": ExportKind(".html", "an animation", _write_animation),
}
"""The formats of motions, by the labels of their buttons."""


Array = NDArray[np.float64]


class FirstTask(NamedTuple):
    """The task that the editor starts with, for an arm without one."""

    bends: tuple[float, ...] = (1.4, 0.8, 0.4, 0.2)
    """Turns of the curve between its ends, of which the first that the arm can take is shown [rad]."""

    control_points: int = 6
    """Number of control points of the curve."""

    joint_shares: tuple[float, ...] = (0.3, 0.15, 0.05, 0.0)
    """Shares of joint ranges, for a shape where no bent line can be taken."""

    close: float = 0.02
    """Distance of the whole arm from a curve that it takes closely, relative to the arm."""

    length: float = 1.08
    """Length of the curve, relative to the arm, since modules cut corners."""

    acceleration: float = 20.0
    """Limit of each joint [rad/s^2 or m/s^2]: smooth, and fast enough to follow a drag."""

    bent_time: float = 3.0
    """Time of the second keyframe [s]."""


FIRST_TASK = FirstTask()


def first_task(arm: Arm, name: str = "") -> Task:
    """Return a task for an arm of which nothing is known: straight, and three seconds later bent.

    If the arm takes no such curve closely, its keyframes are taught.

    Args:
        arm: the arm.
        name: of the task.
    """
    straight = _first_feasible(arm, [_line(arm), *_along_arm(arm, (0.0,))])
    arcs = [_arc(arm, bend) for bend in FIRST_TASK.bends]
    bent = _first_feasible(arm, [*arcs, *_along_arm(arm, FIRST_TASK.joint_shares)])
    if straight is None or bent is None:
        shares = (0.0, FIRST_TASK.joint_shares[0])
        ends = (Keyframe(joints=joints_at(arm, _bent(arm, share))) for share in shares)
    else:
        ends = (Keyframe(curve.curve, placement="as_is", trim=True) for curve in (straight, bent))
    first, last = ends
    keyframes = (replace(first, name="straight"), replace(last, name="bent", time=FIRST_TASK.bent_time))
    limits = Limits(step=None, dt=CYCLES.default, acceleration=FIRST_TASK.acceleration)
    return Task(arm=arm, motion=keyframes, limits=limits, name=name)


def _first_feasible(arm: Arm, shapes: list[Shape]) -> Shape | None:
    for shape in shapes:
        with no_warnings():  # of a shape that is only tried
            verdict = judge(arm, Keyframe(shape.curve, placement="as_is", trim=True), None)
        off = verdict.distance_from_curve or 0.0
        if verdict.target is not None and off < FIRST_TASK.close * arm.length:
            return shape
    return None


def _line(arm: Arm) -> Shape:
    along = np.linspace(0.0, FIRST_TASK.length * arm.length, FIRST_TASK.control_points)
    return Shape(_round_points(arm, arm.chain.base + along[:, None] * arm_axis(arm)))


def _arc(arm: Arm, bend: float) -> Shape:
    """Return a shape that leaves along the arm, and turns upwards if it can."""
    ahead = arm_axis(arm)
    up = np.array([0.0, 0.0, 1.0])
    if arm.dimension == 2:
        up = arm.plane.T @ (arm.plane @ up)
        if float(np.linalg.norm(up)) < 0.1:
            up = arm.plane[1]
    side = up - (up @ ahead) * ahead
    if float(np.linalg.norm(side)) < 0.1:
        side = arm.plane.T @ (arm.plane @ np.array([1.0, 0.3, 0.0]))
        side -= (side @ ahead) * ahead
    side /= np.linalg.norm(side)
    # Straight for the first leg, so that the first module need not turn; then an arc.
    leg = FIRST_TASK.length * arm.length / (FIRST_TASK.control_points - 1)
    headings = np.concatenate([[0.0], np.linspace(0.0, bend, FIRST_TASK.control_points - 2)])
    steps = leg * (np.cos(headings)[:, None] * ahead + np.sin(headings)[:, None] * side)
    return Shape(_round_points(arm, arm.chain.base + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])))


def _round_points(arm: Arm, points: Array) -> Array:
    """Round points (n, 3) [m] to a few digits, for legible files; the first stays where it is."""
    digits = 4 - int(np.floor(np.log10(arm.length)))
    return np.vstack([points[:1], np.round(points[1:], digits)])


def _along_arm(arm: Arm, shares: tuple[float, ...]) -> list[Shape]:
    """Return shapes along the stretched arm with its joints moved by shares of their ranges."""
    shapes: list[Shape] = []
    for share in shares:
        try:
            line = arm_line(arm, _bent(arm, share))
            end = line[-1] + (line[-1] - line[-2]) / np.linalg.norm(line[-1] - line[-2]) * 0.05 * arm.length
            through = Curve.points(np.vstack([line, end]))
            tolerance = 2.0 * SHAPE.fit_tolerance * float(arm.chain.module_lengths.mean())
            fitted = through.controlled_within(tolerance, most=SHAPE.most_points)
            shapes.append(Shape(np.array(fitted.coefficients)))
        except PostureError:
            continue
    return shapes


def _bent(arm: Arm, share: float) -> Array:
    """Return the stretched arm with its joints moved by a share towards the middle of their ranges, (nq,)."""
    start = arm.straight()
    lower, upper = (np.clip(edge, -np.pi, np.pi) for edge in (arm.limits.lower, arm.limits.upper))
    middle = np.clip(0.5 * (lower + upper) - arm.positions(start), -1.0, 1.0) * arm.moved
    return arm.integrate(start, share * middle)
