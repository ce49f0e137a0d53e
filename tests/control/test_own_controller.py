"""Controllers that others write: how they are found, and what is said of steps that are none."""

from __future__ import annotations

import pickle
import re
import traceback
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from threading import Lock

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.control import CONTROLLERS, Memory, Step, controller_named, registry
from pinposture.control.controller import step_within
from pinposture.errors import ControllerError, InvalidValue, UnknownName

MODULE = """
from pinposture.control import Step


class Still:
    name = "still"

    def step(self, state, target, limits=None, memory=None):
        held = limits.hold(state)
        return Step(held.dq, clipped=held.clipped, reason="it never moves")


class Picky(Still):
    def __init__(self, needed):
        self.needed = needed


NUMBER = 3
"""

LIMITS = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=4.0)


@dataclass(frozen=True)
class Returning:
    """Returns what it is told to, whatever the state."""

    returned: object
    name: str = "returning"

    def step(self, state, target, limits=None, memory=None):
        return self.returned


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "own_module_of_a_test.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(registry.sys.path))


@pytest.fixture
def arm():
    return template_arm("RyRz", 4)


def test_a_class_is_found_where_it_is_said_to_be(folder, arm):
    controller = controller_named("own_module_of_a_test:Still")
    assert (controller.name, type(controller).__name__) == ("still", "Still")
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    run = pp.track(arm, target, arm.straight(), "own_module_of_a_test:Still")
    assert (run.steps, run.status) == (0, "no_control_points")
    assert "it never moves" in run.reason


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("own_module_of_a_test:Stil", UnknownName, "did you mean 'Still'"),
        ("own_module_of_a_test:NUMBER", UnknownName, "NUMBER"),
        ("no_module_of_a_test:Still", InvalidValue, "No module named 'no_module_of_a_test'"),
        ("own_module_of_a_test:Picky", InvalidValue, "needed"),
        ("json:JSONDecoder", InvalidValue, "method `step`"),
        ("own_module_of_a_test", UnknownName, "geodesic"),
        ("own_module_of_a_test", UnknownName, "package.module:Class"),
        (":Still", UnknownName, "geodesic"),
    ],
)
def test_what_is_not_found_is_named(folder, name, kind, words):
    with pytest.raises(kind, match=words):
        controller_named(name)


def test_an_object_that_is_no_controller_is_told_what_is_missing(folder):
    still = type(controller_named("own_module_of_a_test:Still"))
    with pytest.raises(InvalidValue, match=r"such as Still\(\)"):
        controller_named(still)
    nameless = type("Nameless", (), {"step": still.step})()
    with pytest.raises(InvalidValue, match="an object with a `name` and a method `step`"):
        controller_named(nameless)


def test_only_what_a_module_defines_is_offered(folder):
    with pytest.raises(UnknownName) as caught:
        controller_named("own_module_of_a_test:Nothing")
    assert caught.value.allowed == ("Still", "Picky")


