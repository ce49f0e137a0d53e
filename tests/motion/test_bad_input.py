"""What cannot be run is refused by name, before anything moves; what is damaged, when it is read."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.control import CONTROLLERS
from pinposture.errors import FileError, InvalidValue

POINTS = np.outer([0.05, 0.1, 0.15, 0.2], [1.0, 0.0, 0.0])  # of the straight arm
LOST = np.where(np.arange(4)[:, None] == 2, np.nan, POINTS)


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 4)


@pytest.fixture(scope="session")
def goal(arm: pp.Arm) -> pp.Target:
    return pp.Target.from_configuration(arm, np.full(8, 0.2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": None}, "target"),
        ({"target": pp.Target(POINTS, np.ones(3))}, r"target\.weights \(shape\)"),
        ({"target": pp.Target(LOST, np.array([1.0, 1.0, 0.0, 1.0]))}, r"target\.points\[2, 0\]"),
        ({"target": pp.Target(POINTS, np.array([1.0, np.nan, 1.0, 1.0]))}, r"target\.weights\[1\]"),
        ({"target": pp.Target(POINTS, np.ones(4), q=np.zeros(7))}, r"target\.q"),
        ({"limits": 0.1}, "limits"),
        ({"controller": 3}, "controller"),
        ({"controller": pp.Switching}, "controller"),
        ({"tolerance": "x"}, "tolerance"),
        ({"tolerance": True}, "tolerance"),
        ({"max_steps": True}, "max_steps"),
    ],
)
def test_what_cannot_be_run_is_refused(arm: pp.Arm, goal: pp.Target, change: dict, message: str) -> None:
    arguments = {"arm": arm, "target": goal, "q0": np.zeros(8)} | change
    with pytest.raises(InvalidValue, match=message):
        pp.track(**arguments)


RESOLVE_AGAIN = "the target belongs to another arm: resolve it for this one"


@pytest.mark.parametrize(
    ("template", "modules", "links"),
    [("RyRz", 3, None), ("Rz", 4, None), ("RyRz", 4, (0.04, 0.03))],  # fewer modules or joints; longer links
)
def test_a_target_of_another_arm_is_refused(
    arm: pp.Arm, template: str, modules: int, links: tuple[float, ...] | None
) -> None:
    other = pp.Arm.from_template(template, modules, link_lengths=links)
    arc = pp.Curve.helix(0.2, 0.0, 0.5, axis=(0, 0, 1))
    target = pp.resolve_targets(arm, arc, placement="align")
    pp.track(arm, target, arm.straight(), max_steps=1)
    tracker = pp.Tracker(other, "joint", pp.Limits(dt=0.02))
    with pytest.raises(InvalidValue, match=RESOLVE_AGAIN):
        pp.track(other, target, other.straight())
    with pytest.raises(InvalidValue, match=rf"targets\[0\].*{RESOLVE_AGAIN}"):
        pp.track_many(other, [target], [other.straight()])
    with pytest.raises(InvalidValue, match=RESOLVE_AGAIN):
        tracker.update(target)
    points = pp.Target.from_points(arm, target.points)  # for whichever arm
    if other.n_modules == arm.n_modules:
        pp.track(other, points, other.straight(), max_steps=1)


@pytest.mark.parametrize("name", ["geodesic", "joint", "projection", "selection", "switching"])
def test_a_controller_refuses_a_target_of_an_arm_with_other_modules(arm: pp.Arm, name: str) -> None:
    other = pp.Arm.from_template("RyRz", 3)
    target = pp.Target.from_configuration(arm, np.full(8, 0.2))
    with pytest.raises(InvalidValue, match=RESOLVE_AGAIN):
        CONTROLLERS[name]().step(other.at(np.full(6, 0.1)), target, pp.Limits())


@pytest.mark.parametrize(
    "parameters",
    [{"step": "x"}, {"step": True}, {"velocity": "x", "dt": 0.1}, {"dt": "x"}, {"dt": [1]}]
    + [{"position_margin": value} for value in (None, "x", [1.0], True)],
)
def test_limits_that_are_no_numbers_are_refused(parameters: dict) -> None:
    with pytest.raises(InvalidValue, match=next(iter(parameters))):
        pp.Limits(**parameters)


def test_numbers_of_numpy_are_numbers(arm: pp.Arm, goal: pp.Target, tmp_path) -> None:
    limits = pp.Limits(step=np.float32(0.1), dt=np.float32(0.5), position_margin=np.float32(0.01))
    method = pp.Selection(gain=np.int64(1), null_gain=np.float32(0.5))
    run = pp.track(arm, goal, np.full(8, 0.1), method, limits, max_steps=np.int64(3))
    again = pp.load(pp.save(run, tmp_path / "run.npz"), pp.Run)
    assert again.limits == limits
    assert hash(again.limits) == hash(limits)
    assert limits != pp.Limits(step=np.full(8, 0.1))


@pytest.mark.parametrize(
    "placement",
    [2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan), np.eye(3), "x"],
)
def test_a_base_that_is_not_placed_rigidly_is_refused(arm: pp.Arm, placement: object) -> None:
    with pytest.raises(InvalidValue, match="base_placement"):
        pp.Arm.from_template("RyRz", 2, base_placement=placement)
    with pytest.raises(InvalidValue, match="base_placement"):
        pp.Arm.from_model(arm.model, arm.control_points, base_placement=placement)


def test_a_base_may_be_placed_by_a_matrix() -> None:
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0), np.array([0.1, 0.2, 0.3]))
    by_matrix = pp.Arm.from_template("RyRz", 2, base_placement=placement.homogeneous)
    by_placement = pp.Arm.from_template("RyRz", 2, base_placement=placement)
    q = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(by_matrix.at(q).points, by_placement.at(q).points, atol=1e-15)


def test_a_model_must_be_one() -> None:
    with pytest.raises(InvalidValue, match="model"):
        pp.Arm.from_model(None, ["tip"])


def test_damaged_runs_are_file_errors(arm: pp.Arm, goal: pp.Target, tmp_path) -> None:
    run = pp.track(arm, goal, np.zeros(8), max_steps=3)
    path = pp.save(run, tmp_path / "run.npz")
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    for _ in range(60):
        broken = bytearray(content)
        for place in rng.integers(0, len(content), 3):
            broken[place] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(broken))
        try:
            pp.load(path, pp.Run)
        except FileError:
            continue
    with np.load(pp.save(run, path)) as stored:
        arrays = dict(stored)
    for name, value in {"q": np.zeros((2, 2)), "about": np.array(json.dumps({"format": "?"}))}.items():
        np.savez(path, **(arrays | {name: value}))
        with pytest.raises(FileError):
            pp.load(path, pp.Run)
