"""The arm in the page: bodies, colours, ellipsoids, the measured arm, and the Arm tab."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.arm.weight import Weight
from pinposture.control import CONTROLLERS, Limits
from pinposture.editor.edits import (
    differ_in_weight_alone,
    is_at_tip,
    with_controller,
    with_limits,
    with_tip_load,
    with_weight,
)
from pinposture.editor.measured_arm import JointStates
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import (
    Bound,
    Post,
    Request,
    color,
    framed_html,
    legend_html,
    put,
    quaternions,
)
from pinposture.schema import describe_field
from pinposture.units import length_text
from pinposture.viz import palette
from pinposture.viz.arm_figure import LOADS, load_levels
from pinposture.viz.body import TriangleMesh, ball, bodies, body_poses
from pinposture.viz.drawing import arm_surfaces, link_radius
from pinposture.viz.palette import THEME
from pinposture.viz.postures import POSTURES, drawn_length, principal_frame

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]


class Colorings(NamedTuple):
    """By what bodies are coloured, as the page calls it."""

    at_limits: str = "joints at limits"
    near_singular: str = "distance from singularity"
    modules: str = "modules only"
    torques: str = "torque at rest"


COLORING = Colorings()

COLORINGS = {
    COLORING.at_limits: ((THEME.mark, "a joint at a limit"),),
    COLORING.near_singular: (
        (palette.index_color(0.0), "singular"),
        (palette.index_color(0.25 * THEME.regular_index), "near"),
        (palette.index_color(THEME.regular_index), "far from it"),
    ),
    COLORING.modules: (),
    COLORING.torques: tuple((shade, meaning) for _, shade, _, meaning in LOADS),
}
"""For each choice, the colours and what they mean."""


class ArmLook(NamedTuple):
    """How the arm is drawn, and what is said of it."""

    near_singular: float = 0.02
    """Manipulability index below which a stretch is near singular."""

    stretch: float = 0.2
    """Length of a stretch, relative to the arm."""

    most_named: int = 4
    """Most stretches that are named."""

    most_ellipsoids: int = 8
    """Most ellipsoids that are drawn."""

    ellipsoid_opacity: float = 0.4
    """Opacity of ellipsoids."""

    measured_opacity: float = 0.45
    """Opacity of the measured arm."""

    old_age: float = 1.0
    """Age from which on joint states are called old [s]."""

    rate_digits: int = 4
    """Digits of limits behind the point."""

    facts_period: float = 0.25
    """Time for which facts stay, so that they can be read [s]."""


LOOK = ArmLook()


class ArmDrawing:
    """An arm in the page, in the shades of its modules or in one tint.

    It is drawn as few kinds of bodies, so that long arms move quickly.

    Attributes:
        foot: vertices of the base, (n, 3) [m], world frame.
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
        self.foot = surfaces.base.vertices
        shades = [THEME.modules[body.module % len(THEME.modules)] for body in bodies(arm)]
        self.shades: Colors = np.array([color(tint or shade) for shade in shades], dtype=np.uint8)
        self._colors = self.shades.copy()
        self.q = arm.straight()
        poses = body_poses(arm, self.q)
        self._base = server.scene.add_mesh_simple(
            f"{name}/base",
            surfaces.base.vertices,
            surfaces.base.faces,
            color=color(tint or THEME.base),
            opacity=opacity,
        )
        # Bodies that look alike: what draws them, and their joints in the chain, 0-based.
        self._kinds: list[tuple[viser.BatchedMeshHandle, NDArray[np.intp]]] = []
        for k, (surface, members) in enumerate(_group_alike(surfaces.bodies)):
            handle = server.scene.add_batched_meshes_simple(
                f"{name}/kind_{k}",
                surface.vertices,
                surface.faces,
                batched_wxyzs=quaternions(poses[members, :3, :3]).astype(np.float32),
                batched_positions=poses[members, :3, 3],
                batched_colors=self.shades[members],
                opacity=opacity,
                lod="off",
            )
            self._kinds.append((handle, members))

    def move(self, q: Array) -> None:
        """Show it at another configuration, (nq,)."""
        if np.array_equal(q, self.q):
            return
        self.q = np.array(q)
        poses = body_poses(self.arm, q)
        wxyzs = quaternions(poses[:, :3, :3]).astype(np.float32)
        for handle, members in self._kinds:
            handle.batched_positions = poses[members, :3, 3].astype(np.float32)
            handle.batched_wxyzs = wxyzs[members]

    def paint(self, colors: Colors | None = None) -> None:
        """Colour each body, (n, 3); None for their own colours."""
        colors = self.shades if colors is None else colors
        if np.array_equal(colors, self._colors):
            return
        self._colors = colors.copy()
        for handle, members in self._kinds:
            handle.batched_colors = colors[members]

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""
        for node in (self._base, *(handle for handle, _ in self._kinds)):
            put(node, visible=visible)


