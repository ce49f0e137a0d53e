"""What all parts of the page share: callbacks, updates of handles, and text fields."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, Protocol, TypeAlias

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from viser import GuiEvent

from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.viz import palette

Array = NDArray[np.float64]
Color = tuple[int, int, int]

Post: TypeAlias = Callable[..., None]
"""`Editor.post`: posts a request to the loop."""

Request: TypeAlias = Callable[[Session], object]
"""What is posted; called by the loop."""

TYPING_PAUSE = 0.8  # after the last key before a typed value counts [s]


class Part(Protocol):
    """Part of the page. Made once; its callbacks only post requests."""

    def show(self, session: Session, live: Live, /) -> None:
        """Bring it up to date; called by the loop some thirty times a second."""


def color(name: str) -> Color:
    """Return a colour of the palette as the page takes it."""
    red, green, blue = (round(255.0 * part) for part in palette.rgb(name))
    return red, green, blue


def quaternions(rotations: ArrayLike) -> Array:
    """Return rotation matrices, (3, 3) or (n, 3, 3), as quaternions w, x, y, z, (4,) or (n, 4)."""
    return np.asarray(Rotation.from_matrix(rotations).as_quat(scalar_first=True))


def round_number(value: float) -> float:
    """Round to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(step * power - value)) * power)


MILLIMETRE = 1e-3
"""Unit of lengths in fields [m]: that of the status for all that is smaller than a metre."""


def coordinate_digits(length: float) -> int:
    """Return the number of decimals of coordinates [mm]: none, or some for an arm of less than a metre."""
    return max(0, -int(np.floor(np.log10(length) + 1e-9)))  # 0.999... m counts as 1 m


def framed_html(name: str, shade: str, title: str, text: str, below: str = "") -> str:
    """Return a title and a text beside a bar of some shade, in an element with an id; all as HTML."""
    return (
        '<div style="font-size:13px;line-height:1.35;padding:2px 10px 4px 10px">'
        f'<div id="{name}" style="border-left:4px solid {shade};padding-left:8px">'
        f"<b>{title}</b><br>{text}</div>{below}</div>"
    )


def legend_html(rows: Iterable[tuple[str, str]]) -> str:
    """Return a legend, as HTML.

    Args:
        rows: colours, and what they mean.
    """
    style = "display:inline-block;width:18px;height:8px;border-radius:2px;margin-right:8px"
    lines = [f'<div><span style="{style};background:{shade}"></span>{words}</div>' for shade, words in rows]
    flow = "display:flex;flex-wrap:wrap;column-gap:14px"
    return f'<div style="font-size:12px;line-height:1.4;padding:4px 12px;{flow}">{"".join(lines)}</div>'


def on_change(control: Any, act: Callable[[Any], None]) -> None:
    """Call a function, which may only post, with the value when a user, not the program, changes it."""

    # viser calls asynchronous functions in order, others in a pool of threads.
    async def changed(event: GuiEvent[Any]) -> None:
        if event.client_id is not None:
            act(event.target.value)

    control.on_update(changed)


def on_click(button: Any, act: Callable[[], None]) -> None:
    """Call a function, which may only post, when a user clicks a button."""

    async def clicked(_: GuiEvent[Any]) -> None:
        act()

    button.on_click(clicked)


def on_choice(buttons: Any, act: Callable[[str], None]) -> None:
    """Call a function, which may only post, with the label that a user clicks in a group of buttons."""

    async def clicked(event: GuiEvent[Any]) -> None:
        act(event.target.value)

    buttons.on_click(clicked)


