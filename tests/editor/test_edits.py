"""Edits of a task: what they do to times, names and order; the task that they are given stays as it was."""

from __future__ import annotations

import copy
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from edited_tasks import L, bent_spline, coil, six_modules, straight_line, task
from hypothesis import given
from hypothesis import strategies as st

import pinposture as pp
from pinposture.arm.weight import Load
from pinposture.editor import edits
from pinposture.editor.edits import Shape, reshaped
from pinposture.errors import InvalidValue, PostureError, TaskError, UnknownName
from pinposture.task import Keyframe, Task
from pinposture.task.keyframe import schedule

DT = 0.02
TASKS = Path(__file__).resolve().parents[2] / "examples" / "tasks"
numbers = st.floats(-1.0, 8.0) | st.sampled_from([0.0, 1.0, 1.05, 1.55, 5.0, float("nan"), float("inf"), 1e9])
places = st.integers(0, 4)
any_edit = st.one_of(
    st.builds(edits.dragged, places, numbers),
    st.builds(edits.retimed, places, numbers),
    st.builds(edits.held, places, numbers),
    st.builds(edits.added, places, st.sampled_from(["", "a name"])),
    st.builds(edits.removed, places),
    st.builds(edits.reordered, places, st.integers(-1, 5)),
    st.builds(lambda k, name: edits.with_keyframe(k, name=name), places, st.text(max_size=5)),
    st.builds(
        lambda k, method: edits.with_keyframe(k, method=method), places, st.sampled_from(["auto", "none"])
    ),
    st.builds(edits.with_controller, st.sampled_from(["geodesic", "lm", "nobody"])),
    st.builds(lambda v: edits.with_limits(velocity=v), st.sampled_from([1.0, 2.0, -1.0])),
    st.builds(lambda r: edits.with_obstacle("ball", pp.Sphere((1, 1, 1), r)), st.sampled_from([0.1, 0.2])),
    st.just(edits.with_obstacle("ball", None)),
    st.builds(edits.taught, places, st.just(np.full(12, 0.1))),
    st.builds(edits.repeated, st.integers(0, 3)),
)


def done(edit: edits.Edit, before: Task) -> Task:
    """The task after an edit; itself if that is refused."""
    try:
        return edit(before)
    except (PostureError, IndexError):
        return before


def values_of(given: Task) -> tuple[object, ...]:
    return tuple(getattr(given, each.name) for each in fields(given) if not each.name.startswith("_"))


def reached(given: Task) -> list[float]:
    """When keyframes are reached, by the schedule that motions are made by, to half a control cycle [s]."""
    return [DT * row for row in schedule(edits.keyframes_of(given), DT).reached]


@given(st.lists(any_edit, max_size=12))
def test_any_edits_leave_a_task_that_can_be_scheduled_and_the_one_before_as_it_was(
    listed: list[edits.Edit],
) -> None:
    now = task()
    for edit in listed:
        kept = values_of(now)
        motion = copy.copy(now.motion)
        after = done(edit, now)
        assert values_of(now) == kept
        assert now.motion == motion
        frames = edits.keyframes_of(after)
        assert len(frames) >= 2
        assert np.allclose(edits.times_of(after), reached(after), rtol=0.0, atol=0.5 * DT + 1e-6)
        assert replace(after, name="made again").motion == after.motion  # it is one that `Task` takes
        now = after


@given(st.integers(1, 3), st.floats(0.0, 10.0))
def test_a_keyframe_is_at_the_time_that_was_asked_and_none_before_it_moves(index: int, time: float) -> None:
    before = task()
    old = edits.times_of(before)
    left = old[index - 1] + edits.keyframes_of(before)[index - 1].hold
    if time < left + edits.TIMES.least_gap - 1e-9:
        with pytest.raises(InvalidValue, match=f"time of keyframe {index + 1}"):
            edits.retimed(index, time)(before)
        return
    after = edits.retimed(index, time)(before)
    new = edits.times_of(after)
    assert new[index] == pytest.approx(time, abs=1e-8)
    assert new[:index] == old[:index]
    own_end = time + edits.keyframes_of(before)[index].hold
    if index < 3 and own_end + edits.TIMES.least_gap <= old[index + 1]:
        assert np.allclose(new[index + 1 :], old[index + 1 :], atol=1e-8)
    elif index < 3:  # they make way, all by as much
        assert np.allclose(np.subtract(new, old)[index:], time - old[index], atol=1e-8)