def _group_alike(surfaces: tuple[TriangleMesh, ...]) -> list[tuple[TriangleMesh, NDArray[np.intp]]]:
    """Return the surfaces that differ, and which bodies have each."""
    groups: dict[bytes, list[int]] = {}
    for index, surface in enumerate(surfaces):
        key = np.round(surface.vertices, 9).tobytes() + surface.faces.tobytes()
        groups.setdefault(key, []).append(index)
    return [(surfaces[members[0]], np.array(members)) for members in groups.values()]


def body_colors(coloring: str, live: Live, shades: Colors) -> Colors:
    """Return the colours of the bodies, (n, 3), by one of `COLORINGS`; their own shades are the default."""
    if coloring == COLORING.at_limits and np.any(live.at_limit):
        colors: Colors = shades.copy()
        colors[live.at_limit[live.arm.chain.input_numbers]] = color(THEME.mark)
        return colors
    if coloring == COLORING.near_singular:
        indices = stretch_indices(live.state)
        shown = [color(palette.index_color(float(index))) for index in indices]
        by_module: Colors = np.array(shown, dtype=np.uint8)
        return np.repeat(by_module, [len(joints) for joints in live.arm.module_joints], axis=0)
    if coloring == COLORING.torques and live.arm.torques_known:
        return np.array([color(LOADS[level][1]) for level in load_levels(live.state)], dtype=np.uint8)
    return shades


def stretch_indices(state: ArmState) -> NDArray[np.float64]:
    """Return the manipulability index of a short stretch of modules that ends at each control point, (m,).

    The stretch is a fifth of the arm, and at least as many modules as have enough joints to move its end in
    all directions; the index is small where these modules together are near singular, for instance straight.
    """
    arm = state.arm
    width = stretch_width(arm)
    m = arm.n_modules
    ends = np.arange(1, m + 1)
    values: NDArray[np.float64] = state.manipulability()[np.maximum(ends - width, 0), ends]
    if width > 1:
        values[: width - 1] = values[width - 1] if m >= width else 0.0
    return values


def stretch_width(arm: Arm) -> int:
    """Return how many modules such a stretch has."""
    sizes = np.diff(arm.chain.input_ends, prepend=0).tolist()
    for width in range(max(1, round(LOOK.stretch * arm.n_modules)), arm.n_modules + 1):
        if all(sum(sizes[k : k + width]) >= arm.dimension for k in range(len(sizes) - width + 1)):
            return width
    return arm.n_modules


