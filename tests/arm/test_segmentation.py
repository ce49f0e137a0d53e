"""Modules are what Section 4.1 asks for: the smallest whose end can be placed on any curve."""

from __future__ import annotations

import itertools
import warnings

import numpy as np
import pytest
from arm.describing import HERE, LINK, X, Y, Z, arm_text, limit, pairs
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm.segmentation import EndMobility

TURN = "revolute"
SLIDE = "prismatic"
LONG = "0.13 0 0"
SHORT = "0.05 0 0"
OFFSET = "0 0.02 0.08"


def load(joints, tip=LINK):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pp.Arm.load(arm_text(joints, tip))


def sizes(arm):
    return [len(names) for names in arm.module_joints]


CASES = {
    # joints, tip, sizes of the modules, plane
    "pairs": (pairs(5), LINK, [2] * 5, 3),
    "pairs of unequal links": ([(TURN, Y, LONG), (TURN, Z, SHORT)] * 4, LONG, [2] * 4, 3),
    "two kinds in turn": (
        [(TURN, Y, LONG), (TURN, Z, SHORT), (TURN, Z, LONG), (TURN, Y, LINK)] * 3,
        SHORT,
        [2] * 6,
        3,
    ),
    "parallel pairs": (
        [(TURN, Y, LINK), (TURN, Y, LINK), (TURN, Z, LINK), (TURN, Z, LINK)] * 3,
        LINK,
        [3, 2, 2, 2, 3],
        3,
    ),
    "a base that turns first": ([(TURN, X, LINK), *pairs(4)], LINK, [3, 2, 2, 2], 3),
    "an odd joint at the tip": ([*pairs(4), (TURN, Y, LINK)], LINK, [2, 2, 2, 3], 3),
    "nothing behind the last joint": (pairs(4), HERE, [2, 2, 4], 3),
    "a roll about the last link": ([*pairs(3), (TURN, X, LINK)], LINK, [2, 2, 3], 3),
    "pairs in one place": ([(TURN, Y, LINK), (TURN, Z, HERE)] * 4, LINK, [2] * 4, 3),
    "pairs in one place, no end": ([(TURN, Y, LINK), (TURN, Z, HERE)] * 4, HERE, [2, 2, 4], 3),
    "three in one place": ([(TURN, X, LINK), (TURN, Y, HERE), (TURN, Z, HERE)] * 4, LINK, [3] * 4, 3),
    "roll and bend": ([(TURN, X, LINK), (TURN, Y, HERE)] * 4, LINK, [2] * 4, 3),
    "roll, link and bend": ([(TURN, X, HERE), (TURN, Y, LINK)] * 4, LINK, [4, 4], 3),
    "roll, bend and slide": ([(TURN, X, LINK), (TURN, Y, HERE), (SLIDE, X, LINK)] * 4, LINK, [3] * 4, 3),
    "bend, bend and roll": ([(TURN, Y, LINK), (TURN, Z, LINK), (TURN, X, LINK)] * 4, LINK, [3] * 4, 3),
    "tilted and offset": ([(TURN, "0.1 1 0.3", OFFSET), (TURN, "0 -0.4 1", LINK)] * 5, LINK, [2] * 5, 3),
    "a slide across and a hinge": ([(SLIDE, Y, LINK), (TURN, Y, LINK)] * 3, LINK, [2] * 3, 3),
    "planar": ([(TURN, Z, LINK)] * 7, LINK, [1] * 7, 2),
    "planar, either sense": ([(TURN, Z, LINK), (TURN, "0 0 -1", LINK)] * 3, LINK, [1] * 6, 2),
    "planar, no end": ([(TURN, Z, LINK)] * 7, HERE, [1, 1, 1, 1, 1, 2], 2),
    "planar, rounded": ([(TURN, Z, LINK), (TURN, "0 0.0002 1", LINK)] * 3, LINK, [1] * 6, 2),
    "planar with slides along the links": ([(TURN, Z, LINK), (SLIDE, X, LINK)] * 4, LINK, [2] * 4, 2),
    "planar, with a roll at the tip": ([*[(TURN, Z, LINK)] * 5, (TURN, X, LINK)], LINK, [1, 1, 1, 1, 2], 2),
    "planar slides": ([(SLIDE, X, LINK), (SLIDE, Y, LINK)], LINK, [2], 2),
    "a plane that turns": ([(TURN, Z, LINK), *[(TURN, Y, LINK)] * 3], LINK, [2, 1, 1], 3),
    "planes that turn, unlike": (
        [(TURN, Z, SHORT), *[(TURN, Y, LONG)] * 4, (TURN, Z, LINK), *[(TURN, Y, LINK)] * 5],
        SHORT,
        [2, 1, 1, 1, 2, 1, 1, 1, 1],
        3,
    ),
    "a base that drives": (
        [(SLIDE, X, HERE, limit(-1e6, 1e6)), (SLIDE, Y, HERE, limit(-1e6, 1e6)), *pairs(3)],
        LINK,
        [4, 2, 2],
        3,
    ),
    "parallel axes and a slide along them": ([(TURN, Z, LINK)] * 2 + [(SLIDE, Z, LINK)], HERE, [3], 3),
}


