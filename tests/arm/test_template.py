"""Module templates are data: checked when made, and pleasant to change."""

from __future__ import annotations

import dataclasses
import math
import pickle

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import pinposture as pp
from pinposture.arm.template import TEMPLATES, JointSpec, ModuleTemplate, template
from pinposture.errors import InvalidValue, UnknownName


@pytest.mark.parametrize(
    ("name", "axes", "lengths"),
    [
        ("RyRz", "yz", (0.025, 0.025)),
        ("RzRy", "zy", (0.025, 0.025)),
        ("Rz", "z", (0.15,)),
        ("RzRz", "zz", (0.15, 0.15)),
        ("RzRzRz", "zzz", (0.15, 0.15, 0.15)),
    ],
)
def test_a_shipped_template_has_the_joints_its_name_spells(name, axes, lengths):
    shipped = template(name)
    assert shipped is TEMPLATES[name]
    assert shipped.name == name
    assert [joint.axis for joint in shipped.joints] == list(axes)
    assert shipped.link_lengths == lengths
    for joint in shipped.joints:
        assert (joint.type, joint.lower, joint.upper) == ("revolute", -math.pi, math.pi)


@pytest.mark.parametrize("name", TEMPLATES)
def test_each_shipped_template_is_listed_under_its_name_and_makes_an_arm(name):
    shipped = template(name)
    arm = pp.Arm.from_template(name, modules=4)
    assert shipped.name == name
    assert arm.nq == 4 * sum(joint.follows is None for joint in shipped.joints)
    assert arm.length == pytest.approx(4 * shipped.length - shipped.lead, abs=1e-12)


def test_the_mapping_of_templates_cannot_be_changed():
    with pytest.raises(TypeError):
        TEMPLATES["Rx"] = template("Rz")


def test_an_unknown_template_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownName, match="did you mean 'RyRz'") as caught:
        template("RyRzz")
    assert caught.value.allowed == tuple(TEMPLATES)
    with pytest.raises(UnknownName):
        template(["RyRz"])
    with pytest.raises(InvalidValue, match=r"Arm\.from_modules"):
        pp.Arm.from_template(template("RyRz"), 3)


def test_a_new_template_takes_three_lines():
    slider = JointSpec("x", type="prismatic", lower=0, upper=0.05)
    made = ModuleTemplate(
        "RxRyP", joints=[JointSpec("x"), JointSpec("y"), slider], link_lengths=[0, 0.02, 0.03]
    )
    assert made.joints[2].upper == 0.05
    assert made.link_lengths == (0.0, 0.02, 0.03)
    assert made.length == pytest.approx(0.05, abs=1e-15)
    assert made.radius == 0.01
    assert hash(made) == hash(pickle.loads(pickle.dumps(made)))


def test_other_lengths_leave_the_rest_alone():
    changed = template("RyRz").with_lengths([0.03, 0.0])
    assert changed.link_lengths == (0.03, 0.0)
    assert template("RyRz").link_lengths == (0.025, 0.025)
    assert dataclasses.replace(changed, link_lengths=(0.025, 0.025)) == template("RyRz")


def test_other_limits_change_revolute_joints_only():
    slider = JointSpec("x", type="prismatic", lower=0.0, upper=0.05)
    free = JointSpec("y", type="continuous")
    changed = ModuleTemplate("RPC", (JointSpec("z"), slider, free), (0.1, 0.1, 0.1)).with_limits(-0.5, 1.0)
    assert changed.joints == (JointSpec("z", lower=-0.5, upper=1.0), slider, free)


def test_a_continuous_joint_has_no_limits_and_stays_so_when_replaced():
    spec = JointSpec("z", type="continuous")
    assert (spec.lower, spec.upper) == (-math.inf, math.inf)
    assert dataclasses.replace(spec, velocity=1.0).upper == math.inf
    with pytest.raises(InvalidValue, match="continuous"):
        JointSpec("z", type="continuous", lower=-1.0, upper=1.0)


def test_numbers_of_any_kind_become_plain_floats_without_negative_zero():
    spec = JointSpec("z", lower=np.float32(-0.5), upper=np.int64(2), velocity=np.array(3.0))
    made = ModuleTemplate("Rz", (spec,), np.array([-0.0]), radius=np.float64(0.02))
    values = (spec.lower, spec.upper, spec.velocity, made.link_lengths[0], made.radius)
    assert [repr(value) for value in values] == ["-0.5", "2.0", "3.0", "0.0", "0.02"]