@given(st.integers(1, 3), st.floats(0.0, 10.0))
def test_a_dragged_keyframe_comes_near_the_time_that_was_asked_and_no_other_moves(
    index: int, time: float
) -> None:
    before = task()
    frames = list(edits.keyframes_of(before))
    old = edits.times_of(before)
    after = edits.dragged(index, time)(before)
    to = edits.place_at(before, index, time)
    new = edits.times_of(after)
    assert new == sorted(new)
    assert np.allclose(np.delete(new, to), np.delete(old, index), atol=1e-8)
    frames.insert(to, frames.pop(index))
    assert [each.curve for each in edits.keyframes_of(after)] == [each.curve for each in frames]
    assert [each.hold for each in edits.keyframes_of(after)] == [each.hold for each in frames]
    ends = [at + frame.hold for at, frame in zip(new, frames, strict=True)]
    assert min(np.subtract(new[1:], ends[:-1])) >= edits.TIMES.least_gap - 1e-8
    free = (
        ends[to - 1] + edits.TIMES.least_gap
        <= time
        <= (new[to + 1] if to < 3 else np.inf) - edits.TIMES.least_gap
    )
    if free and frames[to].hold == 0.0:
        assert new[to] == pytest.approx(time, abs=1e-8)
    assert abs(new[to] - time) <= 0.5 + 2.0 * edits.TIMES.least_gap + 1e-8  # the longest hold is in the way


def test_where_a_keyframe_cannot_be_dragged_to() -> None:
    with pytest.raises(InvalidValue, match=r"time of keyframe 1 is 1\.0; allowed: 0 s, the start"):
        edits.dragged(0, 1.0)(task())
    straight = Keyframe(straight_line())
    bent = Keyframe(bent_spline(), trim=True)
    crowded = task(straight, replace(bent, time=0.08), replace(bent, time=1.0, hold=0.5))
    with pytest.raises(InvalidValue, match=r"time of keyframe 3 .*a place with 0\.6 s between other"):
        edits.dragged(2, 0.05)(crowded)
    with pytest.raises(TaskError, match="keyframe 9"):
        edits.dragged(8, 0.05)(crowded)


@pytest.mark.parametrize(("count", "duration"), [(4, None), (3, None), (3, 1.5), (4, 0.7)])
def test_keyframes_of_all_laps_are_where_the_reference_has_them(count: int, duration: float | None) -> None:
    frames = edits.keyframes_of(task())[:count]  # of four, the last one closes the tour
    single = task(*frames)
    tour = edits.with_keyframe(0, duration=duration)(edits.repeated(3)(single))
    reference = tour.reference()
    passes = edits.passes_of(tour)
    waypoints = reference.waypoints
    assert [each.time for each in passes] == pytest.approx(
        [reference.interval * waypoint.row for waypoint in waypoints]
    )
    names = [frame.name or f"keyframe {index + 1}" for index, frame in enumerate(frames)]
    assert [f"{names[each.keyframe]}, lap {each.lap + 1}" for each in passes] == [
        waypoint.name for waypoint in waypoints
    ]
    assert edits.repeated(1)(tour).motion == frames
    assert [each.time for each in edits.passes_of(single)] == edits.times_of(single)


def test_a_tour_of_refused_times_is_still_listed() -> None:
    early = task(Keyframe(straight_line()), Keyframe(bent_spline(), time=0.0, trim=True), repeat=2)
    assert [each.keyframe for each in edits.passes_of(early)] == [0, 1, 1]


def test_the_first_keyframe_stays_at_the_beginning() -> None:
    with pytest.raises(InvalidValue, match="time of keyframe 1"):
        edits.retimed(0, 1.0)(task())
    assert edits.retimed(0, 0.0)(task()).motion == task().motion


@pytest.mark.parametrize("late", [{"time": 2.0}, {"duration": 2.0}])
def test_a_first_keyframe_that_is_late_can_be_put_right(late: dict[str, float]) -> None:
    frame = Keyframe(straight_line())
    wrong = task(replace(frame, **late), Keyframe(bent_spline(), time=3.0), replace(frame, duration=1.0))
    with pytest.raises(TaskError):
        reached(wrong)
    assert edits.times_of(wrong) == [2.0, 3.0, 4.0]
    assert reached(edits.retimed(0, 0.0)(wrong)) == [0.0, 1.0, 2.0]


def test_a_longer_hold_moves_those_behind() -> None:
    after = edits.held(1, 1.25)(task())
    assert edits.times_of(after) == pytest.approx([0.0, 1.0, 4.25, 5.75])
    assert edits.keyframes_of(after)[1].hold == 1.25
    with pytest.raises(InvalidValue, match="hold"):
        edits.held(1, -0.1)(task())


def test_what_was_given_by_a_duration_still_is() -> None:
    after = edits.keyframes_of(edits.retimed(2, 4.0)(task()))
    assert (after[2].time, after[2].duration) == (None, 2.5)
    assert (after[3].time, after[3].duration) == (5.0, None)


