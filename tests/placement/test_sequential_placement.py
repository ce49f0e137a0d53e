"""Algorithm 1 over modules of several kinds: closed forms, the numeric one, and registered ones."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.arm import continuum_section
from pinposture.curve import HELIX
from pinposture.errors import CurveBendsTooMuch, CurveEndsEarly, InvalidValue
from pinposture.placement import (
    ModuleJoints,
    ModuleKinematics,
    Torus,
    curve_crossings,
    register_module_kinematics,
    unregister_module_kinematics,
)
from pinposture.placement.module_kinematics import GroupRun, group_runs, is_compiled, joint_groups
from pinposture.placement.resolve import Walk

J = pp.JointSpec
URDF = Path(__file__).parents[2] / "urdf"
PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))


def of(count: int, *axes: str, lengths: tuple[float, ...]) -> pp.Arm:
    template = pp.ModuleTemplate("M", tuple(map(J, axes)), lengths)
    return pp.Arm.from_modules([template] * count, base_placement=PLACEMENT)


def gentle(arm: pp.Arm) -> pp.Curve:
    """A curve that bends in all directions, or in the plane, half as long again as the arm."""
    points = np.array(
        [(0, 0, 0), (0.25, 0, 0), (0.5, 0.05, 0.04), (0.75, 0.15, 0.05), (1, 0.2, 0), (1.5, 0.2, -0.1)]
    )
    return pp.Curve.spline(arm.length * (points[:, :2] if arm.dimension == 2 else points))


@pytest.fixture
def registered() -> Iterator[Callable]:
    """Registers for one test."""
    functions = []

    def register(function: Callable) -> None:
        functions.append(register_module_kinematics(function))

    yield register
    for function in functions:
        unregister_module_kinematics(function)


PLACED_BY = {
    "RyRz": "Torus",
    "RzRy": "Torus",
    "Rz": "Circle",
    "RzRz": "Circle",
    "RzRzRz": "Circle",
    "Continuum": "NumericModule",
}


@pytest.mark.parametrize(("name", "expected"), PLACED_BY.items())
def test_templates_say_what_placed_them(name: str, expected: str) -> None:
    arm = template_arm(name, 6)
    target = pp.resolve_targets(arm, gentle(arm), placement="align")
    assert (target.method, target.fallback) == ("sequential", "")
    assert target.placed_by == (expected,) * 6
    assert target.residual.max() < 1e-5 * arm.length
    assert arm.within_limits(target.q)


@pytest.mark.parametrize("file", sorted(URDF.glob("*.urdf")), ids=lambda path: path.stem)
def test_shipped_arms_say_what_placed_them(file: Path) -> None:
    arm = pp.Arm.load(file)
    target = pp.resolve_targets(arm, gentle(arm), placement="align")
    if target.method == "sequential":
        assert set(target.placed_by) <= {"Torus", "Circle"}
        assert target.residual.max() < 1e-5 * arm.length
    else:  # longer before the second hinge than behind it
        assert file.stem == "mixed12"
        assert "zigzag" in target.fallback
        assert set(target.placed_by) == {"least squares"}


@pytest.mark.parametrize("name", ["RyRz", "Rz", "RzRz"])
def test_a_walk_from_unit_to_unit_is_that_of_the_kernel(name: str) -> None:
    arm = pp.Arm.from_template(name, 8, base_placement=PLACEMENT)
    target = pp.resolve_targets(arm, gentle(arm), placement="align", method="sequential")
    walk = Walk(arm, target.curve, 2000, None)
    (run,) = group_runs(arm)
    for k, group in enumerate(run.groups):
        one = GroupRun((group,), run.numbers[k : k + 1], run.shapes[k : k + 1])
        assert walk.place(one) is None
    np.testing.assert_allclose(walk.positions, arm.positions(target.q), atol=1e-9)
    np.testing.assert_allclose(walk.parameters, target.parameters, atol=1e-10)


def test_rolls_and_hinges_are_placed_in_closed_form() -> None:
    for axes, lengths in ((("x", "y"), (0.02, 0.03)), (("x", "z"), (0.025, 0.025))):
        arm = of(12, *axes, lengths=lengths)
        assert is_compiled(arm)
        target = pp.resolve_targets(arm, gentle(arm), samples=20_000, placement="align")
        assert target.placed_by == ("RollPitch",) * 12
        assert target.residual.max() < 1e-8 * arm.length
        np.testing.assert_allclose(arm.at(target.q).points, target.points, atol=1e-12)
        assert np.all(np.diff(target.parameters, prepend=0.0) > 0.9 * 0.05)


def test_a_roll_at_the_end_of_a_module_is_placed_with_the_next() -> None:
    arm = pp.Arm.from_modules([pp.ModuleTemplate("M", (J("y"), J("x")), (0.025, 0.025))] * 10)
    kinds = [type(group.kinematics).__name__ for group in joint_groups(arm)]
    assert kinds == ["Circle", *["RollPitch"] * 9]
    # It leaves the base in the plane of the first hinge, and bends out of it later.
    points = [(0, 0, 0), (0.06, 0, 0), (0.12, 0, 0.0), (0.3, 0.05, 0.03), (0.45, 0.2, 0.05), (0.7, 0.2, 0)]
    line = pp.Curve.spline([(0, 0, 0), (0.06, 0, 0), (0.12, 0, 0.03), (0.3, 0, 0.1), (0.7, 0, 0.1)])
    target = pp.resolve_targets(arm, line, placement="as_is", method="sequential")
    assert target.residual.max() < 1e-5
    beside = pp.resolve_targets(arm, pp.Curve.spline(points), placement="align")
    assert beside.method != "sequential"
    assert "off the plane" in beside.fallback


def test_modules_with_one_roll_too_many_keep_it_still() -> None:
    arm = of(8, "y", "z", "x", lengths=(0.02, 0.02, 0.02))
    target = pp.resolve_targets(arm, gentle(arm), placement="align")
    assert target.placed_by == ("Torus",) * 8
    np.testing.assert_allclose(arm.positions(target.q)[2::3], 0.0)
    assert target.residual.max() < 1e-5


def test_sections_of_coupled_joints_are_placed_one_by_one() -> None:
    arm = pp.Arm.from_modules([continuum_section(10, 0.1)] * 3 + [pp.template("RyRz")] * 6)
    target = pp.resolve_targets(arm, gentle(arm), placement="align")
    assert target.placed_by == ("NumericModule",) * 3 + ("Torus",) * 6
    assert target.method == "sequential"
    assert target.residual[:3].max() < 1e-10
    assert target.residual.max() < 1e-5
    closest = pp.resolve_targets(arm, gentle(arm), placement="align", method="closest")
    np.testing.assert_allclose(target.points[0], closest.points[0], atol=1e-3)


def test_redundant_modules_stay_near_a_given_posture() -> None:
    arm = of(6, "y", "z", "y", lengths=(0.02, 0.02, 0.02))
    rng = np.random.default_rng(0)
    near = pp.Target.from_configuration(arm, arm.configuration(0.2 * rng.normal(size=arm.nv)))
    curve = gentle(arm)
    alone, close = (
        pp.resolve_targets(arm, curve, placement="align", method="sequential", near=each)
        for each in (None, near)
    )
    apart = [np.linalg.norm(arm.difference(each.q, near.q)) for each in (alone, close)]
    assert apart[1] < apart[0]
    assert close.residual.max() < 1e-10


def test_numeric_modules_tell_why_they_have_no_place() -> None:
    arm = pp.Arm.from_modules([continuum_section(6, 0.1, bend=0.6)] * 3)
    sharp = pp.Curve.spline([(0, 0, 0), (0.1, 0, 0), (0.15, 0, 0), (0.15, 0.1, 0), (0.15, 0.5, 0)])
    with pytest.raises(CurveBendsTooMuch, match=r"module 2 .*no posture within its joint limits"):
        pp.resolve_targets(arm, sharp, method="sequential")
    with pytest.raises(CurveEndsEarly, match="module 2"):
        pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.15, 0, 0)), method="sequential")
    partial = pp.resolve_targets(arm, sharp, method="sequential", incomplete="partial")
    assert partial.has_target.tolist() == [True, False, False]


def test_falling_back_to_least_squares_is_told(caplog: pytest.LogCaptureFixture) -> None:
    arm = of(8, "y", "x", lengths=(0.025, 0.025))
    with caplog.at_level(logging.INFO, logger="pinposture"):
        target = pp.resolve_targets(arm, gentle(arm), placement="align")
    assert set(target.placed_by) == {"least squares"}
    assert target.fallback in caplog.text
    assert target.fallback


# Registered kinematics.


@dataclass(frozen=True)
class Own:
    """A torus under another name; `fault` says what is wrong with it."""

    torus: Torus
    fault: str = ""
    dof: int = 2

    @property
    def reach(self) -> float:
        return self.torus.reach

    def forward(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place, turn = self.torus.forward(q)
        return (1.01 if self.fault == "forward" else 1.0) * place, turn

    def inverse(self, p: np.ndarray) -> list[np.ndarray]:
        return [q + (0.1 if self.fault == "inverse" else 0.0) for q in self.torus.inverse(p)]

    def target_point(self, base: pin.SE3, curve: pp.Curve, start: float) -> float | None:
        if self.fault == "target_point":
            return start

        def level(p: np.ndarray) -> np.ndarray:
            return np.hypot(np.hypot(p[:, 0], p[:, 2]) - self.torus.l1, p[:, 1]) - self.torus.l2

        return next((s for s, _ in curve_crossings(curve, base, start, level, self.reach)), None)


def own(fault: str = "") -> Callable[[ModuleJoints], ModuleKinematics | None]:
    def recognise(joints: ModuleJoints) -> ModuleKinematics | None:
        if joints.dof != 2 or not np.allclose(joints.axes, [[0, 1, 0], [0, 0, 1]]):
            return None
        first = joints.origins[1, 0]
        second = joints.end[0] - joints.origins[1, 0]
        if not np.allclose([first, second], [0.02, 0.03]):
            return None
        return Own(Torus(float(first), float(second)), fault)

    return recognise


def test_registered_kinematics_place_an_arm_as_those_of_the_library_do(registered: Callable) -> None:
    arm = of(12, "y", "z", lengths=(0.02, 0.03))
    curve = gentle(arm)
    expected = pp.resolve_targets(arm, curve, placement="align", samples=50_000)
    assert expected.placed_by == ("Torus",) * 12
    registered(own())
    target = pp.resolve_targets(arm, curve, placement="align")
    assert target.placed_by == ("Own",) * 12
    assert target.method == "sequential"
    assert target.residual.max() < 1e-12
    np.testing.assert_allclose(target.points, expected.points, atol=1e-8)
    np.testing.assert_allclose(target.q, expected.q, atol=1e-6)


def test_registered_kinematics_cut_loaded_arms_into_modules(registered: Callable) -> None:
    roll = pp.ModuleTemplate("RxRyRz", (J("x"), J("y"), J("z")), (0.02, 0.02, 0.02))
    mine = pp.ModuleTemplate("Own", (J("y"), J("z")), (0.02, 0.03))
    text = pp.Arm.from_modules([roll, mine, mine, mine, roll]).urdf
    before = [len(joints) for joints in pp.Arm.load(text).module_joints]
    registered(own())
    arm = pp.Arm.load(text)
    sizes = [len(joints) for joints in arm.module_joints]
    assert sum(sizes) == sum(before) == 12
    assert "Own (" in arm.segmentation.reason
    kinds = [type(group.kinematics).__name__ for group in joint_groups(arm)]
    assert kinds.count("Own") >= 3
    assert sizes != [12]
    target = pp.resolve_targets(arm, gentle(arm), placement="align")
    assert target.residual.max() < 1e-5
    given = pp.Arm.load(text, split=[3, 2, 2, 2, 3])
    assert [len(joints) for joints in given.module_joints] == [3, 2, 2, 2, 3]


def test_limits_make_the_library_ask_for_the_next_point(registered: Callable) -> None:
    registered(own())
    narrow = pp.ModuleTemplate(
        "M", (J("y", lower=-0.4, upper=0.4), J("z", lower=-0.4, upper=0.4)), (0.02, 0.03)
    )
    arm = pp.Arm.from_modules([narrow] * 4)
    target = pp.resolve_targets(arm, gentle(arm), method="sequential")
    assert arm.within_limits(target.q)
    sharp = pp.Curve.spline([(0, 0, 0), (0.06, 0, 0), (0.07, 0, 0), (0.07, 0.1, 0), (0.07, 0.5, 0)])
    with pytest.raises(CurveBendsTooMuch, match="no posture within its joint limits"):
        pp.resolve_targets(arm, sharp, method="sequential")


@pytest.mark.parametrize("fault", ["forward", "inverse", "target_point"])
def test_kinematics_that_contradict_themselves_are_refused(registered: Callable, fault: str) -> None:
    arm = of(3, "y", "z", lengths=(0.02, 0.03))
    registered(own(fault))
    with pytest.raises(InvalidValue, match=fault):
        pp.resolve_targets(arm, HELIX, placement="align")


WRONG = {
    "forward": [
        None,
        3,
        "here",
        np.zeros(3),
        (np.zeros(2), np.eye(3)),
        (np.zeros(3), np.full((3, 3), np.nan)),
    ],
    "inverse": [None, 3, "here", [np.zeros(3)], [None], [np.array([np.nan, 0.0])], ["ab"]],
    "target_point": ["far", np.nan, [0.1], True, 1e9, 1.0 + 1.0j],
    "dof": [None, "2", 2.0, np.ones(2)],
    "reach": [None, "long", np.nan, -1.0, 0.0, np.ones(2)],
    "tolerance": [None, "small", np.nan, -1e-3],
}
"""What methods and attributes of kinematics must not return."""


@pytest.mark.parametrize(("name", "value"), [(name, each) for name in WRONG for each in WRONG[name]])
def test_what_kinematics_return_is_checked_and_named(registered: Callable, name: str, value: object) -> None:
    arm = of(3, "y", "z", lengths=(0.02, 0.03))
    good = own()

    def recognise(joints: ModuleJoints) -> ModuleKinematics | None:
        found = good(joints)
        if found is not None:
            wrong = (lambda self, *_: value) if name in ("forward", "inverse", "target_point") else value
            found = type("Broken", (Own,), {name: wrong})(found.torus)
            if name == "dof":
                object.__setattr__(found, "dof", value)
        return found

    registered(recognise)
    with pytest.raises(InvalidValue, match=rf"(Broken\.|recognise: ){name}") as caught:
        pp.resolve_targets(arm, gentle(arm), placement="align")
    assert "allowed" in str(caught.value)


@pytest.mark.parametrize("call", ["forward", "inverse", "target_point", "recognise"])
def test_what_kinematics_raise_is_raised(registered: Callable, call: str) -> None:
    arm = of(3, "y", "z", lengths=(0.02, 0.03))
    good = own()

    def fail(*_: object) -> None:
        raise LookupError("mine")

    def recognise(joints: ModuleJoints) -> ModuleKinematics | None:
        found = good(joints)
        if call == "recognise":
            fail()
        return found and type("Broken", (Own,), {call: fail})(found.torus)

    registered(recognise)
    with pytest.raises(LookupError, match="mine") as caught:
        pp.resolve_targets(arm, gentle(arm), placement="align")
    assert caught.traceback[-1].name == "fail"


def test_kinematics_that_approximate_say_by_how_much(registered: Callable) -> None:
    @dataclass(frozen=True)
    class Rough(Own):
        tolerance: float = 0.0

    def recognise(tolerance: float) -> Callable[[ModuleJoints], ModuleKinematics]:
        return lambda joints: Rough(Torus(0.0201, 0.03), tolerance=tolerance)

    arm = of(3, "y", "z", lengths=(0.02, 0.03))
    registered(recognise(0.01))
    target = pp.resolve_targets(arm, gentle(arm), placement="align")
    assert target.placed_by == ("Rough",) * 3
    assert 1e-6 < target.residual.max() < 5e-4  # told as it is, by the joints themselves
    registered(recognise(0.0))
    with pytest.raises(InvalidValue, match="reaches"):
        pp.resolve_targets(arm, gentle(arm), placement="align")


def test_what_is_no_kinematics_is_refused(registered: Callable) -> None:
    with pytest.raises(InvalidValue, match="recognise"):
        register_module_kinematics("Torus")  # type: ignore[type-var]
    with pytest.raises(InvalidValue, match="recognise"):
        unregister_module_kinematics(own())
    registered(lambda joints: "a torus")
    with pytest.raises(InvalidValue, match="forward, inverse and target_point"):
        pp.Arm.load(pp.Arm.from_template("RyRz", 2).urdf)
