"""Joint motions to write and read, and what it is for two to be the same."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
from arm.describing import LINK, X, Y, Z, arm_text
from hypothesis import HealthCheck
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.motion.joint_trajectory import JointTrajectory

TABLES = ("time", "positions", "velocities", "accelerations")
FILES = examples(40, suppress_health_check=[HealthCheck.function_scoped_fixture])

NUMBER = st.floats(-1e30, 1e30)
NAME = st.text(st.characters(exclude_categories=("C", "Z"), include_characters=" "), min_size=1).filter(
    lambda name: name == name.strip()
)

POSITIONS = np.array([[0.0, 1.0], [0.1, 1.0], [0.4, 0.5], [0.5, 0.5]])
MOMENTS = np.arange(4) + 0.5


@cache
def arm() -> pp.Arm:
    return pp.Arm.load(
        arm_text(
            [("continuous", Y, LINK), ("prismatic", X, LINK), ("continuous", Z, LINK), ("revolute", Y, LINK)]
        )
    )


@st.composite
def motions(draw: st.DrawFn, least_step: float = 0.0) -> JointTrajectory:
    names = draw(st.lists(NAME, min_size=1, max_size=4, unique=True))
    steps = st.floats(least_step or 1e-12, 1e3)
    time = np.cumsum(draw(st.lists(steps, min_size=1, max_size=5)))
    if draw(st.booleans()):
        time = time - time[0]
    rows = len(time)
    tables = [
        np.reshape(draw(st.lists(NUMBER, min_size=rows * len(names), max_size=rows * len(names))), (rows, -1))
        for _ in range(3)
    ]
    units = draw(st.lists(st.sampled_from(["rad", "m", ""]), min_size=len(names), max_size=len(names)))
    return JointTrajectory(tuple(names), time, *tables, tuple(units), draw(st.text(max_size=5)))


def of_arm(seed: int, rows: int = 6, dt: float = 0.1) -> JointTrajectory:
    rng = np.random.default_rng(seed)
    q = [arm().random(rng)]
    for _ in range(rows - 1):
        q.append(arm().integrate(q[-1], rng.uniform(-3.0, 3.0, 4) * [1.0, 0.01, 1.0, 0.1]))
    return JointTrajectory.from_configurations(arm(), q, dt)


def assert_same(one: JointTrajectory, other: JointTrajectory, tables: tuple[str, ...] = TABLES) -> None:
    assert (one.joint_names, one.units) == (other.joint_names, other.units)
    for name in tables:
        here = getattr(one, name)
        there = getattr(other, name)
        np.testing.assert_array_equal(here, there)
        np.testing.assert_array_equal(np.signbit(here), np.signbit(there))


def written(tmp_path: Path, name: str, content: object) -> Path:
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path