@pytest.mark.parametrize("case", CASES)
def test_joints_are_grouped_as_one_would_by_hand(case):
    joints, tip, expected, dimension = CASES[case]
    arm = load(joints, tip)
    assert (sizes(arm), arm.dimension) == (expected, dimension)
    assert arm.segmentation.sizes == tuple(expected)
    assert arm.segmentation.can_follow is (not case.startswith(("a plane that", "planes that")))
    assert ("planar" in arm.segmentation.reason) is (dimension == 2)


@pytest.mark.parametrize("case", CASES)
def test_the_end_of_every_module_moves_across_its_line_to_the_base(case):
    """By finite differences of the control points, in random postures: rank 2 in space, 1 in the plane.

    It is 1 too where parallel axes in a row leave no plane.
    """
    joints, tip, _, dimension = CASES[case]
    arm = load(joints, tip)
    h = 1e-6
    needed = np.where(arm.chain.plane_bound, 1, dimension - 1)
    ranks = []
    for seed in range(9):
        q = arm.configuration(
            np.random.default_rng(seed).uniform(-0.9, 0.9, arm.nv) * np.where(arm.slides, 0.05, 1.0)
        )
        points = np.vstack([arm.chain.base, arm.at(q).points])
        rank = []
        for k, own in enumerate(arm.chain.module_slices):
            moved = [arm.at(arm.integrate(q, h * np.eye(arm.nv)[u])).points[k] for u in arm.columns[own]]
            motion = (np.array(moved) - points[k + 1]) / h
            start = arm.chain.base if k == 0 else points[k]
            along = (points[k + 1] - start) / np.linalg.norm(points[k + 1] - start)
            across = motion - np.outer(motion @ along, along)
            rank.append(np.linalg.matrix_rank(across, tol=1e-3))
        ranks.append(rank)
    assert np.all(np.median(ranks, axis=0) >= needed)
    assert arm.segmentation.can_follow or np.all(np.max(ranks, axis=0)[arm.chain.plane_bound] == 1)


@pytest.mark.parametrize("case", CASES)
def test_control_points_are_apart(case):
    arm = load(*CASES[case][:2])
    assert arm.chain.module_lengths.min() > 1e-3 * arm.length


def test_long_rows_of_parallel_axes_are_measured_no_more_than_their_square(monkeypatch):
    """Postures are gone through joint by joint, which took a time like the cube of their number."""
    counts = []
    motions = EndMobility._jacobians

    def counted(mobility, first, stop):
        counts[-1] += stop - first
        return motions(mobility, first, stop)

    monkeypatch.setattr(EndMobility, "_jacobians", counted)
    for n in (30, 60):
        counts.append(0)
        arm = load([(TURN, Z, LINK), *[(TURN, Y, f"{0.1 + 0.01 * (k % 7)} 0 0") for k in range(n)]])
        assert max(sizes(arm)) == 2
    assert counts[1] < 5 * counts[0]


@pytest.mark.long
def test_without_a_pattern_no_cut_gives_more_modules():
    """Against every way to cut seven joints with nothing alike."""
    rng = np.random.default_rng(4)
    for _ in range(3):
        axes = [" ".join(map(str, rng.choice(np.eye(3), p=[0.3, 0.4, 0.3]))) for _ in range(7)]
        links = [f"{length} 0 0" for length in 0.05 * 1.4 ** np.arange(8)]
        joints = [(TURN, axis, link) for axis, link in zip(axes, links[:7], strict=True)]
        arm = load(joints, links[7])
        if arm.segmentation.can_follow is False:
            continue
        assert arm.segmentation.period is None
        most = 0
        for cuts in itertools.chain.from_iterable(itertools.combinations(range(1, 7), k) for k in range(7)):
            bounds = [0, *cuts, 7]
            most = (
                max(most, len(bounds) - 1)
                if all(places(arm, a, b) for a, b in itertools.pairwise(bounds))
                else most
            )
        assert arm.n_modules == most


