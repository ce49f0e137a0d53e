"""Tours: taught configurations among curves, repetitions, speeds of keyframes, and why a motion is slow."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from task.keyed_arms import positions, snake, straight
from task.performed import arm_named, check_motion
from task.same_tasks import assert_same

import pinposture as pp
from pinposture.errors import InvalidValue, MotionError, PostureWarning, TaskError
from pinposture.task import Keyframe, keyframe_reference, perform

LIMITS = pp.Limits(step=None, dt=0.02, velocity=1.5, acceleration=6.0)
CONTINUITIES = ("velocity", "acceleration")


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=6)


def line(arm: pp.Arm) -> pp.Curve:
    return straight(arm.length)


def bow(arm: pp.Arm) -> pp.Curve:
    """An arc that leaves the base along the arm."""
    return pp.Curve.helix(0.5 * arm.length, 0, 1, axis=(0, 0, 1))


def taught(arm: pp.Arm, seed: int, size: float = 0.5) -> np.ndarray:
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, arm.nv)


def mixed(arm: pp.Arm) -> list[Keyframe]:
    """Two curves, two taught configurations, two curves."""
    return [
        Keyframe(line(arm)),
        Keyframe(bow(arm), duration=1.0, trim=True, placement="align"),
        Keyframe(joints=taught(arm, 1), duration=1.5, name="first"),
        Keyframe(joints=taught(arm, 2), duration=1.0, name="second", hold=0.4),
        Keyframe(bow(arm), duration=1.5, trim=True, placement="align"),
        Keyframe(line(arm), duration=1.0),
    ]


# Taught configurations.


@pytest.mark.parametrize("continuity", CONTINUITIES)
def test_taught_configurations_are_passed_exactly_and_curves_are_taken(arm: pp.Arm, continuity: str) -> None:
    keyframes = mixed(arm)
    reference = keyframe_reference(arm, keyframes, 0.02, continuity)
    times = [reference.times[waypoint.row] for waypoint in reference.waypoints]
    assert np.allclose(times, [0.0, 1.0, 2.5, 3.5, 5.4, 6.4])
    for waypoint, keyframe in zip(reference.waypoints, keyframes, strict=True):
        q = positions(reference)[waypoint.row]
        if keyframe.joints is not None:
            assert np.abs(q - keyframe.joints).max() < 1e-12
            assert waypoint.target.curve is None
        else:
            assert waypoint.target.residual.max() < 1e-8
        assert np.allclose(waypoint.target.points, arm.at(arm.configuration(q)).points, atol=1e-12)
    held = slice(reference.waypoints[3].row, reference.waypoints[3].row + round(0.4 / reference.interval) + 1)
    assert np.ptp(positions(reference)[held], axis=0).max() == 0.0


@pytest.mark.parametrize("continuity", CONTINUITIES)
def test_a_mixed_tour_is_continuous_and_rests_where_its_kind_changes(arm: pp.Arm, continuity: str) -> None:
    order = 2 if continuity == "velocity" else 3

    def measured(interval: float) -> tuple[float, np.ndarray]:
        reference = keyframe_reference(arm, mixed(arm), interval, continuity)
        rows = [waypoint.row for waypoint in reference.waypoints]
        q = positions(reference)
        step = reference.interval
        speeds = np.abs(q[np.array(rows[1:-1]) + 1] - q[np.array(rows[1:-1]) - 1]).max(axis=1) / (2.0 * step)
        return float(np.abs(np.diff(q, order, axis=0)).max()) / step ** (order - 1), speeds

    (coarse, _), (fine, speeds) = measured(0.01), measured(0.0025)
    assert fine < 0.4 * coarse
    assert np.all(speeds[[0, 2, 3]] < 0.02)  # the kind changes, a hold, the kind changes back
    assert speeds[1] > 0.1  # from one taught configuration to the next the arm does not stop


@pytest.mark.parametrize(
    ("continuity", "law"),
    [
        ("velocity", lambda x: 3 * x**2 - 2 * x**3),
        ("acceleration", lambda x: x**3 * (10 - 15 * x + 6 * x**2)),
    ],
)
def test_between_two_configurations_joints_move_in_proportion(
    arm: pp.Arm, continuity: str, law: object
) -> None:
    ends = taught(arm, 3), taught(arm, 4)
    tour = [Keyframe(joints=ends[0]), Keyframe(joints=ends[1], time=1.0)]
    reference = keyframe_reference(arm, tour, 0.01, continuity)
    share = law(np.linspace(0.0, 1.0, reference.rows))[:, None]  # type: ignore[operator]
    assert np.allclose(positions(reference), (1 - share) * ends[0] + share * ends[1], atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("continuity", CONTINUITIES)
@pytest.mark.parametrize("jerk", (None, 60.0))
def test_joints_stay_between_their_keyframes_whatever_the_times(continuity: str, jerk: float | None) -> None:
    arm = arm_named("spatial")
    limits = pp.Limits(step=None, dt=0.02, velocity=2.0, acceleration=10.0, jerk=jerk)
    values = np.array([0.0, 0.2, 0.25])
    totals = []
    for seconds in (1.0, 0.3, 0.1, 0.02):
        keyframes = [
            Keyframe(joints=np.full(arm.nv, value), duration=duration)
            for value, duration in zip(values, (None, 3.0, seconds), strict=True)
        ]
        motion = pp.move_through(arm, keyframes, limits=limits, continuity=continuity)
        assert motion.run.status == "converged"
        check_motion(motion, limits)
        assert values.min() - 1e-4 <= motion.q.min() <= motion.q.max() <= values.max() + 1e-4
        totals.append(motion.time[-1])
    assert all(after <= before + 2 * limits.dt for before, after in pairwise(totals))


@pytest.mark.long
@pytest.mark.parametrize("continuity", CONTINUITIES)
def test_a_short_time_beside_a_long_one_neither_bends_nor_delays_the_arm(continuity: str) -> None:
    arm = pp.Arm.from_template("RyRz", modules=10)
    limits = replace(LIMITS, velocity=2.0, acceleration=10.0)
    coil = pp.Curve.helix(0.12 * arm.length, 0.1 * arm.length, 3)
    totals = []
    for seconds in (1.0, 0.2, 0.05):
        keyframes = [
            Keyframe(line(arm), trim=True),
            Keyframe(bow(arm), duration=seconds, trim=True, placement="align"),
            Keyframe(coil, duration=3.0, trim=True, placement="align"),
            Keyframe(line(arm), duration=seconds, trim=True),
        ]
        motion = pp.move_through(arm, keyframes, limits=limits, continuity=continuity)
        keyed = np.array([motion.q[place.row] for place in motion.waypoints])
        assert motion.run.status == "converged"
        assert np.abs(motion.q).max() <= 1.1 * np.abs(keyed).max()
        totals.append(motion.time[-1])
    assert all(after <= 1.03 * before for before, after in pairwise(totals))


@pytest.mark.long
@given(st.integers(0, 10_000), st.sampled_from(CONTINUITIES), st.sampled_from((None, 100.0)))
@examples(5)
def test_asking_for_less_time_never_takes_longer(seed: int, continuity: str, jerk: float | None) -> None:
    """By more than a cycle; one time is shortened, or all are, down to a cycle."""
    arm = pp.Arm.from_template("RyRz", modules=3)
    rng = np.random.default_rng(seed)
    totals = []
    limits = replace(LIMITS, velocity=2.0, acceleration=10.0, jerk=jerk)
    postures = rng.uniform(-1.0, 1.0, (5, arm.nv))
    durations = 10.0 ** rng.uniform(-1.3, 1.3, 4)
    shortened = slice(None) if seed % 3 == 0 else rng.integers(4)
    for share in (4.0, 1.0, 0.25, 0.05, 0.01):
        asked = durations.copy()
        asked[shortened] *= share
        keyframes = [Keyframe(joints=postures[0])] + [
            Keyframe(joints=posture, duration=max(seconds, limits.dt))
            for posture, seconds in zip(postures[1:], asked, strict=True)
        ]
        motion = pp.move_through(arm, keyframes, limits=limits, continuity=continuity)
        assert motion.run.status == "converged"
        assert np.all(motion.q >= postures.min(axis=0) - 1e-3)
        assert np.all(motion.q <= postures.max(axis=0) + 1e-3)
        totals.append(motion.time[-1])
    assert all(later <= earlier + 1.001 * limits.dt for earlier, later in combinations(totals, 2))


def test_continuous_joints_take_the_short_way_round() -> None:
    arm = arm_named("endless")
    endless = arm.kinematics.endless
    before = np.where(endless, 3.0, 0.2)
    after = np.where(endless, -3.0, -0.2)
    tour = [Keyframe(joints=before), Keyframe(joints=after, time=2.0)]
    reference = keyframe_reference(arm, tour, 0.02)
    turned = reference.offsets[-1]
    assert np.allclose(turned[endless], 2 * np.pi - 6.0) and np.allclose(turned[~endless], -0.4)
    found = pin.difference(arm.model, reference.configuration(-1), arm.configuration(after))
    assert np.abs(found).max() < 1e-12


@pytest.mark.parametrize("name", ("spatial", "planar", "sliding", "endless"))
def test_the_arm_performs_taught_tours_within_its_limits(name: str) -> None:
    arm = arm_named(name)
    rng = np.random.default_rng(5)
    low = np.maximum(arm.limits.lower, -0.4)
    high = np.minimum(arm.limits.upper, 0.4)
    stops = [rng.uniform(low, high) for _ in range(3)]
    tour = [Keyframe(joints=q, duration=1.0 if k else None) for k, q in enumerate(stops)]
    motion = pp.move_through(arm, tour, limits=LIMITS, continuity="acceleration")
    check_motion(motion, LIMITS)
    assert motion.converged and not motion.faults
    ends = motion.q[[0, -1]]
    for q, joints in zip(ends, (stops[0], stops[-1]), strict=True):
        assert np.abs(pin.difference(arm.model, q, arm.configuration(joints))).max() < 1e-9


def test_a_taught_posture_gives_way_to_a_tip_where_it_is_asked(arm: pp.Arm) -> None:
    q = arm.configuration(taught(arm, 1))
    place = arm.at(q).points[-1] + (0.0, 0.01, 0.01)
    tip = pp.EndEffector(position=place, priority=True)
    tour = [Keyframe(line(arm)), Keyframe(joints=arm.positions(q), time=1.5, tip=tip)]
    reference = keyframe_reference(arm, tour, 0.02)
    reached = arm.at(reference.configuration(-1)).points
    assert np.allclose(reached[-1], place, atol=1e-6)
    assert np.linalg.norm(reached - arm.at(q).points, axis=1).mean() < 0.02


def test_taught_configurations_that_are_none_are_refused(arm: pp.Arm) -> None:
    with pytest.raises(
        InvalidValue, match=r"curve is not given; allowed: a Curve; or None, with the joints to take"
    ):
        Keyframe()
    for name, value in (("placement", "align"), ("roll", 1.0), ("method", "smooth"), ("trim", True)):
        with pytest.raises(InvalidValue, match=f"{name} is .*, as there is no curve"):
            Keyframe(joints=np.zeros(arm.nv), **{name: value})
    with pytest.raises(InvalidValue, match="joints"):
        Keyframe(joints=np.full(arm.nv, np.nan))
    for joints, words in (
        (np.zeros(3), r"has 3 values; needed: 12, one for each joint \[rad\]"),
        (
            np.full(arm.nv, 9.0),
            r"is 9 rad for joint 1 'm01_j1_y', .*; is it in degrees\? np.deg2rad",
        ),
        (np.full(arm.nv, 4.0), r"is 4 rad for joint 1 'm01_j1_y', whose limits are -3.142 and 3.142 rad$"),
    ):
        tour = [Keyframe(line(arm)), Keyframe(joints=joints, time=1.0, name="odd")]
        with pytest.raises(TaskError, match=f"keyframe 2 'odd': joints {words}"):
            keyframe_reference(arm, tour, 0.02)
        with pytest.raises(TaskError, match=f"keyframe 2 'odd': joints {words}"):
            pp.Task(arm, tour, LIMITS)


@pytest.mark.long
def test_obstacles_count_for_taught_configurations(arm: pp.Arm) -> None:
    q = taught(arm, 1)
    tip = arm.at(arm.configuration(q)).points[-1]
    scene = pp.Scene({"ball": pp.Sphere(tip, 0.03)})
    there = [Keyframe(line(arm)), Keyframe(joints=q, time=1.0, name="inside")]
    task = pp.Task(arm, there, LIMITS, scene=scene)
    assert task.feasibility(task.reference())[1].clearance < -0.01
    with pytest.warns(PostureWarning, match="keyframe 2 'inside': .* ball"):
        motion = task.perform()
    assert motion.run.clearance.min() > -1e-9 and not motion.converged
    begins_inside = [Keyframe(joints=q, name="inside"), Keyframe(line(arm), time=1.0)]
    with pytest.raises(TaskError, match=r"keyframe 1 'inside': .*ball"):
        pp.Task(arm, begins_inside, LIMITS, scene=scene).perform()


# Repetitions.


def test_an_open_tour_goes_back_between_its_repetitions(arm: pp.Arm) -> None:
    q = taught(arm, 1)
    tour = [
        Keyframe(line(arm), duration=0.8, name="home"),
        Keyframe(bow(arm), duration=1.0, trim=True, placement="align"),
        Keyframe(joints=q, duration=1.2, hold=0.4, name="there"),
    ]
    reference = keyframe_reference(arm, tour, 0.02, repeat=3)
    lap = 1.0 + 1.2 + 0.4 + 0.8
    assert reference.duration == pytest.approx(3 * lap - 0.8)
    assert [waypoint.name for waypoint in reference.waypoints] == [
        f"{name}, lap {number}" for number in (1, 2, 3) for name in ("home", "keyframe 2", "there")
    ]
    times = np.array([reference.times[waypoint.row] for waypoint in reference.waypoints]).reshape(3, 3)
    assert np.allclose(times, np.array([0.0, 1.0, 2.2]) + lap * np.arange(3)[:, None])
    rows = round(lap / reference.interval)
    found = positions(reference)
    assert np.abs(found[rows : 2 * rows] - found[:rows]).max() < 1e-12
    assert np.abs(np.diff(found, axis=0)).max() < 0.06
    once = positions(keyframe_reference(arm, [Keyframe(line(arm)), *tour[1:]], 0.02))
    assert np.abs(found[: len(once)] - once).max() < 1e-9  # as the tour alone
    limits = pp.Limits(step=None, dt=0.02, velocity=1.5, acceleration=6.0)
    motion = perform(reference, "geodesic", limits)
    check_motion(motion, limits)
    assert motion.converged and len(motion.waypoints) == 9
    assert np.abs(motion.q[-1] - q).max() < 1e-9


def test_the_way_back_takes_the_longest_time_between_keyframes_by_default(arm: pp.Arm) -> None:
    tour = [
        Keyframe(line(arm)),
        Keyframe(bow(arm), duration=1.5, trim=True, placement="align"),
        Keyframe(joints=taught(arm, 1), time=2.0),
    ]
    assert keyframe_reference(arm, tour, 0.02, repeat=2).duration == pytest.approx(2.0 + 1.5 + 2.0)


def test_a_closed_tour_goes_on_at_once(arm: pp.Arm) -> None:
    tour = [
        Keyframe(line(arm), name="a"),
        Keyframe(joints=taught(arm, 1), time=1.0),
        Keyframe(line(arm), time=2.0),
    ]
    reference = keyframe_reference(arm, tour, 0.02, repeat=2)
    assert reference.duration == pytest.approx(4.0)
    assert [waypoint.name for waypoint in reference.waypoints] == [
        "a, lap 1", "keyframe 2, lap 1", "keyframe 3, lap 1", "keyframe 2, lap 2", "keyframe 3, lap 2",
    ]  # fmt: skip
    lap = round(2.0 / reference.interval)
    assert np.abs(positions(reference)[[lap, -1]] - positions(reference)[0]).max() < 1e-12


def test_turns_of_continuous_joints_add_up() -> None:
    arm = arm_named("endless")
    endless = arm.kinematics.endless
    stops = [np.where(endless, angle, 0.1) for angle in (0.0, 2.0, 4.0)]  # and the short way on to 2 pi
    tour = [Keyframe(joints=q, duration=1.0) for q in stops]
    reference = keyframe_reference(arm, tour, 0.02, repeat=3)
    assert np.allclose(reference.offsets[-1], np.where(endless, 2 * 2 * np.pi + 4.0, 0.0))
    assert np.abs(np.diff(reference.offsets, axis=0)).max() < 0.1


@pytest.mark.long
def test_arms_placed_by_least_squares_come_back_to_where_they_began() -> None:
    arm = snake(pp.JointSpec("x"), pp.JointSpec("y"), pp.JointSpec("z"), modules=5)
    tour = [Keyframe(line(arm)), Keyframe(bow(arm), duration=1.5, trim=True, placement="align")]
    found = positions(keyframe_reference(arm, tour, 0.02, repeat=2))
    assert np.abs(np.diff(found, axis=0)).max() < 0.1
    rows = (len(found) - 1) // 3
    assert np.abs(found[2 * rows :] - found[: rows + 1]).max() < 1e-9


def test_repetitions_that_make_no_sense_are_refused(arm: pp.Arm) -> None:
    tour = [Keyframe(line(arm), duration=0.001), Keyframe(bow(arm), duration=1.0, trim=True)]
    with pytest.raises(TaskError, match=r"keyframe 1: its duration is 0.001 s; the return to it takes"):
        keyframe_reference(arm, tour, 0.02, repeat=2)
    with pytest.raises(TaskError, match=r"keyframe 1: its duration is 0.001 s, .* or set repeat to 2"):
        keyframe_reference(arm, tour, 0.02)
    for repeat in (0, 1.5, True, 10**6):
        with pytest.raises(InvalidValue, match="repeat"):
            keyframe_reference(arm, [Keyframe(line(arm)), *tour[1:]], 0.02, repeat=repeat)  # type: ignore[arg-type]


# Speeds of keyframes.


def largest_shares(motion: pp.Trajectory, velocity: float) -> list[float]:
    """Largest joint speed on the way to each place but the first, relative to the limit."""
    rows = [place.row for place in motion.waypoints]
    moved = np.array([pin.difference(motion.arm.model, a, b) for a, b in pairwise(motion.q)])
    return [float(np.abs(moved[a:b]).max()) / motion.dt / velocity for a, b in pairwise(rows)]


@pytest.mark.parametrize("speed", (0.3, 0.2, 0.05))
@pytest.mark.parametrize("continuity", CONTINUITIES)
def test_a_keyframe_limits_the_speed_of_the_motion_to_it(arm: pp.Arm, speed: float, continuity: str) -> None:
    tour = [
        Keyframe(line(arm)),
        Keyframe(bow(arm), duration=0.6, trim=True, placement="align"),
        Keyframe(line(arm), duration=0.6, speed=speed, name="careful"),
        Keyframe(joints=taught(arm, 6), duration=0.6),
    ]
    reference = keyframe_reference(arm, tour, 0.02, continuity)
    limits = pp.Limits(step=None, dt=0.02, velocity=2.0, acceleration=40.0)
    motion = perform(reference, "geodesic", limits)
    check_motion(motion, limits)
    assert motion.converged and motion.planned == pytest.approx(1.8)
    before, slow, after = largest_shares(motion, 2.0)
    assert 0.9 * speed < slow <= speed
    assert min(before, after) > 1.2 * speed
    assert [place.planned for place in motion.waypoints] == pytest.approx([0.0, 0.6, 1.2, 1.8])
    if speed < 0.3:
        assert f"careful allows {100 * speed:g} % of the velocity limits" in motion.slowdown
    for place, waypoint in zip(motion.waypoints, reference.waypoints, strict=True):
        nearest = np.abs(motion.q - reference.configuration(waypoint.row)).max(axis=1).min()
        assert nearest <= 0.5 * 2.0 * 0.02 + 1e-9  # half a cycle at full speed
        assert place.speed == waypoint.speed


@pytest.mark.parametrize("speeds", [(0.5, 1.0), (1.0, 0.5), (0.7, 0.2)])
@pytest.mark.parametrize("jerk", [2.0, 5.0, 20.0])
def test_speeds_hold_up_to_their_keyframes_under_jerk_limits(
    arm: pp.Arm, speeds: tuple[float, float], jerk: float
) -> None:
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=6.0, jerk=jerk)
    first, middle, last = (np.full(arm.nv, bend) for bend in (-0.9, 0.0, 0.9))
    tour = [
        Keyframe(joints=q, duration=1.2, speed=each) for q, each in zip((middle, last), speeds, strict=True)
    ]
    motion = pp.move_through(arm, [Keyframe(joints=first), *tour], limits=limits)
    check_motion(motion, limits)
    assert motion.converged
    assert np.all(np.array(largest_shares(motion, 1.0)) <= speeds)


def test_a_motion_that_is_slow_enough_is_not_changed_by_a_speed(arm: pp.Arm) -> None:
    tour = [Keyframe(line(arm)), Keyframe(bow(arm), duration=4.0, trim=True)]
    slow = [tour[0], Keyframe(bow(arm), duration=4.0, trim=True, speed=0.9)]
    motions = [pp.move_through(arm, each, limits=LIMITS) for each in (tour, slow)]
    assert np.abs(motions[0].q - motions[1].q).max() < 1e-12
    assert motions[1].slowdown == ""


@pytest.mark.parametrize("speed", (0, -1, 1.1, np.nan, True, "1"))
def test_speeds_that_are_no_share_are_refused(arm: pp.Arm, speed: object) -> None:
    with pytest.raises(InvalidValue, match=r"speed is .*; allowed: a share of the velocity limits"):
        Keyframe(line(arm), speed=speed)  # type: ignore[arg-type]


def test_a_speed_that_would_never_end_is_refused(arm: pp.Arm) -> None:
    tour = [Keyframe(line(arm)), Keyframe(bow(arm), duration=1.0, trim=True, speed=1e-9)]
    with pytest.raises(InvalidValue, match="cycles of the motion"):
        pp.move_through(arm, tour, limits=LIMITS)


def test_speeds_are_kept_with_a_motion(arm: pp.Arm, tmp_path: Path) -> None:
    tour = [Keyframe(line(arm)), Keyframe(joints=taught(arm, 1), duration=0.5, speed=0.3)]
    motion = pp.move_through(arm, tour, limits=LIMITS, repeat=2)
    again = pp.load(pp.save(motion, tmp_path / "motion.npz"))
    assert again.waypoints == motion.waypoints
    assert [place.speed for place in again.waypoints] == [1.0, 0.3, 1.0, 0.3]
    assert again.slowdown == motion.slowdown != ""


# Why a motion is slow.


@pytest.mark.parametrize("kind", ("velocity", "acceleration"))
@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_the_joint_that_holds_a_motion_back_is_named(arm: pp.Arm, kind: str) -> None:
    weak = 5
    limit = np.full(arm.nv, 4.0 if kind == "velocity" else 60.0)
    limit[weak] /= 40.0
    other = {"acceleration": 400.0} if kind == "velocity" else {"velocity": 4.0}
    limits = pp.Limits(step=None, dt=0.02, **{kind: limit}, **other)
    tour = [Keyframe(joints=np.full(arm.nv, -0.3)), Keyframe(joints=np.full(arm.nv, 0.3), time=1.0)]
    motion = pp.move_through(arm, tour, limits=limits)
    assert motion.converged and motion.time_scale > 1.1
    assert f": joint {arm.joint_names[weak]} is at its {kind} limit for " in motion.slowdown
    # How long that is, from the configurations alone.
    moved = np.array([pin.difference(arm.model, a, b) for a, b in pairwise(motion.q)])
    seconds = float(motion.slowdown.split(" for ")[-1].split()[0])
    if kind == "velocity":
        at_limit = np.count_nonzero(np.abs(moved[:, weak]) > 0.8 * limit[weak] * 0.02) * 0.02
        assert seconds == pytest.approx(at_limit, rel=0.1)
    assert motion.slowdown in repr(motion)


def test_a_jerk_limit_that_holds_a_motion_back_is_named(arm: pp.Arm) -> None:
    limits = pp.Limits(step=None, dt=0.02, velocity=2.0, acceleration=40.0, jerk=20.0)
    tour = [Keyframe(joints=np.full(arm.nv, -0.3)), Keyframe(joints=np.full(arm.nv, 0.3), time=0.3)]
    motion = pp.move_through(arm, tour, limits=limits)
    # Neither of the other limits is nearly reached.
    assert np.abs(motion.velocities).max() < 0.8 * 2.0 and np.abs(motion.accelerations).max() < 0.7 * 40.0
    assert motion.converged and motion.time_scale > 1.1
    assert " is at its jerk limit for " in motion.slowdown
    names = set(map(motion._cause, motion._slow_cycles))
    assert all(name.endswith("jerk limit") for name in names)


def test_a_controller_that_lags_behind_is_told(arm: pp.Arm) -> None:
    tour = [Keyframe(line(arm)), Keyframe(bow(arm), duration=0.3, trim=True)]
    motion = pp.move_through(arm, tour, "lm", pp.Limits(step=0.02, dt=0.02))
    assert motion.time_scale > 1.1
    assert "joint " in motion.slowdown or "the arm is behind its targets" in motion.slowdown


@pytest.mark.long
def test_an_obstacle_that_keeps_the_arm_off_its_path_is_told(arm: pp.Arm) -> None:
    up, down = np.zeros((2, arm.nv))
    up[1] = 0.8
    down[1] = -0.8
    post = pp.Sphere(arm.at(arm.straight()).points[-1], 0.03)
    tour = [Keyframe(joints=up), Keyframe(joints=down, time=2.0)]
    motion = pp.move_through(arm, tour, limits=LIMITS, scene=pp.Scene({"post": post}))
    assert motion.converged and not motion.faults and motion.deviations
    assert ": an obstacle keeps the arm off the planned path for " in motion.slowdown
    assert motion.slowdown.endswith("and post come closest to each other")


def test_a_motion_on_time_tells_of_no_slowdown(arm: pp.Arm) -> None:
    motion = pp.move_through(
        arm, [Keyframe(line(arm)), Keyframe(bow(arm), time=4.0, trim=True)], limits=LIMITS
    )
    assert motion.slowdown == "" and motion.converged


# Missed keyframes.


def sharp(hold: float = 0.0) -> tuple[pp.Arm, list[Keyframe]]:
    """An arm of 16 joints, and a tour of taught configurations and a curve that reverses most joints."""
    arm = pp.Arm.from_template("RyRz", modules=8)
    tour = [Keyframe(joints=taught(arm, k), duration=1.0 if k else None, hold=hold) for k in range(4)]
    return arm, [*tour, Keyframe(line(arm), duration=1.0)]


def nearest_miss(motion: pp.Trajectory, joints: np.ndarray, seconds: tuple[float, float]) -> float:
    """Smallest mean distance of the control points from a configuration within a time [m]."""
    arm = motion.arm
    wanted = arm.at(arm.configuration(joints)).points
    begin, end = (round(each / motion.dt) for each in seconds)
    return min(float(np.linalg.norm(arm.at(q).points - wanted, axis=1).mean()) for q in motion.q[begin:end])


def waving(modules: int) -> tuple[pp.Arm, list[Keyframe]]:
    """A tour that bends an arm to one side and to the other, with all joints at once."""
    arm = pp.Arm.from_template("RyRz", modules=modules)
    bends = (0.0, 6.4, -6.4, 6.4, 0.0)
    return arm, [
        Keyframe(joints=np.full(arm.nv, bend / modules), duration=0.3 if number else None)
        for number, bend in enumerate(bends)
    ]


@pytest.mark.long
@pytest.mark.parametrize("modules", [8, 16, 30, 50])
@pytest.mark.parametrize("jerk", [5.0, 20.0, 100.0])
def test_keyframes_are_passed_in_spite_of_a_jerk_limit(modules: int, jerk: float) -> None:
    arm, tour = waving(modules)
    limits = replace(LIMITS, jerk=jerk)
    motion = pp.move_through(arm, tour, limits=limits)
    check_motion(motion, limits)
    assert motion.converged and motion.run.excess is None
    for place, keyframe in zip(motion.waypoints, tour, strict=True):
        near = (max(place.reached - 0.5, 0.0), place.reached + 0.5)
        assert nearest_miss(motion, keyframe.joints, near) < 0.1 * arm.length / modules
    # About as fast as with a stop at each keyframe that the filter needs to settle.
    stop = 2.0 * min(LIMITS.acceleration, np.cbrt(0.03 * jerk**2)) / jerk
    stops = [replace(each, hold=stop) for each in tour[1:-1]]
    held = pp.move_through(arm, [tour[0], *stops, tour[-1]], limits=limits)
    assert motion.steps < 1.1 * held.steps


@pytest.mark.long
@pytest.mark.parametrize("modules", [12, 24, 40])
def test_a_long_arm_passes_random_shapes_in_all_laps_under_jerk_limits(modules: int) -> None:
    arm = pp.Arm.from_template("RyRz", modules)
    rng = np.random.default_rng(modules)
    limits = replace(LIMITS, jerk=20.0)
    shapes = [arm.positions(pp.arm.smooth_configuration(arm, rng, 0.4)) for _ in range(4)]
    how = (
        {"duration": 0.5},
        {"duration": 0.4, "speed": 0.4},
        {"duration": 0.8, "hold": 0.06},
        {"duration": 0.6},
    )
    tour = [Keyframe(joints=q, **more) for q, more in zip(shapes, how, strict=True)]
    motion = pp.move_through(arm, tour, limits=limits, repeat=2)
    check_motion(motion, limits)
    assert motion.converged and motion.run.excess is None and len(motion.waypoints) == 8
    for place, q in zip(motion.waypoints, 2 * shapes, strict=True):
        near = (max(place.reached - 0.1, 0.0), place.reached + 0.1)
        assert nearest_miss(motion, q, near) < 0.1 * arm.length / modules
    free = pp.move_through(arm, tour, limits=LIMITS, repeat=2)
    assert motion.steps < free.steps + 2 * 8 * 2.0 * LIMITS.acceleration / 20.0 / LIMITS.dt


@pytest.mark.long
@pytest.mark.parametrize("jerk", [5.0, 20.0])
@pytest.mark.parametrize("bend", [0.1, 0.12])
def test_a_keyframe_is_passed_before_the_arm_evades_an_obstacle_behind_it(bend: float, jerk: float) -> None:
    arm = pp.Arm.from_template("RyRz", modules=12)
    up, near, down = bends = np.zeros((3, arm.nv))
    up[1] = 0.8
    near[1] = bend
    down[1] = -0.8
    tour = [Keyframe(joints=q, duration=0.6 if k else None) for k, q in enumerate(bends)]
    scene = pp.Scene({"post": pp.Sphere(arm.at(arm.straight()).points[-1], 0.03)})
    limits = replace(LIMITS, jerk=jerk)
    motion = pp.move_through(arm, tour, limits=limits, scene=scene)
    check_motion(motion, limits)
    assert motion.converged and not motion.faults and motion.deviations
    reached = motion.waypoints[1].reached
    assert nearest_miss(motion, near, (reached - 0.1, reached + 0.1)) < 0.1 * arm.length / 12
    assert motion.run.clearance.min() > 0.999 * scene.margin


def test_a_curve_is_missed_as_a_configuration_is(arm: pp.Arm) -> None:
    tour = [Keyframe(line(arm)), Keyframe(bow(arm), time=1.0, trim=True), Keyframe(line(arm), time=2.0)]
    limits = replace(LIMITS, position_margin=float(arm.limits.upper[0]) - 0.1)
    motion = pp.move_through(arm, tour, limits=limits)
    assert [place.missed for place in motion.waypoints] == [False, True, False]
    assert motion.run.status == "missed" and "1 of 3 postures is missed, keyframe 2, by" in motion.run.reason


@pytest.mark.long
def test_a_keyframe_that_is_held_long_enough_is_taken_in_spite_of_the_jerk_limit() -> None:
    arm, tour = sharp(hold=2.5)
    motion = pp.move_through(arm, tour, limits=replace(LIMITS, jerk=5.0))
    assert motion.converged and motion.run.excess is None
    for place, keyframe in zip(motion.waypoints[:-1], tour, strict=False):
        assert nearest_miss(motion, keyframe.joints, (place.reached, place.reached + 2.5)) < 1e-9


@pytest.mark.parametrize("cycle", (0.02, 0.1))
@pytest.mark.parametrize("seconds", (0.05, 0.3, 2.0))
def test_a_keyframe_that_is_passed_between_two_cycles_is_not_missed(cycle: float, seconds: float) -> None:
    arm, tour = sharp()
    tour = [tour[0], *(replace(each, duration=max(seconds, cycle)) for each in tour[1:])]
    motion = pp.move_through(arm, tour, limits=replace(LIMITS, dt=cycle))
    assert motion.converged and not any(place.missed for place in motion.waypoints)


def test_a_configuration_within_the_margin_of_the_joint_limits_is_missed(tmp_path: Path) -> None:
    arm = pp.Arm.from_template("RyRz", modules=8)
    tour = [Keyframe(joints=np.zeros(arm.nv)), Keyframe(joints=np.full(arm.nv, 0.4), time=2.0, name="end")]
    limits = replace(LIMITS, position_margin=float(arm.limits.upper[0]) - 0.3)
    motion = pp.move_through(arm, tour, limits=limits)
    assert np.abs(motion.q[-1]).max() <= 0.3 + 1e-9
    assert [place.missed for place in motion.waypoints] == [False, True]
    assert motion.run.status == "missed" and "position margin" in motion.run.reason
    assert motion.faults == (f"it missed a target: {motion.run.reason}",)
    with pytest.raises(MotionError, match="1 of 2 postures is missed"):
        motion.joint_trajectory()
    again = pp.load(pp.save(motion, tmp_path / "motion.npz"))
    assert again.waypoints == motion.waypoints and again.faults == motion.faults


# Task files.

FILE = """\
# Teach and repeat.
version = 1
kind = "keyframes"
repeat = 3     # laps