SIZE = st.floats(min_value=-1e300, max_value=1e300)


@given(st.tuples(SIZE, SIZE, SIZE).filter(any))
@example((5e-324, 5e-324, 0.0))
@example((1.7e308, -1.7e308, 1.7e308))
def test_the_direction_of_any_axis_is_a_unit_vector_along_it(axis):
    direction = np.array(JointSpec(axis).direction)
    scaled = np.array(axis) / np.max(np.abs(axis))
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-15)
    assert np.linalg.norm(np.cross(direction, scaled)) < 1e-15
    assert direction @ scaled > 0.0


@pytest.mark.parametrize(("letter", "vector"), [("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))])
def test_a_letter_stands_for_a_unit_vector(letter, vector):
    assert JointSpec(letter).direction == vector


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"axis": "w"}, "joint axis"),
        ({"axis": "xy"}, "joint axis"),
        ({"axis": (0, 0, 0)}, "joint axis"),
        ({"axis": (1, 0)}, "joint axis"),
        ({"axis": (1, 0, math.nan)}, "joint axis"),
        ({"axis": ("1", "0", "0")}, "joint axis"),
        ({"axis": None}, "joint axis"),
        ({"axis": "x", "lower": 1.0, "upper": 1.0}, "joint limits"),
        ({"axis": "x", "lower": 1.0, "upper": 0.0}, "joint limits"),
        ({"axis": "x", "upper": math.inf}, "upper"),
        ({"axis": "x", "lower": math.nan}, "lower"),
        ({"axis": "x", "lower": "0"}, "lower"),
        ({"axis": "x", "lower": True}, "lower"),
        ({"axis": "x", "velocity": 0.0}, "velocity"),
        ({"axis": "x", "velocity": math.inf}, "velocity"),
        ({"axis": "x", "effort": -1.0}, "effort"),
        ({"axis": "x", "effort": 10**400}, "effort"),
        ({"axis": "x", "type": "prismatic"}, "limits of a prismatic joint"),
    ],
)
def test_a_bad_joint_is_refused_by_name(fields, name):
    with pytest.raises(InvalidValue) as caught:
        JointSpec(**fields)
    assert caught.value.name == name


@pytest.mark.parametrize(("kind", "hint"), [("revolut", " (did you mean 'revolute'?)"), (None, "")])
def test_an_unknown_type_of_joint_is_refused_with_those_there_are(kind, hint):
    with pytest.raises(UnknownName) as caught:
        JointSpec("x", type=kind)
    there_are = "there are: revolute, continuous, prismatic"
    assert str(caught.value) == f"no type of joint is called {kind!r}{hint}; {there_are}"


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"name": ""}, "template name"),
        ({"name": "a b"}, "template name"),
        ({"name": "1R"}, "template name"),
        ({"name": "R<"}, "template name"),
        ({"name": "Rz\n"}, "template name"),
        ({"name": None}, "template name"),
        ({"joints": ()}, "joints"),
        ({"joints": ("y", "z")}, "joints"),
        ({"joints": JointSpec("y")}, "joints"),
        ({"link_lengths": (0.1,)}, "link_lengths"),
        ({"link_lengths": 0.1}, "link_lengths"),
        ({"link_lengths": "ab"}, "link_lengths"),
        ({"link_lengths": (0.1, -0.1)}, "link_lengths[1]"),
        ({"link_lengths": (math.nan, 0.1)}, "link_lengths[0]"),
        ({"link_lengths": (0.1, 2e6)}, "link_lengths[1]"),
        ({"radius": 0.0}, "radius"),
        ({"radius": -0.01}, "radius"),
        ({"radius": math.inf}, "radius"),
        ({"radius": None}, "radius"),
    ],
)
def test_a_bad_template_is_refused_by_name(fields, name):
    good = {
        "name": "RyRz",
        "joints": (JointSpec("y"), JointSpec("z")),
        "link_lengths": (0.1, 0.1),
        "radius": 0.01,
    }
    with pytest.raises(InvalidValue) as caught:
        ModuleTemplate(**(good | fields))
    assert caught.value.name == name


def test_templates_cannot_be_changed_in_place():
    with pytest.raises(dataclasses.FrozenInstanceError):
        template("Rz").radius = 1.0