def test_a_name_can_be_added_and_a_package_can_bring_one(folder, monkeypatch):
    monkeypatch.setitem(CONTROLLERS, "mine", lambda: Returning(None))
    assert controller_named("mine") == Returning(None)
    offered = EntryPoint("theirs", "own_module_of_a_test:Still", registry.ENTRY_POINTS)

    def listed(group):
        return [offered] if group == registry.ENTRY_POINTS else []

    monkeypatch.setattr(registry, "entry_points", listed)
    monkeypatch.syspath_prepend(".")
    assert controller_named("theirs").name == "still"
    with pytest.raises(UnknownName) as caught:
        controller_named("nobody")
    assert {"mine", "theirs", "geodesic"} <= set(caught.value.allowed)


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        (np.zeros(8), r"Returning.step\(\.\.\.\) \(returned\) is array.*a Step"),
        (None, "is not given.*a Step"),
        ((np.zeros(8), ()), "a Step"),
        (Step([0.0] * 8), r"\.dq is \[0.0"),
        (Step(np.zeros(3)), "dq.*8 finite numbers"),
        (Step(np.zeros((8, 1))), "dq.*8 finite numbers"),
        (Step(np.full(8, np.nan)), "dq.*8 finite numbers"),
        (Step(np.zeros(8), clipped=np.zeros(3, dtype=bool)), "clipped.*8 times True or False"),
        (Step(np.zeros(8), reason=None), "reason is not given.*text"),
        (Step(np.zeros(8), violated_constraints="margin"), "violated_constraints is 'margin'.*tuple"),
        (Step(np.zeros(8), near=(1,)), "near.*tuple of texts"),
        (Step(np.zeros(8), info=["sigma"]), "info.*a mapping"),
        (Step(np.zeros(8), info={"a b": 1.0}), r"info \(name\) is 'a b'.*letters"),
        (Step(np.zeros(8), info={"how": None}), r"info\['how'\] is not given.*a number, text"),
        (Step(np.zeros(8), info={"how": [object()]}), r"info\['how'\].*a number, text"),
        (Step(np.zeros(8), None), "active is not given.*0 to 3"),
        (Step(np.zeros(8), (4,)), r"active is \(4,\)"),
        (Step(np.zeros(8), memory={"dq": 0}), "memory is {'dq': 0}.*Memory"),
        (Step(np.full(8, "a")), "dq.*8 finite numbers"),
        (Step(np.full(8, 1e20)), "dq.*8 finite numbers"),
        (Step(np.full(8, None)), "dq.*8 finite numbers"),
        (Step(np.zeros(8, dtype=complex)), "dq.*8 finite numbers"),
        (Step(np.zeros(8, dtype=bool)), "dq.*8 finite numbers"),
        (Step(np.zeros(8), (0.5,)), r"active is \(0\.5,\)"),
        (Step(np.zeros(8), ("tip",)), r"active is \('tip',\)"),
        (Step(np.zeros(8), (True,)), r"active is \(True,\)"),
        (Step(np.zeros(8), clipped=np.zeros(8)), "clipped.*8 times True or False"),
        (Step(np.zeros(8), clipped=[[True], True]), "clipped.*8 times True or False"),
        (Step(np.zeros(8), error_increasing=np.zeros(8)), "error_increasing.*True or False"),
        (Step(np.zeros(8), following_path=None), "following_path is not given.*True or False"),
        (Step(np.zeros(8), info={"how": np.nan}), r"info\['how'\] is nan.*not NaN"),
        (Step(np.zeros(8), info={"how": [[1.0], 2.0]}), r"info\['how'\].*an array"),
        (Step(np.zeros(8), info={"how": lambda: 1.0}), r"info\['how'\].*a number"),
        (Step(np.zeros(8), memory=Memory(np.zeros(3))), r"memory\.dq.*an array of 8"),
        (Step(np.zeros(8), memory=Memory([0.0] * 8)), r"memory\.dq.*an array of 8"),
        (Step(np.zeros(8), memory=Memory(np.zeros(8), np.zeros(8))), r"memory\.stopping.*\(k, 8\)"),
    ],
)
def test_a_step_that_is_none_is_refused_with_what_was_allowed(arm, returned, words):
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    with pytest.raises(InvalidValue, match=words):
        pp.track(arm, target, arm.straight(), Returning(returned), max_steps=2)


class Failing:
    """Divides by zero in the file of the test, below its step."""

    name = "failing"

    def step(self, state, target, limits=None, memory=None):
        return self.divided(np.zeros(8).tolist())

    def divided(self, values):
        return values[0] / values[1]


def test_an_exception_in_a_step_names_the_controller_and_the_place(arm):
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    words = r"^Failing\.step\(\.\.\.\) raised ZeroDivisionError: .*\(test_own_controller\.py, line (\d+)\)$"
    with pytest.raises(ControllerError, match=words) as caught:
        pp.track(arm, target, arm.straight(), Failing())
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    line = int(re.search(words, str(caught.value))[1])
    assert "values[0] / values[1]" in Path(__file__).read_text().splitlines()[line - 1]
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    with pytest.raises(ControllerError, match=words):
        pp.track_many(arm, target, arm.straight(), Failing(), jobs=1)


