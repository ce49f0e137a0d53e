"""What the page of an animation says: under each configuration, and of the colours."""

from __future__ import annotations

import html
from collections.abc import Sequence

from pinposture.motion import Motion
from pinposture.view import palette
from pinposture.view.animation import Film
from pinposture.view.clearance import has_clearance
from pinposture.view.ellipsoids import KEY
from pinposture.view.staging import Staged
from pinposture.view.words import is_slowed, moved_curves


def texts(shown: Film) -> list[str]:
    """What is written under each configuration that is shown."""
    listed, run = [], shown.run
    for row in shown.rows:
        text = _step(shown, row) if shown.motion is None else _moment(shown.motion, row)
        listed.append(text + (f", clearance {run.clearance[row]:.3g} m" if has_clearance(run) else ""))
    return listed


def _step(shown: Film, row: int) -> str:
    """A configuration of a run in words."""
    run = shown.run
    text = f"step {row} of {run.steps}, posture error {run.posture_error[row]:.3g} m"
    if run.steps:
        count = int(run.active[min(row, run.steps - 1)].sum())
        text += f", {count} of {run.arm.n_modules} control points active"
        if run.switches:
            text += f" by {run.method[min(row, run.steps - 1)].capitalize()}"
    return text


def _moment(motion: Motion, row: int) -> str:
    """A configuration of a motion in words."""
    text = f"{motion.time[row]:.2f} of {motion.time[-1]:.2f} s"
    if is_slowed(motion):
        text += f" ({motion.clock[row]:.2f} of {motion.planned:.2f} s of the plan)"
    count = sum(place.row is not None and place.row <= row for place in motion.passed)
    if row < motion.set_out:
        text += ", coming to the first posture"
    elif count:
        text += f", reached {motion.passed[count - 1].name} ({count} of {len(motion.passed)})"
    return f"{text}, posture error {motion.run.posture_error[row]:.3g} m"


def legend(shown: Film, setting: Staged, target: bool, scale: str) -> str:
    """What the colours mean, and how fast a motion is shown, as HTML.

    Args:
        shown: what is shown.
        setting: what is drawn of it.
        target: whether a target is drawn that stays where it is.
        scale: the scale of ellipsoids, in words; empty if there are none.
    """
    entries = [("target", palette.TARGET)] if target else []
    if shown.motion is not None:
        entries = [("target of the moment", palette.TARGET)]
    if shown.run.steps:
        entries += [("active control point", palette.ACTIVE), ("idle", palette.IDLE)]
    else:
        entries.append(("control point", palette.IDLE))
    if setting.obstacles:
        entries.append(("obstacle", palette.OBSTACLE))
    lines = [_dots(entries)]
    if shown.motion is not None:
        lines.append(_in_time(shown, setting))
    moved = moved_curves(shown.run if shown.motion is None else shown.motion)
    if moved:
        lines.append(html.escape(moved))
    if scale:
        listed = [(f"index {meaning}", color) for color, meaning in KEY.items()]
        lines.append(f"ellipsoids, {scale}: {_dots(listed)}")
    return "<br>".join(lines)


def _in_time(shown: Film, setting: Staged) -> str:
    speed = "shown in real time" if shown.pace == 1.0 else f"shown {shown.pace:.0f} times as fast as it was"
    named = [(", ".join(place.name for place in group), group[0].color) for group in setting.places]
    return f"{speed}; targets at {_dots(named)}" if named else speed


def _dots(entries: Sequence[tuple[str, str]]) -> str:
    dots = [
        f'<span class="dot" style="background: {color}"></span>{html.escape(name)}' for name, color in entries
    ]
    return "".join(dots)
