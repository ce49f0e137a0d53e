"""The same arms, starts and targets for every method, as plain numbers.

RyRz modules, two links of 2.5 cm each, joint limits +-pi, joint speed 2 rad/s. Nothing
here uses the library or a peer: the kinematics of the arm are two rotations a module, written out, and judge
everybody alike. NumPy only, since the environments of the peers have little more.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LINK = 0.025
"""Length of each link [m]."""

SPEED = 2.0
"""Largest joint speed [rad/s]."""

DT = 0.05
"""Duration of a step [s]; with the speed, |dq| <= 0.1 rad."""

POSITION = np.pi
"""Joint positions lie within +- this [rad]."""

NEAR = 0.05
"""Largest difference of a joint between start and target of a near case [rad], up to 20 modules."""

AMPLITUDES = (0.2, 1.0)
"""Range of the largest joint position of a smooth posture [rad], up to 20 modules."""

FAMILIES = ("near", "random")


class Case(NamedTuple):
    """One start and one target.

    Attributes:
        family: "near" or "random".
        start: configuration to start from, (nv,) [rad].
        q: configuration that takes the target posture, (nv,) [rad]; what a peer is not told.
        points: target of each module end, (m, 3) [m], base frame.
    """

    family: str
    start: Array
    q: Array
    points: Array


class Problem(NamedTuple):
    """An arm and what it is asked to do.

    Attributes:
        modules: number of modules; twice as many joints.
        urdf: the arm as URDF text: joints, limits, inertias, and a link at each module end; no shapes.
        cases: starts and targets.
    """

    modules: int
    urdf: str
    cases: tuple[Case, ...]

    @property
    def length(self) -> float:
        """Length of the arm [m]."""
        return 2 * LINK * self.modules

    @property
    def speed(self) -> float:
        """Largest speed of each joint [rad/s].

        Beyond 400 joints, where only our own methods run, a tenth: else the first step would be the last.
        """
        return SPEED if self.modules <= 200 else 0.1 * SPEED

    @property
    def bound(self) -> float:
        """Largest |dq| of a joint in one step [rad]."""
        return self.speed * DT

    @property
    def point_names(self) -> list[str]:
        """Names of the links at the module ends."""
        return [point_name(k) for k in range(self.modules)]


def flatness(modules: int) -> float:
    """By how much less the joints of a long arm turn than those of one of 20 modules.

    Long arms take the same shapes: with the same joint positions they would roll up into many coils. The
    speed limit is the same for all that are compared: if it went down as well, it would bind in most joints
    of most steps, and programs with many active limits take several times as long to solve.
    """
    return min(1.0, 20.0 / modules)


def point_name(module: int) -> str:
    """Name of the link at the end of a module, counted from 0."""
    return f"point_{module:04d}"


def points_at(q: Array) -> Array:
    """Module ends, (..., m, 3) [m], at configurations (..., 2 m); each module turns by Ry(q0) Rz(q1)."""
    q0, q1 = q[..., 0::2], q[..., 1::2]
    c0, s0, c1, s1 = np.cos(q0), np.sin(q0), np.cos(q1), np.sin(q1)
    zero = np.zeros_like(c0)
    rows = [[c0 * c1, -c0 * s1, s0], [s1, c1, zero], [-s0 * c1, s0 * s1, c0]]
    turns = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    across = np.stack([c0 * (1.0 + c1), s1, -s0 * (1.0 + c1)], axis=-1) * LINK
    reach = 1
    while reach < turns.shape[-3]:  # products of ever longer runs of modules
        turns[..., reach:, :, :] = turns[..., :-reach, :, :] @ turns[..., reach:, :, :]
        reach *= 2
    across[..., 1:, :] = np.einsum("...ij,...j->...i", turns[..., :-1, :, :], across[..., 1:, :])
    return np.cumsum(across, axis=-2)


def smooth_configuration(modules: int, rng: np.random.Generator, amplitude: float) -> Array:
    """Joints along three sine waves, (2 m,) [rad], as `pinposture.arm.smooth_configuration` has them."""
    along = np.linspace(0.0, 1.0, modules)
    q = np.zeros((modules, 2))
    for place in range(2):
        for number in (1, 2, 3):
            phase = np.pi * number * along + rng.uniform(0.0, 2.0 * np.pi)
            q[:, place] += rng.normal() / number * np.sin(phase)
    return (q * amplitude / np.abs(q).max()).ravel()


def problem(modules: int, cases: int, seed: int = 0) -> Problem:
    """An arm with so many cases of each family.

    Near targets differ by noise, which adds up along the arm as a random walk: it goes down with the root.
    """
    scale = flatness(modules)
    listed = []
    for number in range(cases):
        rng = np.random.default_rng([seed, modules, number])
        start, other = (smooth_configuration(modules, rng, rng.uniform(*AMPLITUDES) * scale) for _ in "ab")
        beside = start + rng.uniform(-NEAR, NEAR, 2 * modules) * np.sqrt(scale)
        for family, goal in zip(FAMILIES, (beside, other), strict=True):
            listed.append(Case(family, start, goal, points_at(goal)))
    return Problem(modules, urdf_text(modules), tuple(listed))


def stream(modules: int, steps: int, seed: int = 0) -> Array:
    """Configurations whose postures a moving target takes, (steps, 2 m): once round in 1,000 steps."""
    rng = np.random.default_rng([seed, modules, 1_000_000])
    one, two = (smooth_configuration(modules, rng, 0.6 * flatness(modules)) for _ in "ab")
    phase = 2.0 * np.pi * np.arange(steps)[:, None] / 1000.0
    return np.cos(phase) * one + np.sin(phase) * two


def urdf_text(modules: int) -> str:
    """The arm as URDF: what counts for kinematics, and inertias because some loaders want them."""
    inertia = ' ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"'
    limit = f'<limit lower="{-POSITION!r}" upper="{POSITION!r}" velocity="{SPEED!r}" effort="100"/>'
    lines = ['<robot name="arm">', '<link name="base"/>']
    parent, offset = "base", 0.0
    for k in range(modules):
        for axis, vector in (("y", "0 1 0"), ("z", "0 0 1")):
            child = f"link_{k:04d}_{axis}"
            lines += [
                f'<joint name="joint_{k:04d}_{axis}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{child}"/><origin xyz="{offset} 0 0"/><axis xyz="{vector}"/>{limit}</joint>',
                f'<link name="{child}"><inertial><mass value="0.01"/><inertia{inertia}/></inertial></link>',
            ]
            parent, offset = child, LINK
        lines += [
            f'<joint name="end_{k:04d}" type="fixed"><parent link="{parent}"/>'
            f'<child link="{point_name(k)}"/><origin xyz="{LINK} 0 0"/></joint>',
            f'<link name="{point_name(k)}"/>',
        ]
    return "\n".join([*lines, "</robot>"])


def save(path: Path, given: Problem) -> None:
    """Write a problem for the processes that measure."""
    fields = {
        "families": np.array([case.family for case in given.cases]),
        "starts": np.array([case.start for case in given.cases]),
        "goals": np.array([case.q for case in given.cases]),
        "points": np.array([case.points for case in given.cases]),
    }
    np.savez(path, modules=given.modules, urdf=given.urdf, **fields)


def load(path: Path) -> Problem:
    """Read what `save` wrote."""
    with np.load(path) as file:
        columns = (file["families"].tolist(), file["starts"], file["goals"], file["points"])
        cases = tuple(Case(*row) for row in zip(*columns, strict=True))
        return Problem(int(file["modules"]), str(file["urdf"]), cases)
