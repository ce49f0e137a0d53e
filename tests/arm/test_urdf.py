"""The written URDF describes the arm that the templates describe; checked against Pinocchio and by hand."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation

from pinposture.arm.description import read_description
from pinposture.arm.inertias import RigidBody
from pinposture.arm.template import (
    DENSITY,
    JointSpec,
    ModuleTemplate,
    link_inertia,
    modules_to_urdf,
    template,
)
from pinposture.arm.urdf import (
    Follows,
    JointDescription,
    ShapeDescription,
    read_inertials,
    read_joint,
    read_shape,
    write_inertial,
    write_joint,
    write_shape,
)
from pinposture.errors import InvalidValue

AXES = st.one_of(
    st.sampled_from("xyz"),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: np.linalg.norm(axis) > 1e-3),
)
REVOLUTE = st.builds(
    JointSpec, AXES, lower=st.floats(-4.0, -0.1), upper=st.floats(0.1, 4.0), velocity=st.floats(0.1, 9.0)
)
PRISMATIC = st.builds(
    JointSpec, AXES, type=st.just("prismatic"), lower=st.just(-0.1), upper=st.floats(0.0, 0.2)
)
CONTINUOUS = st.builds(JointSpec, AXES, type=st.just("continuous"))


@st.composite
def arms(draw):
    modules = []
    for _ in range(draw(st.integers(1, 5))):
        joints = draw(st.lists(st.one_of(REVOLUTE, PRISMATIC, CONTINUOUS), min_size=1, max_size=4))
        lengths = draw(st.lists(st.floats(0.0, 0.3), min_size=len(joints), max_size=len(joints)))
        modules.append(ModuleTemplate("any", joints, lengths, draw(st.floats(0.001, 0.05))))
    return modules


def tip_by_hand(modules, positions):
    """Placement of the tip: the product of joint motions and links, one after the other."""
    rotation = np.eye(3)
    point = np.zeros(3)
    at = iter(positions)
    for module in modules:
        for spec, length in zip(module.joints, module.link_lengths, strict=True):
            value = next(at)
            axis = np.array(spec.direction)
            if spec.type == "prismatic":
                point = point + rotation @ axis * value
            else:
                rotation = rotation @ Rotation.from_rotvec(axis * value).as_matrix()
            point = point + rotation @ np.array([length, 0.0, 0.0])
    return rotation, point


@given(arms(), st.integers(0, 2**32 - 1))
@examples(60)
def test_the_tip_is_where_the_product_of_joints_and_links_puts_it(modules, seed):
    model = pin.buildModelFromXML(modules_to_urdf(modules, "any"))
    positions = np.random.default_rng(seed).uniform(-3.0, 3.0, model.nv)
    data = model.createData()
    q = pin.integrate(model, pin.neutral(model), positions)
    pin.framesForwardKinematics(model, data, q)
    tip = data.oMf[model.getFrameId("tip")]
    rotation, point = tip_by_hand(modules, positions)
    np.testing.assert_allclose(tip.translation, point, atol=1e-12)
    np.testing.assert_allclose(tip.rotation, rotation, atol=1e-12)


@given(arms())
@examples(40)
def test_every_number_reads_back_as_the_float_it_was(modules):
    description = read_description(modules_to_urdf(modules, "any"))
    specs = [spec for module in modules for spec in module.joints]
    moving = description.joints[:-1]
    assert len(moving) == len(specs)
    for joint, spec in zip(moving, specs, strict=True):
        assert (joint.type, joint.lower, joint.upper) == (spec.type, spec.lower, spec.upper)
        assert joint.velocity == spec.velocity
        np.testing.assert_allclose(joint.axis, spec.direction, atol=1e-15)
    model = pin.buildModelFromXML(description.text)
    assert list(model.velocityLimit) == [spec.velocity for spec in specs]
    assert list(model.effortLimit) == [spec.effort for spec in specs]
    lengths = [length for module in modules for length in module.link_lengths]
    origins = [placement.translation[0] for placement in list(model.jointPlacements)[1:]]
    assert [*origins, model.frames[model.getFrameId("tip")].placement.translation[0]] == [0.0, *lengths]


def slices(length, radius):
    """Inertia of ball and cylinder by integration over discs across x; exact, for all is polynomial in x."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    mass = 0.0
    moment = 0.0
    along = 0.0
    second = 0.0
    for low, high, disc in (
        (-radius, radius, lambda x: radius**2 - x**2),
        (0.0, length, lambda x: np.full_like(x, radius**2)),
    ):
        x = (high + low) / 2 + (high - low) / 2 * nodes
        dx = (high - low) / 2 * weights
        squared = disc(x)  # radius of the disc, squared
        mass += DENSITY * np.sum(dx * math.pi * squared)
        moment += DENSITY * np.sum(dx * math.pi * squared * x)
        along += DENSITY * np.sum(dx * math.pi * squared**2 / 2)
        second += DENSITY * np.sum(dx * (math.pi * squared**2 / 4 + math.pi * squared * x**2))
    return mass, moment / mass, along, second - moment**2 / mass