def places(arm, first, stop):
    """The rank test by brute force: the end's motion across its line to the base, in many postures."""
    stations = np.vstack([arm.chain.origins, arm.chain.points[-1]])
    ratios = []
    for seed in range(40):
        amounts = np.random.default_rng(seed).uniform(-1, 1, stop - first)
        place = stations[stop]
        lines = []
        for u in range(stop - 1, first - 1, -1):
            turn = rotation(arm.chain.axes[u], amounts[u - first])
            place = stations[u] + turn @ (place - stations[u])
            lines = [(turn @ axis, stations[u] + turn @ (at - stations[u])) for axis, at in lines]
            lines.append((arm.chain.axes[u], stations[u]))
        span = place - stations[first]
        along = span / np.linalg.norm(span)
        motion = np.array([np.cross(axis, place - at) for axis, at in lines])
        values = np.linalg.svd(motion - np.outer(motion @ along, along), compute_uv=False)
        ratios.append(values[1] / np.linalg.norm(span) if len(values) > 1 else 0.0)
    return np.median(ratios) > 0.05


def rotation(axis, angle):
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def test_zero_positions_and_senses_of_axes_do_not_change_the_pattern():
    rng = np.random.default_rng(1)
    text = arm_text(pairs(6))
    for k in range(1, 13):
        axis = Y if k % 2 else Z
        turned = " ".join(str(rng.uniform(-1, 1) * float(x)) for x in axis.split())
        before = f'<origin xyz="{LINK}"/><axis xyz="{axis}"/>'
        flipped = " ".join(str(rng.choice([-1, 1]) * float(x)) for x in axis.split())
        text = text.replace(before, f'<origin xyz="{LINK}" rpy="{turned}"/><axis xyz="{flipped}"/>', 1)
    arm = pp.Arm.load(text)
    assert np.linalg.norm(arm.chain.points[-1] - arm.chain.base) < 0.95 * arm.length
    assert sizes(arm) == [2] * 6
    assert arm.segmentation.period == 1


def test_limits_that_leave_out_zero_do_not_mislead():
    joints = [(TURN, Y, LINK, limit(0.5, 2.0)), (TURN, Z, LINK, limit(-2.0, -0.3))] * 4
    assert sizes(load(joints)) == [2] * 4


def test_the_reason_names_the_pattern_and_the_exception():
    reason = load([*pairs(4), (TURN, Y, LINK)]).segmentation.reason
    assert (
        "the joints from 'j1' to 'j9' repeat joint by joint; a module of 2 joints meets this need" in reason
    )
    assert "module 4 has 3 joints" in reason
    assert load(pairs(4)).segmentation.period == 1
    odd = [(TURN, Y, LINK), (TURN, X, SHORT), (TURN, Z, LONG), (TURN, Y, OFFSET), (TURN, Z, LINK)]
    assert "no pattern" in load(odd).segmentation.reason
    assert (
        pp.Arm.load(arm_text(pairs(4)), split=4).segmentation.reason == "4 joints for each module, as given"
    )


@given(
    st.lists(
        st.tuples(
            st.sampled_from([TURN, TURN, SLIDE]),
            st.sampled_from([X, Y, Z, "1 1 0", "0 0.6 -0.8"]),
            st.sampled_from([LINK, LONG, HERE, OFFSET]),
        ),
        min_size=1,
        max_size=12,
    )
)
@examples(120)
def test_any_arm_is_cut_into_modules_that_can_place_their_ends_or_is_one_module(joints):
    arm = load(joints)
    cut = arm.segmentation
    assert sum(cut.sizes) == arm.nv == len(joints) and min(cut.sizes) >= 1
    assert cut.reason
    if cut.can_follow:
        assert min(cut.sizes) >= arm.dimension - 1
    elif len(cut.sizes) > 1:
        assert "in one plane at a time" in cut.reason and arm.dimension == 3
