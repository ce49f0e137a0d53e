"""What a driver finds for an arm with a joint that fails, and how it comes out with one that falls."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event
from typing import Any

import numpy as np
import pytest
from ros2.processes import set_to

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.motion.latest import Outdated
from pinposture.ros2 import Driver, DriverSettings, RobotSettings, SimulatedRobot
from pinposture.ros2.failures import FallbackSearch, Locked, find_fallback
from pinposture.sim import Servos
from pinposture.task.falling import Fallen


@pytest.mark.long
def test_a_fallback_tells_how_near_the_target_is_and_gives_a_way_out_that_leaves_the_joint_alone() -> None:
    arm = pp.Arm.from_template("RyRz", modules=3)
    q = np.full(arm.nv, 0.3)
    rows = np.linspace(0.0, 1.0, 20)[:, None] * q
    name = arm.joint_names[1]
    locked = arm.with_locked({name: 0.3})
    target = pp.Target.from_configuration(arm, np.full(arm.nv, -0.3))
    limits = pp.Limits(dt=0.02, velocity=1.0, acceleration=2.0)
    scene = pp.Scene()
    given = Locked(arm, locked, {name: 0.3}, q, target, scene, limits, rows, False)
    found = find_fallback(given)
    assert found.way_out is not None and found.reason == ""
    motion = found.way_out
    np.testing.assert_allclose(motion.positions[0], q, atol=1e-9)
    np.testing.assert_allclose(motion.positions[:, 1], 0.3, atol=1e-9)
    others = np.arange(arm.nv) != 1
    np.testing.assert_allclose(motion.positions[-1, others], 0.0, atol=1e-6)
    assert np.abs(np.diff(motion.positions, axis=0)).max() <= 1.0 * 0.02 + 1e-9
    run = pp.track(locked, pp.Target.from_points(locked, target.points), q)
    assert found.error == pytest.approx(run.mean_error[-1], abs=1e-3 * arm.length)
    words = str(found)
    assert words.startswith("the target is reached to ") and "a way out of " in words

    # Where the arm overlaps an obstacle, there is none; and a question may become outdated.
    ball = pp.Scene({"ball": pp.Sphere(tuple(arm.at(q).points[-1]), 0.02)})
    blocked = find_fallback(given._replace(scene=ball, target=None))
    assert blocked.error is None and blocked.way_out is None
    assert "no way out was found: at the posture" in str(blocked)
    search = FallbackSearch()
    assert str(search.find(given._replace(leave=True), Event())).startswith("a way out of ")
    outdated = Event()
    outdated.set()
    with pytest.raises(Outdated):
        search.find(given, outdated)


@pytest.mark.long
def test_a_way_out_with_a_joint_that_has_fallen_takes_it_where_it_hangs_and_is_slow() -> None:
    hinges = tuple(pp.JointSpec(axis, lower=-0.8, upper=0.8) for axis in "yz")
    arm = pp.Arm.from_modules([pp.ModuleTemplate("m", hinges, (0.05, 0.05))] * 3)
    rows = np.linspace(0.0, 1.0, 20)[:, None] * np.full(arm.nv, 0.2)
    q = rows[-1].copy()
    q[0] = 0.8  # its end stop
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=2.0)
    target = pp.Target.from_configuration(arm, np.full(arm.nv, -0.3))
    name = arm.joint_names[0]
    given = Locked(arm, arm, {}, q, target, pp.Scene(), limits, rows, False)
    found = find_fallback(given._replace(fallen=Fallen(name, 0.8, 0.0, q)))
    assert found.error is None and found.way_out is not None  # other targets are out of the question
    np.testing.assert_allclose(found.way_out.positions[:, 0], 0.8, atol=1e-9)
    np.testing.assert_allclose(found.way_out.positions[-1, 1:], 0.0, atol=1e-6)
    (way,) = pp.can_retreat(arm, np.vstack([rows, q]), pp.Scene(), name, torque=0.0, postures=[20]).ways
    assert found.way_out.time[-1] == pytest.approx(4.0 * pp.retime(way.path, limits).duration, abs=0.1)

    # Beside another one that is locked; and one that holds up no more than it does now.
    other = arm.joint_names[2]
    locked = given._replace(arm=arm.with_locked({other: 0.2}), positions={other: 0.2})
    found = find_fallback(locked._replace(fallen=Fallen(name, 0.8, 0.0, q)))
    assert found.way_out is not None
    np.testing.assert_allclose(found.way_out.positions[:, [0, 2]], [[0.8, 0.2]] * len(found.way_out.time))
    held = float(abs(arm.at(rows[-1]).gravity_torques[2]))
    found = find_fallback(given._replace(q=rows[-1], fallen=Fallen(other, 0.2, held, rows[-1])))
    assert found.way_out is not None
    needed = [abs(arm.at(each).gravity_torques[2]) for each in found.way_out.positions]
    assert max(needed) <= held * (1.0 + 1e-4)
    assert abs(arm.at(rows[0]).gravity_torques[2]) > 1.02 * held  # where it came from it would fall again


class Falls:
    """A simulated robot whose joints fail, and its driver, in this process.

    Args:
        graph: the graph.
        settings: of the driver.
    """

    def __init__(self, graph: Any, settings: DriverSettings) -> None:
        hinges = tuple(pp.JointSpec(axis, lower=-0.8, upper=0.8) for axis in "yz")
        self.graph = graph
        self.arm = arm = pp.Arm.from_modules([pp.ModuleTemplate("m", hinges, (0.05, 0.05))] * 3)
        robot = RobotSettings(servos=Servos(frequency=10.0))
        self.robot = SimulatedRobot(graph.node("robot"), arm, None, robot)
        limits = pp.Limits(step=None, dt=0.02, velocity=2.0, acceleration=8.0)
        self.driver = Driver(graph.node("driver"), arm, settings, limits=limits)
        self.diagnostics: dict[str, str] = {}
        from diagnostic_msgs.msg import DiagnosticArray

        user = graph.node("user")
        user.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)

    def _hear(self, message: Any) -> None:
        self.diagnostics = {each.key: each.value for each in message.status[0].values}

    @property
    def positions(self) -> np.ndarray:
        return self.arm.drives.joint_positions(self.robot.plant.positions)

    def aim(self, bend: float) -> None:
        """Have the arm take a posture, and wait until it does."""
        target = pp.Target.from_configuration(self.arm, np.full(self.arm.nq, bend))
        self.driver.aim(target)
        assert self.graph.run(lambda: np.abs(self.positions - bend).max() < 0.01), self.driver.reason
        self.wait_for("status", "converged")

    def wait_for(self, key: str, start: str) -> str:
        """Wait until diagnostics tell something, and return all of it."""
        told = self.graph.run(lambda: self.diagnostics.get(key, "").startswith(start))
        assert told, (self.diagnostics, self.driver.reason)
        return self.diagnostics[key]

    def close(self) -> None:
        self.driver.close()
        self.graph.close()


@pytest.fixture
def falls(graph: Any) -> Iterator[Falls]:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    made = Falls(graph, DriverSettings(rate=50.0, lock_after=0.5))
    yield made
    made.close()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*outside the limits")  # end stops give way a little
def test_the_arm_comes_out_with_a_joint_that_falls_and_works_again_without(falls: Falls) -> None:
    driver = falls.driver
    robot = falls.robot._node
    names = falls.arm.joint_names
    others = np.arange(falls.arm.nv) != 0
    falls.aim(0.3)
    refused = set_to(driver._node, "retreat", True)
    assert "false while no joint is locked or has fallen" in refused.reason
    assert "no joint that moves is called 'elbow'" in set_to(driver._node, "fallen", "elbow").reason

    # Told by hand: the arm holds where it is, until the joint works again.
    assert set_to(driver._node, "fallen", names[2]).successful
    falls.wait_for("fallen joint", f"{names[2]} is weak at 0.3")
    np.testing.assert_allclose(falls.positions, 0.3, atol=0.02)
    assert set_to(driver._node, "fallen", "").successful

    # Limp: it falls to its end stop, stands there, and is taken for fallen, not locked.
    assert set_to(robot, "limp", names[0]).successful
    driver.aim(pp.Target.from_configuration(falls.arm, np.full(falls.arm.nq, 0.2)))
    falls.wait_for("failing joints", f"{names[0]} is astray")
    assert falls.wait_for("fallen joint", f"{names[0]} is limp at 0.8") == f"{names[0]} is limp at 0.8"
    assert driver.locked == {}
    falls.wait_for("without them", "a way out of ")
    assert falls.wait_for("reason", names[0]).startswith(f"{names[0]} has fallen; way out: ")
    with pytest.raises(InvalidValue, match="only retreat"):
        falls.aim(0.0)
    assert set_to(driver._node, "retreat", True).successful
    assert falls.graph.run(lambda: np.abs(falls.positions[others]).max() < 0.02), driver.reason
    assert falls.positions[0] == pytest.approx(0.8, abs=0.06)

    # It works again.
    for node, name, value in (
        (robot, "limp", ""),
        (driver._node, "retreat", False),
        (driver._node, "fallen", ""),
    ):
        assert set_to(node, name, value).successful
    falls.aim(0.1)
    falls.wait_for("fallen joint", "")
