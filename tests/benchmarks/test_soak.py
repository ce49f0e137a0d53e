"""Loops of every kind keep nothing of the cycles before: objects are counted, in small."""

from __future__ import annotations

import argparse
import ctypes
import gc
import itertools
import sys

import pytest

import pinposture as pp
from benchmarks.studies import soak
from pinposture.collision import CollisionModel

SCENARIOS = (
    *("faults", "obstacles", "drifting", "scenes", "limits"),
    *("jumps", "scans", "follow", "tip", "restarts"),
)


@pytest.mark.soak
@pytest.mark.filterwarnings("ignore::pinposture.errors.PostureWarning")
@pytest.mark.parametrize(
    ("scenario", "jerk"), [*((name, None) for name in SCENARIOS), ("obstacles", 100.0), ("limits", 100.0)]
)
def test_a_loop_keeps_nothing_of_the_cycles_before(
    scenario: str, jerk: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert set(SCENARIOS) == set(soak.SCENARIOS)
    given = argparse.Namespace(
        seed=0, modules=4, free=False, jerk=jerk, controller="geodesic", deadline=float("inf")
    )
    loop, change = soak.Loop(given, scenario), soak.SCENARIOS[scenario]
    # Scenes change every 50 cycles: caches of them are full after 150.
    monkeypatch.setattr("pinposture.arm.arm.MAX_KEPT", 3)
    first = {"tip": 20}.get(scenario, 200)
    count = {"tip": 20}.get(scenario, 60)
    objects: list[int] = []
    blocks: list[int] = []
    kilobytes: list[float] = []
    cycles = itertools.count()
    for part in (first, count, count, count):
        for cycle in itertools.islice(cycles, part):
            loop.cycle(change, cycle)
        gc.collect()
        objects.append(len(gc.get_objects()))
        blocks.append(sys.getallocatedblocks())
        kilobytes.append(allocated() / 1024)
    # Plans and scans come and go: a plan has 300 objects.
    assert min(objects[2:]) < max(objects[:2]) + 300 + count
    # Up to 320 blocks of memory were counted, as joints fail and loops start again. Numbers and arrays are no
    # objects of the collector.
    assert min(blocks[2:]) < max(blocks[:2]) + 500 + 2 * count
    assert min(kilobytes[2:]) < max(kilobytes[:2]) + 100  # up to 4 were counted


class MallocInfo(ctypes.Structure):
    """What `mallinfo2` of the GNU C library tells; `uordblks` and `hblkhd` are bytes in use."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
            *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
        )
    )


def allocated() -> int:
    """Bytes in use beside Python's small blocks, of arrays above all; 0 with other C libraries."""
    tell = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if tell is None:
        return 0
    tell.restype = MallocInfo
    told = tell()
    return int(told.uordblks + told.hblkhd)


@pytest.mark.soak
@pytest.mark.filterwarnings("ignore::pinposture.errors.PostureWarning")
def test_a_cycle_beside_a_scan_does_the_same_work_from_the_first_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Joints that sag as the loop begins are never seen to start from rest, as its targets keep jumping."""
    places: list[pp.Target] = []
    update = pp.Geodesic._plan
    monkeypatch.setattr(pp.Geodesic, "_plan", lambda *given: places.append(given[2]) or update(*given))
    given = argparse.Namespace(
        seed=0, modules=4, free=False, jerk=None, controller="geodesic", deadline=float("inf")
    )
    loop = soak.Loop(given, "scans")
    for cycle in range(100):
        loop.cycle(soak.scans, cycle)
    places.clear()
    for cycle in range(100, 150):
        loop.cycle(soak.scans, cycle)
    assert len(places) == 50  # the feedback moves the target in each


def test_models_of_moments_do_not_hold_each_other() -> None:
    arm = pp.Arm.from_template("RyRz", modules=3)
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.2, 0.1), 0.03), "far": pp.Sphere((1.0, 0.0, 0.0), 0.1)})
    made = [CollisionModel(arm, scene.moved({"ball": (0.0, 0.0, 0.001 * k)})) for k in range(20)]
    assert made[-1] is CollisionModel(arm, made[-1].scene)
    del made[:-1]
    gc.collect()
    ours = [
        each for each in gc.get_objects() if isinstance(each, CollisionModel) and each._model is arm.model
    ]
    assert len(ours) <= 2  # that of the scene, and that of the last moment


def test_a_model_of_moving_obstacles_checks_the_same_pairs_as_one_made_for_them() -> None:
    arm = pp.Arm.from_template("RyRz", modules=5)
    around = {
        "foot": pp.Box((0.0, 0.0, -0.02), (0.1, 0.1, 0.02)),  # the arm is mounted on it
        "beside": pp.Sphere((0.0, 0.02, 0.0), 0.01),
        "ball": pp.Sphere((0.1, 0.1, 0.0), 0.02),
    }
    scene = pp.Scene(around, margin=0.005, self_collision=True)
    still = CollisionModel(arm, scene)
    assert {each.second for each in still.excluded_pairs} >= {"foot", "beside"}
    moved = CollisionModel(arm, scene.moved({"foot": (0.0, 0.0, 0.0)}))
    own = len([pair for pair in still.pairs if pair[1] not in around])
    movable = len({pair[0] for pair in moved.pairs if pair[1] == "foot"})
    assert movable == len({pair[0] for pair in still.pairs if pair[1] == "ball"})
    assert "foot" not in {each.second for each in moved.excluded_pairs}
    assert "beside" in {each.second for each in moved.excluded_pairs}
    assert len([pair for pair in moved.pairs if pair[1] not in around]) == own
