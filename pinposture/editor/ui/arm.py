"""The arm in the page: bodies, colours, ellipsoids, the measured arm, and its tab."""

from __future__ import annotations

import time
from functools import partial
from html import escape
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, ArmState
from pinposture.control import CONTROLLERS
from pinposture.editor.edits import with_controller, with_limits
from pinposture.editor.measured_arm import JointStates
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import Post, Typed, color, on_change, put
from pinposture.viz import palette
from pinposture.viz.body import bodies, body_poses
from pinposture.viz.drawing import arm_surfaces, link_radius
from pinposture.viz.ellipsoids import THINNEST, drawn_length, principal_frame
from pinposture.viz.mesh import TriangleMesh, ball

# The arm in the page: few kinds of bodies, each drawn many times at once, so that long arms move quickly.

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]


class BodyKind(NamedTuple):
    """Bodies that look alike.

    Attributes:
        handle: what draws them.
        members: which bodies these are, by their joint in the chain, 0-based.
    """

    handle: viser.BatchedMeshHandle
    members: NDArray[np.intp]


class ArmDrawing:
    """An arm in the page.

    Args:
        server: the page.
        arm: the arm.
        name: what to call it in the tree of the page.
        opacity: below 1 to see through it.
        tint: one colour for all of it; None for the two shades of modules.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        arm: Arm,
        name: str = "/arm",
        opacity: float | None = None,
        tint: str | None = None,
    ) -> None:
        self.arm = arm
        surfaces = arm_surfaces(arm)
        shades = [palette.MODULES[body.module % len(palette.MODULES)] for body in bodies(arm)]
        self.shades: Colors = np.array([color(tint or shade) for shade in shades], dtype=np.uint8)
        self._colors, self._q = self.shades.copy(), arm.straight()
        poses = body_poses(arm, self._q)
        self._base = server.scene.add_mesh_simple(
            f"{name}/base",
            surfaces.base.vertices,
            surfaces.base.faces,
            color=color(tint or palette.BASE),
            opacity=opacity,
        )
        self._kinds = [
            BodyKind(
                _drawn(server, f"{name}/kind_{k}", surface, poses[members], self.shades[members], opacity),
                members,
            )
            for k, (surface, members) in enumerate(_alike(surfaces.bodies))
        ]

    def move(self, q: Array) -> None:
        """Show it at another configuration, (nq,)."""
        if np.array_equal(q, self._q):
            return
        self._q = np.array(q)
        poses = body_poses(self.arm, q)
        turns = _quaternions(poses)
        for handle, members in self._kinds:
            handle.batched_positions = poses[members, :3, 3].astype(np.float32)
            handle.batched_wxyzs = turns[members]

    def paint(self, colors: Colors | None = None) -> None:
        """Give each body a colour, (n, 3); None: its own."""
        colors = self.shades if colors is None else colors
        if np.array_equal(colors, self._colors):
            return
        self._colors = colors.copy()
        for handle, members in self._kinds:
            handle.batched_colors = colors[members]

    def set_visible(self, visible: bool) -> None:
        """Show it, or not."""
        for node in (self._base, *(kind.handle for kind in self._kinds)):
            if node.visible != visible:
                node.visible = visible

    def remove(self) -> None:
        """Take it away for good."""
        for node in (self._base, *(kind.handle for kind in self._kinds)):
            node.remove()


def _alike(surfaces: tuple[TriangleMesh, ...]) -> list[tuple[TriangleMesh, NDArray[np.intp]]]:
    """Surfaces that differ, and which bodies have each."""
    groups: dict[bytes, list[int]] = {}
    for index, surface in enumerate(surfaces):
        key = np.round(surface.vertices, 9).tobytes() + surface.faces.tobytes()
        groups.setdefault(key, []).append(index)
    return [(surfaces[members[0]], np.array(members)) for members in groups.values()]


def _drawn(
    server: viser.ViserServer,
    name: str,
    surface: TriangleMesh,
    poses: Array,
    colors: Colors,
    opacity: float | None,
) -> viser.BatchedMeshHandle:
    return server.scene.add_batched_meshes_simple(
        name,
        surface.vertices,
        surface.faces,
        batched_wxyzs=_quaternions(poses),
        batched_positions=poses[:, :3, 3],
        batched_colors=colors,
        opacity=opacity,
        lod="off",
    )


def _quaternions(poses: Array) -> NDArray[np.float32]:
    """Turns of homogeneous transforms (n, 4, 4) as quaternions w, x, y, z, (n, 4)."""
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return np.asarray(turns[:, [3, 0, 1, 2]], dtype=np.float32)


# Colours of the bodies of the arm: which joints are at limits, which stretches are near singular.

WAYS = ("limits that bind", "nearness to singular", "modules only")
"""What the colours can say."""

NEAR = 0.02
"""Manipulability index below which a stretch is near singular."""

SHARE = 0.2
"""How much of the arm is a stretch that is looked at."""


def paint(way: str, live: Live, shades: Colors) -> Colors:
    """Colours of the bodies, (n, 3).

    Args:
        way: one of `WAYS`.
        live: the arm.
        shades: what they are if nothing is to be said.
    """
    if way == WAYS[0] and np.any(live.at_limit):
        colors: Colors = shades.copy()
        colors[live.at_limit] = color(palette.MARK)
        return colors
    if way == WAYS[1]:
        indices = stretch_indices(live.state)
        by_module: Colors = np.array(
            [color(palette.index_color(float(index))) for index in indices], dtype=np.uint8
        )
        sizes = [len(joints) for joints in live.arm.module_joints]
        return np.repeat(by_module, sizes, axis=0)
    return shades


def stretch_indices(state: ArmState) -> NDArray[np.float64]:
    """Manipulability index of a short stretch that ends at each control point, (m,).

    The stretch is a fifth of the arm, and as many modules at least as have joints enough to move its end in
    all directions; the index is small where these modules together are near singular, as where they lie
    straight.
    """
    arm = state.arm
    width, m = stretch_width(arm), arm.n_modules
    ends = np.arange(1, m + 1)
    own: NDArray[np.float64] = state.manipulability()[np.maximum(ends - width, 0), ends]
    if width > 1:
        own[: width - 1] = own[width - 1] if m >= width else 0.0
    return own


def stretch_width(arm: Arm) -> int:
    """How many modules such a stretch has."""
    sizes = [len(joints) for joints in arm.module_joints]
    for width in range(max(1, round(SHARE * arm.n_modules)), arm.n_modules + 1):
        if all(sum(sizes[k : k + width]) >= arm.dimension for k in range(len(sizes) - width + 1)):
            return width
    return arm.n_modules


def near_singular(state: ArmState) -> list[tuple[int, int]]:
    """First and last module of each stretch that is near singular, counted from 1."""
    near = stretch_indices(state) < NEAR
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    return [(int(first) + 1, int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]


# Manipulability ellipsoids in the page.

MOST = 8
"""How many are shown at most."""

OPACITY = 0.4


class Ellipsoids:
    """Ellipsoids of some control points, evenly along the arm.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._arm = arm
        every = -(-arm.n_modules // MOST)
        self.points = tuple(range(arm.n_modules - 1, -1, -every))[::-1]
        count = len(self.points)
        self._length = drawn_length(arm, self.points)
        self._thinnest = THINNEST * link_radius(arm)
        self._steps, self._visible = -1, False
        surface = ball(np.zeros(3), 1.0, 3)
        self._balls = server.scene.add_batched_meshes_simple(
            "/ellipsoids",
            *surface,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            batched_positions=np.zeros((count, 3)),
            batched_scales=np.full((count, 3), 1e-6),
            batched_colors=np.tile(color(palette.REGULAR), (count, 1)),
            opacity=OPACITY,
            cast_shadow=False,
            receive_shadow=False,
            lod="off",
            visible=False,
        )

    def show(self, state: ArmState, steps: int, visible: bool) -> None:
        """Show them at a state of the arm, or not at all.

        Args:
            state: the state.
            steps: a number that is another where the state is.
            visible: whether to show them.
        """
        if visible != self._visible:
            self._visible = visible
            self._balls.visible = visible
        if not visible or steps == self._steps:
            return
        self._steps = steps
        listed = state.ellipsoids(self.points)
        frames = np.array([principal_frame(one) for one in listed])
        radii = np.array([np.append(one.radii, 0.0)[:3] for one in listed]) * self._length
        turns = Rotation.from_matrix(frames.transpose(0, 2, 1)).as_quat()[:, [3, 0, 1, 2]]
        self._balls.batched_positions = np.array([one.center for one in listed], dtype=np.float32)
        self._balls.batched_wxyzs = turns.astype(np.float32)
        self._balls.batched_scales = np.maximum(radii, self._thinnest).astype(np.float32)
        colors = [color(palette.index_color(one.index)) for one in listed]
        self._balls.batched_colors = np.array(colors, dtype=np.uint8)


# Where the arm is measured to be, beside where it is planned to be.

MEASURED_OPACITY = 0.45
"""How opaque the measured arm is."""

OLD = 1.0
"""Age from which on joint states are said to be old [s]."""


class MeasuredArm:
    """A see-through arm where joint states say that it is, and how far that is from the plan.

    Args:
        server: the page; what it says is written where it is at.
        arm: the arm.
        states: the joint states; None if there are none. Nothing is shown then, nor if they are of another
            arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, states: JointStates | None) -> None:
        # Joint states of another arm, that was there before, say nothing of this one.
        self._states, self._count = (states if states is not None and states.arm is arm else None), -1
        if self._states is None:
            return
        self._about = server.gui.add_html("")
        self._text = ""
        self._drawing = ArmDrawing(server, arm, "/measured", MEASURED_OPACITY, palette.FINAL)
        self._drawing.set_visible(False)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del session
        if self._states is None:
            return
        latest = self._states.latest
        if latest.count != self._count and latest.count > 0:
            self._count = latest.count
            self._drawing.move(latest.q)
            self._drawing.set_visible(True)
        if latest.count == 0:
            lines = ["no joint states yet"]
        else:
            away = live.arm.at(latest.q).points - live.state.points
            distance = float(np.linalg.norm(away, axis=1).mean())
            lines = [f"{1000.0 * distance:.3g} mm from the plan on average"]
            if latest.age > OLD:
                lines.append(f"the last joint state is {latest.age:.0f} s old")
        if latest.complaint:
            lines.append(latest.complaint)
        text = "<br>".join(map(escape, lines))
        if text != self._text:
            self._text = text
            self._about.content = (
                '<div style="font-size:13px;line-height:1.35;padding:2px 10px 4px 10px">'
                f'<div id="measured" style="border-left:4px solid {palette.FINAL};padding-left:8px">'
                f"<b>Measured</b><br>{text}</div></div>"
            )


# The tab for the arm: what moves it, within what, and what of it is shown.

PAUSE = 0.25
"""How long facts stay as they are, for people to read them [s]."""

NAMED = 4
"""How many stretches are listed."""


class ArmTab:
    """Controls for the arm.

    Args:
        server: the page; the controls are made where it is at.
        drawing: the arm in the page.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, drawing: ArmDrawing, post: Post) -> None:
        self._drawing, self._post, gui = drawing, post, server.gui
        self._ellipsoids = Ellipsoids(server, drawing.arm)
        self._steps, self._due = -1, 0.0
        self._facts = gui.add_markdown("")
        self._controller = gui.add_dropdown("Controller", tuple(CONTROLLERS), hint="What moves the arm")
        speed = gui.add_number(
            "Speed [rad/s]", 0.0, min=0.0, step=0.1, hint="Of each joint at most; 0: as the arm is described"
        )
        acceleration = gui.add_number(
            "Accel. [rad/s²]", 0.0, min=0.0, step=1.0, hint="Of each joint at most; 0: no limit"
        )
        self._at_once = gui.add_checkbox(
            "At once", False, hint="Take each shape at once, whatever the limits"
        )
        self._way = gui.add_dropdown("Colours", WAYS, hint="Red: at a limit, or near singular")
        self._balls = gui.add_checkbox("Ellipsoids", False, hint="Manipulability; red and flat: singular")
        on_change(self._controller, self._controlled)
        self._limits = (
            Typed(speed, partial(self._limited, "velocity", "speed")),
            Typed(acceleration, partial(self._limited, "acceleration", "acceleration")),
        )
        on_change(self._at_once, self._hurried)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        limits = session.task.limits
        put(self._controller, value=session.task.controller.name)
        for field, limit in zip(self._limits, (limits.velocity, limits.acceleration), strict=True):
            several = np.ndim(limit if limit is not None else 0.0) > 0
            field.show(0.0 if limit is None else round(float(np.min(limit)), 6), disabled=several)
        put(self._at_once, value=session.at_once)
        now = time.monotonic()
        if live.steps != self._steps and now >= self._due:
            self._steps, self._due = live.steps, now + PAUSE
            put(self._facts, content=_facts(live))
        self._drawing.paint(paint(self._way.value, live, self._drawing.shades))
        self._ellipsoids.show(live.state, live.steps, self._balls.value)

    def _controlled(self, name: str) -> None:
        self._post(lambda session: session.edit(with_controller(name), f"controller {name}"))

    def _limited(self, key: str, what: str, value: float, over: bool) -> None:
        del over
        limit = None if value == 0.0 else float(value)
        text = f"{what} {value:g}" if limit else f"no limit of {what} of our own"
        self._post(lambda session: session.edit(with_limits(**{key: limit}), text))

    def _hurried(self, value: bool) -> None:
        def request(session: Session) -> None:
            session.at_once = value
            session.touch()

        self._post(request)


def _facts(live: Live) -> str:
    """The arm in a few words."""
    arm = live.arm
    stretches = near_singular(live.state)
    listed = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in stretches[:NAMED])
    more = " ..." if len(stretches) > NAMED else ""
    bound = int(np.count_nonzero(live.at_limit))
    lag = "..." if live.lag is None else f"{1000.0 * live.lag:.0f} ms"
    return (
        f"**{arm.n_modules} modules, {arm.nv} joints, {arm.length:.3g} m**\n\n"
        f"Near singular: {f'modules {listed}{more}' if listed else 'nowhere'}\n\n"
        f"Joints at a limit: {bound or 'none'}\n\n"
        f"First step after a change: {lag}"
    )
