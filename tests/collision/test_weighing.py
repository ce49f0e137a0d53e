"""Masses from the density of shapes, against closed forms and trimesh."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName, WeightUnknown

SHAPES = {
    "box": ('<box size="0.1 0.02 0.03"/>', 0.1 * 0.02 * 0.03),
    "sphere": ('<sphere radius="0.02"/>', 4.0 / 3.0 * math.pi * 0.02**3),
    "cylinder": ('<cylinder radius="0.02" length="0.1"/>', math.pi * 0.02**2 * 0.1),
    "capsule": (
        '<capsule radius="0.02" length="0.1"/>',
        math.pi * 0.02**2 * 0.1 + 4.0 / 3.0 * math.pi * 0.02**3,
    ),
}
R = 0.02
L = 0.1
TUBE = math.pi * R**2 * L
BALL = 4.0 / 3.0 * math.pi * R**3
ACROSS = TUBE * (3 * R**2 + L**2) / 12 + BALL * (0.4 * R**2 + (L / 2) ** 2 + 2 * L / 2 * 3 / 8 * R)
MOMENTS = {  # about the centre, of density 1
    "box": 6e-5 / 12 * np.array([0.02**2 + 0.03**2, 0.1**2 + 0.03**2, 0.1**2 + 0.02**2]),
    "sphere": BALL * 0.4 * R**2 * np.ones(3),
    "cylinder": TUBE * np.array([(3 * R**2 + L**2) / 12, (3 * R**2 + L**2) / 12, R**2 / 2]),
    "capsule": np.array([ACROSS, ACROSS, TUBE * R**2 / 2 + BALL * 0.4 * R**2]),
}


def arm_of(*inside: str) -> pp.Arm:
    """Two hinges about y; what is inside the first moving link, and the second has a mass."""
    mass = '<inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3"'
    mass += ' ixy="0" ixz="0" iyz="0"/></inertial>'
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 1 0"/><origin xyz="{x} 0 0"/>'
        '<limit lower="-3" upper="3" velocity="1" effort="7"/></joint>'
        for name, kind, parent, child, x in (
            ("a", "revolute", "l0", "l1", 0.0),
            ("b", "revolute", "l1", "l2", 0.2),
            ("c", "fixed", "l2", "tip", 0.2),
        )
    )
    links = f'<link name="l0"/><link name="l1">{"".join(inside)}</link><link name="l2">{mass}</link>'
    return pp.Arm.load(f'<robot name="r">{links}<link name="tip"/>{joints}</robot>', split=1)


def shape(geometry: str, tag: str = "collision", xyz: str = "0.1 0.02 -0.03", rpy: str = "0.3 0.2 -1") -> str:
    return f'<{tag}><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{geometry}</geometry></{tag}>'


@pytest.mark.parametrize("kind", SHAPES)
def test_a_solid_weighs_its_volume_times_its_density(kind: str) -> None:
    geometry, volume = SHAPES[kind]
    arm = pp.weigh(arm_of(shape(geometry)), density=2000.0)
    (load,) = arm.weight.masses
    assert (load.frame, arm.weight.density) == ("l1", 2000.0)
    assert load.mass == pytest.approx(2000.0 * volume, rel=1e-12)
    np.testing.assert_allclose(load.com, (0.1, 0.02, -0.03), atol=1e-12)
    turn = Rotation.from_euler("xyz", [0.3, 0.2, -1.0]).as_matrix()
    moments = turn @ np.diag(2000.0 * MOMENTS[kind]) @ turn.T
    np.testing.assert_allclose(load.body().inertia, moments, atol=1e-12)
    torques = arm.at(np.zeros(2)).gravity_torques
    np.testing.assert_allclose(torques, [-9.81 * (0.3 + 0.1 * load.mass), -0.981], rtol=1e-12)


def test_shapes_of_a_link_add_up_and_collision_comes_before_visual() -> None:
    ball = SHAPES["sphere"][0]
    both = shape(ball), shape(ball, xyz="0 0 0.1"), shape('<box size="1 1 1"/>', "visual")
    arm = pp.weigh(arm_of(*both), density=1000.0)
    assert arm.weight.masses[0].mass == pytest.approx(2000.0 * SHAPES["sphere"][1])
    np.testing.assert_allclose(arm.weight.masses[0].com, (0.05, 0.01, 0.035), atol=1e-12)
    seen = pp.weigh(arm_of(shape(ball, "visual")), density=1000.0)
    assert seen.weight.masses[0].mass == pytest.approx(1000.0 * SHAPES["sphere"][1])


def test_a_mesh_weighs_as_its_hull(tmp_path) -> None:
    bumpy = trimesh.creation.icosphere(2, 0.03)
    bumpy.vertices *= np.random.default_rng(0).uniform(0.8, 1.0, (len(bumpy.vertices), 1))
    bumpy.export(tmp_path / "bumpy.stl")
    mesh = f'<mesh filename="{tmp_path / "bumpy.stl"}" scale="1 2 1"/>'
    arm = pp.weigh(arm_of(shape(mesh, xyz="0 0 0", rpy="0 0 0")), density=1000.0)
    hull = bumpy.convex_hull
    hull.apply_scale((1.0, 2.0, 1.0))
    (load,) = arm.weight.masses
    assert load.mass == pytest.approx(1000.0 * hull.volume, rel=1e-6)
    np.testing.assert_allclose(load.com, hull.center_mass, atol=1e-8)
    np.testing.assert_allclose(load.body().inertia, 1000.0 * hull.moment_inertia, rtol=1e-5, atol=1e-12)


def test_masses_may_be_given_by_name() -> None:
    box = SHAPES["box"][0]
    arm = pp.weigh(arm_of(shape(box)), masses={"l1": 0.4})
    assert arm.at(np.zeros(2)).gravity_torques[0] == pytest.approx(-9.81 * (0.3 + 0.1 * 0.4))
    nothing = pp.weigh(arm_of(shape(box)), masses={"l1": 0.0})
    assert nothing.at(np.zeros(2)).gravity_torques[0] == pytest.approx(-9.81 * 0.3)
    line = pp.weigh(arm_of(), masses={"l1": 0.4})  # without a shape: along the line to the next joint
    assert line.at(np.zeros(2)).gravity_torques[0] == pytest.approx(-9.81 * (0.3 + 0.1 * 0.4))
    (rod,) = line.weight.masses
    np.testing.assert_allclose(
        rod.inertia, (0.0, 0.4 * 0.04 / 12, 0.4 * 0.04 / 12, 0.0, 0.0, 0.0), atol=1e-15
    )


def test_masses_of_the_description_stay_as_they_are() -> None:
    arm = pp.Arm.from_template("RyRz", 3)
    same = pp.weigh(arm, density=7800.0)
    q = arm.random(0)
    np.testing.assert_array_equal(same.at(q).gravity_torques, arm.at(q).gravity_torques)


def test_what_cannot_be_weighed_is_named() -> None:
    with pytest.raises(WeightUnknown, match="the mass of link 'l1' is not known; they have no shapes"):
        pp.weigh(arm_of(), density=1000.0)
    with pytest.raises(WeightUnknown, match="give a density, or their masses"):
        pp.weigh(arm_of(shape(SHAPES["box"][0])))
    missing = shape('<mesh filename="nowhere.stl"/>')
    with pytest.raises(WeightUnknown, match=r"'l1' is not known.*nowhere\.stl"):
        pp.weigh(arm_of(missing), density=1000.0)
    with pytest.raises(UnknownName, match="no link without a mass is called 'l2'"):
        pp.weigh(arm_of(), masses={"l2": 1.0})
    for density in (0.0, -1.0, math.nan, "heavy"):
        with pytest.raises(InvalidValue, match="density"):
            pp.weigh(arm_of(), density=density)  # type: ignore[arg-type]
    for masses in ({"l1": -1.0}, {"l1": math.nan}, [1.0], 3):
        with pytest.raises(InvalidValue, match="masses"):
            pp.weigh(arm_of(), masses=masses)  # type: ignore[arg-type]