def put(handle: Any, **values: Any) -> None:
    """Set attributes of a control or node that differ: each is sent to every browser."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


def put_at(handle: Any, position: Array, tolerance: float = 1e-7) -> None:
    """Move a node to a position, (3,) [m], unless it is within a tolerance [m] of it."""
    if not np.allclose(handle.position, position, atol=tolerance):
        handle.position = position


def add_lines(
    server: viser.ViserServer, name: str, count: int, thickness: float, visible: bool = True
) -> viser.LineSegmentsHandle:
    """Add straight pieces of a thickness [m], whose positions and colours are set later."""
    points = np.zeros((count, 2, 3))
    colors = np.zeros((count, 2, 3), dtype=np.uint8)
    return server.scene.add_line_segments(name, points, colors, thickness=thickness, visible=visible)


def add_axes(
    server: viser.ViserServer, name: str, scale: float, rotations: bool = False, sliders: bool = False
) -> viser.TransformControlsHandle:
    """Add axes of a length [m] to drag something by, in front of all else; hidden until they are needed."""
    return server.scene.add_transform_controls(
        name,
        scale=scale,
        disable_rotations=not rotations,
        disable_sliders=not sliders,
        depth_test=False,
        visible=False,
    )


class Drag:
    """A node of the page that a user drags by the mouse, or axes that a user drags.

    It posts requests; those on the way replace each other, the last one counts.

    Attributes:
        held: whether a user holds it; until the end, the loop does not move axes, nor what moves at once.
        start: where the node was when the drag began, (3,) [m].
        position: where it is dragged to, (3,) [m].
        ended: whether the drag has ended.
        keyframe: index of the keyframe that was selected when the drag began.

    Args:
        post: `Editor.post`.
        node: the node.
        ask: returns the request to post, given this drag.
        keyframe: returns the index of the selected keyframe; called when a drag begins.
        moves: whether the mouse moves the node at once; otherwise the loop puts it where it may be.
    """

    def __init__(
        self,
        post: Post,
        node: Any,
        ask: Callable[[Drag], Request],
        keyframe: Callable[[], int] = lambda: -1,
        moves: bool = False,
    ) -> None:
        self.held = False
        self.start = np.zeros(3)
        self.position = np.zeros(3)
        self.ended = False
        self.keyframe = -1
        self._grip = np.zeros(3)  # where the mouse took hold
        self._post = post
        self._node = node
        self._ask = ask
        self._selected = keyframe
        self._moves = moves
        if isinstance(node, viser.TransformControlsHandle):
            node.on_update(self.by_axes)
        else:
            node.on_drag(self.by_mouse)

    async def by_mouse(self, event: Any) -> None:
        """Take a move of the mouse; viser calls it."""
        if event.phase == "start" or not self.held:
            self._begin()
            self._grip = np.asarray(event.start_position)
        position = self.start + (np.asarray(event.end_position) - self._grip)
        if self._moves:
            try:
                self._node.position = position
            except RuntimeError:  # the node has been removed, and perhaps the arm with it
                self.held = False
                return
        self._go(position, event.phase == "end")

    async def by_axes(self, event: Any) -> None:
        """Take a move of the axes; viser calls it."""
        if event.client_id is None:  # moved by the loop
            return
        if event.phase == "start":
            self._begin()
        elif self.held:
            self._go(np.array(self._node.position), event.phase == "end")

    def _begin(self) -> None:
        self.held = True
        self.start = np.array(self._node.position)
        self.keyframe = self._selected()

    def _go(self, position: Array, ended: bool) -> None:
        self.held = not ended
        self.position = position
        self.ended = ended
        self._post(self._ask(self), "" if ended else f"drag {id(self)}")


class Bound:
    """A control bound to a value of the session: it shows the value, and what a user enters becomes an edit.

    A choice counts at once. Of a field that is typed into, the browser reports each key: a "12" typed as part
    of "125" is not meant, and may be invalid; so a value counts only after a pause, and the field is not
    written to before.

    Attributes:
        control: the control.

    Args:
        post: `Editor.post`.
        control: the control.
        get: returns the value to show, of a session; None if it has none.
        edit: returns the request that a user makes by entering a value; None for none.
        preview: the same for a value that is still being typed.
        unit: the value of what the control shows as 1, such as `MILLIMETRE`; None: values are shown as they
            are, without rounding.
        absent: what the control is, by attribute, while there is no value; hidden if None.
    """

    def __init__(
        self,
        post: Post,
        control: Any,
        get: Callable[[Session], Any],
        edit: Callable[[Any], Request | None],
        preview: Callable[[Any], Request | None] | None = None,
        unit: float | None = None,
        absent: dict[str, bool] | None = None,
    ) -> None:
        self.control = control
        self._post = post
        self._get = get
        self._edit = edit
        self._preview = preview
        self._unit = unit
        self._absent = {"visible": False} if absent is None else absent
        self._typed: Any = None
        self._value: Any = control.value
        self._since: float | None = None
        chosen = isinstance(control, viser.GuiCheckboxHandle | viser.GuiDropdownHandle)
        on_change(control, self._choose if chosen else self._type)

    def show(self, session: Session, **others: Any) -> None:
        """Write the value into the control, or pass on what was typed; called by the loop.

        Args:
            session: the session.
            others: further attributes of the control while there is a value.
        """
        value = self._get(session)
        if value is None:
            self.forget()
            put(self.control, **self._absent)
            return
        self._value = self._written(value)
        if self._since is None:
            put(self.control, value=self._value)
        elif time.monotonic() - self._since >= TYPING_PAUSE:
            self.finish()
        put(self.control, **{name: not state for name, state in self._absent.items()} | others)

    def finish(self) -> None:
        """Pass on what was typed, if it does not count yet."""
        since = self._since
        self._since = None
        if since is not None and (self._preview is not None or self._typed != self._value):
            self._choose(self._typed)

    def forget(self) -> None:
        """Drop what was typed and does not count yet."""
        self._since = None

    def _choose(self, shown: Any) -> None:
        self._ask(self._edit(self._meant(shown)))

    def _type(self, shown: Any) -> None:
        self._typed = shown
        self._since = time.monotonic()
        if self._preview is not None:
            self._ask(self._preview(self._meant(shown)), f"typed {id(self)}")

    def _ask(self, request: Request | None, key: str = "") -> None:
        if request is not None:
            self._post(request, key)

    def _written(self, value: Any) -> Any:
        """Return a value as the field shows it."""
        if self._unit is None:
            return value
        shown = np.round(np.asarray(value, dtype=np.float64) / self._unit, self.control.precision) + 0.0
        return float(shown) if shown.ndim == 0 else tuple(shown.tolist())

    def _meant(self, shown: Any) -> Any:
        """Return the value of what the field shows."""
        if self._unit is None:
            return shown
        return self._unit * shown if np.ndim(shown) == 0 else tuple(self._unit * number for number in shown)
