"""The pace along a way, against the motion that it makes: counted step by step, and in closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples, seeds
from scipy.interpolate import CubicSpline
from scipy.optimize import linprog
from scipy.sparse import csr_array, vstack

import pinposture as pp
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import PATH, JointPath, SpeedProfile

ROUNDING = 1e-9


@cache
def arm_of(joints: int) -> pp.Arm:
    return pp.Arm.from_template("Rz", joints)


def way(offsets: np.ndarray) -> JointPath:
    arm = arm_of(offsets.shape[1])
    objective = Objective(arm, pp.Target.from_configuration(arm, arm.neutral()))
    return JointPath(objective, arm.neutral(), offsets - offsets[0])


def smooth_way(rng: np.random.Generator, rows: int, joints: int) -> JointPath:
    """A sum of three sine waves in each joint."""
    s = np.linspace(0.0, 1.0, rows)[:, None]
    waves = [
        rng.normal(size=joints) / k**2 * np.sin(5.0 * k * rng.uniform(0.3, 1) * s + rng.uniform(0, 6, joints))
        for k in (1, 2, 3)
    ]
    return way(np.sum(waves, axis=0))


def gone(
    path: JointPath, bound: np.ndarray, brake: np.ndarray | None, most: float | np.ndarray = np.inf
) -> np.ndarray:
    """The places of a motion at the pace that is given, step by step until its end."""
    bounds = replace(pp.Limits().for_arm(path.arm), bound=bound, brake=brake)
    profile = SpeedProfile(path, bounds, most)
    places = [0.0]
    speed = 0.0
    while places[-1] < path.end:
        speed = profile.next(places[-1], speed)
        assert 0.0 < speed <= np.max(most) * (1.0 + ROUNDING)
        places.append(min(places[-1] + speed, path.end))
        assert len(places) < 50_000
    return np.array(places)


def loads(path: JointPath, places: np.ndarray, bound: np.ndarray, brake: np.ndarray) -> tuple[float, float]:
    """Largest step and largest change of it from one to the next, from and to rest, of their limits."""
    steps = np.diff([path.smooth_offset(place) for place in places], axis=0)
    rest = np.zeros((1, steps.shape[1]))
    changes = np.diff(np.concatenate([rest, steps, rest]), axis=0)
    return float(np.abs(steps / bound).max()), float(np.abs(changes / brake).max())


def fewest_steps(distance: float, bound: float, brake: float) -> int:
    """The fewest steps from rest to rest, none above the bound, none differing by more than the brake."""
    count = 1
    while True:
        k = np.arange(1, count + 1)
        reach = np.minimum(np.minimum(k, count + 1 - k) * brake, bound).sum()
        if reach >= distance * (1.0 - ROUNDING):
            return count
        count += 1


@pytest.mark.parametrize("seed", seeds(25))
@pytest.mark.parametrize("timed", [True, False])
def test_the_motion_keeps_speed_and_acceleration_from_rest_to_rest(seed: int, timed: bool) -> None:
    rng = np.random.default_rng(seed)
    joints = int(rng.integers(1, 6))
    rows = int(rng.integers(60, 300))
    path = smooth_way(rng, rows, joints)
    row = np.abs(np.diff(path.offsets, axis=0)).max()
    bound = row * rng.uniform(0.2, 0.9) * rng.uniform(0.5, 1.0, joints)
    brake = bound * 10 ** rng.uniform(-2.0, 0.0)
    most = 10 ** rng.uniform(-1.0, 0.3) if timed else np.inf
    fastest, hardest = loads(path, gone(path, bound, brake, most), bound, brake)
    assert fastest <= 1.0 + ROUNDING
    assert hardest <= 1.0 + ROUNDING
    assert max(fastest, hardest) > 0.3 or timed  # it does not creep


@given(st.floats(0.01, 3.0), st.floats(0.003, 0.3), st.floats(0.03, 2.0), st.integers(2, 200), st.booleans())
@examples(40)
def test_a_straight_way_takes_little_longer_than_it_must(
    distance: float, bound: float, share: float, rows: int, timed: bool
) -> None:
    brake = share * bound
    path = way(np.linspace(0.0, distance, rows)[:, None])
    most = 0.6 * bound / distance * path.end if timed else np.inf
    places = gone(path, np.array([bound]), np.array([brake]), most)
    fastest, hardest = loads(path, places, np.array([bound]), np.array([brake]))
    assert fastest <= 1.0 + ROUNDING and hardest <= 1.0 + ROUNDING
    least = fewest_steps(distance, 0.6 * bound if timed else bound, brake)
    assert least <= len(places) - 1 <= 1.3 * least + 3.0
    # In continuous time that is the trapezoid: D / v + v / a, or the triangle 2 sqrt(D / a).
    speed = 0.6 * bound if timed else bound
    long = distance > speed**2 / brake
    theory = distance / speed + speed / brake if long else 2.0 * np.sqrt(distance / brake)
    assert len(places) - 1 <= 1.3 * theory + 4.0


@pytest.mark.parametrize("seed", seeds(10))
def test_tighter_limits_are_never_faster(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = smooth_way(rng, 120, 3)
    bound = np.full(3, 0.02)
    brake = np.full(3, 0.004)
    most = 0.8
    counts = [
        len(gone(path, bound, brake, most)),
        len(gone(path, 0.7 * bound, brake, most)),
        len(gone(path, 0.7 * bound, 0.5 * brake, most)),
        len(gone(path, 0.7 * bound, 0.5 * brake, 0.5 * most)),
    ]
    assert counts == sorted(counts) and counts[0] < counts[-1]


@pytest.mark.parametrize("most", [0.13, 1.0, 3.7])
def test_time_alone_sets_the_pace_where_limits_are_wide(most: float) -> None:
    path = smooth_way(np.random.default_rng(1), 90, 2)
    for brake in (None, np.full(2, 1e3)):
        places = gone(path, np.full(2, 1e3), brake, most)
        np.testing.assert_allclose(np.diff(places)[:-1], most, rtol=1e-12)
        assert len(places) - 1 == int(np.ceil(path.end / most - ROUNDING))


def test_speed_alone_sets_it_where_nothing_brakes() -> None:
    path = way(np.linspace(0.0, 1.0, 41)[:, None])
    steps = np.diff(path.end / 40 * gone(path, np.array([0.02]), None, 5.0) / 40)
    np.testing.assert_allclose(steps[:-1], 0.98 * 0.02, rtol=1e-9)


@pytest.mark.parametrize("most", [np.inf, 0.05])
def test_two_rows_and_joints_that_stand_still(most: float) -> None:
    path = way(np.array([[0.0, 0.0, 0.0], [0.5, 0.0, -0.2]]))
    bound = np.full(3, 0.03)
    brake = np.full(3, 0.01)
    fastest, hardest = loads(path, gone(path, bound, brake, most), bound, brake)
    assert 0.5 < fastest <= 1.0 and hardest <= 1.0 + ROUNDING


@pytest.mark.parametrize("most", [0.4, 1.0])
def test_rows_that_repeat_take_their_time(most: float) -> None:
    s = np.linspace(0.0, 1.0, 40)[:, None]
    bend = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2)) * [[0.4, -0.7]]
    path = way(np.concatenate([bend, np.repeat(bend[-1:], 25, axis=0), bend[::-1]]))
    bound = np.full(2, 0.05)
    brake = np.full(2, 0.003)
    places = gone(path, bound, brake, most)
    fastest, hardest = loads(path, places, bound, brake)
    assert fastest <= 1.0 + ROUNDING and hardest <= 1.0 + ROUNDING
    resting = np.count_nonzero((places >= 40.0) & (places <= 63.0))
    assert resting == pytest.approx(23.0 / most, abs=1.5)


def test_a_way_that_goes_nowhere_ends_all_the_same() -> None:
    path = way(np.zeros((5, 2)))
    for most in (0.5, np.inf):
        assert gone(path, np.full(2, 0.1), np.full(2, 0.01), most)[-1] == path.end


@pytest.mark.parametrize("most", [np.inf, 0.7])
def test_the_last_step_can_be_stopped_from_at_once(most: float) -> None:
    # Ways that end steeply: the pace has to come down to what one step can brake.
    for seed in seeds(20):
        rng = np.random.default_rng(seed)
        path = way(np.linspace(0.0, rng.uniform(0.1, 2.0), 30)[:, None])
        brake = 10 ** rng.uniform(-3.5, -1.5)
        places = gone(path, np.array([0.05]), np.array([brake]), most)
        last = path.smooth_offset(places[-1]) - path.smooth_offset(places[-2])
        assert abs(last[0]) <= brake * (1.0 + ROUNDING)


def shortest(path: JointPath, profile: SpeedProfile, brake: np.ndarray) -> float:
    """Steps with the largest squares of speeds on the parts of a path that HiGHS finds for its limits."""
    count = len(profile.top) - 1
    h = path.end / count
    curve = CubicSpline(np.arange(path.end + 1.0), path.offsets, bc_type="natural")
    at = h * np.arange(count)[:, None] + h * np.array([1e-9, 0.5, 1.0 - 1e-9])
    slopes = curve(at, 1)
    bends = curve(at, 2)
    # f = q' u + q'' (x + 2 (s - s0) u) has three Bernstein coefficients on a part that begins at s0.
    u = slopes + bends * (2.0 * h * np.array([0.0, 0.5, 1.0]))[:, None]
    u[:, 1] = 2.0 * u[:, 1] - 0.5 * (u[:, 0] + u[:, 2])
    bends[:, 1] = 2.0 * bends[:, 1] - bends[:, ::2].mean(1)
    rows = []
    columns = []
    values = []
    parts = np.repeat(np.arange(count), u[0].size)
    for column, share in ((parts, bends - u / (2.0 * h)), (parts + 1, u / (2.0 * h))):
        rows.append(np.arange(len(parts)))
        columns.append(column)
        values.append(share.reshape(count, -1).ravel())
    matrix = csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))))
    limits = np.tile(brake, 3 * count)
    ends = [(0.0, (path.end + 1.0) ** 2)] * (count + 1)
    ends[0] = (0.0, profile.top[0] ** 2)
    ends[-1] = (0.0, profile.top[-1] ** 2)
    both = vstack([matrix, -matrix])
    most = np.concatenate([limits, limits])
    found = linprog(-np.ones(count + 1), both, most, bounds=ends)
    assert found.status == 0
    speeds = np.sqrt(np.maximum(found.x, 0.0))
    return float((2.0 * h / (speeds[1:] + speeds[:-1])).sum())


@pytest.mark.parametrize("seed", seeds(12))
def test_no_speeds_that_the_limits_allow_are_much_faster(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = smooth_way(rng, 70, 4)
    brake = rng.uniform(1e-4, 1e-2, 4)
    bounds = replace(
        pp.Limits().for_arm(path.arm), bound=np.full(4, np.inf), brake=brake / PATH.acceleration_share
    )
    profile = SpeedProfile(path, bounds)
    assert profile.steps <= 1.02 * shortest(path, profile, brake)


@pytest.mark.parametrize("seed", seeds(6))
def test_a_rate_for_each_piece_is_kept_there_and_limits_too(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = smooth_way(rng, 60, 3)
    rates = np.full(59, 0.8)
    rates[20:30] = 0.1
    rates[40] = 0.3
    bound = np.full(3, 0.1)
    brake = rng.uniform(1e-4, 1e-2, 3)
    places = gone(path, bound, brake, rates)
    begin = places[:-1].astype(int)
    for first, last, passed in zip(begin, np.ceil(places[1:]).astype(int), np.diff(places), strict=True):
        assert passed <= rates[first:last].max() * (1.0 + ROUNDING)
    assert max(loads(path, places, bound, brake)) <= 1.0 + ROUNDING
    np.testing.assert_array_equal(gone(path, bound, brake, np.full(59, 0.8)), gone(path, bound, brake, 0.8))
    assert len(places) > len(gone(path, bound, brake, 0.8)) + 50


@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_the_arm_does_not_stop_on_the_way_because_of_rounding() -> None:
    arm = pp.Arm.from_template("RyRz", 8, (1 / 16, 1 / 16))
    rng = np.random.default_rng(15)
    limits = pp.Limits(step=None, velocity=1000.0, acceleration=5.0, dt=0.01)
    start, goal = (pp.arm.smooth_configuration(arm, rng, 2.0) for _ in range(2))
    path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=limits)
    profile = pp.retime(path, limits).profile
    assert profile is not None and profile.top[1:-1].min() > 0.05
    brake = PATH.acceleration_share * limits.for_arm(arm).brake
    assert profile.steps <= 1.02 * shortest(path, profile, brake)