def near_singular(state: ArmState) -> list[tuple[int, int]]:
    """Return the first and last module of each stretch that is near singular, counted from 1."""
    near = stretch_indices(state) < LOOK.near_singular
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    return [(int(first) + 1, int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]


class Ellipsoids:
    """Manipulability ellipsoids at some control points, evenly along the arm."""

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        every = -(-arm.n_modules // LOOK.most_ellipsoids)
        self.points = tuple(range(arm.n_modules - 1, -1, -every))[::-1]
        count = len(self.points)
        self._length = drawn_length(arm, self.points)
        self._thinnest = POSTURES.least_ellipsoid * link_radius(arm)
        self._steps = -1
        self._balls = server.scene.add_batched_meshes_simple(
            "/ellipsoids",
            *ball(np.zeros(3), 1.0, 3),
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            batched_positions=np.zeros((count, 3)),
            batched_scales=np.full((count, 3), 1e-6),
            batched_colors=np.tile(color(THEME.regular), (count, 1)),
            opacity=LOOK.ellipsoid_opacity,
            cast_shadow=False,
            receive_shadow=False,
            lod="off",
            visible=False,
        )

    def show(self, state: ArmState, steps: int, visible: bool) -> None:
        """Show them at a state of the arm, identified by a number of steps, or hide them."""
        put(self._balls, visible=visible)
        if not visible or steps == self._steps:
            return
        self._steps = steps
        ellipsoids = state.ellipsoids(self.points)
        frames = np.array([principal_frame(ellipsoid) for ellipsoid in ellipsoids])
        radii = np.array([np.append(ellipsoid.radii, 0.0)[:3] for ellipsoid in ellipsoids]) * self._length
        centers = [ellipsoid.center for ellipsoid in ellipsoids]
        wxyzs = quaternions(frames.transpose(0, 2, 1))
        self._balls.batched_positions = np.array(centers, dtype=np.float32)
        self._balls.batched_wxyzs = wxyzs.astype(np.float32)
        self._balls.batched_scales = np.maximum(radii, self._thinnest).astype(np.float32)
        colors = [color(palette.index_color(ellipsoid.index)) for ellipsoid in ellipsoids]
        self._balls.batched_colors = np.array(colors, dtype=np.uint8)


class MeasuredArm:
    """A see-through arm at its measured configuration, and its distance from the plan."""

    def __init__(self, server: viser.ViserServer, arm: Arm, states: JointStates | None) -> None:
        # Joint states of an arm that was edited before say nothing of this one.
        self._states = states if states is not None and differ_in_weight_alone(states.arm, arm) else None
        self._count = -1
        if self._states is None:
            return
        self._about = server.gui.add_html("")
        self._drawing = ArmDrawing(server, arm, "/measured", LOOK.measured_opacity, THEME.final)
        self._drawing.set_visible(False)

    def show(self, _: Session, live: Live) -> None:
        """Bring it up to date."""
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
            lines = [f"{length_text(distance)} from the plan on average"]
            if latest.age > LOOK.old_age:
                lines.append(f"the last joint state is {latest.age:.0f} s old")
        if latest.complaint:
            lines.append(latest.complaint)
        text = "<br>".join(map(escape, lines))
        put(self._about, content=framed_html("measured", THEME.final, "Measured", text))


class DeclaredNumber(NamedTuple):
    """A number of the limits of the task or of the weight of its arm, in a field where 0 stands for None."""

    kind: type[Limits] | type[Weight]  # the class that declares it
    name: str  # of its field
    label: str  # with the unit
    step: float  # of the arrows beside it
    noun: str  # in messages

    def value(self, session: Session) -> Any:
        """Return the value: a number, several, or None."""
        task = session.task
        return getattr(task.limits if self.kind is Limits else task.arm.weight, self.name)

    def has_several(self, session: Session) -> bool:
        """Whether joints have numbers of their own, which a field cannot show."""
        value = self.value(session)
        return isinstance(value, dict) or np.ndim(value) > 0

    def shown(self, session: Session) -> float:
        """Return the number to show: the least of several, 0 for None."""
        value = self.value(session)
        if value is None:
            return 0.0
        listed = np.array(list(value.values()) if isinstance(value, dict) else value)
        return round(float(np.min(np.diag(listed) if listed.ndim == 2 else listed)), LOOK.rate_digits)

    def request(self, shown: float) -> Request:
        """Return the request of another number."""
        value = float(shown) or None
        change = with_limits if self.kind is Limits else with_weight
        what = f"{self.noun} {shown:g}" if value else f"no {self.noun} in the task"
        return partial(Session.edit, edit=change(**{self.name: value}), what=what)


NUMBERS = (
    DeclaredNumber(Limits, "velocity", "Speed [rad/s]", 0.1, "speed limit"),
    DeclaredNumber(Limits, "acceleration", "Accel. [rad/s²]", 1.0, "acceleration limit"),
    DeclaredNumber(Limits, "jerk", "Jerk [rad/s³]", 10.0, "jerk limit"),
    DeclaredNumber(Weight, "effort", "Torque [N m]", 0.1, "torque limit"),
    DeclaredNumber(Weight, "stiffness", "Stiff. [N m/rad]", 10.0, "stiffness"),
)
"""The numbers that have fields."""


class ArmTab:
    """Controls for the arm: what moves it, its limits, and what of it is shown."""

    def __init__(self, server: viser.ViserServer, drawing: ArmDrawing, post: Post) -> None:
        self._drawing = drawing
        gui = server.gui
        bind = partial(Bound, post)
        self._ellipsoids = Ellipsoids(server, drawing.arm)
        self._steps = -1
        self._due = 0.0
        self._facts = gui.add_markdown("")
        controller = gui.add_dropdown("Controller", tuple(CONTROLLERS), hint="It moves the arm")
        self._numbers = [self._add_number(gui, bind, number) for number in NUMBERS if number.kind is Limits]
        at_once = gui.add_checkbox("At once", False, hint="Jump to each shape, ignoring the limits")
        self._coloring = gui.add_dropdown("Colours", tuple(COLORINGS), hint="What the colours of bodies tell")
        self._meaning = gui.add_html("")
        hint = "Manipulability; red and flat: singular"
        self._with_ellipsoids = gui.add_checkbox("Ellipsoids", False, hint=hint)
        self._choices = (
            bind(
                controller,
                lambda session: session.task.controller.name,
                lambda name: partial(Session.edit, edit=with_controller(name), what=f"controller {name}"),
            ),
            bind(at_once, lambda session: session.at_once, _move_at_once),
        )
        with gui.add_folder("Weight and torques"):
            hint = "Mass at the tip; what the arm carries elsewhere stays"
            mass = gui.add_number("Payload [kg]", 0.0, min=0.0, step=0.1, hint=hint)
            mass.precision = LOOK.rate_digits
            self._payload = bind(mass, _payload_of, _carry)
            self._numbers += [
                self._add_number(gui, bind, number) for number in NUMBERS if number.kind is Weight
            ]
            kept = gui.add_checkbox("Keep torques", False, hint=describe_field(Limits, "effort"))
            self._kept = bind(kept, lambda session: session.task.limits.effort is not None, _keep_torques)

    def _add_number(
        self, gui: viser.GuiApi, bind: Callable[..., Bound], number: DeclaredNumber
    ) -> tuple[DeclaredNumber, Bound]:
        """Add a field for a number; its hint is what the class says of it."""
        hint = f"{describe_field(number.kind, number.name)} 0 stands for this default."
        control = gui.add_number(number.label, 0.0, min=0.0, step=number.step, hint=hint)
        control.precision = LOOK.rate_digits
        return number, bind(control, number.shown, number.request)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        for choice in (*self._choices, self._payload):
            choice.show(session)
        for number, field in self._numbers:
            field.show(session, disabled=number.has_several(session))
        self._kept.show(session, disabled=not isinstance(session.task.limits.effort, bool | None))
        now = time.monotonic()
        if live.steps != self._steps and now >= self._due:
            self._steps = live.steps
            self._due = now + LOOK.facts_period
            put(self._facts, content=_facts(live))
        put(self._meaning, content=_meaning(self._coloring.value, live.arm))
        self._drawing.paint(body_colors(self._coloring.value, live, self._drawing.shades))
        self._ellipsoids.show(live.state, live.steps, self._with_ellipsoids.value)


def _meaning(coloring: str, arm: Arm) -> str:
    """Return what the colours of bodies mean, as HTML."""
    if coloring == COLORING.torques and not arm.torques_known:
        return legend_html([(THEME.rest, "masses or torque limits are not known")])
    return legend_html(COLORINGS[coloring])


def _payload_of(session: Session) -> float:
    masses = [load.mass for load in session.task.arm.weight.payloads if is_at_tip(load)]
    return round(sum(masses), LOOK.rate_digits)


def _carry(mass: float) -> Request:
    what = f"payload {mass:g} kg" if mass else "no payload at the tip"
    return partial(Session.edit, edit=with_tip_load(float(mass)), what=what)


def _keep_torques(kept: bool) -> Request:
    what = "torques kept within limits" if kept else "torques not limited"
    return partial(Session.edit, edit=with_limits(effort=True if kept else None), what=what)


def _move_at_once(value: bool) -> Request:
    def request(session: Session) -> None:
        session.at_once = value
        session.touch()

    return request


def _facts(live: Live) -> str:
    arm = live.arm
    stretches = near_singular(live.state)
    listed = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in stretches[: LOOK.most_named])
    more = " ..." if len(stretches) > LOOK.most_named else ""
    bound = int(np.count_nonzero(live.at_limit))
    lag = "..." if live.lag is None else f"{1000.0 * live.lag:.0f} ms"
    return (
        f"**{arm.n_modules} modules, {arm.nv} joints, {length_text(arm.length)}**\n\n"
        f"Near singular: {f'modules {listed}{more}' if listed else 'nowhere'}\n\n"
        f"Joints at a limit: {bound or 'none'}\n\n"
        f"First step after a change: {lag}"
    )
