"""Many runs at once are what `track` makes of each of them, whatever computes them, and in their order."""

from __future__ import annotations

import json
import threading
import warnings
from collections import Counter
from dataclasses import replace
from functools import partial

import joblib
import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.curve import HELIX
from pinposture.errors import ControllerError, InvalidValue, PostureWarning, UnknownName
from pinposture.motion.track import name_enough_steps

Asked = tuple[pp.Arm, list[pp.Target], np.ndarray]


@pytest.fixture(scope="module")
def asked() -> Asked:
    """An arm, targets and starts, as `track_many` takes them."""
    arm = template_arm("RyRz", 4)
    rng = np.random.default_rng(5)
    starts = np.array([smooth_configuration(arm, rng, 0.2 + 0.2 * k) for k in range(5)])
    targets = [
        pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 0.7)),
        pp.resolve_targets(arm, HELIX, placement="align"),
        pp.Target.from_points(arm, arm.at(starts[0]).points + [0.0, 0.0, 3.0]),  # out of reach
        pp.Target.from_configuration(arm, starts[3]),  # there to begin with
        pp.resolve_targets(arm, HELIX, placement="align").region(1, 2),
    ]
    starts[3] = targets[3].q
    return arm, targets, starts


@pytest.fixture(scope="module")
def scene() -> pp.Scene:
    return pp.Scene({"ball": pp.Sphere((0.1, 0.0, 0.35), 0.02)})


def assert_same_run(one: pp.Run, other: pp.Run) -> None:
    """Everything that a run has, to the last bit."""
    assert vars(one).keys() >= {"q", "points", "reason", "violated_constraints"}
    for name, value in vars(other).items():
        if isinstance(value, np.ndarray):
            assert getattr(one, name).dtype.kind == value.dtype.kind, name
            np.testing.assert_array_equal(getattr(one, name), value, err_msg=name)
    assert one.info.keys() == other.info.keys()
    for name, column in other.info.items():
        np.testing.assert_array_equal(one.info[name], column, err_msg=name)
    for name in ("arm", "target", "controller", "limits", "status", "reason", "scene"):
        assert getattr(one, name) == getattr(other, name), name


@pytest.mark.parametrize("controller", ["geodesic", "switching"])
def test_each_run_is_what_track_makes_of_it(asked: Asked, scene: pp.Scene, controller: str) -> None:
    arm, targets, starts = asked
    around = scene if controller == "geodesic" else None
    limits = pp.Limits(step=0.07)
    told = []
    batch = pp.track_many(
        *asked,
        controller,
        limits,
        around,
        max_steps=40,
        tolerance=1e-5,
        jobs=1,
        progress=lambda *n: told.append(n),
    )
    assert told == [(k, 5) for k in range(1, 6)]
    runs = [
        pp.track(arm, target, start, controller, limits, around, max_steps=40, tolerance=1e-5)
        for target, start in zip(targets, starts, strict=True)
    ]
    assert len({run.steps for run in runs}) > 1  # ragged
    assert runs[3].steps == 0
    for k, (one, run) in enumerate(zip(batch, runs, strict=True)):
        assert_same_run(one, run)
        assert (batch.status[k], batch.reason[k], batch.steps[k]) == (run.status, run.reason, run.steps)
        errors = [np.linalg.norm(p - run.target.points, axis=1)[run.target.has_target] for p in run.points]
        assert batch.start_error[k] == pytest.approx(errors[0].sum(), abs=1e-15)
        assert batch.final_error[k] == pytest.approx(errors[-1].sum(), abs=1e-15)
        assert batch.mean_error[k] == pytest.approx(errors[-1].mean(), abs=1e-15)
        judged = pp.CollisionModel(arm, pp.Scene() if around is None else around)
        least = min(judged.minimum(q).distance for q in run.q)
        assert batch.path_length_ratio[k] == run.path_length_ratio
        assert batch.clearance[k] == pytest.approx(least, abs=1e-12)
        np.testing.assert_array_equal(batch.q_start[k], starts[k])
        np.testing.assert_array_equal(batch.q_final[k], run.q[-1])
    np.testing.assert_array_equal(batch.converged, [run.converged for run in runs])