def test_those_that_do_not_move_are_the_same_objects() -> None:
    before = task()
    after = edits.retimed(2, 4.0)(before)
    assert [a is b for a, b in zip(after.motion, before.motion, strict=True)] == [True, True, False, True]


def test_an_added_keyframe_has_the_shape_of_the_one_before_it_and_no_more() -> None:
    tip = pp.EndEffector(position=(0.2, 0, 0))
    before = edits.with_keyframe(1, tip=tip, region=(0, 3), method="closest")(task())
    after = edits.added(1, "new")(before)
    frames = edits.keyframes_of(after)
    assert edits.times_of(after) == pytest.approx([0.0, 1.0, 2.5, 4.5, 6.0])
    assert frames[2].curve is frames[1].curve
    assert (frames[2].name, frames[2].hold, frames[2].tip) == ("new", 0.0, None)
    assert (frames[2].region, frames[2].method, frames[2].trim) == ((0, 3), "closest", True)
    assert frames[1].tip is tip


@pytest.mark.parametrize(
    ("index", "times"),
    [(0, [0.0, 2.5, 4.0]), (1, [0.0, 3.5, 5.0]), (2, [0.0, 1.0, 5.0]), (3, [0.0, 1.0, 3.5])],
)
def test_the_others_stay_when_one_is_deleted_but_the_first_is_at_zero(index: int, times: list[float]) -> None:
    after = edits.removed(index)(task())
    assert edits.times_of(after) == pytest.approx(times)
    assert reached(after) == pytest.approx(times)


def test_two_keyframes_stay() -> None:
    two = edits.removed(0)(edits.removed(0)(task()))
    with pytest.raises(TaskError, match="a motion needs two keyframes"):
        edits.removed(1)(two)


def test_a_new_order_keeps_holds_with_their_keyframes_and_the_time_in_between() -> None:
    after = edits.reordered(1, 2)(task())
    frames = edits.keyframes_of(after)
    assert [frame.curve for frame in frames] == [straight_line(), coil(), bent_spline(), straight_line()]
    assert [frame.hold for frame in frames] == [0.0, 0.0, 0.5, 0.0]
    assert edits.times_of(after) == pytest.approx([0.0, 1.0, 3.0, 5.0])


@given(st.integers(0, 3), st.integers(0, 3))
def test_there_and_back_gives_the_order_and_the_times_from_before(index: int, to: int) -> None:
    after = edits.reordered(to, index)(edits.reordered(index, to)(task()))
    assert edits.times_of(after) == pytest.approx(edits.times_of(task()))
    assert [each.curve for each in edits.keyframes_of(after)] == [each.curve for each in task().motion]


@pytest.mark.parametrize(("index", "to"), [(0, -1), (3, 4)])
def test_no_order_beyond_the_ends(index: int, to: int) -> None:
    with pytest.raises(TaskError, match="before the first or after the last"):
        edits.reordered(index, to)(task())


def test_a_motion_that_would_last_too_long_is_refused() -> None:
    with pytest.raises(InvalidValue, match="end of the motion"):
        edits.retimed(3, 1e9)(task())


def test_a_slow_cycle_keeps_keyframes_apart_in_cycles() -> None:
    slow = task(limits=pp.Limits(dt=0.25))
    with pytest.raises(InvalidValue, match="allowed: 2 s or later"):
        edits.retimed(2, 1.9)(slow)
    schedule(edits.keyframes_of(edits.retimed(2, 2.0)(slow)), 0.25)


def test_a_taught_keyframe_has_no_curve_and_keeps_all_else() -> None:
    before = edits.with_keyframe(1, placement="as_is", method="closest", region=(0, 3))(task())
    q = np.linspace(-0.5, 0.5, 12)
    frames = edits.keyframes_of(edits.taught(1, q)(before))
    assert frames[1].joints == pytest.approx(q, abs=1e-6)
    assert (frames[1].curve, frames[1].placement, frames[1].method, frames[1].trim) == (
        None,
        None,
        "auto",
        False,
    )
    assert (frames[1].time, frames[1].hold, frames[1].region) == (1.0, 0.5, (0, 3))
    assert all(frames[k] is before.motion[k] for k in (0, 2, 3))  # type: ignore[index]
    with pytest.raises(TaskError, match="keyframe 2: joints is 9 rad for joint 1 'm01_j1_y', whose limits"):
        edits.taught(1, np.full(12, 9.0))(before)


def test_the_time_to_come_back_to_the_first_keyframe_stays() -> None:
    first, *others = task().motion
    repeated = task(replace(first, duration=0.7), *others, repeat=2)
    assert edits.times_of(repeated) == edits.times_of(task())
    later = edits.retimed(1, 1.25)(repeated)
    assert (later.motion[0].duration, later.motion[1].time, later.repeat) == (0.7, 1.25, 2)
    assert edits.held(0, 0.5)(later).motion[0].duration == 0.7


