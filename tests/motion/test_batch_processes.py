"""Work is spread only where that pays; what all of it needs is sent packed, and unpacked once."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import queue
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from arms import template_arm
from joblib import delayed

import pinposture as pp
from benchmarks.cases.scenarios import SPATIAL_SCENARIOS
from benchmarks.studies.arms import survey_arms
from benchmarks.studies.methods import compare_methods
from benchmarks.studies.runs import study_scenarios
from pinposture.errors import InvalidValue
from pinposture.motion import processes
from pinposture.motion.processes import Shared, adaptively_in_order, in_order

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


def squares(n: int) -> list:
    return [delayed(pow)(k, 2) for k in range(n)]


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """How many calls were sent, to how many processes."""
    seen = []

    def noted(tasks, jobs):
        tasks = list(tasks)
        seen.append((len(tasks), jobs))
        return iter([function(*given) for function, given, _ in tasks])

    monkeypatch.setattr(processes, "_distribute", noted)
    return seen


def test_little_work_stays_here(sent: list) -> None:
    assert list(adaptively_in_order(squares(9), None)) == [k**2 for k in range(9)]
    assert sent == []


def test_long_work_goes_to_all_processes_after_a_trial(sent: list, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0, *range(0, 100, 2)])  # two seconds each
    monkeypatch.setattr(processes, "perf_counter", lambda: next(clock))
    assert list(adaptively_in_order(squares(9), None)) == [k**2 for k in range(9)]
    assert sent == [(8, -1)]
    sent.clear()
    clock = iter([0, *range(0, 100, 2)])
    assert list(adaptively_in_order(squares(3), None)) == [0, 1, 4]  # what is left takes 4 s
    assert sent == []


def test_whoever_says_where_is_obeyed_at_once(sent: list) -> None:
    list(adaptively_in_order(squares(2), 3))
    with joblib.parallel_config(n_jobs=2):
        list(adaptively_in_order(squares(2), None))
    with joblib.parallel_config(backend="threading"):
        list(adaptively_in_order(squares(2), None))
    assert sent == [(2, 3), (2, 2), (2, -1)]


def test_within_the_work_of_others_nothing_is_distributed() -> None:
    def nested() -> tuple[list, list]:
        seen = []
        original = processes._distribute
        processes._distribute = lambda tasks, jobs: seen.append(jobs) or iter(())
        try:
            return list(adaptively_in_order(squares(2), None)), seen
        finally:
            processes._distribute = original

    with joblib.parallel_config(backend="threading", n_jobs=2):
        found = joblib.Parallel()([delayed(nested)()])
    assert found == [([], [1])]


def test_processes_leave_the_threads_of_blas_out(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in THREADS:
        monkeypatch.setenv(name, "2")
    tasks = [delayed(os.getenv)(name) for name in (THREADS[0], *THREADS)]
    assert list(in_order(tasks, 1)) == ["2"] * 3  # those of this process are its user's
    assert list(in_order(tasks, 2)) == ["2", "1", "1"]  # the first call is made here


@pytest.mark.parametrize("interrupted", [True, False])
def test_an_interruption_stays_one_if_joblib_fails_to_end_its_processes(
    interrupted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object, **__: object) -> Any:
        try:
            raise KeyboardInterrupt if interrupted else ValueError
        except BaseException:
            raise RuntimeError("cannot join thread before it is started")  # noqa: B904

    monkeypatch.setattr(processes, "_distribute_once", failing)
    with pytest.raises(KeyboardInterrupt if interrupted else RuntimeError):
        list(in_order(squares(3), 2))


def test_what_all_share_is_unpacked_once() -> None:
    shared = Shared([1, 2])
    sent = [pickle.loads(pickle.dumps((shared, k))) for k in range(3)]
    assert sent[0][0].value == [1, 2]
    assert sent[0][0].value is not shared.value
    assert all(each is sent[0][0] for each, _ in sent)
    other = pickle.loads(pickle.dumps(Shared([3])))
    assert other.value == [3]


@pytest.mark.parametrize("jobs", [1, 2, -1])
def test_results_are_in_the_order_of_the_calls(jobs: int) -> None:
    assert list(in_order((delayed(pow)(n, 2) for n in range(7)), jobs)) == [n**2 for n in range(7)]


@pytest.mark.parametrize("jobs", [0, -2, True, 1.5, "2"])
def test_a_number_of_processes_that_is_none_is_refused(jobs: object, tmp_path) -> None:
    arm = template_arm("RyRz", 3)
    (tmp_path / "arm.urdf").write_text(arm.urdf)
    calls = (
        lambda: study_scenarios(arm, SPATIAL_SCENARIOS[:1], ["joint"], [0], jobs=jobs),
        lambda: compare_methods(arm, ["joint"], [0]).rows(jobs),
        lambda: survey_arms(tmp_path).rows(jobs),
    )
    for call in calls:
        with pytest.raises(InvalidValue, match="jobs"):
            call()


def die_once(marker: str) -> str:
    """End the process that makes the call, except for the second time."""
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "made"


@pytest.mark.process
def test_calls_that_are_lost_with_a_process_are_made_again(tmp_path: Path) -> None:
    tasks = [*squares(6), delayed(die_once)(str(tmp_path / "died")), *squares(4)]
    assert list(in_order(tasks, 2)) == [0, 1, 4, 9, 16, 25, "made", 0, 1, 4, 9]


@dataclass(frozen=True)
class Deadly(pp.Geodesic):
    """A controller that ends other processes than its own if it is to move to a certain target."""

    home: int = 0

    def step(self, state, target, limits=None, memory=None):
        if target.weights[0] == 0.5 and os.getpid() != self.home:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(state, target, limits, memory)


@pytest.mark.process
def test_runs_that_are_there_are_kept_if_processes_are_killed_again_and_again() -> None:
    arm = template_arm("RyRz", 3)
    goal = pp.Target.from_configuration(arm, [0.1] * arm.nv)
    deadly = replace(goal, weights=[0.5, 1.0, 1.0])
    with pytest.warns(pp.PostureWarning, match="runs failed; run 3: ProcessError"):
        batch = pp.track_many(
            arm, [goal, goal, goal, deadly], arm.straight(), Deadly(home=os.getpid()), jobs=2
        )
    assert batch.status.tolist() == ["converged", "converged", "converged", "failed"]
    assert "1 of 4 calls were not made" in batch.reason[3]


def _tracked(arm: pp.Arm, results: Any) -> None:
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)}, margin=0.01)
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.2))
    run = pp.track(arm, target, np.zeros(arm.nv), limits=pp.Limits(step=0.1), scene=scene)
    batch = pp.track_many(arm, [target], [np.zeros(arm.nv)] * 3, limits=pp.Limits(step=0.1), jobs=2)
    results.put((run.q, batch.q_final))


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
def test_a_process_of_any_kind_makes_the_same_runs(method: str) -> None:
    arm = template_arm("RyRz", 3)
    here: queue.Queue[Any] = queue.Queue()
    _tracked(arm, here)
    context = multiprocessing.get_context(method)
    results = context.Queue()
    child = context.Process(target=_tracked, args=(arm, results))
    child.start()
    for found, expected in zip(results.get(timeout=120.0), here.get(), strict=True):
        np.testing.assert_array_equal(found, expected)
    child.join(60.0)
    assert child.exitcode == 0


WITHOUT_STREAMS = """
import sys
import numpy as np
import pinposture as pp

arm = pp.Arm.from_template("RyRz", 3)
targets = [pp.Target.from_configuration(arm, np.full(6, 0.1 * k)) for k in range(4)]
sys.stdout = sys.stderr = None
batch = pp.track_many(arm, targets, arm.neutral(), jobs=2)
tracker = pp.Tracker(arm, limits=pp.Limits(velocity=1.0, acceleration=5.0, dt=0.01), deadline=0.002)
sys.exit(0 if all(batch.converged) else 3)
"""


@pytest.mark.process
@pytest.mark.long
def test_a_program_without_a_console_starts_processes(tmp_path: Path) -> None:
    script = tmp_path / "service.py"
    script.write_text(WITHOUT_STREAMS)
    subprocess.run([sys.executable, str(script)], cwd=tmp_path, timeout=120, check=True)