def test_values_that_are_computed_later_are_part_of_the_step(arm):
    class Lazy:
        name = "lazy"

        def step(self, state, target, limits=None, memory=None):
            return step_within(limits.apply(state, np.zeros(8)), info={"share": lambda: 1.0 / 0.0})

    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    words = r"^Lazy\.step\(\.\.\.\)\.info raised ZeroDivisionError"
    with pytest.raises(ControllerError, match=words):
        pp.track(arm, target, arm.straight(), Lazy())


def test_what_is_reported_must_be_like_before(arm):
    class Changing:
        name = "changing"

        def step(self, state, target, limits=None, memory=None):
            return Step(np.full(8, 0.01), info={"share": 1.0 if memory is None else [1.0, 2.0]})

    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    with pytest.raises(InvalidValue, match=r"^Changing\.step\(\.\.\.\)\.info\['share'\].*as before"):
        pp.track(arm, target, arm.straight(), Changing())


def test_a_memory_that_cannot_be_carried_on_is_refused(arm):
    class Kept(Memory):
        def __init__(self, dq, count):
            super().__init__(dq)
            object.__setattr__(self, "count", count)

    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    returning = Returning(Step(np.full(8, 0.01), memory=Kept(np.full(8, 0.01), 1)))
    with pytest.raises(InvalidValue, match=r"memory is.*a dataclass derived from it"):
        pp.track(arm, target, arm.straight(), returning, max_steps=2)


@pytest.mark.parametrize("deadline", [np.inf, 30.0])
@pytest.mark.parametrize("returned", [None, Step(np.full(8, np.nan))])
def test_a_control_loop_holds_and_names_what_a_controller_returned(arm, deadline, returned):
    tracker = pp.Tracker(arm, Returning(returned), LIMITS, deadline=deadline, planning="thread")
    tracker.update(pp.Target.from_configuration(arm, np.full(arm.nq, 0.2)))
    assert not np.any(tracker.step(arm.straight()))
    assert tracker.report.status == "holding" and "Returning.step(...)" in tracker.report.reason


@pytest.mark.parametrize("deadline", [np.inf, 30.0])
def test_a_control_loop_holds_and_logs_where_a_controller_failed(arm, deadline, caplog):
    tracker = pp.Tracker(arm, Failing(), LIMITS, deadline=deadline, planning="thread")
    tracker.update(pp.Target.from_configuration(arm, np.full(arm.nq, 0.2)))
    for _ in range(3):
        assert not np.any(tracker.step(arm.straight()))
    assert tracker.report.status == "holding" and "Failing.step(...) raised" in tracker.report.reason
    logged = [each for each in caplog.records if each.name == "pinposture.motion.tracker"]
    assert len(logged) == 1  # not in every cycle
    assert "values[0] / values[1]" in caplog.text and "ZeroDivisionError" in caplog.text


@pytest.mark.long
def test_an_exception_in_another_process_comes_with_its_traceback(arm):
    targets = [pp.Target.from_configuration(arm, np.full(arm.nq, 0.02 * k)) for k in range(6)]
    with pytest.raises(ControllerError, match=r"^Late\.step\(\.\.\.\) raised ZeroDivisionError") as caught:
        pp.track_many(arm, targets, arm.straight(), Late(), jobs=2)
    told = "".join(traceback.format_exception(caught.value))
    assert "return 1.0 / 0.0" in told


def test_a_controller_that_other_processes_cannot_have_is_named(arm):
    @dataclass(frozen=True)
    class Locked:
        lock: object
        name: str = "locked"

        def step(self, state, target, limits=None, memory=None):
            return Step(np.full(8, 0.01))

    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    with pytest.raises(InvalidValue, match=r"controller=.*can be pickled"):
        pp.track_many(arm, [target] * 4, arm.straight(), Locked(Lock()), jobs=2, max_steps=2)


class Late:
    """Fails where the target is another, in processes that get the later runs."""

    name = "late"

    def step(self, state, target, limits=None, memory=None):
        if target.points[-1, 0] < state.arm.length - 1e-6:
            return 1.0 / 0.0
        return Step(np.zeros(8), reason="it is there")


