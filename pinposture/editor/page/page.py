"""The page: the server, its parts, and what brings them up to date."""

from __future__ import annotations

import contextlib
import io

from pinposture.arm import Arm
from pinposture.editor.files import Files
from pinposture.editor.joint_states import JointStates
from pinposture.editor.live import Live
from pinposture.editor.page.arm import ArmDrawing
from pinposture.editor.page.arm_tab import ArmTab
from pinposture.editor.page.clearance import ClearanceLine
from pinposture.editor.page.curve import CurveDrawing
from pinposture.editor.page.export import ExportButtons
from pinposture.editor.page.file_tab import FileTab
from pinposture.editor.page.handles import Handles
from pinposture.editor.page.keyframes_tab import KeyframesTab
from pinposture.editor.page.measured import MeasuredArm
from pinposture.editor.page.obstacles import Obstacles
from pinposture.editor.page.other_curves import OtherCurves
from pinposture.editor.page.part import Part, Post, color
from pinposture.editor.page.player import Player
from pinposture.editor.page.points import Points
from pinposture.editor.page.scans import Scans
from pinposture.editor.page.scene_tab import SceneTab
from pinposture.editor.page.server import serve
from pinposture.editor.page.shape_tab import ShapeTab
from pinposture.editor.page.shortcuts import add_shortcuts
from pinposture.editor.page.stage import set_stage
from pinposture.editor.page.status import Status
from pinposture.editor.page.tour import offer_tour
from pinposture.editor.session import Session
from pinposture.editor.surroundings import Surroundings
from pinposture.viz import palette

WIDTH = 340
"""Width of the controls [pixels]."""


class Page:
    """What browsers show, all of them the same.

    Args:
        session: what is edited; only to begin with.
        post: leaves a request for the loop.
        files: what saves and opens.
        surroundings: what is around the arm.
        states: where the arm is measured to be; None if it is not.
        host: at which address to listen.
        port: at which port; another if it is taken.

    Attributes:
        url: where a browser on this machine finds it; whoever has it is let in.

    Raises:
        ViewerError: it cannot be served.
    """

    def __init__(
        self,
        session: Session,
        post: Post,
        files: Files,
        surroundings: Surroundings,
        states: JointStates | None,
        host: str,
        port: int,
    ) -> None:
        self._post, self._files, self._surroundings, self._states = post, files, surroundings, states
        self._server, self.url = serve(host, port)
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=color(palette.START), dark_mode=False
        )
        offer_tour(self._server)
        self._build(session.arm)

    def _build(self, arm: Arm) -> None:
        """Make all parts for an arm."""
        server, post, files = self._server, self._post, self._files
        server.gui.set_panel_label("pinposture")
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(WIDTH)
        set_stage(server, arm)
        self._arm = ArmDrawing(server, arm)
        self._parts: list[Part] = [
            CurveDrawing(server, arm),
            Handles(server, arm, post),
            Points(server, arm),
            Obstacles(server, arm, post),
            Scans(server, arm, self._surroundings.scans),
            ClearanceLine(server, arm),
            Status(server),
            Player(server, arm, post),
        ]
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Shape"):
            self._parts.append(ShapeTab(server, post))
        with tabs.add_tab("Keyframes"):
            keyframes = KeyframesTab(server, post)
            self._parts += [keyframes, OtherCurves(server, arm, lambda: keyframes.others)]
        with tabs.add_tab("Scene"):
            self._parts.append(SceneTab(server, self._surroundings.scans, post))
        with tabs.add_tab("Arm"):
            self._parts.append(MeasuredArm(server, arm, self._states))
            self._parts.append(ArmTab(server, self._arm, post))
        with tabs.add_tab("File"):
            self._parts.append(FileTab(server, files, post))
            self._parts.append(ExportButtons(server, post))
        add_shortcuts(server, files, post)

    def show(self, session: Session, live: Live) -> None:
        """Bring everything up to date; only what changed is sent."""
        if live.arm is not session.arm:
            return  # the solver has not seen it yet
        with self._server.atomic():
            if live.arm is not self._arm.arm:
                self._server.gui.reset()
                self._server.scene.reset()
                self._build(live.arm)
            live = session.playback.seen(live)
            self._arm.move(live.state.q)
            for part in self._parts:
                part.show(session, live)
        self._server.flush()

    def close(self) -> None:
        """End the service."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
