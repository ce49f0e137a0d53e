"""What is drawn is what its name says, can be reached, and depends on the seed alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import pinposture as pp
from benchmarks.cases.families import START_KINDS, Family, Subject, built_subject, draw_case, loaded_subject
from pinposture.errors import InvalidValue, UnknownName

NAMES = ("ryrz20", "planar45")


@cache
def subject_named(name):
    return built_subject(name)


@pytest.fixture(scope="session")
def stiff():
    return pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.3, 0.2)] * 5)


def test_the_arms_are_those_of_the_thesis_and_the_planar_one_has_a_point_at_every_second_joint():
    spatial, planar = subject_named("ryrz20").arm, subject_named("planar45").arm
    assert (spatial.nv, spatial.n_modules, spatial.dimension) == (40, 20, 3)
    assert (planar.nv, planar.n_modules, planar.dimension) == (45, 23, 2)
    assert planar.length == pytest.approx(6.75)
    np.testing.assert_allclose(np.diff(planar.at(planar.straight()).points[:, 0])[:-1], 0.3)
    with pytest.raises(UnknownName, match="planar45"):
        built_subject("planar46")


def test_families_are_all_pairs_but_the_one_where_nothing_moves(stiff):
    assert len(subject_named("ryrz20").families) == 5 * 4 - 1
    assert len(subject_named("planar45").families) == 5 * 3 - 1
    for subject in map(subject_named, NAMES):
        assert len(set(subject.families)) == len(subject.families)
        assert ("straight", "line") not in subject.families
    assert len(loaded_subject(stiff).families) == 10


@pytest.mark.parametrize("name", NAMES)
def test_every_case_is_within_the_limits_can_be_reached_and_is_the_same_again(name):
    subject, twin = subject_named(name), built_subject(name)
    for family in subject.families:
        start, target = draw_case(subject, family, 7)
        again, same = draw_case(twin, family, 7)
        np.testing.assert_array_equal(start, again)
        np.testing.assert_array_equal(target.points, same.points)
        assert subject.arm.within_limits(start)
        assert subject.arm.within_limits(target.q)
        np.testing.assert_allclose(subject.arm.at(target.q).points, target.points, atol=1e-12)
        error = np.linalg.norm(subject.arm.at(start).points - target.points, axis=1).mean()
        assert error > 1e-5 * subject.arm.length  # something is to be done
        other, _ = draw_case(subject, family, 8)
        assert (family.start == "straight") == np.array_equal(start, other)


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_has_one_start_for_all_targets_and_one_target_for_all_starts(name):
    subject = subject_named(name)
    starts, targets = {}, {}
    for family in subject.families:
        start, target = draw_case(subject, family, 3)
        np.testing.assert_array_equal(starts.setdefault(family.start, start), start)
        np.testing.assert_array_equal(targets.setdefault(family.target, target).points, target.points)
    assert not np.allclose(starts["smooth"], targets["random"].q, atol=1e-3)
    # Starts of different kinds are not copies of each other at another scale.
    turned = np.corrcoef(starts["uniform-0.6"], starts["uniform-1.5"])[0, 1]
    assert abs(turned) < 0.6


def test_starts_have_the_size_that_their_names_say():
    subject = subject_named("ryrz20")
    drawn = {
        start: np.array([draw_case(subject, Family(start, "random"), seed)[0] for seed in range(10)])
        for start in START_KINDS
    }
    for start, width in (("uniform-0.6", 0.6), ("uniform-1.5", 1.5), ("noise", 1e-3)):
        assert 0.95 * width < drawn[start].max() <= width
        assert -width <= drawn[start].min() < -0.95 * width
    largest = np.abs(drawn["smooth"]).max(axis=1)
    assert np.all((largest >= 0.2) & (largest <= 1.0))
    assert np.all(drawn["straight"] == 0.0)


@pytest.mark.parametrize("name", NAMES)
def test_a_fold_lies_on_the_line_of_the_straight_arm_which_no_joint_brings_closer(name):
    subject = subject_named(name)
    arm, joints = subject.arm, []
    for seed in range(24):
        start, target = draw_case(subject, Family("straight", "folded"), seed)
        assert np.all(target.points[:, 1:] == 0.0)
        (joint,) = np.flatnonzero(target.q)
        assert abs(target.q[joint]) == np.pi
        joints.append(joint)
        if seed < 2:
            for u in range(arm.nv):  # central differences: only the second order is left
                ends = [arm.at(start + sign * 1e-4 * np.eye(arm.nv)[u]).points for sign in (1, -1)]
                costs = [np.sum((points - target.points) ** 2) for points in ends]
                assert abs(costs[0] - costs[1]) < 1e-12 * arm.length**2
    assert 4 < joints.count(0) < 20
    assert max(joints) < arm.nv // 2
    assert len(set(joints)) > 3


def test_a_loaded_arm_keeps_its_limits(stiff):
    subject = loaded_subject(stiff)
    assert subject.targets == ("gentle", "random")
    for family in subject.families:
        start, target = draw_case(subject, family, 1)
        assert stiff.within_limits(start)
        assert stiff.within_limits(target.q)
        np.testing.assert_allclose(stiff.at(target.q).points, target.points, atol=1e-12)
    harsh, _ = draw_case(subject, Family("uniform-1.5", "random"), 1)
    assert np.isin(harsh, (-0.3, 0.2)).sum() > 5


def test_slides_are_drawn_in_their_unit():
    joints = (pp.JointSpec("y"), pp.JointSpec("x", type="prismatic", lower=-1.0, upper=1.0))
    arm = pp.Arm.from_modules(
        [pp.ModuleTemplate("slide", joints, (0.1, 0.1))] * 6
    ).with_characteristic_length(0.01)
    straight = arm.positions(arm.straight())
    start, _ = draw_case(loaded_subject(arm), Family("noise", "random"), 0)
    off = np.abs(arm.positions(start) - straight)
    assert np.all(off[arm.slides] <= 1e-5)
    assert off[~arm.slides].max() > 1e-4


def test_what_there_is_not_is_refused(stiff):
    subject = subject_named("planar45")
    with pytest.raises(UnknownName, match="helix"):
        draw_case(subject, Family("smooth", "helix"), 0)
    with pytest.raises(UnknownName, match="sideways"):
        draw_case(subject, Family("sideways", "line"), 0)
    with pytest.raises(InvalidValue, match="turns by pi"):
        draw_case(Subject("stiff", stiff, ("folded",)), Family("smooth", "folded"), 0)
