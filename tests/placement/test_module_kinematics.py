"""FK, IK and TP of every kind of module, against Pinocchio, rotation matrices and scans of dense grids."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import continuum_section
from pinposture.placement import (
    Circle,
    ConstantCurvature,
    ModuleKinematics,
    NumericModule,
    RollPitch,
    Torus,
    curve_crossings,
)
from pinposture.placement.module_kinematics import joint_groups, module_joints

J = pp.JointSpec
angles = st.floats(-np.pi, np.pi)
small = st.floats(-0.3, 0.3)


def rx(a: float) -> np.ndarray:
    return pin.rpy.rpyToMatrix(a, 0.0, 0.0)


def ry(a: float) -> np.ndarray:
    return pin.rpy.rpyToMatrix(0.0, a, 0.0)


def module(*joints: pp.JointSpec, lengths: tuple[float, ...]) -> pp.ModuleTemplate:
    return pp.ModuleTemplate("M", joints, lengths)


SLIDE = J("x", "prismatic", -0.02, 0.02)
NUMERIC = {
    "three hinges": module(J("y"), J("z"), J("y"), lengths=(0.02, 0.02, 0.02)),
    "roll and two": module(J("x"), J("y"), J("z"), lengths=(0.02, 0.02, 0.02)),
    "tilted": module(J("y"), J((0.3, 0.2, 1.0)), lengths=(0.03, 0.03)),
    "slide last": module(J("y"), J("z"), SLIDE, lengths=(0.02, 0.02, 0.02)),
    "slide first": module(SLIDE, J("y"), J("z"), lengths=(0.01, 0.02, 0.03)),
    "hinge and slide": module(J("z"), J("z", "prismatic", -0.05, 0.05), lengths=(0.02, 0.05)),
    "coupled": continuum_section(disks=6, length=0.1),
    "coupled, stretching": continuum_section(disks=4, length=0.1, stretch=0.02),
}
CLOSED = {
    "torus": Torus(0.02, 0.03),
    "long first": Torus(0.04, 0.01, sense=-1.0),
    "universal": Torus(0.0, 0.05),
    "roll-pitch": RollPitch(0.02, 0.03),
    "roll-pitch, long first": RollPitch(0.03, 0.02, sense=-1.0),
    "roll-pitch in one place": RollPitch(0.0, 0.05),
    "arc": ConstantCurvature(0.1),
    "arc, stretching": ConstantCurvature(0.1, 0.02),
}


@cache
def numeric(kind: str) -> NumericModule:
    """The kinematics of the middle module of three."""
    arm = pp.Arm.from_modules([NUMERIC[kind]] * 3)
    kinematics = joint_groups(arm)[1].kinematics
    assert isinstance(kinematics, NumericModule)
    return kinematics


def kinematics_called(kind: str) -> ModuleKinematics:
    return CLOSED[kind] if kind in CLOSED else numeric(kind)


@st.composite
def curves(draw: st.DrawFn) -> tuple[pin.SE3, pp.Curve]:
    """A base anywhere, and a curve from it that begins about along its x axis, half a metre long."""
    base = pin.SE3(pin.rpy.rpyToMatrix(*[draw(angles) for _ in range(3)]), np.array([0.4, -2.0, 0.7]))
    bends = [[draw(small), draw(small)] for _ in range(4)]
    points = np.cumsum(
        [[0.0, 0.0, 0.0], [0.06, 0.0, 0.0], *[[0.08, *0.08 * np.array(b)] for b in bends]], axis=0
    )
    return base, pp.Curve.spline(points @ base.rotation.T + base.translation)


@pytest.mark.parametrize("kind", [*CLOSED, *NUMERIC])
def test_each_is_module_kinematics(kind: str) -> None:
    assert isinstance(kinematics_called(kind), ModuleKinematics)


@given(
    angles, angles, st.sampled_from([(0.02, 0.03), (0.03, 0.02), (0.0, 0.05)]), st.sampled_from([1.0, -1.0])
)
def test_fk_of_a_roll_and_a_hinge_is_a_product_of_rotations(
    q0: float, q1: float, lengths: tuple[float, float], sense: float
) -> None:
    l1, l2 = lengths
    place, turn = RollPitch(l1, l2, sense).forward(np.array([q0, q1]))
    expected = rx(sense * q0) @ ry(q1)
    np.testing.assert_allclose(turn, expected, atol=1e-14)
    np.testing.assert_allclose(place, [l1, 0.0, 0.0] + expected @ [l2, 0.0, 0.0], atol=1e-14)


@given(angles, st.floats(0.01, 3.1), st.sampled_from([1.0, -1.0]), st.sampled_from([1.0, -1.0]))
def test_ik_of_a_roll_and_a_hinge_finds_both_branches(
    q0: float, q1: float, side: float, sense: float
) -> None:
    roll_pitch = RollPitch(0.02, 0.03, sense)
    q = np.array([q0, side * q1])
    end = roll_pitch.forward(q)[0]
    found = roll_pitch.inverse(end)
    assert len(found) == 2
    assert abs(found[0][0]) <= abs(found[1][0])
    for each in found:
        np.testing.assert_allclose(roll_pitch.forward(each)[0], end, atol=1e-15)
    assert min(np.abs(np.exp(1j * each) - np.exp(1j * q)).max() for each in found) < 1e-9
    assert roll_pitch.inverse(1.01 * end + [0.001, 0.0, 0.0]) == []


@given(st.floats(-2.2, 2.2), st.floats(-2.2, 2.2), st.floats(-0.019, 0.019))
def test_ik_of_an_arc_finds_what_fk_was_given(bend_y: float, bend_z: float, longer: float) -> None:
    for arc, q in (
        (ConstantCurvature(0.1), np.array([bend_y, bend_z])),
        (ConstantCurvature(0.1, 0.02), np.array([bend_y, bend_z, longer])),
    ):
        (found,) = arc.inverse(arc.forward(q)[0])
        np.testing.assert_allclose(found, q, atol=1e-7)
    beside = ConstantCurvature(0.1).forward(np.array([bend_y, bend_z]))[0] * 1.01
    assert ConstantCurvature(0.1).inverse(beside) == []


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(0.05, 1.0))
def test_an_arc_goes_where_its_end_points(bend_y: float, bend_z: float, share: float) -> None:
    # Of a part of the arc, with the same curvature, the end is a point of the arc, its x axis the tangent.
    bends = np.array([bend_y, bend_z])
    step = 1e-6

    def end(part: float) -> tuple[np.ndarray, np.ndarray]:
        return ConstantCurvature(0.1 * part).forward(part * bends)

    slope = (end(share + step)[0] - end(share - step)[0]) / (2.0 * step)
    turn = end(share)[1]
    np.testing.assert_allclose(slope, 0.1 * turn[:, 0], atol=1e-9)
    spin = turn.T @ (end(share + step)[1] - end(share - step)[1]) / (2.0 * step)
    expected = [[0.0, -bend_z, bend_y], [bend_z, 0.0, 0.0], [-bend_y, 0.0, 0.0]]
    np.testing.assert_allclose(spin, expected, atol=1e-7)


@pytest.mark.parametrize("bends", [(1.0, 0.0), (-0.4, 2.0), (1.5, -1.5)])
def test_disks_come_to_the_arc_with_the_square_of_their_number(bends: tuple[float, float]) -> None:
    off = []
    for disks in (10, 20, 40):
        arm = pp.Arm.from_modules([continuum_section(disks, 0.2)])
        end = arm.at(arm.configuration(np.array(bends) / disks)).points[0]
        off.append(np.linalg.norm(end - ConstantCurvature(0.2).forward(np.array(bends))[0]))
    assert off[0] < 0.01 * 0.2
    assert 3.6 < off[0] / off[1] < 4.4
    assert 3.6 < off[1] / off[2] < 4.4


def test_disks_that_stretch_come_to_the_arc_too() -> None:
    q = np.array([-0.4, 2.0, 0.013])
    off = []
    for disks in (10, 20, 40):
        arm = pp.Arm.from_modules([continuum_section(disks, 0.2, stretch=0.02)])
        end = arm.at(arm.configuration(q / disks)).points[0]
        off.append(np.linalg.norm(end - ConstantCurvature(0.2, 0.02).forward(q)[0]))
    assert off[0] < 0.01 * 0.2 + 0.013 / 10  # the half links at both ends do not stretch alike
    assert off[0] > 1.8 * off[1] > 1.8**2 * off[2]


@pytest.mark.parametrize("kind", NUMERIC)
def test_numeric_fk_is_that_of_pinocchio(kind: str) -> None:
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))
    arm = pp.Arm.from_modules([NUMERIC[kind]] * 3, base_placement=placement)
    groups = joint_groups(arm)
    rng = np.random.default_rng(0)
    for _ in range(3):
        q = arm.random(rng)
        state = arm.at(q)
        positions = arm.positions(q)
        # of the body before, which the neutral arm has at the identity
        turn = np.eye(3)
        place = np.zeros(3)
        for group in groups:
            base = turn @ group.base + place
            frame = turn @ group.frame
            at, facing = group.kinematics.forward(positions[arm.columns[group.inputs]])
            end = base + frame @ at
            np.testing.assert_allclose(end, state.points[group.module], atol=1e-12)
            turn = frame @ facing @ group.frame.T
            place = end - turn @ arm.chain.points[group.module]
        np.testing.assert_allclose(
            turn @ arm.at(arm.neutral()).rotations[-1], state.rotations[-1], atol=1e-12
        )


@pytest.mark.parametrize("kind", NUMERIC)
def test_numeric_ik_puts_the_end_at_the_point(kind: str) -> None:
    kinematics = numeric(kind)
    rng = np.random.default_rng(1)
    low = np.maximum(kinematics.joints.lower, -1.5)
    high = np.minimum(kinematics.joints.upper, 1.5)
    for _ in range(10):
        goal = kinematics.forward(rng.uniform(low, high))[0]
        (found,) = kinematics.inverse(goal)
        np.testing.assert_allclose(kinematics.forward(found)[0], goal, atol=1e-9)
        assert np.all((found >= kinematics.joints.lower) & (found <= kinematics.joints.upper))
    assert kinematics.inverse(np.array([1.0, 0.0, 0.0])) == []


@pytest.mark.parametrize("kind", [*CLOSED, *NUMERIC])
@examples(30)
@given(given_curve=curves())
def test_the_target_point_is_ahead_on_the_curve_and_within_reach(
    kind: str, given_curve: tuple[pin.SE3, pp.Curve]
) -> None:
    kinematics, (base, curve) = kinematics_called(kind), given_curve
    s = kinematics.target_point(base, curve, 0.0)
    assert s is not None
    assert 0.0 < s <= curve.length
    p = base.actInv(curve.at(s))
    if isinstance(kinematics, NumericModule):
        at, q = kinematics.place(base, curve, 0.0)
        assert at == s
        assert np.all((q >= kinematics.joints.lower) & (q <= kinematics.joints.upper))
        found = [q]
    else:
        found = list(kinematics.inverse(p))
        assert found
    for q in found:
        np.testing.assert_allclose(kinematics.forward(q)[0], p, atol=1e-9 * kinematics.reach)


@examples(20)
@given(given_curve=curves())
@pytest.mark.parametrize("lengths", [(0.02, 0.03), (0.0, 0.05)])
def test_the_search_finds_the_target_point_of_the_closed_form(
    lengths: tuple[float, float], given_curve: tuple[pin.SE3, pp.Curve]
) -> None:
    base, curve = given_curve
    for axes, form in ((("y", "z"), Torus(*lengths)), (("x", "y"), RollPitch(*lengths))):
        arm = pp.Arm.from_modules([module(*map(J, axes), lengths=lengths)] * 2)
        group = joint_groups(arm)[1]
        assert type(group.kinematics) is type(form)
        described = module_joints(arm, group.joints, group.base, arm.chain.points[1])
        search = NumericModule(described, np.zeros(2))
        expected = form.target_point(base, curve, 0.0)
        found = search.target_point(base, curve, 0.0)
        assert expected is not None
        assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["roll-pitch", "arc", "tilted", "coupled"])
@examples(6)
@given(given_curve=curves())
def test_the_target_point_is_where_a_dense_grid_of_postures_first_meets_the_curve(
    kind: str, given_curve: tuple[pin.SE3, pp.Curve]
) -> None:
    kinematics, (base, curve) = kinematics_called(kind), given_curve
    s = kinematics.target_point(base, curve, 0.0)
    assert s is not None
    quarter = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 61)
    grids = {"roll-pitch": [2.0 * quarter, quarter], "coupled": [quarter / 6, quarter / 6]}
    postures = product(*grids.get(kind, [quarter, quarter]))
    ends = np.array([kinematics.forward(np.array(q))[0] for q in postures])
    along = np.linspace(0.02 * kinematics.reach, min(2.0 * kinematics.reach, curve.length), 400)
    points = (curve.at(along) - base.translation) @ base.rotation
    away = np.linalg.norm(ends[None] - points[:, None], axis=2).min(axis=1)
    met = away < 0.06 * kinematics.reach  # the grid is that fine
    assert met.any()
    first = int(np.argmax(met))
    last = first + int(np.argmin(np.append(met[first:], False)))
    assert along[first] - 1e-9 <= s <= along[min(last, len(along) - 1)] + 1e-9


def test_crossings_of_any_surface_are_found_in_order() -> None:
    curve = pp.Curve.helix(0.03, 0.05, 3)
    base = pin.SE3(np.eye(3), curve.start)
    found = list(curve_crossings(curve, base, 0.0, lambda p: p[:, 0] - 0.06, reach=0.2))
    assert [s for s, _ in found] == pytest.approx([0.06 * curve.length / 0.15], abs=1e-9)
    slab = list(curve_crossings(curve, base, 0.0, lambda p: np.sin(100.0 * p[:, 0]), reach=0.07))
    expected = [np.pi / 100.0 * k * curve.length / 0.15 for k in (1,)]
    assert [s for s, _ in slab] == pytest.approx(expected, abs=1e-8)
    assert list(curve_crossings(curve, base, curve.length, lambda p: p[:, 0], reach=0.2)) == []


def test_a_hinge_has_target_points_in_its_plane_only() -> None:
    flat = pp.Curve.spline([(0, 0, 0), (0.1, 0, 0.02), (0.2, 0, 0.1), (0.3, 0, 0.1)])
    s = Circle(0.1).target_point(pin.SE3.Identity(), flat, 0.0)
    assert s is not None
    assert np.linalg.norm(flat.at(s)) == pytest.approx(0.1, abs=1e-12)
    beside = pp.Curve.spline([(0, 0, 0), (0.1, 0.05, 0.02), (0.2, 0.1, 0.1), (0.3, 0.1, 0.1)])
    assert Circle(0.1).target_point(pin.SE3.Identity(), beside, 0.0) is None


def test_an_arc_that_can_stretch_does_so_only_where_the_curve_ends() -> None:
    line = pp.Curve.line((0, 0, 0), (0.09, 0, 0))
    here = pin.SE3.Identity()
    assert ConstantCurvature(0.1).target_point(here, line, 0.0) is None
    assert ConstantCurvature(0.1, 0.02).target_point(here, line, 0.0) == pytest.approx(0.09)
    long = pp.Curve.line((0, 0, 0), (0.3, 0, 0))
    assert ConstantCurvature(0.1, 0.02).target_point(here, long, 0.0) == pytest.approx(0.1, abs=1e-9)
    for wrong in ({"length": 0.0}, {"length": 0.1, "stretch": 0.1}, {"length": 0.1, "stretch": -0.01}):
        with pytest.raises(pp.PostureError):
            ConstantCurvature(**wrong)


def test_the_solvers_one_after_the_other_are_the_arm() -> None:
    modules = [pp.template("RyRz").with_lengths((0.03, 0.02)), pp.template("RzRz"), pp.template("RzRy")]
    arm = pp.Arm.from_modules(modules)
    groups = joint_groups(arm)
    q = 0.3 * np.random.default_rng(0).normal(size=arm.nv)
    turn = np.eye(3)
    point = arm.chain.base
    ends = []
    for group in groups:
        frame = turn @ group.frame
        position, end = group.kinematics.forward(q[group.joints])
        point = point + frame @ position
        turn = frame @ end @ group.frame.T
        ends.append(point)
    last = [max(i for i, group in enumerate(groups) if group.module == k) for k in range(arm.n_modules)]
    np.testing.assert_allclose(np.array(ends)[last], arm.at(arm.configuration(q)).points, atol=1e-14)
