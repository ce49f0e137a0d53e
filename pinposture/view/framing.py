"""Where to look from, so that what happens fills the picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AZIMUTHS = np.radians([-70.0, -110.0, -45.0, -135.0])
ELEVATIONS = np.radians([22.0, 38.0, 60.0])
"""Views to choose from: x to the right, z up, and none along an axis, where scales would fall together."""

BETTER = 1.3
"""How much more area a view must show than one before it in the list to be preferred to it."""


class Framing(NamedTuple):
    """A look at a cloud of points.

    Attributes:
        center: centre of its bounding box, (3,) [m], world frame.
        radius: distance of the farthest point from there, above 0 [m].
        azimuth: where the eye stands around the vertical, from x towards y [rad].
        elevation: height of the eye above the horizon [rad].
    """

    center: Array
    radius: float
    azimuth: float
    elevation: float

    @property
    def axes(self) -> Array:
        """Unit vectors to the right, up, and towards the eye, (3, 3), world frame."""
        return look(self.azimuth, self.elevation)

    def distance(self, points: Array, opening: float, aspect: float) -> float:
        """How far from the centre the eye must be to see all points.

        Args:
            points: (n, 3) [m], world frame.
            opening: vertical opening of the camera [rad].
            aspect: width of the picture relative to its height.

        Returns:
            Distance [m].
        """
        right, up, near = self.axes @ (points - self.center).T
        slope = np.tan(opening / 2.0)
        needed = np.maximum(np.abs(up), np.abs(right) / aspect) / slope + near
        return max(float(needed.max()), 2.0 * self.radius)


def frame_points(points: Array) -> Framing:
    """Look at points from where they spread over the largest area.

    Args:
        points: (n, 3) [m], world frame, n >= 1.
    """
    center = (points.max(axis=0) + points.min(axis=0)) / 2.0
    offsets = points - center
    radius = max(float(np.linalg.norm(offsets, axis=1).max()), 1e-9)
    # A little spread in every direction lets a line, which has no area from anywhere, show its length.
    scatter = offsets.T @ offsets / (len(points) * radius**2) + 1e-4 * np.eye(3)
    chosen, largest = (0.0, 0.0), 0.0
    for elevation in ELEVATIONS:
        for azimuth in AZIMUTHS:
            screen = look(float(azimuth), float(elevation))[:2]
            area = float(np.sqrt(np.linalg.det(screen @ scatter @ screen.T)))
            if area > BETTER * largest:
                chosen, largest = (float(azimuth), float(elevation)), area
    return Framing(center, radius, *chosen)


def look(azimuth: float, elevation: float) -> Array:
    """Unit vectors to the right, up, and towards an eye that stands there [rad], (3, 3), world frame."""
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.array([right, np.cross(eye, right), eye])
