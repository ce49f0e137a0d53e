"""The arm in the page: few kinds of bodies, each drawn many times at once, so that long arms move quickly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.editor.page.part import color
from pinposture.viz import palette
from pinposture.viz.body import bodies, body_poses
from pinposture.viz.drawing import arm_surfaces
from pinposture.viz.mesh import TriangleMesh

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]


class Kind(NamedTuple):
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
            Kind(
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