def test_one_target_serves_all_starts_and_one_start_all_targets(asked: Asked) -> None:
    arm, targets, starts = asked
    for one, all_starts in ((targets[0], starts), (targets[:1], list(starts))):
        batch = pp.track_many(arm, one, all_starts, max_steps=3, jobs=1)
        assert len(batch) == 5
        np.testing.assert_array_equal(batch.q_start, starts)
        assert {batch[k].target for k in range(5)} == {targets[0]}
    for one_start in (starts[0], starts[0].tolist(), starts[:1]):
        batch = pp.track_many(arm, targets, one_start, max_steps=3, jobs=1)
        assert [run.target for run in batch] == targets
        np.testing.assert_array_equal(batch.q_start, np.tile(starts[0], (5, 1)))
    single = pp.track_many(arm, targets[0], starts[1], max_steps=3)
    assert len(single) == 1
    own = partial(pp.track, arm, targets[0], starts[1])
    named = name_enough_steps(own(max_steps=3), pp.Geodesic(), lambda steps: own(max_steps=steps))
    assert_same_run(single[-1], named)


@examples(6)
@given(order=st.permutations(range(5)))
def test_other_orders_of_what_is_asked_are_other_orders_of_the_same_runs(
    asked: Asked, order: list[int]
) -> None:
    arm, targets, starts = asked
    ordered = [targets[k] for k in order]
    plain = pp.track_many(*asked, "projection", max_steps=4, jobs=1)
    other = pp.track_many(arm, ordered, starts[order], "projection", max_steps=4, jobs=1)
    np.testing.assert_array_equal(other.q_final, plain.q_final[order])
    for place, number in enumerate(order):
        assert_same_run(other[place], plain[number])


@pytest.mark.parametrize(
    ("choose", "says"),
    [
        (lambda targets, starts: (targets[:2], starts[:3]), r"targets and starts is \(2, 3\)"),
        (lambda targets, starts: (targets, []), r"\(5, 0\)"),
        (lambda targets, starts: ([], starts), r"\(0, 5\)"),
        (lambda targets, starts: (targets, [*starts[:4], starts[0][:-1]]), r"starts\[4\]"),
        (lambda targets, starts: (targets, [*starts[:2], np.full(8, np.nan), *starts[3:]]), r"starts\[2\]"),
        (lambda targets, starts: (targets[0], starts[0][:-1]), "starts"),
        (lambda targets, starts: (targets[0], 0.5), "starts"),
        (lambda targets, starts: (targets[0], [[1.0, [2.0]], starts[0]]), r"starts\[0\]"),
        (
            lambda targets, starts: ([*targets[:2], replace(targets[2], weights=np.zeros(4))], starts[0]),
            r"targets\[2\]\.weights",
        ),
        (lambda targets, starts: ([targets[0], targets[0].points], starts[0]), r"targets\[1\]"),
        (lambda targets, starts: (3, starts), "targets"),
    ],
)
def test_what_does_not_fit_is_named_before_anything_runs(asked, choose, says) -> None:
    arm, targets, starts = asked
    targets, starts = choose(targets, starts)
    told = []
    with pytest.raises(InvalidValue, match=says):
        pp.track_many(arm, targets, starts, jobs=1, progress=lambda *n: told.append(n))
    assert told == []


@pytest.mark.parametrize(
    ("named", "says"),
    [
        ({"limits": 0.1}, "limits"),
        ({"limits": pp.Limits(step=[0.1] * 3)}, "step"),
        ({"scene": 1}, "scene"),
        ({"max_steps": 0}, "max_steps"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"jobs": 0}, "jobs"),
    ],
)
def test_arguments_that_no_run_would_take_are_refused_at_once(asked, named, says) -> None:
    with pytest.raises(InvalidValue, match=says):
        pp.track_many(*asked, **named)
    with pytest.raises(UnknownName):
        pp.track_many(*asked, "jump")
    with pytest.raises(UnknownName, match=r"no thing to keep is called 'end' \(did you mean 'ends'\?\)"):
        pp.track_many(*asked, keep="end")


