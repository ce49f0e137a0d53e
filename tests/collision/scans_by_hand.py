"""Distances of an arm from points and triangles by naive means that share nothing with the package."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pinocchio as pin
from collision.solids_by_hand import project
from scipy.optimize import nnls

from pinposture.collision import Box, Capsule, Cylinder, Mesh, Sphere
from pinposture.collision.bodies import bodies_of


def hull_distance(one, other):
    """Distance of the convex hulls of points, (n, 3) and (m, 3), as non-negative least squares."""
    weight = 1e4 * max(np.abs(one).max(), np.abs(other).max(), 1e-3)
    # Weights of the corners that are not negative and add up to 1, for each hull.
    system = np.zeros((5, len(one) + len(other)))
    system[:3, : len(one)] = one.T
    system[:3, len(one) :] = -other.T
    system[3, : len(one)] = weight
    system[4, len(one) :] = weight
    shares = nnls(system, np.array([0, 0, 0, weight, weight]))[0]
    first = shares[: len(one)]
    second = shares[len(one) :]
    return np.linalg.norm(one.T @ (first / first.sum()) - other.T @ (second / second.sum()))


def corners(shape):
    """Corners of a solid with flat faces, or of the axis of one that is round."""
    if isinstance(shape, Sphere):
        return np.array([shape.center])
    if isinstance(shape, Capsule):
        return np.array([shape.start, shape.end])
    if isinstance(shape, Box):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return shape.center + signs * np.array(shape.size) / 2 @ np.array(shape.rotation).T
    assert isinstance(shape, Mesh)
    return np.array(shape.vertices) @ np.array(shape.rotation).T + shape.center


def planes(points):
    """Planes through three points that have all others on one side: normals outwards and offsets."""
    found = []
    for i, j, k in combinations(range(len(points)), 3):
        normal = np.cross(points[j] - points[i], points[k] - points[i])
        if np.linalg.norm(normal) > 1e-12:
            normal /= np.linalg.norm(normal)
            heights = (points - points[i]) @ normal
            if heights.max() < 1e-12 or heights.min() > -1e-12:
                normal = normal if heights.max() < 1e-12 else -normal
                found.append((normal, normal @ points[i]))
    return found


def point_distance(point, shape):
    """Distance of a point from the surface of a solid, negative inside."""
    if isinstance(shape, (Sphere, Capsule)):
        return hull_free(point, corners(shape)) - shape.radius
    if isinstance(shape, Cylinder):
        start = np.array(shape.start)
        end = np.array(shape.end)
        axis = (end - start) / np.linalg.norm(end - start)
        along = (point - start) @ axis
        across = np.linalg.norm(point - start - along * axis)
        depth = min(along, np.linalg.norm(end - start) - along, shape.radius - across)
        return -depth if depth > 0 else np.linalg.norm(point - project(point, shape))
    if isinstance(shape, Box):
        local = np.array(shape.rotation).T @ (point - np.array(shape.center))
        depth = (np.array(shape.size) / 2 - np.abs(local)).min()
        return -depth if depth > 0 else np.linalg.norm(point - project(point, shape))
    depth = min(offset - normal @ point for normal, offset in planes(corners(shape)))
    return -depth if depth > 0 else hull_distance(point[None], corners(shape))


def hull_free(point, axis):
    """Distance of a point from a line of two ends, or from a point."""
    if len(axis) == 1:
        return np.linalg.norm(point - axis[0])
    way = axis[1] - axis[0]
    return np.linalg.norm(axis[0] + np.clip((point - axis[0]) @ way / (way @ way), 0, 1) * way - point)


def triangle_distance(triangle, shape):
    """Distance of a triangle from a solid that it does not overlap; for round ones also where it does."""
    radius = shape.radius if isinstance(shape, (Sphere, Capsule)) else 0.0
    return hull_distance(triangle, corners(shape)) - radius


def local_bodies(arm, q, arm_radius=None):
    """The bodies that move, each with the placement of its joint."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    return [(body, data.oMi[body.joint]) for body in bodies_of(arm, arm_radius) if body.joint]


def brute_force(arm, q, scan, arm_radius=None, without=()):
    """Smallest distance of any body from any point or triangle."""
    found = []
    for body, place in local_bodies(arm, q, arm_radius):
        if body.name in without:
            continue
        points = (scan.points - place.translation) @ place.rotation
        if scan.faces is None:
            found += [(point_distance(point, body.shape), body.name) for point in points]
        else:
            found += [(triangle_distance(points[face], body.shape), body.name) for face in scan.faces]
    return min(found)
