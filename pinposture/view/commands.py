"""What the meshcat viewer in the browser understands: drawing commands, as its protocol describes them.

Commands are plain data. A server passes them on to browsers, a page can hold them; both take them packed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import umsgpack
from numpy.typing import NDArray

from pinposture.view.mesh import Mesh

Array = NDArray[np.float64]
Command = dict[str, Any]

ANIMATION = "/pinposture/animation"

# Numbers by which the protocol marks packed arrays.
_FLOATS, _INDICES = 0x17, 0x16

_DISCRETE = 2300  # three.js's name for a value that holds until the next one


class Track(NamedTuple):
    """How one property of one object changes with time.

    Attributes:
        path: the object in the scene.
        name: the property, for instance "position".
        kind: "vector3", "quaternion" (x, y, z, w) or "color" (red, green, blue in [0, 1]).
        times: (n,) increasing, in frames.
        values: (n, 3) or (n, 4).
        smooth: whether values in between are interpolated, or hold until the next.
    """

    path: str
    name: str
    kind: str
    times: Array
    values: Array
    smooth: bool


def draw(path: str, mesh: Mesh, color: str, opacity: float = 1.0) -> Command:
    """Draw a surface [m] of one colour "#RRGGBB", which may let through what is behind it."""
    # Names within one command only have to differ from those of other objects in the scene.
    geometry = {
        "uuid": f"{path}/geometry",
        "type": "BufferGeometry",
        "data": {
            "attributes": {"position": _packed(mesh.vertices, "Float32Array")},
            "index": _packed(mesh.faces, "Uint32Array"),
        },
    }
    material: dict[str, Any] = {
        "uuid": f"{path}/material",
        "type": "MeshPhongMaterial",
        "color": int(color.lstrip("#"), 16),
        "shininess": 40,
        "side": 2,
    }
    if opacity < 1.0:  # what shines through must not hide what is drawn later
        material.update(transparent=True, opacity=opacity, depthWrite=False)
    shape = {
        "uuid": f"{path}/mesh",
        "type": "Mesh",
        "geometry": geometry["uuid"],
        "material": material["uuid"],
        "matrix": np.eye(4).ravel().tolist(),
    }
    lowered = {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [geometry],
        "materials": [material],
        "object": shape,
    }
    return {"type": "set_object", "path": path, "object": lowered}


def transform(path: str, matrix: Array) -> Command:
    """Place an object: a transform (4, 4) to the frame of its parent [m]."""
    return {"type": "set_transform", "path": path, "matrix": matrix.T.ravel().tolist()}


def set_property(path: str, name: str, value: Any) -> Command:
    """Set a property of an object."""
    return {"type": "set_property", "path": path, "property": name, "value": value}


def delete(path: str) -> Command:
    """Remove an object and all below it."""
    return {"type": "delete", "path": path}


def animate(tracks: Sequence[Track], fps: float) -> Command:
    """Play tracks over and over, in place of what was played before; no tracks: stop."""
    clips: dict[str, list[dict[str, Any]]] = {}
    for track in tracks:
        lowered: dict[str, Any] = {
            "name": f".{track.name}",
            "type": track.kind,
            "times": umsgpack.Ext(_FLOATS, track.times.astype("<f4").tobytes()),
            "values": umsgpack.Ext(_FLOATS, track.values.astype("<f4").tobytes()),
        }
        if not track.smooth:
            lowered["interpolation"] = _DISCRETE
        clips.setdefault(track.path, []).append(lowered)
    return {
        "type": "set_animation",
        # Where a server keeps it for browsers that come later: it sends what it got first, first, and an
        # animation means nothing before the objects that it moves are there.
        "path": ANIMATION,
        "animations": [
            {"path": path, "clip": {"fps": fps, "name": "run", "tracks": listed}}
            for path, listed in clips.items()
        ],
        "options": {"play": True, "repetitions": float("inf")},
    }


def pack(command: Command) -> bytes:
    """A command as the viewer receives it."""
    packed: bytes = umsgpack.packb(command)
    return packed


def _packed(array: NDArray[Any], kind: str) -> dict[str, Any]:
    code, dtype = (_FLOATS, "<f4") if kind == "Float32Array" else (_INDICES, "<u4")
    return {
        "itemSize": array.shape[1],
        "type": kind,
        "array": umsgpack.Ext(code, array.astype(dtype).tobytes()),
        "normalized": False,
    }