@given(st.floats(0.0, 1.0), st.floats(0.02, 0.5))
def test_the_inertia_of_a_link_is_that_of_its_ball_and_cylinder(length, radius):
    np.testing.assert_allclose(link_inertia(length, radius), slices(length, radius), rtol=1e-11, atol=1e-16)


@given(st.one_of(st.just(0.0), st.floats(0.0, 1e6)), st.floats(1e-6, 1e6))
def test_inertia_is_positive_and_physical_at_every_size(length, radius):
    solid = link_inertia(length, radius)
    assert min(solid.mass, solid.along, solid.across) > 0.0 and solid.center >= 0.0
    assert np.all(np.isfinite(solid))
    assert (
        solid.along <= 2.0 * solid.across
    )  # the other two triangle inequalities are across <= across + along


@given(st.floats(1e-6, 1.0), st.one_of(st.just(0.0), st.floats(0.0, 1e4)))
def test_pinocchio_sees_a_positive_definite_inertia(radius, slenderness):
    module = ModuleTemplate("Rz", (JointSpec("z"),), (slenderness * radius,), radius)
    inertia = pin.buildModelFromXML(modules_to_urdf([module], "one")).inertias[1]
    moments = np.linalg.eigvalsh(inertia.inertia)
    assert moments[0] > 0.0
    assert moments[0] + moments[1] >= moments[2] * (1.0 - 1e-12)
    assert inertia.mass > 0.0 and not np.any(inertia.lever[1:])


@pytest.mark.parametrize("kind", [pin.GeometryType.VISUAL, pin.GeometryType.COLLISION])
def test_each_link_shows_a_ball_at_its_joint_and_a_cylinder_to_the_next(tmp_path, kind):
    modules = [template("RyRz").with_lengths((0.04, 0.0)), template("Rz")]
    path = tmp_path / "arm.urdf"
    path.write_text(modules_to_urdf(modules, "arm"))
    model = pin.buildModelFromUrdf(str(path))
    shapes = pin.buildGeomFromUrdf(model, str(path), kind)
    data = model.createData()
    placed = shapes.createData()
    pin.updateGeometryPlacements(model, data, shapes, placed, pin.neutral(model))
    found = {}
    for shape, placement in zip(shapes.geometryObjects, placed.oMg, strict=True):
        name = type(shape.geometry).__name__
        geometry = shape.geometry
        start = placement.translation[0]
        if name == "Cylinder":
            np.testing.assert_allclose(placement.rotation[:, 2], [1.0, 0.0, 0.0], atol=1e-15)
            start -= geometry.halfLength
            found.setdefault(name, []).append((round(start, 12), 2 * geometry.halfLength, geometry.radius))
        else:
            found.setdefault(name, []).append((round(start, 12), geometry.radius))
        np.testing.assert_allclose(placement.translation[1:], 0.0, atol=1e-15)
    assert sorted(found["Sphere"]) == [(0.0, 0.01), (0.04, 0.01), (0.04, 0.02)]
    assert sorted(found["Cylinder"]) == [(0.0, 0.04, 0.01), (0.04, 0.15, 0.02)]


def test_names_spell_module_joint_and_axis():
    skew = ModuleTemplate("skew", (JointSpec((1, 1, 0)),), (0.1,))
    description = read_description(modules_to_urdf([template("RyRz"), skew], "arm"))
    assert description.links == ("base", "m01_l1", "m01_l2", "m02_l1", "tip")
    assert [joint.name for joint in description.joints] == ["m01_j1_y", "m01_j2_z", "m02_j1", "tip_joint"]


@pytest.mark.parametrize(
    "modules", [[template("Rz")] * 120, [ModuleTemplate("many", [JointSpec("z")] * 12, [0.1] * 12)]]
)
def test_names_sort_in_the_order_of_the_chain(modules):
    description = read_description(modules_to_urdf(modules, "arm"))
    joints = [joint.name for joint in description.joints[:-1]]
    assert joints == sorted(joints)
    assert list(description.links[1:-1]) == sorted(description.links[1:-1])


def test_the_text_is_the_same_each_time_and_says_where_it_came_from():
    modules = [template("RyRz"), template("Rz")]
    text = modules_to_urdf(modules, "arm", command="make arms")
    assert text == modules_to_urdf(list(modules), "arm", command="make arms")
    declaration, comment, root = text.splitlines()[:3]
    assert declaration.startswith("<?xml")
    assert comment == "<!-- Generated by make arms; do not edit. -->"
    assert root == '<robot name="arm">'
    assert max(map(len, text.splitlines())) < 200