def test_a_run_that_fails_does_not_lose_the_others(asked: Asked) -> None:
    arm, targets, starts = asked
    with pytest.warns(PostureWarning, match="1 of 5 runs failed; run 2: InvalidValue: target.q is not given"):
        batch = pp.track_many(*asked, "joint", jobs=1)
    assert batch.status[2] == "failed"
    assert not batch.converged[2]
    np.testing.assert_array_equal(batch.q_final[2], starts[2])
    failed = batch[2]
    assert (failed.steps, failed.status, failed.points.shape) == (0, "failed", (1, 4, 3))
    assert all(
        np.isfinite(getattr(batch, name)).all() for name in ("start_error", "mean_error", "path_length_ratio")
    )
    assert "1, run 2 first: InvalidValue" in batch.in_words()["failed"]
    for k in (0, 1, 3, 4):
        assert_same_run(batch[k], pp.track(arm, targets[k], starts[k], "joint"))


class Faulty(pp.Projection):
    """A controller with a mistake in it."""

    def step(self, *_: object) -> pp.Step:
        raise ZeroDivisionError


def test_mistakes_in_a_controller_are_not_hidden(asked: Asked) -> None:
    with pytest.raises(ControllerError, match="ZeroDivisionError"):
        pp.track_many(*asked, Faulty(), jobs=1)


def test_a_warning_that_holds_for_all_runs_is_given_once(asked: Asked, scene: pp.Scene) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        batch = pp.track_many(*asked, "projection", scene=scene, max_steps=3, jobs=1)
    assert ["does not avoid obstacles" in str(each.message) for each in caught] == [True]
    assert caught[0].filename == __file__
    assert np.isfinite(batch.clearance).all()


def test_ends_alone_are_the_same_and_say_how_to_have_more(asked: Asked) -> None:
    batch, ends = (pp.track_many(*asked, max_steps=5, keep=k) for k in ("motions", "ends"))
    assert ends.motions is None
    for name in ("status", "reason", "steps", "final_error", "path_length_ratio", "q_start", "q_final"):
        np.testing.assert_array_equal(getattr(ends, name), getattr(batch, name))
    with pytest.raises(InvalidValue, match='"motions" in track_many'):
        ends[0]


def test_it_counts_as_a_sequence_does(asked: Asked) -> None:
    batch = pp.track_many(*asked, max_steps=2)
    assert_same_run(batch[-2], batch[3])
    for number in (5, -6):
        with pytest.raises(IndexError, match="of 5"):
            batch[number]
    with pytest.raises(TypeError):
        batch["0"]


def test_numbers_and_words_tell_the_same(asked: Asked, scene: pp.Scene) -> None:
    batch = pp.track_many(*asked, max_steps=10, scene=scene)
    told = json.loads(json.dumps(batch.summary(), allow_nan=False))
    assert (
        told["statuses"] == Counter(run["status"] for run in told["runs"]) == Counter(batch.status.tolist())
    )
    assert [run["mean_error"] for run in told["runs"]] == batch.mean_error.tolist()
    words = batch.in_words()
    assert all(f"{count} {status}" in words["runs"] for status, count in told["statuses"].items())
    assert f"{np.median(batch.steps):.0f} (median), at most {max(batch.steps)}" == words["steps"]
    worst = max((run["mean_error"], k) for k, run in enumerate(told["runs"]) if run["status"] != "converged")
    assert words["worst"].startswith(f"run {worst[1]}, ")
    assert f"in run {batch.clearance.argmin()}" in words["clearance"]
    assert [line.split("  ")[0].strip() for line in str(batch).splitlines()] == list(words)


@pytest.mark.process
def test_two_processes_find_the_same_as_one(asked: Asked) -> None:
    class Own(pp.Projection):  # which no other process can import
        pass

    controller = Own(gain=0.8)
    told = []
    one = pp.track_many(*asked, controller, max_steps=20, jobs=1)
    two = pp.track_many(*asked, controller, max_steps=20, jobs=2, progress=lambda *n: told.append(n))
    assert told == [(k, 5) for k in range(1, 6)]
    for own, other in zip(one, two, strict=True):
        assert_same_run(own, other)


def test_runs_go_where_joblib_is_told_to_send_them(asked: Asked) -> None:
    seen = set()

    class Watched(pp.Projection):
        def step(self, *given: object) -> pp.Step:
            seen.add(threading.get_ident())
            return super().step(*given)

    with joblib.parallel_config(backend="threading", n_jobs=2):
        there = pp.track_many(*asked, Watched(), max_steps=8)
    assert threading.get_ident() not in seen
    seen.clear()
    here = pp.track_many(*asked, Watched(), max_steps=8, jobs=1)
    assert seen == {threading.get_ident()}
    for one, other in zip(there, here, strict=True):
        assert_same_run(one, other)
