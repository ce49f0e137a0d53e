"""Shapes: what keeps of them however they are pulled about, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from edited_tasks import L, bent_spline, coil, six_modules, straight_line
from hypothesis import assume, given
from hypothesis import strategies as st
from nearest import distances_to_nearest
from sampling import cases, examples

import pinposture as pp
from pinposture.curve.curve import describe_curve
from pinposture.editor.edits import SHAPE, Shape
from pinposture.editor.solver import judge
from pinposture.errors import CurveError, InvalidValue, PostureError
from pinposture.placement import resolve_targets
from pinposture.placement.target import place_curve
from pinposture.task import Keyframe

AWAY = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.9])), np.array([0.7, -0.4, 1.1]))


@cache
def planar() -> pp.Arm:
    return pp.Arm.from_template("Rz", modules=5, base_placement=AWAY)


@cache
def spatial() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=5, base_placement=AWAY)


ARMS = {"at the origin": six_modules, "elsewhere": spatial, "planar, elsewhere": planar}


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return six_modules()


coordinates = st.floats(-1.5, 1.5)
moves = st.tuples(
    st.sampled_from(["move", "insert", "remove"]),
    st.integers(0, 9),
    st.tuples(coordinates, coordinates, coordinates),
)


def length_of(curve: pp.Curve, pieces: int = 20_000) -> float:
    """Its length, by a fine polygon: never more than it is."""
    knots = np.linspace(0.0, curve.length, pieces + 1)
    return float(np.linalg.norm(np.diff(curve.at(knots), axis=0), axis=1).sum())


@pytest.mark.parametrize("where", ARMS)
@given(st.lists(moves, min_size=1, max_size=8))
@examples(40)
def test_it_begins_at_the_base_and_is_never_shorter_than_the_arm(where: str, listed: list[tuple]) -> None:
    arm = ARMS[where]()
    shape = Shape.of(arm, Keyframe(pp.Curve.line((0, 0, 0), (arm.length, 0, 0))))
    degree = shape.degree
    for kind, index, place in listed:
        before = shape.points.copy()
        try:
            if kind == "move":
                after = shape.moved(arm, index, arm.chain.base + arm.length * np.array(place))
            else:
                after = shape.inserted(arm, index) if kind == "insert" else shape.removed(arm, index)
        except (CurveError, InvalidValue):
            after = shape
        assert np.array_equal(shape.points, before)
        shape = after
        assert shape.degree == degree
        assert len(shape.points) > degree
        assert np.allclose(shape.points[0], arm.chain.base, atol=1e-12)
        if kind == "move" and shape.points is not before:
            assert np.allclose(shape.curve.start, arm.chain.base, atol=1e-9 * arm.length)
        if not np.array_equal(shape.points, before):
            # A curve that is just as long as the arm stays so when a point is inserted.
            assert length_of(shape.curve) >= (1.0 - 1e-7) * arm.length
        assert np.all(np.isfinite(shape.points))


@given(st.integers(1, 3), st.tuples(coordinates, coordinates, coordinates))
def test_a_moved_point_is_where_it_was_put_and_the_others_stay_but_for_the_last(
    arm: pp.Arm, index: int, place: tuple[float, float, float]
) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline()))
    wanted = L * np.array(place)
    rest = np.delete(shape.points, index, axis=0)
    least = SHAPE.least_distance * arm.chain.module_lengths.min()
    assume(np.linalg.norm(rest - wanted, axis=1).min() > 1.001 * least)
    after = shape.moved(arm, index, wanted)
    assert np.array_equal(after.points[index], np.round(wanted, 9))
    assert np.array_equal(np.delete(after.points, index, axis=0)[:-1], rest[:-1])
    ahead = shape.points[-1] - after.points[-2]
    moved = after.points[-1] - shape.points[-1]
    assert np.allclose(np.cross(ahead, moved), 0.0, atol=1e-9)  # straight ahead, if at all
    assert ahead @ moved >= 0.0


def test_moved_points_are_written_without_noise(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline()))
    after = shape.moved(arm, 2, [0.1 + 0.2, -3.34e-34, 0.123456789012345], others=[3])
    assert [repr(x) for x in after.points[2].tolist()] == ["0.3", "0.0", "0.123456789"]
    assert all(len(repr(abs(x))) <= len("0.123456789") for x in after.points[3].tolist())
    assert np.allclose(after.points[3] - shape.points[3], after.points[2] - shape.points[2], atol=2e-9)


@pytest.mark.parametrize("degree", [1, 2, 3])
@given(st.lists(st.integers(0, 9), min_size=1, max_size=4))
@examples(20)
def test_inserted_points_keep_the_curve_and_deleting_them_brings_back_the_old_ones(
    degree: int, places: list[int]
) -> None:
    arm = spatial()
    points = arm.chain.base + arm.length * np.array([(0, 0, 0), (0.5, 0, 0), (0.8, 0.3, 0), (1.4, 0.3, 0.4)])
    polygon = Keyframe(pp.Curve.spline(points, degree), placement="as_is")
    shapes = [Shape.of(arm, polygon) if degree == 3 else Shape(points, degree)]
    for place in places:
        before = shapes[-1]
        after = place % len(before.points)
        try:
            shape = before.inserted(arm, after)
        except CurveError as error:  # many at one place
            assert "too close" in str(error)
            assume(False)
        index = min(after, len(before.points) - 2) + 1
        new = shape.points[index]
        ends = before.points[index - 1 : index + 1]
        assert np.linalg.norm(ends - new, axis=1).sum() == pytest.approx(np.linalg.norm(ends[1] - ends[0]))
        along = np.linspace(0.0, before.curve.length, 201)
        assert np.allclose(shape.curve.at(along), before.curve.at(along), atol=1e-11)
        # A keyframe keeps them, and so does a file.
        kept = shape.keyframe(polygon)
        assert pp.Curve.from_dict(describe_curve(kept.curve)) == kept.curve
        if degree == 3:
            assert np.array_equal(Shape.of(arm, kept).points, shape.points)
        shapes.append(shape)
    shape = shapes.pop()
    while shapes:
        before = shapes.pop()
        after = places[len(shapes)] % len(before.points)
        shape = shape.removed(arm, min(after, len(before.points) - 2) + 1)
        assert np.allclose(shape.curve.at(along), before.curve.at(along), atol=1e-9)
        assert len(shape.points) == len(before.points)
    assert np.allclose(shape.points, points, atol=1e-8)


def test_a_deleted_point_that_shapes_the_curve_leaves_the_others_where_they_are(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline(), placement="as_is")).inserted(arm, 2)
    moved = shape.moved(arm, 3, shape.points[3] + [0, 0, 0.05])
    after = moved.removed(arm, 3)
    assert np.array_equal(after.points, np.delete(moved.points, 3, axis=0))


def test_points_are_inserted_as_long_as_the_arm_can_use_them(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(straight_line(), trim=True))
    with pytest.raises(CurveError, match="cannot be inserted: an arm of 6 modules takes 8 at most"):
        for _ in range(9):
            shape = shape.inserted(arm, len(shape.points) // 2)
    assert len(shape.points) == 8
    through = pp.Curve.spline(shape.curve.resample(12), through=True)  # with more is replaced by fewer
    assert len(Shape.of(arm, Keyframe(through, placement="as_is")).points) < 12


@given(st.integers(1, 3), st.tuples(coordinates, coordinates, coordinates))
def test_points_of_a_planar_arm_stay_in_its_plane(index: int, place: tuple[float, float, float]) -> None:
    arm = planar()
    # about which all of its joints turn
    base = arm.chain.base
    axis = AWAY.rotation[:, 2]
    shape = Shape.of(arm, Keyframe(pp.Curve.line((0, 0, 0), (arm.length, 0, 0))))
    wanted = base + np.array(place)
    try:
        after = shape.moved(arm, index, wanted)
    except CurveError:
        assume(False)
    assert np.allclose((after.points - base) @ axis, 0.0, atol=1e-9)
    if index < len(after.points) - 1:  # the last may have given way
        assert np.allclose(np.cross(wanted - after.points[index], axis), 0.0, atol=1e-9)


def test_several_points_are_moved_by_as_much(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline(), placement="as_is"))
    step = L * np.array([0.1, 0.2, -0.1])
    after = shape.moved(arm, 2, shape.points[2] + step, (3, 2, 0, 4))  # the one at the base stays
    assert np.allclose(after.points - shape.points, [[0, 0, 0], [0, 0, 0], step, step, step])
    with pytest.raises(CurveError, match="point 4: is too close to point 5"):
        shape.moved(arm, 2, shape.points[2] + shape.points[4] - shape.points[3], (3,))
    with pytest.raises(InvalidValue, match="point is 9; allowed: 1 to 5"):
        shape.moved(arm, 2, shape.points[2], (8,))


@pytest.mark.parametrize("refined", [False, True])
def test_copies_are_put_behind_points_and_the_others_stay(refined: bool) -> None:
    arm = spatial()
    points = arm.chain.base + arm.length * np.array([(0, 0, 0), (0.5, 0, 0), (0.8, 0.3, 0), (1.6, 0.3, 0.4)])
    shape = Shape(points).inserted(arm, 1) if refined else Shape(points)
    count = len(shape.points)
    after = shape.duplicated(arm, count - 1, 1, 1)
    assert np.array_equal(np.delete(after.points, [2, count + 1], axis=0), shape.points)
    assert np.allclose(after.points[2], 0.5 * (shape.points[1] + shape.points[2]))
    assert np.allclose(after.points[-1], 1.5 * shape.points[-1] - 0.5 * shape.points[-2])
    assert after.curve.length > shape.curve.length  # there are knots for all of it


def test_where_there_is_no_room_for_copies(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline(), placement="as_is"))
    with pytest.raises(CurveError, match="is too close to"):
        for _ in range(9):
            shape = shape.duplicated(arm, 1)
    long = pp.Curve.spline([(L * k, 0.1 * L * (k % 2), 0) for k in range(SHAPE.most_points)])
    full = Shape.of(arm, Keyframe(long, placement="as_is", trim=True))
    with pytest.raises(CurveError, match="point 4: cannot be added: a curve has 32 control points at most"):
        full.duplicated(arm, 2)


def test_several_points_are_deleted(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline(), placement="as_is"))
    more = shape.duplicated(arm, 1, 3)
    assert np.array_equal(more.removed(arm, 2, 5).points, shape.points)
    finer = shape.inserted(arm, 3).inserted(arm, 1)
    fewer = finer.removed(arm, 5, 2)
    along = np.linspace(0.0, shape.curve.length, 101)
    assert len(fewer.points) == 5
    assert np.allclose(fewer.curve.at(along), shape.curve.at(along))
    with pytest.raises(CurveError, match="point 2: cannot be deleted: a curve of degree 3 needs 4"):
        shape.removed(arm, 1, 2)


@pytest.mark.parametrize("index", [-1, 5])
def test_points_that_there_are_not(arm: pp.Arm, index: int) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline()))
    for act in (lambda: shape.moved(arm, index, (0, 0, 1)), lambda: shape.inserted(arm, index)):
        with pytest.raises(InvalidValue, match="allowed: 1 to 5"):
            act()
    with pytest.raises(InvalidValue, match="allowed: 1 to 5"):
        shape.removed(arm, index)


@pytest.mark.parametrize("place", [(0, np.nan, 0), (0, np.inf, 0), (0, 0), "nowhere"])
def test_places_that_are_none(arm: pp.Arm, place: object) -> None:
    with pytest.raises(InvalidValue, match="position"):
        Shape.of(arm, Keyframe(bent_spline())).moved(arm, 2, place)  # type: ignore[arg-type]


def test_what_is_refused(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline()))
    with pytest.raises(CurveError, match="point 3: is too close to point 2"):
        shape.moved(arm, 2, shape.points[1])
    with pytest.raises(InvalidValue, match=r"point 1 .*at the base"):
        shape.moved(arm, 0, (0.1, 0, 0))
    with pytest.raises(InvalidValue, match=r"point 1 .*at the base"):
        shape.removed(arm, 0)
    least = shape.removed(arm, 2)
    with pytest.raises(CurveError, match="a curve of degree 3 needs 4 control points"):
        least.removed(arm, 2)
    assert np.array_equal(shape.moved(arm, 0, shape.points[0]).points[0], arm.chain.base)


def test_control_points_of_a_spline_are_its_own(arm: pp.Arm) -> None:
    shape = Shape.of(arm, Keyframe(bent_spline(), placement="as_is"))
    assert np.array_equal(shape.points, bent_spline().control_points)
    assert (shape.degree, shape.off) == (3, 0.0)
    polygon = pp.Curve.spline(bent_spline().control_points, degree=2)
    assert Shape.of(arm, Keyframe(polygon, placement="as_is")).degree == 2


@pytest.mark.long
@pytest.mark.parametrize(
    "make",
    [
        straight_line,
        coil,
        lambda: pp.Curve.helix(0.1 * L, 0.1 * L, 6),
        lambda: pp.Curve.points(bent_spline().resample(40)),
    ],
    ids=["line", "coil", "helix", "points"],
)
@pytest.mark.parametrize("where", cases(["elsewhere", "at the origin"], quick=1))
def test_another_kind_of_curve_is_controlled_within_what_it_says(
    where: str, make: Callable[[], pp.Curve]
) -> None:
    arm = ARMS[where]()
    curve = make()
    keyframe = Keyframe(curve, trim=True)
    shape = Shape.of(arm, keyframe)
    laid = place_curve(arm, curve, "align", 0.0)[0]
    places = laid.at(np.linspace(0.0, min(laid.length, arm.length), 1001))
    fine = shape.curve.at(np.linspace(0.0, shape.curve.length, 40_001))
    apart = distances_to_nearest(places, fine).max()
    assert shape.off <= SHAPE.fit_tolerance * arm.chain.module_lengths.mean()
    assert apart <= shape.off + 1e-4 * arm.length
    assert SHAPE.degree < len(shape.points) <= SHAPE.most_points
    assert np.allclose(shape.points[0], arm.chain.base, atol=1e-9)


@pytest.mark.long
def test_a_curve_that_winds_too_much_says_how_far_off_it_is() -> None:
    arm = pp.Arm.from_template("RyRz", modules=40)
    shape = Shape.of(arm, Keyframe(pp.Curve.helix(0.02, 0.005, 40), trim=True))
    assert len(shape.points) == SHAPE.most_points
    assert shape.off > SHAPE.fit_tolerance * arm.chain.module_lengths.mean()


def test_a_curve_that_passes_the_base_begins_there(arm: pp.Arm) -> None:
    curve = pp.Curve.line((-L, 0, 0), (2 * L, 0, 0))
    shape = Shape.of(arm, Keyframe(curve, placement="as_is", trim=True))
    assert np.allclose(shape.points[0], 0.0, atol=1e-9)
    assert np.allclose(shape.points[:, 1:], 0.0, atol=1e-9)


@pytest.mark.statistics
@pytest.mark.parametrize("modules", [4, 8, 20])
@pytest.mark.filterwarnings("ignore:the arm does not follow the curve")
def test_a_curve_that_is_lengthened_is_nearly_always_long_enough_where_it_bends(modules: int) -> None:
    arm = pp.Arm.from_template("RyRz", modules=modules)
    rng = np.random.default_rng(modules)
    tried = short_of = 0
    for _ in range(50):
        points = np.cumsum([(0, 0, 0), (1, 0, 0), *rng.normal((0.5, 0, 0), 0.45, (4, 3))], axis=0)
        spline = pp.Curve.spline(points)
        short = Shape(points * (0.9 * arm.length / spline.length))
        try:
            longer = short.moved(arm, 2, short.points[2])
        except CurveError:  # points too near to each other
            continue
        ahead = longer.points[-1] - longer.points[-2]
        ample = np.vstack([longer.points, longer.points[-1] + arm.length * ahead / np.linalg.norm(ahead)])
        try:
            resolve_targets(arm, pp.Curve.spline(ample), placement="as_is")
        except PostureError:  # it bends too much
            continue
        tried += 1
        short_of += "too short" in judge(arm, longer.keyframe(Keyframe(straight_line())), None).reason
    assert tried > 10
    assert short_of <= 0.05 * tried


def test_a_keyframe_keeps_all_but_its_shape(arm: pp.Arm) -> None:
    before = Keyframe(coil(), time=2.0, hold=0.5, name="coil", roll=0.3, method="smooth", region=(1, 3))
    after = Shape.of(arm, before).keyframe(before)
    assert (after.time, after.hold, after.name, after.method, after.region) == (
        2.0,
        0.5,
        "coil",
        "smooth",
        (1, 3),
    )
    assert (after.placement, after.roll, after.trim) == ("as_is", 0.0, True)
    assert before.curve is coil()
    here = resolve_targets(arm, after.curve, placement="as_is")
    there = resolve_targets(arm, coil(), placement="align", roll=0.3)
    assert np.abs(here.points - there.points).max() < 0.1 * arm.chain.module_lengths.mean()
