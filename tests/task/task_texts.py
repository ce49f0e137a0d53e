"""Task files that the tests share, as text, and ways to spoil them."""

from __future__ import annotations

from typing import NamedTuple

VALID = """\
# An arm of six modules, 0.3 m long.
version = 1
kind = "keyframes"
name = "bow"

[arm]
template = "RyRz"
modules = 6
link_lengths = ["25 mm", 0.025]
joint_limits = ["-170 deg", 3.0]

[limits]
cycle = "20 ms"
velocity = "90 deg/s"
acceleration = 10

[controller]
name = "geodesic"
joint_weight = 0.2

[start]
posture = "straight"

[scene]
margin = "5 mm"

[scene.obstacles.ball]
type = "sphere"
center = [0.0, 0.0, "-50 cm"]
radius = 0.1

[[keyframes]]
name = "straight"
curve = { type = "line", a = [0, 0, 0], b = [0.3, 0, 0] }

[[keyframes]]
name = "bowed"
time = "1 s"
hold = 0.1
curve = { type = "helix", radius = "10 cm", pitch = 0, turns = 0.6 }
placement = "align"
trim = true

[output]
formats = ["npz", "csv"]
"""

LEADER = """\
version = 1
kind = "follow_leader"

[arm]
template = "RyRz"
modules = 4
feed = { stroke = "30 cm" }

[limits]
cycle = "200 ms"

[leader]
path = { type = "spline", control_points = [[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0.1, 0]] }
speed = "5 cm/s"
depth = 0.1
pipe = "45 mm"
"""

TEXTS = {
    "LINE": 'curve = { type = "line", a = [0, 0, 0], b = [0.3, 0, 0] }',
    "BOW": 'curve = { type = "helix", radius = "10 cm", pitch = 0, turns = 0.6 }',
    "TEMPLATE": VALID[VALID.index("template") : VALID.index("\n[limits]")],
    "LIMITS": VALID[VALID.index("[limits]") : VALID.index("[start]")],
    "LIMITED": VALID[VALID.index("[limits]") : VALID.index("acceleration")],
    "SCENE": VALID[VALID.index("[scene]") : VALID.index("[[keyframes]]")],
    "KEYFRAMES": VALID[VALID.index("[[keyframes]]") : VALID.index("[output]")],
    "BOWED": VALID[VALID.rindex("[[keyframes]]") : VALID.index("[output]")],
    "SECOND": '[[keyframes]]\nname = "bowed"',
    "PATH": LEADER[LEADER.index("path =") : LEADER.index("\nspeed")],
    "LED": LEADER[LEADER.index("[leader]") :],
}


class Mistake(NamedTuple):
    """A file with a mistake in it.

    Attributes:
        text: the file.
        line: the line that the message should name; None if there is none to name.
        says: what else it should contain.
    """

    text: str
    line: int | None
    says: tuple[str, ...]


def mistakes(valid: str, listed: str) -> dict[str, Mistake]:
    """The mistakes of a list (`mistakes.py` says how it is written), by their lines in it."""
    found = {}
    for row in listed.strip().replace("\n    ::", " ::").split("\n"):
        change, _, told = row.partition(" :: ")
        told, _, place = told.partition(" @ ")
        after = " + " in change
        old, new = change.replace(" ->", " -> ", 1).split(" + " if after else " -> ", 1)
        old = _text(old)
        new = _text(new.strip())
        assert old in valid, old
        new += "\n" if new and old.endswith("\n") and not new.endswith("\n") else ""
        put_in = f"{old}\n{new}" if after else new
        at = valid.index(old)
        text = valid[:at] + put_in + valid[at + len(old) :]
        end = at + len(put_in.partition("§")[0].rstrip())
        text = text.replace("§", "")
        line: int | None = text[:end].count("\n") + 1
        if place == "none":
            line = None
        elif place:
            if _text(place) not in text:  # a key that has to stand before all tables
                text = f"{place}\n{text}"
            line = text[: text.index(_text(place))].count("\n") + 1
        found[row] = Mistake(text, line, tuple(words.strip() for words in told.split("|")))
    return found


def _text(words: str) -> str:
    return TEXTS.get(words, words.replace("\\n", "\n"))