def test_a_task_that_follows_a_leader_is_refused_in_words() -> None:
    leader = Task.load(TASKS / "pipe.toml")
    with pytest.raises(TaskError, match="only tasks of keyframes can be edited"):
        edits.keyframes_of(leader)


def test_another_shape_keeps_all_else() -> None:
    before = edits.with_keyframe(2, region=(1, 4), hold=0.25, method="smooth")(task())
    shape = Shape.of(six_modules(), before.motion[2])  # type: ignore[index]
    after = reshaped(2, lambda arm, own: own.inserted(arm, 1), shape)(before).motion[2]  # type: ignore[index]
    assert (after.name, after.duration, after.hold) == ("coil", 2.0, 0.25)
    assert (after.region, after.method, after.placement, after.trim) == ((1, 4), "smooth", "as_is", True)


def test_an_inserted_point_is_saved(tmp_path: Path) -> None:
    shape = Shape.of(six_modules(), task().motion[1]).inserted(six_modules(), 2)  # type: ignore[index]
    edited = reshaped(1, lambda *_: shape, shape)(task())
    loaded = Task.load(edited.save(tmp_path / "task.toml"))
    found = Shape.of(loaded.arm, loaded.motion[1])  # type: ignore[index]
    assert np.array_equal(found.points, shape.points)
    assert np.array_equal(found.knots, shape.knots)


def test_controllers_and_limits_are_checked() -> None:
    assert edits.with_controller("lm")(task()).controller == pp.control.controller_named("lm")
    with pytest.raises(UnknownName):
        edits.with_controller("nobody")(task())
    with pytest.raises(InvalidValue):
        edits.with_limits(velocity=np.ones(3))(task())  # the arm has 12 joints
    with pytest.raises(InvalidValue):
        edits.with_limits(dt=None, velocity=None)(task())
    assert edits.with_limits(acceleration=9.0)(task()).limits.acceleration == 9.0


def test_obstacles_are_put_renamed_replaced_and_taken_away() -> None:
    one = pp.Sphere((1, 1, 1), 0.1)
    two = pp.Sphere((2, 1, 1), 0.1)
    both = edits.with_obstacle("b", two)(edits.with_obstacle("a", one)(task()))
    assert dict(both.scene.obstacles) == {"a": one, "b": two}
    renamed = edits.with_obstacle("c", two, instead="a")(both)
    assert list(renamed.scene.obstacles.items()) == [("c", two), ("b", two)]
    with pytest.raises(InvalidValue, match="no other obstacle has"):
        edits.with_obstacle("b", one, instead="a")(both)
    assert list(edits.with_obstacle("a", None)(both).scene.obstacles) == ["b"]
    touchable = edits.with_scene(touchable=("a", "b"))(both)
    assert edits.with_obstacle("c", two, instead="a")(touchable).scene.touchable == ("b", "c")
    assert edits.with_obstacle("a", None)(touchable).scene.touchable == ("b",)
    assert edits.with_scene(margin=0.02)(both).scene.margin == 0.02


def test_no_obstacle_may_stand_around_the_base() -> None:
    with pytest.raises(TaskError, match="it stands where the base of the arm is"):
        edits.with_obstacle("ball", pp.Sphere(six_modules().chain.base, 0.1 * L))(task())
    edits.with_obstacle("ball", pp.Sphere(six_modules().chain.base + (0, 0, 0.2 * L), 0.1 * L))(task())


def test_the_load_at_the_tip_is_changed_and_all_else_that_the_arm_carries_stays() -> None:
    arm = six_modules().with_payload(0.2, frame="m01_l2").with_payload(0.1, com=(0.01, 0.0, 0.0))
    first = edits.with_tip_load(0.5)(task(arm=arm))
    assert first.arm.weight.payloads == (*arm.weight.payloads, Load(0.5))
    second = edits.with_tip_load(0.25)(first)
    assert second.arm.weight.payloads == (*arm.weight.payloads, Load(0.25))
    assert edits.with_tip_load(0.0)(second).arm.weight == arm.weight
    with pytest.raises(InvalidValue):
        edits.with_tip_load(-1.0)(first)


def test_arms_that_differ_in_weight_alone_are_known() -> None:
    arm = six_modules()
    heavy = edits.with_weight(effort=2.0, stiffness=300.0)(task(arm=arm)).arm
    assert np.all(heavy.effort == 2.0) and np.all(np.diag(heavy.stiffness) == 300.0)
    assert edits.differ_in_weight_alone(arm, heavy) and edits.differ_in_weight_alone(heavy, arm)
    others = (pp.Arm.from_template("RyRz", 5), arm.with_characteristic_length(0.1))
    assert not any(edits.differ_in_weight_alone(arm, other) for other in others)
