"""Arms whose dynamics are known in closed form, and motions for them."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin

import pinposture as pp
from pinposture.errors import PostureWarning

MASS = 1.2
REACH = 0.3
MOMENT = 0.004
"""The pendulum: mass [kg], distance of its centre from the joint [m], moment about the centre [kg m^2]."""

INERTIA = MOMENT + MASS * REACH**2
"""Its inertia about the joint [kg m^2]."""

WEIGHT = 9.81 * MASS * REACH
"""Torque of its weight when it is level [N m]."""


def link(name: str, inertial: str = "") -> str:
    return f'<link name="{name}">{inertial}</link>'


def inertial(mass=MASS, center=(REACH, 0, 0), moments=(MOMENT,) * 3, rpy=(0, 0, 0)) -> str:
    xx, yy, zz = moments
    return (
        f'<inertial><origin xyz="{_text(center)}" rpy="{_text(rpy)}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def joint(name, parent, child, kind="revolute", axis=(0, 1, 0), at=(0, 0, 0), more="", effort=50.0) -> str:
    limit = f'<limit lower="-3" upper="3" velocity="5" effort="{effort}"/>'
    limit = "" if kind in ("fixed", "floating") else limit
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(at)}"/><axis xyz="{_text(axis)}"/>{limit}{more}</joint>'
    )


def robot(*parts: str) -> str:
    return f'<robot name="made">{"".join(parts)}</robot>'


def pendulum(kind: str = "revolute", axis=(0, 1, 0), effort: float = 50.0, more: str = "") -> pp.Arm:
    """One joint; level along x at position 0, and a turn about y lowers it."""
    tip = joint("end", "bob", "tip", "fixed", at=(1, 0, 0))
    moving = joint("swing", "base", "bob", kind, axis, effort=effort, more=more)
    return quiet(robot(link("base"), link("bob", inertial()), link("tip"), moving, tip))


def quiet(source: str | Path, **options) -> pp.Arm:
    """Load an arm; what loading warns of is tested elsewhere."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        return pp.Arm.load(source, **options)


def mass_matrix(arm: pp.Arm, q: np.ndarray) -> np.ndarray:
    """Pinocchio's mass matrix, (nv, nv)."""
    upper = np.triu(pin.crba(arm.model, arm.model.createData(), q))
    return upper + np.triu(upper, 1).T


def quintic(start, end, duration: float, dt: float) -> np.ndarray:
    """Joint positions from rest to rest with continuous acceleration, (N, n)."""
    share = np.linspace(0.0, 1.0, round(duration / dt) + 1)[:, None]
    return np.asarray(start) + (10 * share**3 - 15 * share**4 + 6 * share**5) * np.subtract(end, start)


def quintic_peaks(way: float, duration: float) -> tuple[float, float]:
    """The largest speed and acceleration of a quintic motion."""
    return 1.875 * way / duration, 10.0 / math.sqrt(3.0) * way / duration**2


def _text(numbers) -> str:
    return " ".join(map(str, numbers))
