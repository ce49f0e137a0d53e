"""Point clouds of cameras: PointCloud2 in the frame of a link or of the world, into a map."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import require_known
from pinposture.arm import Arm
from pinposture.collision import Map, Mounting
from pinposture.errors import InvalidValue
from pinposture.motion.ros import world_frame

Array = NDArray[np.float64]

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


class CloudFrames:
    """The frames in which clouds and curves may be given: the world, and the links of an arm.

    Attributes:
        names: their names.

    Args:
        arm: the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._world = world_frame(arm)
        frames = enumerate(arm.model.frames)
        self._links = {str(frame.name): k for k, frame in frames if k and frame.type == pin.FrameType.BODY}
        self.names = (self._world, *self._links)

    def require(self, frame: str) -> None:
        """Raise UnknownName unless a frame is one of `names`."""
        require_known("frame of the arm", frame, self.names)

    def fixed(self, frame: str) -> pin.SE3 | None:
        """Return the placement of a frame that stands still, world frame; None if it moves with joints."""
        if frame == self._world:
            return pin.SE3.Identity()
        link = self._arm.model.frames[self._links[frame]]
        return link.placement if link.parentJoint == 0 else None

    def add(self, mapped: Map, points: Array, frame: str, time: float) -> None:
        """Add a cloud to a map.

        The sensor is at the origin of the link in whose frame the points are, so that cells between are free.
        In the frame of the world or of the base, it is not known where the sensor is.

        Args:
            mapped: the map.
            points: the points, (n, 3) [m], in the frame.
            frame: the frame.
            time: when they were measured [s].

        Raises:
            UnknownName: the frame is not known.
            InvalidValue: no point is finite, or the joints were not measured at that time.
        """
        self.require(frame)
        if len(points) and not np.isfinite(points).all(axis=1).any():
            raise InvalidValue("points", f"{len(points)}, none of them finite", "at least one")
        if frame not in (self._world, self._arm.base):
            mapped.add_cloud(points, Mounting(frame, pin.SE3.Identity()), time)
            return
        placement = cast(pin.SE3, self.fixed(frame))
        mapped.add_cloud(points @ placement.rotation.T + placement.translation, None, time)
