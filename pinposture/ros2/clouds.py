"""Point clouds of cameras as obstacles: PointCloud2 in the frame of a link or of the world."""

from __future__ import annotations

from math import sqrt
from typing import Any, Final, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scan, Scene
from pinposture.collision.solids import Solid
from pinposture.errors import InvalidValue, UnknownName, no_warnings
from pinposture.motion.ros import world_frame

Array = NDArray[np.float64]

REACH = 2.0
"""Distance from the base beyond which points are left out, in arm lengths: the arm does not get there."""

MAX_CUBES = 20_000
"""Largest number of cubes that a cloud may occupy. Distances to so many take the loop some milliseconds."""

FORMATS: Final = {7: "f4", 8: "f8"}
"""Types of numbers by their number in `sensor_msgs/msg/PointField`: FLOAT32 and FLOAT64."""


def read_points(message: Any) -> Array:
    """Return the points of a `sensor_msgs/msg/PointCloud2`, (n, 3) [m], in its frame; also not finite ones.

    Raises:
        InvalidValue: there are no fields x, y and z of floating-point numbers, or the data is too short.
    """
    fields = {field.name: field for field in message.fields}
    order = ">" if message.is_bigendian else "<"
    for name in "xyz":
        if name not in fields or fields[name].datatype not in FORMATS or fields[name].count > 1:
            raise InvalidValue("fields", list(fields), "x, y and z of the type FLOAT32 or FLOAT64")
    columns = {
        "names": list("xyz"),
        "formats": [order + FORMATS[fields[name].datatype] for name in "xyz"],
        "offsets": [fields[name].offset for name in "xyz"],
        "itemsize": message.point_step,
    }
    try:
        kind = np.dtype(columns)  # type: ignore[call-overload]
        rows = np.ndarray(
            (message.height, message.width), kind, bytes(message.data), 0, (message.row_step, kind.itemsize)
        )
    except (TypeError, ValueError) as error:
        raise InvalidValue("data (bytes)", len(message.data), f"as the fields say ({error})") from error
    return np.column_stack([rows[name].ravel().astype(np.float64) for name in "xyz"])


def write_points(points: Array, frame: str, stamp: Any) -> Any:
    """Return points, (n, 3) [m], as a `sensor_msgs/msg/PointCloud2` of FLOAT32 in a frame."""
    from sensor_msgs.msg import PointCloud2, PointField

    data = np.ascontiguousarray(points, dtype="<f4")
    message = PointCloud2(height=1, width=len(data), point_step=12, row_step=12 * len(data))
    message.header.frame_id = frame
    message.header.stamp = stamp
    float32 = PointField.FLOAT32
    message.fields = [
        PointField(name=name, offset=4 * k, datatype=float32, count=1) for k, name in enumerate("xyz")
    ]
    message.is_dense = bool(np.isfinite(data).all())
    message.data = data.tobytes()
    return message


class Cloud(NamedTuple):
    """A cloud, and where the arm was when it was taken.

    Attributes:
        points: the points, (n, 3) [m], in the frame.
        frame: name of the frame.
        q: the configuration of the arm, (nq,).
    """

    points: Array
    frame: str
    q: Array


class CloudObstacles:
    """Turns clouds into obstacles of an arm.

    The space is divided into cubes, and a cloud occupies those with a point. It becomes a `Scan` of their
    centres with half their diagonal as `point_radius`, which contains all points: gaps are closed, and noise
    that stays within a cube changes nothing. Points on the arm itself, or within the margin from it, are left
    out, and points far beyond its reach.

    Args:
        arm: the arm.
        scene: the obstacles that are known otherwise, and the margin.
        resolution: edge length of the cubes [m].
    """

    def __init__(self, arm: Arm, scene: Scene, resolution: float) -> None:
        self.resolution = resolution
        self._arm = arm
        self._margin = scene.margin
        self._solids = CollisionModel(arm, scene).solids
        self._world = world_frame(arm)
        self._data = arm.model.createData()
        frames = enumerate(arm.model.frames)
        self._links = {str(each.name): k for k, each in frames if k and each.type == pin.FrameType.BODY}

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the frames that a cloud may have: that of the world, and the links of the arm."""
        return self._world, *self._links

    def require_frame(self, frame: str) -> None:
        """Raise UnknownName unless a frame is one of `frames`."""
        if frame not in self.frames:
            raise UnknownName("frame of the arm", frame, self.frames)

    def is_fixed(self, frame: str) -> bool:
        """Return whether a frame does not move with the joints."""
        return frame == self._world or self._arm.model.frames[self._links[frame]].parentJoint == 0

    def to_world(self, points: Array, frame: str, q: Array) -> Array:
        """Return points in the world frame, (n, 3) [m], given those in a frame of the arm at q, (nq,)."""
        if frame == self._world:
            return points
        pin.framesForwardKinematics(self._arm.model, self._data, q)
        placement = self._data.oMf[self._links[frame]]
        return np.asarray(points @ placement.rotation.T + placement.translation)

    def obstacle(self, cloud: Cloud) -> Scan | None:
        """Return a cloud as an obstacle; None if no point is left.

        Raises:
            UnknownName: the frame is not known.
            InvalidValue: no point is finite, or too many cubes are occupied.
        """
        self.require_frame(cloud.frame)
        points = cloud.points[np.isfinite(cloud.points).all(axis=1)]
        if len(cloud.points) and not len(points):
            raise InvalidValue("points", f"{len(cloud.points)}, none of them finite", "at least one")
        points = self.to_world(points, cloud.frame, cloud.q)
        base = np.array(self._arm.base_placement.translation)
        points = points[np.linalg.norm(points - base, axis=1) <= REACH * self._arm.length]
        points = points[~self._on_arm(points, cloud.q)]
        cubes = np.unique(np.floor(points / self.resolution), axis=0)
        if len(cubes) > MAX_CUBES:
            allowed = f"at most {MAX_CUBES}; a larger cloud_resolution than {self.resolution:g} m gives fewer"
            raise InvalidValue("occupied cubes", len(cubes), allowed)
        if not len(cubes):
            return None
        radius = 0.5 * sqrt(3.0) * self.resolution
        with no_warnings():
            return Scan((cubes + 0.5) * self.resolution, name=f"cloud in {cloud.frame}", point_radius=radius)

    def _on_arm(self, points: Array, q: Array) -> NDArray[np.bool_]:
        """Return which points, (n, 3) [m], are on the arm at q, (nq,), or within the margin from it."""
        pin.forwardKinematics(self._arm.model, self._data, q)
        found = np.zeros(len(points), dtype=np.bool_)
        for joint, solid in self._solids:
            placement = self._data.oMi[joint]
            found |= within(solid, (points - placement.translation) @ placement.rotation, self._margin)
        return found


def within(solid: Solid, points: Array, distance: float) -> NDArray[np.bool_]:
    """Return which points, (n, 3) [m], are within a distance of the capsule that contains a solid."""
    axis = solid.end - solid.start
    along = (points - solid.start) @ axis / max(float(axis @ axis), np.finfo(np.float64).tiny)
    nearest = solid.start + np.clip(along, 0.0, 1.0)[:, None] * axis
    return np.asarray(np.linalg.norm(points - nearest, axis=1) <= solid.radius + distance)
