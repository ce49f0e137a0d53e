"""The tab for what is around the arm: obstacles in numbers, what to keep from them, how near they are."""

from __future__ import annotations

from functools import partial
from html import escape
from typing import Any

import numpy as np
import pinocchio as pin
import viser

from pinposture.collision import Obstacle, Scene
from pinposture.editor.edits import with_scene
from pinposture.editor.live import Live
from pinposture.editor.new_obstacles import KINDS
from pinposture.editor.obstacle_edits import (
    add_obstacle,
    delete_obstacle,
    edit_obstacle,
    obstacles_of,
    rename_obstacle,
    select_obstacle,
)
from pinposture.editor.page.clearance import COLORS, clearance_text
from pinposture.editor.page.part import Post, on_change, on_choice, on_click, put
from pinposture.editor.page.scans import ScanControls
from pinposture.editor.page.typed import Typed
from pinposture.editor.scan_shelf import ScanShelf
from pinposture.editor.session import Session
from pinposture.viz import palette

LABELS = {
    "Sphere": "sphere",
    "Box": "box",
    "Cylinder": "cylinder",
    "Capsule": "capsule",
    "Half-space": "half_space",
}
"""What the buttons say, and what they make."""

DIGITS = 4
"""Digits behind the point of coordinates [m]; two of angles [deg]."""

assert set(LABELS.values()) == set(KINDS)

VECTORS = {
    "center": ("Centre [m]", "Of the obstacle, in the world"),
    "start": ("Start [m]", "Middle of one end, in the world"),
    "end": ("End [m]", "Middle of the other end"),
    "point": ("Point [m]", "Any point of its surface"),
    "normal": ("Normal", "Away from the solid, to the side that is free"),
    "size": ("Size [m]", "Edges along its own axes"),
    "rotation": ("Turned [deg]", "Roll, pitch, yaw"),
}
"""Values of three numbers, what they are called, and what there is to say of them."""


class SceneTab:
    """Controls for what is around the arm.

    Args:
        server: the page; the controls are made where it is at.
        scans: what reads scans.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, scans: ScanShelf, post: Post) -> None:
        self._post, gui = post, server.gui
        self._points = np.zeros((0, 3))
        self._name = ""
        self._about = gui.add_html("")
        self._add = gui.add_button_group(
            "Add", tuple(LABELS), hint="Beside the arm; then drag it where you want it"
        )
        self._chosen = gui.add_dropdown("Obstacle", ("none",), hint="Or click on one in the picture")
        self._called = Typed(gui.add_text("Name", "", visible=False), self._renamed)
        self._vectors = {
            key: Typed(
                gui.add_vector3(
                    label, (0.0, 0.0, 0.0), step=1.0 if key == "rotation" else 0.005, hint=hint, visible=False
                ),
                partial(self._typed, key),
                preview=True,
            )
            for key, (label, hint) in VECTORS.items()
        }
        self._radius = Typed(
            gui.add_number("Radius [m]", 0.0, min=0.0, step=0.005, visible=False),
            partial(self._typed, "radius"),
            preview=True,
        )
        self._delete = gui.add_button("Delete", icon=viser.Icon.TRASH, visible=False)
        with gui.add_folder("Keep clear"):
            self._margin = Typed(
                gui.add_number(
                    "Margin [m]", 0.0, min=0.0, step=0.001, hint="Distance to keep from obstacles"
                ),
                self._margin_typed,
            )
            self._itself = gui.add_checkbox(
                "Self-collision", False, hint="Whether the arm is to keep clear of itself, too"
            )
            self._thick = Typed(
                gui.add_number(
                    "Arm radius [m]",
                    0.0,
                    min=0.0,
                    step=0.001,
                    hint="Taken for that of its links; 0: as described",
                ),
                self._thickness_typed,
            )
        with gui.add_folder("Meshes and scans", expand_by_default=False):
            self._scans = ScanControls(server, scans, post)
        on_choice(self._add, self._added)
        on_change(self._chosen, self._select)
        on_click(self._delete, lambda: post(delete_obstacle))
        on_change(self._itself, self._itself_too)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        places = [live.state.points] if live.target is None else [live.state.points, live.target.points[::-1]]
        self._points = np.vstack(places)
        listed, scene = obstacles_of(session.shown), session.shown.scene or Scene()
        names = ("none", *listed)
        if tuple(self._chosen.options) != names:
            self._chosen.options = names
        name = session.obstacle if session.obstacle in listed else None
        put(self._chosen, value=name or "none")
        if (name or "") != self._name:
            for typed in (self._called, self._radius, *self._vectors.values()):
                typed.finish()  # it was meant for the one before
            self._name = name or ""
        self._show_values(listed.get(self._name))
        self._margin.show(round(scene.margin, 6))
        put(self._itself, value=scene.self_collision)
        self._thick.show(0.0 if scene.arm_radius is None else round(scene.arm_radius, 6))
        put(self._about, content=_about(session))
        self._scans.show(session)

    def _show_values(self, obstacle: Obstacle | None) -> None:
        """Show the values that the selected obstacle has."""
        self._called.show(self._name, visible=obstacle is not None)
        put(self._delete, visible=obstacle is not None)
        for key, typed in self._vectors.items():
            own = None if obstacle is None else getattr(obstacle, key, None)
            typed.show(_told(key, own) if own is not None else typed.control.value, visible=own is not None)
        radius = getattr(obstacle, "radius", None)
        self._radius.show(
            round(radius, DIGITS + 1) if radius is not None else 0.0, visible=radius is not None
        )

    def _added(self, label: str) -> None:
        self._post(partial(add_obstacle, LABELS[label], self._points))

    def _select(self, name: str) -> None:
        self._post(partial(select_obstacle, None if name == "none" else name))

    def _renamed(self, to: str, final: bool) -> None:
        if final:
            self._post(partial(rename_obstacle, self._name, to))

    def _typed(self, key: str, value: Any, final: bool) -> None:
        if key == "rotation":
            value = tuple(np.radians(value))
        elif key == "radius":
            value = float(value)
        self._post(partial(edit_obstacle, self._name, key, value, final), "" if final else "obstacle")

    def _margin_typed(self, value: float, final: bool) -> None:
        if final:
            edit = with_scene(margin=float(value))
            self._post(lambda session: session.edit(edit, f"margin {1000.0 * value:.4g} mm"))

    def _thickness_typed(self, value: float, final: bool) -> None:
        if final:
            edit = with_scene(arm_radius=float(value) if value > 0.0 else None)
            text = f"arm radius {1000.0 * value:.4g} mm" if value > 0.0 else "arm as thick as described"
            self._post(lambda session: session.edit(edit, text))

    def _itself_too(self, value: bool) -> None:
        text = "the arm keeps clear of itself" if value else "the arm may touch itself"
        self._post(lambda session: session.edit(with_scene(self_collision=value), text))


def _told(key: str, value: Any) -> tuple[float, ...]:
    """Three numbers as they are shown."""
    if key == "rotation":
        angles = np.degrees(pin.rpy.matrixToRpy(np.array(value)))
        return tuple(round(float(each), 2) + 0.0 for each in angles)
    return tuple(round(float(each), DIGITS) + 0.0 for each in value)


def _about(session: Session) -> str:
    found = session.nearest
    shade = palette.QUIET if found is None else COLORS[found.level]
    return (
        '<div style="font-size:13px;line-height:1.35;padding:2px 10px 4px 10px">'
        f'<div id="clearance" style="border-left:4px solid {shade};padding-left:8px">'
        f"<b>Clearance</b><br>{escape(clearance_text(found))}</div></div>"
    )
