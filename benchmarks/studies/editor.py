"""How often the arm moves in the page while a hand drags, and how long after the hand.

    python -m benchmarks.studies.editor --modules 20 100

A client that speaks the protocol of the page, without drawing, drags and looks at what it is sent. It drags

* a control point of the curve, in circles, telling of its moves twenty times a second, as browsers do, and as
  often as it likes;
* the tip of the arm, in circles;
* a ball of 6 % of the arm's length to and fro through the middle of the arm, at 20 % of its length a second.

For each: postures of the arm a second, and the longest time without one; for the ball, while it is near, and
the smallest distance of the arm from it. Then, how long after a single move from rest the first posture
towards it comes. What a browser needs to draw is not in these figures. Besides, how long least squares take
that lay the arm on the curve, where Algorithm 1 would zigzag: from the straight arm, and from where it was.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from viser._messages import (
    SceneNodeDragMessage,
    TransformControlsDragEndMessage,
    TransformControlsDragStartMessage,
    TransformControlsUpdateMessage,
)

import pinposture as pp
from benchmarks.page_client import PageClient
from pinposture.editor import Editor
from pinposture.editor.edits import with_obstacle
from pinposture.editor.files import first_task
from pinposture.editor.postures import hold_tip
from pinposture.editor.session import Session

PACES = {"as browsers": 0.05, "at will": 0.01}
"""How often the client tells of a drag [s]."""

RADIUS, ROUNDS = 0.08, 0.5
"""Of the circles, relative to the arm; and how many a second."""

BALL, BALL_SPEED, BALL_TRAVEL = 0.06, 0.2, 0.3
"""Radius of the ball, its speed [1/s], and how far it is dragged to each side, relative to the arm."""

NEAR = 0.015
"""The arm has to move while the ball is nearer than this [m]: three margins."""

REST = 0.3
"""Without a posture for so long, the arm is at rest [s]."""

Tell = Callable[[str, np.ndarray], None]
"""Tells of a drag: its phase ("start", "update" or "end"), and where the hand is, (3,) [m]."""


class Client(PageClient):
    """A browser without a picture that notes when postures of the arm come; as `PageClient`."""

    def __init__(self, url: str) -> None:
        self.postures: list[float] = []  # when each came
        super().__init__(url)

    def drag(self, name: str, home: np.ndarray, phase: str, place: np.ndarray) -> None:
        """Tell of a drag of something that was at home."""
        message = SceneNodeDragMessage(
            phase=phase,
            name=name,
            instance_index=None,
            start_position=tuple(map(float, home)),
            start_screen_pos=(0.5, 0.5),
            end_position=tuple(map(float, place)),
            end_screen_pos=(0.5, 0.5),
            button="left",
            modifier=None,
        )
        self._tell(message)

    def drag_axes(self, name: str, phase: str, place: np.ndarray) -> None:
        """Tell of a drag by axes."""
        if phase == "start":
            self._tell(TransformControlsDragStartMessage(name))
        x, y, z = map(float, place)
        self._tell(TransformControlsUpdateMessage(name, (1.0, 0.0, 0.0, 0.0), (x, y, z)))
        if phase == "end":
            self._tell(TransformControlsDragEndMessage(name))

    def _take(self, messages: list[dict[str, Any]]) -> None:
        if any(map(_moves_the_arm, messages)):
            self.postures.append(time.perf_counter())


def _moves_the_arm(message: dict[str, Any]) -> bool:
    arm = str(message.get("name", "")).startswith("/arm/")
    return arm and "batched_positions" in message.get("updates", ())


def rested(client: Client) -> None:
    """Wait until the arm is at rest."""
    while not client.postures or time.perf_counter() - client.postures[-1] < REST:
        time.sleep(0.05)


def drag_along(
    client: Client,
    tell: Tell,
    path: Callable[[float], np.ndarray],
    seconds: float,
    every: float,
    counts: Callable[[np.ndarray], bool] = lambda _: True,
) -> dict[str, float]:
    """Drag something along a path; return how often postures came, while the place of the hand counts."""
    tell("start", path(0.0))
    begun = due = time.perf_counter()
    runs: list[list[float]] = []  # beginning and end of the times that count
    while (passed := time.perf_counter() - begun) < seconds:
        place = path(passed)
        tell("update", place)
        due += every
        time.sleep(max(0.0, due - time.perf_counter()))
        now = time.perf_counter()
        if passed < 0.5 or not counts(place):
            continue
        if runs and runs[-1][1] > begun + passed - every:
            runs[-1][1] = now
        else:
            runs.append([begun + passed, now])
    times = np.array(client.postures)
    tell("end", path(0.0))
    rested(client)
    came = [times[(times > start) & (times <= end)] for start, end in runs]
    return {
        "postures a second": sum(map(len, came)) / max(sum(end - start for start, end in runs), 1e-9),
        "longest gap [ms]": 1e3 * max(float(np.diff(each).max(initial=0.0)) for each in came),
    }


def circle(home: np.ndarray, radius: float, passed: float) -> np.ndarray:
    """Where a hand is that goes in circles from home."""
    angle = 2.0 * np.pi * ROUNDS * passed
    return home + radius * np.array([0.0, np.sin(angle), 1.0 - np.cos(angle)])


def to_and_fro(home: np.ndarray, side: np.ndarray, length: float, passed: float) -> np.ndarray:
    """Where a hand is that goes from one side of home to the other and back, at a constant speed."""
    period = 4.0 * BALL_TRAVEL / BALL_SPEED
    share = abs((passed / period) % 1.0 - 0.5) * 4.0 - 1.0  # from 1 to -1 and back
    return home + share * BALL_TRAVEL * length * side


def resolving(arm: pp.Arm, moves: int) -> dict[str, float]:
    """How long it takes to lay the arm on a curve that leaves its base at an angle, as it is dragged."""
    points = arm.length * np.linspace([0.0, 0.0, 0.0], [1.1, 0.0, 0.3], 6)
    near, took = None, []
    for k in range(moves + 1):
        points[1] = arm.length * np.array([0.2, 0.04 + 0.002 * k, 0.1])
        begun = time.perf_counter()
        near = pp.resolve_targets(arm, pp.Curve.spline(points), placement="as_is", method="smooth", near=near)
        took.append(1e3 * (time.perf_counter() - begun))
    return {"least squares, anew [ms]": took[0], "least squares, near [ms]": statistics.median(took[1:])}


def drag_ball(editor: Editor, client: Client, seconds: float) -> dict[str, float]:
    """Drag a ball through the arm; what comes of it."""
    arm = editor.session.arm
    home, side = editor.live.state.points[arm.n_modules // 2].copy(), np.array([0.0, 1.0, 0.0])
    path = partial(to_and_fro, home, side, arm.length)
    ball = pp.Sphere(tuple(path(0.0)), BALL * arm.length)

    def add(session: Session) -> None:
        session.edit(with_obstacle("ball", ball), "added a ball")

    editor.post(add)
    time.sleep(2.0)
    scene = pp.Scene({"ball": ball}, self_collision=False)
    distances: list[float] = []

    def is_near(place: np.ndarray) -> bool:
        there = scene.moved({"ball": place - path(0.0)}, {"ball": (0.0, 0.0, 0.0)})
        distances.append(pp.CollisionModel(arm, there).minimum(editor.live.state.q).distance)
        return distances[-1] < NEAR

    tell = partial(client.drag, "/obstacles/1", path(0.0))
    measured = drag_along(client, tell, path, seconds, PACES["as browsers"], is_near)
    return {**measured, "smallest distance [mm]": 1e3 * min(distances)}


def measure(modules: int, seconds: float, moves: int) -> dict[str, float]:
    """Drag, and see what comes of it."""
    arm = pp.Arm.from_template("RyRz", modules=modules)
    resolved = resolving(arm, moves)
    editor = Editor(first_task(arm), port=8300)
    editor.start()
    client = Client(editor.url)
    try:
        time.sleep(2.0)
        home, reach = np.array(editor.session.shape.points[4]), RADIUS * arm.length
        hand = partial(client.drag, "/handles/point_5", home)
        rates: dict[str, float] = {}

        def add(what: str, figures: dict[str, float]) -> None:
            rates.update({f"{what}: {name}": figure for name, figure in figures.items()})

        for pace, every in PACES.items():
            figures = drag_along(client, hand, partial(circle, home, reach), seconds, every)
            add(f"curve, {pace}", figures)

        lags = []
        for k in range(moves):
            rested(client)
            before = len(client.postures)
            sent = time.perf_counter()
            place = home + reach * np.array([0.0, 1.0 if k % 2 else -1.0, 0.0])
            hand("start", place)
            hand("end", place)
            while len(client.postures) == before and time.perf_counter() - sent < 5.0:
                time.sleep(0.0005)
            lags.append(client.postures[before] - sent)

        editor.post(hold_tip)
        time.sleep(0.5)
        tip = editor.live.state.points[-1].copy()
        axes = partial(client.drag_axes, "/handles/tip")
        add("tip", drag_along(client, axes, partial(circle, tip, reach), seconds, PACES["as browsers"]))
        add("ball", drag_ball(editor, client, max(seconds, 2.5 * BALL_TRAVEL / BALL_SPEED)))
        return {
            "modules": modules,
            "joints": arm.nv,
            **rates,
            "lag, median [ms]": 1e3 * statistics.median(lags),
            "lag, longest [ms]": 1e3 * max(lags),
            **resolved,
        }
    finally:
        client.close()
        editor.close()


def main() -> None:
    """Measure and print."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("--modules", type=int, nargs="+", default=[20, 100], help="arms to try")
    parser.add_argument("--seconds", type=float, default=6.0, help="how long to drag")
    parser.add_argument("--moves", type=int, default=15, help="single moves from rest")
    parser.add_argument("--json", action="store_true", help="print JSON")
    given = parser.parse_args()
    rows = [measure(modules, given.seconds, given.moves) for modules in given.modules]
    if given.json:
        print(json.dumps(rows, indent=2))
        return
    for key in rows[0]:
        print(f"{key:40s}" + "".join(f"{row[key]:12.4g}" for row in rows))


if __name__ == "__main__":
    main()