[arm]
template = "RyRz"
modules = 3

[limits]
cycle = "20 ms"
velocity = "2 rad/s"

[[keyframes]]
name = "home"
duration = "0.5 s"     # to come back
curve = { type = "line", a = [0, 0, 0], b = [0.15, 0, 0] }

# Shown by hand.
[[keyframes]]
name = "taught"
duration = "1 s"
speed = 0.25           # with care
joints = ["12 deg", 0, "-10 deg", 0, 0.2, 0]     # in place of a curve
"""


@pytest.mark.long
def test_a_tour_in_a_file_is_read_and_written_with_its_comments(tmp_path: Path) -> None:
    path = tmp_path / "tour.toml"
    path.write_text(FILE)
    task = pp.Task.load(path)
    last = task.motion[1]
    assert (task.repeat, last.curve, last.speed, last.placement) == (3, None, 0.25, None)
    assert np.allclose(last.joints, [np.pi / 15, 0, -np.pi / 18, 0, 0.2, 0])
    again = task.save(tmp_path / "again.toml")
    assert again.read_text().replace('name = "tour"\n', "") == FILE
    for suffix in (".toml", ".json"):
        edited = task.edited(repeat=1, motion=(Keyframe(task.motion[0].curve), last))
        assert_same(pp.Task.load(edited.save(tmp_path / f"edited{suffix}")), edited)
        assert pp.Task.load(task.save(tmp_path / f"plain{suffix}")).repeat == 3
    other = pp.Task.load(tmp_path / "edited.toml")
    assert other.repeat == 1 and other.motion[1] == last
    assert [place.name for place in task.feasibility(task.reference())] == ["home, lap 1", "taught, lap 1"]
    motion = task.perform()
    assert motion.converged and motion.planned == pytest.approx(3 * 1.5 - 0.5)
    assert np.abs(motion.q[-1] - last.joints).max() < 1e-9


def test_a_leader_is_not_repeated() -> None:
    task = pp.Task.load(Path(__file__).parents[2] / "examples" / "tasks" / "pipe.toml")
    with pytest.raises(InvalidValue, match="repeat is 2; allowed: 1, of a leader"):
        task.edited(repeat=2)


def test_a_repeated_tour_too_fast_for_its_limits_keeps_the_times_asked_for(arm: pp.Arm) -> None:
    limits = pp.Limits(step=None, dt=0.02, velocity=0.5, acceleration=2.0)
    tour = [
        Keyframe(joints=taught(arm, 1)),
        Keyframe(joints=taught(arm, 2), duration=0.1, hold=0.06),
        Keyframe(joints=taught(arm, 3), duration=6.0),
    ]
    reference = keyframe_reference(arm, tour, 0.02, repeat=2, limits=limits)
    planned = [float(reference.times[waypoint.row]) for waypoint in reference.waypoints]
    assert planned == pytest.approx([0.0, 0.1, 6.16, 12.16, 12.26, 18.32])
    for waypoint, keyframe in zip(reference.waypoints, 2 * tour, strict=True):
        np.testing.assert_allclose(reference.configuration(waypoint.row), keyframe.joints, atol=1e-12)
    motion = perform(reference, "geodesic", limits)
    check_motion(motion, limits)
    assert motion.converged
