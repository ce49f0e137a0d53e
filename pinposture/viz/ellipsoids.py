"""Manipulability ellipsoids in figures and in the browser."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, Ellipsoid
from pinposture.viz import palette
from pinposture.viz.animation import ROOT, Timeline, Track, pose_tracks, same_signs
from pinposture.viz.drawing import link_radius
from pinposture.viz.postures import PosturePanel

# Scale, colours and figures.

Array = NDArray[np.float64]

LARGEST_RADIUS = 0.2  # that is drawn, approximately, relative to the length of the arm
SIDES = 48  # of the polygon that stands for an ellipse
INDEX_LABELS = {  # what the colours of ellipsoids say of their index (4.4)
    palette.SINGULAR: "0, singular",
    palette.WORSE: f"{palette.REGULAR_INDEX / 4:g}",
    palette.REGULAR: f"{palette.REGULAR_INDEX:g} and more",
}


def drawn_length(arm: Arm, points: Sequence[int]) -> float:
    """Return the length that stands for 1 m/rad [m], the same in every posture.

    It is a round number with which the largest ellipsoid of the control points (indices, 0-based) is well
    visible beside the arm.
    """
    # Per radian, a revolute joint moves a point by at most the length of the arm between them.
    fastest = max((float(np.linalg.norm(_lever_arms(arm, point))) for point in points), default=0.0)
    # In space the motions of the joints spread over two directions across the arm.
    radius = max(fastest / np.sqrt(arm.dimension - 1.0), 0.01 * arm.length)
    return round_down(LARGEST_RADIUS * arm.length / radius, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))


def round_down(length: float, digits: tuple[float, ...] = (1.0, 2.0, 5.0)) -> float:
    """Return the next smaller of some first digits times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(digit for digit in digits if digit * power <= length * (1.0 + 1e-9)) * power)


def scale_in_words(arm: Arm, points: Sequence[int]) -> str:
    """Return the scale of ellipsoids for a legend."""
    return f"1 m/rad drawn as {drawn_length(arm, points):.3g} m"


