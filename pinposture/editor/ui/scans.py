"""Scans in the page, and the controls that load scans and meshes."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser

from pinposture.arm import Arm
from pinposture.collision.scan import Scan
from pinposture.editor.files import within
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.surroundings import ScanShelf, remove_scan
from pinposture.editor.ui.parts import Post, color, on_choice, on_click, put
from pinposture.viz import palette

POINT_SIZE = 0.003  # of a scan, relative to the arm
SCAN_COLOR = palette.mixed(palette.OBSTACLE, "#FFFFFF", 0.35)  # of a scan without colours of its own
SCAN_OPACITY = 0.6  # of such a surface, which may stand in front of the arm
LOAD_KINDS = ("scan", "obstacle")
EXPLANATION = (
    "A **scan** (surface or points) is shown, and the clearance from it is told, but the arm does **not** "
    "avoid it. As an **obstacle**, it is avoided as it is, hollows and all."
)


class Scans:
    """The scans of the task in the page."""

    def __init__(self, server: viser.ViserServer, arm: Arm, shelf: ScanShelf) -> None:
        self._server, self._shelf, self._size = server, shelf, POINT_SIZE * arm.length
        self._drawn: dict[Path, tuple[Scan, viser.MeshHandle | viser.PointCloudHandle | Any]] = {}
        self._made = 0

    def show(self, session: Session, _: Live) -> None:
        """Bring them up to date."""
        listed = self._shelf.of(session.task)
        for path in [path for path, (scan, _) in self._drawn.items() if listed.get(path) is not scan]:
            self._drawn.pop(path)[1].remove()
        for path, scan in listed.items():
            if path not in self._drawn:
                self._made += 1
                self._drawn[path] = scan, self._draw(self._shelf.shown(path))

    def _draw(self, scan: Scan) -> Any:
        name, scene = f"/scans/{self._made}", self._server.scene
        if scan.faces is None:
            colors: Any = color(SCAN_COLOR) if scan.colors is None else scan.colors
            return scene.add_point_cloud(
                name,
                scan.points.astype(np.float32),
                colors,
                point_size=self._size,
                point_shape="circle",
                precision="float32",
            )
        if scan.colors is None:
            return scene.add_mesh_simple(
                name,
                scan.points,
                scan.faces,
                color=color(SCAN_COLOR),
                opacity=SCAN_OPACITY,
                side="double",
                cast_shadow=False,
            )
        import trimesh  # here, because most tasks need no scans

        surface = trimesh.Trimesh(scan.points, scan.faces, vertex_colors=scan.colors, process=False)
        return scene.add_mesh_trimesh(name, surface, cast_shadow=False)


class ScanControls:
    """Controls that load scans and meshes."""

    def __init__(self, server: viser.ViserServer, shelf: ScanShelf, post: Post) -> None:
        self._shelf, self._post, gui = shelf, post, server.gui
        self._folder: Path | None = None
        gui.add_markdown(EXPLANATION)
        self._kind = gui.add_dropdown("Take as", LOAD_KINDS, hint="Files: .ply .xyz .npy .stl .obj")
        self._scale = gui.add_number(
            "scale",
            1.0,
            min=0.0,
            step=0.001,
            hint="Of an obstacle: 0.001 for a file in millimetres",
            visible=False,
        )
        self._path = gui.add_text("File", "", hint="Its name, from the folder of the task")
        load = gui.add_button("Load", icon=viser.Icon.FOLDER_OPEN)
        upload = gui.add_upload_button(
            "Upload", icon=viser.Icon.UPLOAD, hint="It is kept beside the task file"
        )
        self._listed = gui.add_dropdown("Scans", ("none",), visible=False)
        self._remove = gui.add_button_group("Scan", ("Remove",), visible=False)
        self._paths: dict[str, Path] = {}
        on_click(load, self._load)
        upload.on_upload(self._upload)
        on_choice(self._remove, self._remove_chosen)

    def show(self, session: Session) -> None:
        """Bring them up to date."""
        self._folder = None if session.path is None else session.path.absolute().parent
        names = [path.name for path in session.task.scans]
        self._paths = {
            path.name if names.count(path.name) == 1 else str(path): path for path in session.task.scans
        }
        options = tuple(self._paths) or ("none",)
        if tuple(self._listed.options) != options:
            self._listed.options = options
        put(self._listed, visible=bool(self._paths))
        put(self._remove, visible=bool(self._paths))
        put(self._scale, visible=self._kind.value == "obstacle")

    def _load(self) -> None:
        text = self._path.value.strip()
        if not text:
            self._post(lambda session: session.say("no file is named: type the name of one", "warning"))
            return
        avoided, scale = self._kind.value == "obstacle", float(self._scale.value)

        def request(session: Session) -> None:
            path = within(session.folder, text, None if session.path is None else session.path.parent)
            if avoided:
                self._shelf.add_obstacle(path, scale)
            else:
                self._shelf.add_scan(path)

        self._post(request)

    async def _upload(self, event: Any) -> None:
        file = event.target.value
        avoided = self._kind.value == "obstacle"
        self._shelf.upload(file.name, file.content, self._folder, float(self._scale.value), avoided)

    def _remove_chosen(self, _: str) -> None:
        path = self._paths.get(self._listed.value)
        if path is not None:
            self._post(partial(remove_scan, path))