@pytest.mark.parametrize("name", ["a<b & \"c\" 'd'", "é", "arm 2"])
def test_any_printable_name_survives(name):
    text = modules_to_urdf([template("Rz")], name)
    assert ET.fromstring(text).get("name") == name
    assert pin.buildModelFromXML(text).name == name


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (([], "arm"), "modules"),
        ((template("Rz"), "arm"), "modules"),
        (([template("Rz"), "Rz"], "arm"), "modules[1]"),
        (([template("Rz")], " "), "name"),
        (([template("Rz")], "a\nb"), "name"),
        (([template("Rz")], "a\x00b"), "name"),
        (([template("Rz")], "\ud800"), "name"),
        (([template("Rz")], None), "name"),
        (([template("Rz")], "arm", "x --> y"), "command"),
        (([template("Rz")], "arm", "x\ny"), "command"),
    ],
)
def test_what_cannot_be_written_is_refused(arguments, name):
    with pytest.raises(InvalidValue) as caught:
        modules_to_urdf(*arguments)
    assert caught.value.name == name


VECTORS = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
EDGES = st.one_of(st.just((-math.inf, math.inf)), st.tuples(st.floats(-3.0, -0.1), st.floats(0.1, 3.0)))


@st.composite
def described_joints(draw):
    kind = draw(st.sampled_from(["revolute", "prismatic", "continuous"]))
    axis = draw(st.sampled_from([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.6, 0.8)]))
    lower, upper = (-math.inf, math.inf) if kind == "continuous" else draw(EDGES)
    return JointDescription(
        "joint",
        kind,
        "before",
        "after",
        origin=draw(VECTORS),
        rpy=draw(VECTORS),
        axis=axis,
        lower=lower,
        upper=upper,
        velocity=draw(st.floats(0.0, 9.0)),
        effort=draw(st.floats(0.0, 9.0)),
        damping=draw(st.sampled_from([0.0, 0.3])),
        friction=draw(st.sampled_from([0.0, 0.2])),
        follows=draw(st.sampled_from([None, Follows("other", -0.5, 0.25)])),
        excluded=draw(st.sampled_from([None, "for a reason"])),
    )


@given(described_joints())
@examples(60)
def test_a_joint_is_read_as_it_was_written_and_as_pinocchio_reads_it(joint):
    robot = ET.Element("robot", name="one")
    for link in ("before", "after"):
        ET.SubElement(robot, "link", name=link)
    assert read_joint(write_joint(robot, joint), "text") == joint
    model = pin.buildModelFromXML(ET.tostring(robot, encoding="unicode"))
    place = model.jointPlacements[1]
    np.testing.assert_allclose(place.translation, joint.origin, atol=1e-15)
    turned = Rotation.from_euler("xyz", joint.rpy).as_matrix()
    np.testing.assert_allclose(place.rotation, turned, atol=1e-14)
    numbers = (model.velocityLimit[0], model.effortLimit[0], model.damping[0], model.upperDryFrictionLimit[0])
    assert numbers == (joint.velocity, joint.effort, joint.damping, joint.friction)
    if joint.type != "continuous" and math.isfinite(joint.upper):
        assert (model.lowerPositionLimit[0], model.upperPositionLimit[0]) == (joint.lower, joint.upper)


@pytest.mark.parametrize("edges", [(-math.inf, 2.0), (-2.0, math.inf)])
def test_one_limit_alone_is_written_with_a_number_that_means_none_for_the_other(edges):
    one = JointDescription("j", "revolute", "a", "b", lower=edges[0], upper=edges[1], velocity=1.0)
    read = read_joint(write_joint(ET.Element("robot"), one), "text")
    assert (read.lower, read.upper) == tuple(np.clip(edges, -1e9, 1e9))
    assert read.effort == 1e9  # none was given, and URDF needs a number


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        ("sphere", {"radius": (0.1,)}),
        ("cylinder", {"radius": (0.1,), "length": (0.3,)}),
        ("capsule", {"radius": (0.1,), "length": (0.3,)}),
        ("box", {"size": (0.1, 0.2, 0.3)}),
        ("mesh", {"scale": (1.0, -1.0, 0.001)}),
    ],
)
@pytest.mark.parametrize("tag", ["visual", "collision"])
def test_a_shape_is_read_as_it_was_written(kind, numbers, tag):
    file = "arm.stl" if kind == "mesh" else ""
    shape = ShapeDescription(kind, numbers, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), file)
    assert read_shape(write_shape(ET.Element("link"), tag, shape)) == shape
    place = shape.placement
    np.testing.assert_allclose(place.rotation, Rotation.from_euler("xyz", shape.rpy).as_matrix(), atol=1e-15)
    assert tuple(place.translation) == shape.origin


def test_masses_are_read_as_they_were_written():
    rng = np.random.default_rng(0)
    spread = rng.normal(size=(3, 3))
    body = RigidBody(2.5, rng.normal(size=3), spread @ spread.T)
    robot = ET.Element("robot", name="one")
    link = ET.SubElement(robot, "link", name="body")
    write_inertial(link, body)
    text = ET.tostring(robot, encoding="unicode")
    read = read_inertials(text, "text")["body"]
    assert read.mass == body.mass
    np.testing.assert_array_equal(read.center, body.center)
    np.testing.assert_array_equal(read.inertia, body.inertia)