def draw_ellipsoids(panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> None:
    """Draw the ellipse of each pair of principal axes, below the arm, before the panel is finished."""
    for color, center, axes in _scaled_axes(panel, ellipsoids):
        for pair in combinations(axes, 2):
            panel.line(center + _circle() @ pair, color=color, lw=0.9, zorder=1.9)


def shade_ellipsoids(panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> None:
    """Shade ellipsoids within their outlines, after the panel is finished."""
    ax: Any = panel.ax
    for color, center, axes in _scaled_axes(panel, ellipsoids):
        outline = center + silhouette(axes, panel.screen)
        panel.line(outline, color=color, lw=1.3, zorder=1.9)
        style = {"facecolor": (*palette.rgb(color), 0.22), "edgecolor": "none", "zorder": 1.8}
        if panel.spatial:
            ax.add_collection3d(Poly3DCollection([outline], **style))
        else:
            ax.fill(*panel.coordinates(outline), **style)


def silhouette(axes: Array, screen: Array) -> Array:
    """Return the closed line (n, 3) [m] where rays to a far eye touch an ellipsoid about the origin.

    Args:
        axes: its semi-axes, (d, 3) [m], world frame.
        screen: unit vectors to the right and up, (2, 3), world frame.
    """
    # The line consists of the images of those points of the unit sphere that are across the line of sight.
    _, _, rim = np.linalg.svd(screen @ axes.T, full_matrices=False)
    return np.asarray(_circle() @ rim @ axes)


def ellipsoid_key() -> list[Patch]:
    """Return the entries of a legend for the colours of ellipsoids."""
    listed = []
    for color, meaning in INDEX_LABELS.items():
        red, green, blue = palette.rgb(color)
        listed.append(Patch(facecolor=(red, green, blue, 0.3), edgecolor=color, label=f"index {meaning}"))
    return listed


def _scaled_axes(panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> Iterator[tuple[str, Array, Array]]:
    """Yield the colour, centre (3,) [m] and drawn semi-axes (d, 3) [m] of each."""
    length = drawn_length(panel.arm, [one.point for one in ellipsoids])
    for one in ellipsoids:
        yield palette.index_color(one.index), one.center, length * one.semi_axes


def _lever_arms(arm: Arm, point: int) -> Array:
    """Return how far each joint moves a control point per unit of its motion at most, (n,) [m]."""
    chain = arm.chain
    end = chain.module_slices[point].stop
    legs = np.linalg.norm(np.diff(np.vstack([chain.origins[:end], chain.points[point]]), axis=0), axis=1)
    reach = np.cumsum(legs[::-1])[::-1]
    return np.where(chain.revolute[:end], reach, arm.characteristic_length)


def _circle() -> Array:
    """Return the unit circle as a closed line, (SIDES + 1, 2)."""
    around = np.linspace(0.0, 2.0 * np.pi, SIDES + 1)
    return np.column_stack([np.cos(around), np.sin(around)])


# In the browser: unit spheres that are scaled and turned as the arm moves.

MIN_ELLIPSOID_RADIUS = 0.3  # relative to that of the bars of the arm; flat ones are discs or rods

# Permutations of the axes of a right-handed frame, signs included, as rotations (24, 3, 3).
_AXIS_PERMUTATIONS = np.rint(Rotation.create_group("O").as_matrix())


class EllipsoidMotion(NamedTuple):
    """Ellipsoids of p control points at f configurations, as unit spheres that are scaled and turned.

    Attributes:
        points: indices of the control points, 0-based, (p,).
        centers: (f, p, 3) [m], world frame.
        frames: principal axes in rows, right-handed, (f, p, 3, 3), world frame, in the order and with the
            signs that change least from each configuration to the next.
        radii: drawn radii along these axes, (f, p, 3) [m].
        indices: manipulability indices, (f, p).
    """

    points: tuple[int, ...]
    centers: Array
    frames: Array
    radii: Array
    indices: Array


def ellipsoid_motion(arm: Arm, points: tuple[int, ...], rows: Array) -> EllipsoidMotion:
    """Return the ellipsoids of control points, 0-based, at consecutive configurations (f, nq)."""
    shape = (len(rows), len(points))
    listed = [one for q in rows for one in arm.at(q).ellipsoids(points)] if points else []
    centers = np.array([one.center for one in listed]).reshape(*shape, 3)
    frames = np.array([principal_frame(one) for one in listed]).reshape(*shape, 3, 3)
    # An ellipse in a plane has no third radius.
    radii = np.array([np.append(one.radii, 0.0)[:3] for one in listed]).reshape(*shape, 3)
    indices = np.array([one.index for one in listed]).reshape(shape)
    drawn = np.maximum(drawn_length(arm, points) * radii, MIN_ELLIPSOID_RADIUS * link_radius(arm))
    return EllipsoidMotion(points, centers, *continue_axes(frames, drawn), indices)


def axis_ends(shown: EllipsoidMotion) -> Array:
    """Return the ends of the principal axes at all configurations, (n, 3) [m], world frame."""
    axes = shown.frames * shown.radii[..., None]
    ends = shown.centers[..., None, :] + np.stack([axes, -axes])
    return ends.reshape(-1, 3)


def ellipsoid_tracks(shown: EllipsoidMotion, playback: Timeline) -> list[Track]:
    """Return how ellipsoids move, stretch and change their colour in a playback."""
    held, times = playback.key_rows, playback.key_times
    listed = []
    for p, point in enumerate(shown.points):
        turns = Rotation.from_matrix(shown.frames[:, p].transpose(0, 2, 1)).as_quat()
        colors = np.array([palette.rgb(palette.index_color(index)) for index in shown.indices[:, p]])
        path = ellipsoid_path(point)
        listed += [
            *pose_tracks(path, times, shown.centers[held, p], same_signs(turns)[held]),
            Track(path, "scale", "vector3", times, shown.radii[held, p]),
            Track(f"{path}/<object>", "material.color", "color", times, colors[held]),
        ]
    return listed


def continue_axes(frames: Array, radii: Array) -> tuple[Array, Array]:
    """Reorder and reverse the axes of each frame such that they continue those of the one before.

    Order and signs of the principal axes of an ellipsoid are arbitrary, so they could jump otherwise.

    Args:
        frames: right-handed, axes in rows, (f, p, 3, 3).
        radii: radii along them, (f, p, 3).

    Returns:
        Frames, still right-handed, and radii.
    """
    frames, radii = frames.copy(), radii.copy()
    for before, now, lengths in zip(frames[:-1], frames[1:], radii[1:], strict=True):
        renamed = _AXIS_PERMUTATIONS[:, None] @ now  # (24, p, 3, 3)
        best = np.einsum("gpij,pij->gp", renamed, before).argmax(axis=0)
        now[:] = renamed[best, np.arange(len(best))]
        lengths[:] = np.einsum("pij,pj->pi", np.abs(_AXIS_PERMUTATIONS[best]), lengths)
    return frames, radii


def ellipsoid_path(point: int) -> str:
    """Return the path of the ellipsoid of a control point, 0-based."""
    return f"{ROOT}/ellipsoids/point_{point + 1:03d}"


def principal_frame(one: Ellipsoid) -> Array:
    """Return the principal axes in rows, right-handed, (3, 3); those of an ellipse with its normal."""
    if len(one.directions) == 3:
        return one.directions
    return np.vstack([one.directions, np.cross(*one.directions)])