def test_a_step_may_leave_its_memory_out(arm):
    class Short:
        name = "short"

        def step(self, state, target, limits=None, memory=None):
            return Step(np.full(8, 0.01))

    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    assert pp.track(arm, target, arm.straight(), Short(), max_steps=2).steps == 2


def test_a_step_without_memory_is_remembered_for_the_controller(arm):
    seen = []

    class Forgetful:
        name = "forgetful"

        def step(self, state, target, limits=None, memory=None):
            seen.append(memory)
            return Step(np.full(8, 0.01), (0, 3))

    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    run = pp.track(arm, target, arm.straight(), Forgetful(), max_steps=2)
    assert run.steps == 2
    assert isinstance(seen[1], Memory)
    np.testing.assert_array_equal(seen[1].dq, np.full(8, 0.01))


@dataclass
class Reporting:
    """Moves a little and reports what it is told to, one report a step."""

    reports: list[dict[str, object]]
    name: str = "reporting"

    def step(self, state, target, limits=None, memory=None):
        return Step(np.full(8, 0.01), info=self.reports.pop(0))


def reported(arm, *reports):
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    return pp.track(arm, target, arm.straight(), Reporting(list(reports)), max_steps=len(reports))


def test_what_a_controller_reports_becomes_a_column(arm, tmp_path):
    first = {"gain": 0.5, "count": 3, "mode": "far", "edges": np.array([1.0, 2.0])}
    run = reported(arm, first, {"gain": np.inf, "mode": "near the end"}, {"near": True})
    expected = {
        "gain": [0.5, np.inf, 0.0],
        "count": [3, 0, 0],
        "mode": ["far", "near the end", ""],
        "edges": [[1.0, 2.0], [0.0, 0.0], [0.0, 0.0]],
        "near": [False, False, True],
    }
    batch = pp.track_many(
        arm,
        run.target,
        [arm.straight()] * 2,
        Reporting([first, {}, {"more": 1.0}, {}]),
        max_steps=2,
        jobs=1,
    )
    saved = pp.load(pp.save(run, tmp_path / "run.npz"))
    for each in (run, saved):
        assert {name: column.tolist() for name, column in each.info.items()} == expected
        assert not any(column.flags.writeable for column in each.info.values())
    again = pp.load(pp.save(batch, tmp_path / "batch.npz"))
    for each in (batch, again):
        assert [set(run.info) for run in each] == [set(first), {"more"}]
        assert each[0].info["mode"].tolist() == ["far", ""]
        assert each[1].info["more"].tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    ("second", "words"),
    [
        ({"how": np.zeros(2)}, r"info\['how'\].*numbers of shape \(\), as before"),
        ({"how": "well"}, r"info\['how'\] is 'well'; allowed: numbers of shape"),
    ],
)
def test_a_report_of_another_kind_than_before_is_refused(arm, second, words):
    with pytest.raises(InvalidValue, match=words):
        reported(arm, {"how": 1.0}, second)


def test_reports_that_look_like_those_of_the_library_harm_no_figure(arm):
    report = {"switched": 1.0, "method": 2, "sigma_max": "much", "manipulability": np.zeros(3)}
    run = reported(arm, report, report)
    assert run.switches == ()
    pp.plot(run)


def test_what_is_no_function_is_refused_before_the_first_step(arm):
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    keyframes = [pp.Keyframe(joints=(0.0,) * 8), pp.Keyframe(joints=(0.1,) * 8, duration=1.0)]
    task = pp.Task(arm, keyframes, LIMITS)
    for call in (
        lambda: pp.track(arm, target, arm.straight(), callback=3),
        lambda: pp.track_many(arm, target, arm.straight(), progress="often", jobs=1),
        lambda: pp.plan(arm.at(arm.straight()), target, progress=3),
        lambda: task.reference(progress=[]),
        lambda: task.perform(progress=3),
    ):
        with pytest.raises(InvalidValue, match=r"(callback|progress) is .*a function, or None"):
            call()


def test_what_a_callback_raises_is_raised(arm):
    target = pp.Target.from_configuration(arm, np.full(arm.nq, 0.2))
    with pytest.raises(ZeroDivisionError):
        pp.track(arm, target, arm.straight(), callback=lambda *_: 1.0 / 0.0)
