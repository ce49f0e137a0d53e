"""Times in whole cycles, and interpolation in time against closed forms and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sampling import examples
from scipy.interpolate import PchipInterpolator
from task.keyed_arms import straight

from pinposture.errors import TaskError
from pinposture.task.keyframe import CONTINUITIES, Keyframe, Stretch, interpolate, schedule


def stretch(*rows: int) -> Stretch:
    return Stretch(0, len(rows) - 1, np.array(rows))


def frames(*options: dict) -> tuple[Keyframe, ...]:
    line = straight(1.0)
    return tuple(Keyframe(line, **each) for each in options)


def test_times_and_durations_are_rounded_to_whole_cycles() -> None:
    given = frames({"hold": 0.31}, {"duration": 1.0}, {"time": 2.044, "hold": 0.5}, {"duration": 1.0})
    found = schedule(given, 0.1)
    assert found.reached.tolist() == [0, 13, 20, 35]
    assert found.left.tolist() == [3, 13, 25, 35]
    assert found.rests.tolist() == [True, False, True, True]
    assert (found.rows, found.between.min()) == (36, 7)
    first, last = found.stretches()
    assert (first.first, first.last, first.rows.tolist()) == (0, 2, [3, 13, 20])
    assert (last.first, last.last, last.rows.tolist()) == (2, 3, [25, 35])
    finer = found.finer(4)
    assert (finer.rows, finer.reached.tolist()) == (141, [0, 52, 80, 140])


@pytest.mark.parametrize(
    ("given", "message"),
    (
        (({"time": 1.0}, {"time": 2.0}), "keyframe 1: it is at 1 s; the first keyframe is at 0"),
        (({}, {}), "keyframe 2: it has neither a time nor a duration"),
        (({}, {"time": 2.0}, {"time": 2.0, "name": "b"}), "keyframe 3 'b': it is at 2 s, but"),
        (({}, {"time": 2.0, "hold": 1.0}, {"time": 2.5}), "keyframe 2 is left at 3 s; times have to"),
        (({}, {"duration": 0.0}), "keyframe 2: it is at 0 s, but keyframe 1 is at 0 s"),
        (({}, {"duration": 0.01}), "keyframe 2: it is in the same control cycle as keyframe 1"),
        (({}, {"time": 1e9}), "keyframe 2: it ends at 1e[+]09 s; with cycles of 0.1 s, 100000 s"),
    ),
)
def test_times_that_are_none_name_the_keyframe(given: tuple[dict, ...], message: str) -> None:
    keyframes = frames(*given)
    with pytest.raises(TaskError, match=message):
        schedule(keyframes, 0.1)


def test_from_rest_to_rest_the_polynomials_are_known() -> None:
    values = np.array([[1.0, 5.0], [3.0, 1.0]])
    x = np.linspace(0, 1, 11)
    for continuity, share in (
        ("velocity", 3 * x**2 - 2 * x**3),
        ("acceleration", 10 * x**3 - 15 * x**4 + 6 * x**5),
    ):
        found = interpolate(stretch(7, 17), values, continuity, 7 + 10 * x)
        assert np.allclose(found, values[0] + share[:, None] * (values[1] - values[0]), atol=1e-12)


@pytest.mark.parametrize("continuity", CONTINUITIES)
@given(arrays(float, (5, 3), elements=st.floats(-2, 2)), st.lists(st.integers(3, 40), min_size=4, max_size=4))
@examples(25)
def test_it_is_as_continuous_as_it_says(continuity: str, values: np.ndarray, gaps: list[int]) -> None:
    at = stretch(*np.cumsum([2, *gaps]).tolist())
    h = 1e-4 * min(gaps)

    def value(row: float) -> np.ndarray:
        return interpolate(at, values, continuity, [row])[0]

    size = 1e-6 + np.ptp(values) / min(gaps)
    for k, row in enumerate(at.rows):
        assert np.allclose(value(row), values[k], atol=1e-9)
        before = value(row - h)
        here = value(row)
        after = value(row + h)
        before2 = value(row - 2 * h)
        after2 = value(row + 2 * h)
        left = (3 * here - 4 * before + before2) / (2 * h)
        right = (4 * after - after2 - 3 * here) / (2 * h)
        if k in (0, 4):  # beyond the ends it is constant
            assert np.allclose(right if k == 0 else left, 0.0, atol=1e-2 * size)
        else:
            assert np.allclose(left, right, atol=1e-2 * size)
        if continuity == "acceleration":
            bends = (here - 2 * before + before2) / h**2, (here - 2 * after + after2) / h**2
            assert np.allclose(*(bends if 0 < k < 4 else (sum(bends), 0.0)), atol=0.05 * size)


FOUR_DECADES = st.lists(st.floats(0.0, 4.0).map(lambda x: 10.0**x), min_size=5, max_size=5)


@pytest.mark.parametrize("continuity", CONTINUITIES)
@given(arrays(float, (6, 4), elements=st.floats(-2, 2)), FOUR_DECADES)
@examples(25)
def test_it_is_monotone_between_keyframes_whatever_the_times(
    continuity: str, values: np.ndarray, gaps: list[float]
) -> None:
    at = stretch(*np.cumsum([0, *np.ceil(gaps)]).astype(int).tolist())
    for k, (a, b) in enumerate(zip(at.rows[:-1], at.rows[1:], strict=True)):
        found = interpolate(at, values, continuity, np.linspace(a, b, 101))
        rises = np.diff(found, axis=0) * np.sign(values[k + 1] - values[k])
        assert np.all(rises >= -1e-12)
        assert np.allclose(found[[0, -1]], values[k : k + 2], atol=1e-12)


@given(arrays(float, (6, 4), elements=st.floats(-2, 2)), FOUR_DECADES)
@examples(25)
def test_accelerations_are_continuous_whatever_the_times(values: np.ndarray, gaps: list[float]) -> None:
    at = stretch(*np.cumsum([0, *np.ceil(gaps)]).astype(int).tolist())
    widths = np.diff(at.rows)
    for k in range(6):
        beside = widths[max(k - 1, 0) : k + 1]
        h = 1e-4 * beside.min()
        ends = np.maximum(at.rows[k] + h * np.arange(-3, 4), 0.0)
        around = interpolate(at, values, "acceleration", np.minimum(ends, at.rows[-1]))
        left = (2 * around[3] - 5 * around[2] + 4 * around[1] - around[0]) / h**2
        right = (2 * around[3] - 5 * around[4] + 4 * around[5] - around[6]) / h**2
        # One-sided differences are off by the third and fourth derivatives, of the shorter interval.
        assert np.allclose(left, right, atol=1e-3 * (1e-3 + np.ptp(values)) / beside.min() ** 2)


@pytest.mark.parametrize("continuity", CONTINUITIES)
@given(arrays(float, (6, 4), elements=st.floats(-2, 2)), FOUR_DECADES)
@examples(25)
def test_velocities_at_keyframes_are_those_of_a_monotone_cubic_or_smaller(
    continuity: str, values: np.ndarray, gaps: list[float]
) -> None:
    at = stretch(*np.cumsum([0, *np.ceil(gaps)]).astype(int).tolist())
    with np.errstate(over="ignore"):  # of the inverse of means that vanish
        monotone = PchipInterpolator(at.rows, values)(at.rows[1:-1], 1)
    h = 1e-6 * np.diff(at.rows).min()
    after, before = (interpolate(at, values, continuity, at.rows[1:-1] + x) for x in (h, -h))
    found = (after - before) / (2 * h)
    size = 1e-3 * (1e-3 + np.ptp(values)) / np.diff(at.rows).min()
    assert np.all(found * np.sign(monotone) >= -size)
    assert np.all(np.abs(found) <= np.abs(monotone) + size)


@pytest.mark.parametrize("continuity", CONTINUITIES)
def test_a_faster_motion_beyond_a_keyframe_needs_less_velocity_before_it(continuity: str) -> None:
    values = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 0.5, 1.0], [2.1, -1.0, 4.0]])
    peaks = []
    for width in (10_000, 1000, 300, 100, 50, 20, 3, 1):
        found = interpolate(stretch(0, 100, 100 + width, 300 + width), values, continuity, np.arange(101))
        peaks.append(np.abs(np.diff(found, axis=0)).max(axis=0))
    assert np.all(np.diff(peaks, axis=0) <= 1e-12)


@pytest.mark.parametrize("continuity", CONTINUITIES)
def test_a_constant_velocity_is_kept_through_keyframes(continuity: str) -> None:
    at = stretch(0, 10, 13, 200, 201, 300)
    found = interpolate(at, at.rows[:, None] / 7.0, continuity, np.arange(10, 202))
    assert np.allclose(found[:, 0], np.arange(10, 202) / 7.0, atol=1e-12)
