"""A file gives a motion in time back to the last bit, or says what is wrong with it."""

from __future__ import annotations

import json
import pickle
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.files import kind_of
from pinposture.motion.trajectory import Trajectory
from pinposture.task import Reference, Waypoint, perform

LIMITS = pp.Limits(step=None, velocity=np.full(8, 1.5), dt=0.05, acceleration=30.0, position_margin=0.01)


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 4)


def motion_of(
    arm: pp.Arm, controller: str = "geodesic", ball: bool = False, stop: int | None = None
) -> Trajectory:
    s = np.linspace(0.0, 1.0, 31)[:, None]
    offsets = s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * np.linspace(0.2, -0.5, arm.nv)
    weights = np.ones((31, 4))
    weights[10:20, 1] = 0.0
    q = np.full(arm.nv, 0.1)
    waypoints = tuple(
        Waypoint(name, row, pp.Target.from_configuration(arm, q + offsets[row]))
        for name, row in (("first, with ä", 0), ("middle", 15), ("last", 30))
    )
    told: list[float] = []

    def progress(time: float, _: float) -> bool:
        told.append(time)
        return len(told) == stop

    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.0, 0.35), 0.02)}) if ball else None
    reference = Reference(arm, 0.04, q, offsets, weights, waypoints)
    return perform(reference, controller, LIMITS, scene, q0=q + 0.05, progress=progress)


@pytest.fixture(scope="module")
def motion(arm: pp.Arm) -> Trajectory:
    return motion_of(arm)


@pytest.fixture(scope="module")
def content(motion: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return pp.save(motion, tmp_path_factory.mktemp("motion") / "motion.npz").read_bytes()


def assert_equal(one: Trajectory, other: Trajectory) -> None:
    """All of it: arrays to the last bit and of the same kind, numbers, words, and the run within."""
    for pair in ((one, other), (one.run, other.run)):
        for field in fields(pair[1]):
            got, value = (getattr(each, field.name) for each in pair)
            if isinstance(value, np.ndarray):
                assert got.dtype == value.dtype, field.name
                np.testing.assert_array_equal(got, value, err_msg=field.name)
            elif field.name in (
                "start_index",
                "planned",
                "passed",
                "deviations",
                "limits",
                "scene",
                "status",
                "reason",
            ):
                assert got == value and type(got) is type(value), field.name
    np.testing.assert_array_equal(one.run.target.points, other.run.target.points)
    np.testing.assert_array_equal(one.run.target.q, other.run.target.q)
    assert one.arm.joint_names == other.arm.joint_names
    np.testing.assert_array_equal(one.arm.at(one.q[-1]).points, other.arm.at(other.q[-1]).points)
    for name in ("velocities", "accelerations", "time", "mean_error", "duration", "time_scale"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert repr(one) == repr(other)


KINDS = {
    "followed": {},
    "in a scene": {"ball": True},
    "stopped": {"stop": 14},
    "before it set out": {"stop": 1},
    "another controller": {"controller": "joint"},
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_gives_everything_back(arm: pp.Arm, kind: str, tmp_path: Path) -> None:
    motion = motion_of(arm, **KINDS[kind])
    path = pp.save(motion, tmp_path / "deep" / "done")
    assert path == tmp_path / "deep" / "done.npz" and list(path.parent.iterdir()) == [path]
    loaded = pp.load(path, Trajectory)
    assert_equal(loaded, motion)
    again = pp.save(loaded, tmp_path / "again.npz")
    assert_equal(pp.load(again, Trajectory), motion)


def test_a_file_has_every_field_of_a_target(arm: pp.Arm, tmp_path: Path) -> None:
    target = replace(
        pp.resolve_targets(arm, pp.Curve.line((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), placement="align"),
        velocity=np.full(arm.nv, 0.25),
        fallback="its modules zigzag",
        approximate="a local minimum",
    )
    run = pp.track(arm, target, np.full(arm.nq, 0.1), max_steps=2)
    batch = pp.track_many(arm, [target], [np.full(arm.nq, 0.1)] * 2, max_steps=2, jobs=1)
    kept = replace(run, target=target)
    several = replace(batch, targets=(target, replace(target, velocity=None, moved=None)))
    loaded = [
        pp.load(pp.save(kept, tmp_path / "run"), pp.Run).target,
        *pp.load(pp.save(several, tmp_path / "batch"), pp.Batch).targets,
    ]
    assert target.placed_by and target.moved is not None
    for got, given_target in zip(loaded, (target, *several.targets), strict=True):
        for each in fields(pp.Target):
            if each.name != "curve":
                np.testing.assert_equal(getattr(got, each.name), getattr(given_target, each.name), each.name)
        assert got.curve.to_dict() == given_target.curve.to_dict()
    assert type(loaded[0].moved) is type(target.moved)


def test_a_motion_pickles(motion: Trajectory) -> None:
    assert_equal(pickle.loads(pickle.dumps(motion)), motion)


def test_its_arrays_are_not_to_be_written_to(motion: Trajectory, tmp_path: Path) -> None:
    loaded = pp.load(pp.save(motion, tmp_path / "motion"), Trajectory)
    for each in (motion, loaded):
        for array in (each.targets, each.target_mask, each.plan_time, each.q):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0


def test_files_of_other_kinds_name_who_reads_them(arm: pp.Arm, motion: Trajectory, tmp_path: Path) -> None:
    target = pp.Target.from_configuration(arm, np.full(8, 0.2))
    whole = pp.save(motion, tmp_path / "motion")
    run = pp.save(motion.run, tmp_path / "run")
    batch = pp.save(
        pp.track_many(arm, [target], [arm.neutral()], "geodesic", LIMITS, max_steps=3), tmp_path / "batch"
    )
    joints = pp.save(motion.joint_trajectory(force=True), tmp_path / "joints.npz")
    kinds = {whole: Trajectory, run: pp.Run, batch: pp.Batch, joints: pp.JointTrajectory}
    assert {path: type(pp.load(path)) for path in kinds} == {path: kind_of(path) for path in kinds} == kinds
    for path, reader in ((run, "as a Run"), (batch, "as a Batch")):
        with pytest.raises(FileError, match=reader):
            pp.load(path, Trajectory)
    with pytest.raises(FileError, match=r"contains a motion in time; its run is pp.load\(file\)\.run"):
        pp.load(whole, pp.Run)
    with pytest.raises(FileError):
        pp.load(whole, pp.Batch)
    assert pp.load(run, pp.Run).status == motion.run.status


def test_what_has_no_format_is_neither_saved_nor_loaded(
    arm: pp.Arm, motion: Trajectory, tmp_path: Path
) -> None:
    with pytest.raises(InvalidValue, match=r"result is .*allowed: Run, Trajectory.*Simulation.*; curves"):
        pp.save(arm, tmp_path / "arm")
    with pytest.raises(FileError, match="joint_trajectory"):
        pp.save(motion.run, tmp_path / "run.csv")
    with pytest.raises(InvalidValue, match=r"kind is .*Arm"):
        pp.load(pp.save(motion, tmp_path / "motion"), pp.Arm)
    np.savez(tmp_path / "other.npz", about=np.array(json.dumps({"format": "other", "version": 1})))
    with pytest.raises(FileError, match=r"format 'other' version 1; allowed: 'pinposture-run' version 6, "):
        pp.load(tmp_path / "other.npz")
    assert kind_of(tmp_path / "other.npz") is None


def test_what_is_missing_or_no_such_file_is_named(motion: Trajectory, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no such file"):
        pp.load(tmp_path / "nowhere.npz", Trajectory)
    with pytest.raises(FileError, match="is a directory; name a file in it"):
        pp.load(tmp_path)
    for name, text in (("empty.npz", b""), ("text.npz", b"not an archive"), ("zip.npz", b"PK\x03\x04")):
        (tmp_path / name).write_bytes(text)
        with pytest.raises(FileError, match=name):
            pp.load(tmp_path / name, Trajectory)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FileError):
        pp.save(motion, tmp_path / "file" / "motion.npz")


def repacked(content: bytes, tmp_path: Path, **changed: object) -> Path:
    """A file with other arrays; None takes one away."""
    path = tmp_path / "changed.npz"
    path.write_bytes(content)
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files}
    for name, value in changed.items():
        if value is None:
            del arrays[name]
        else:
            arrays[name] = value
    np.savez(path, **arrays)
    return path


def test_arrays_that_do_not_fit_are_refused(content: bytes, motion: Trajectory, tmp_path: Path) -> None:
    assert_equal(pp.load(repacked(content, tmp_path), Trajectory), motion)
    for name in ("motion_targets", "motion_target_mask", "motion_plan_time"):
        whole = getattr(motion, name.removeprefix("motion_"))
        for wrong in (None, whole[:-1], np.zeros(3), whole[..., None]):
            with pytest.raises(FileError, match=r"changed\.npz"):
                pp.load(repacked(content, tmp_path, **{name: wrong}), Trajectory)


def test_a_file_without_a_cycle_or_with_an_unknown_version_or_status_is_refused(
    content: bytes, tmp_path: Path
) -> None:
    path = repacked(content, tmp_path)
    with np.load(path) as stored:
        about = json.loads(str(stored["about"]))
    for key in ("dt", "motion"):
        spoilt = {**about, key: None}
        with pytest.raises(FileError):
            pp.load(repacked(content, tmp_path, about=np.array(json.dumps(spoilt))), Trajectory)
    newer = np.array(json.dumps({**about, "version": 99}))
    with pytest.raises(FileError, match="99"):
        pp.load(repacked(content, tmp_path, about=newer), Trajectory)
    ended = np.array(json.dumps({**about, "status": "finished"}))
    with pytest.raises(FileError, match="no status is called 'finished'"):
        pp.load(repacked(content, tmp_path, about=ended), Trajectory)


@given(data=st.data())
@examples(30)
def test_a_damaged_file_is_refused_or_whole(
    data: st.DataObject, content: bytes, motion: Trajectory, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    at = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        path.write_bytes(content[:at])
    else:
        spoilt = bytearray(content)
        spoilt[at] ^= data.draw(st.integers(1, 255))
        path.write_bytes(bytes(spoilt))
    try:
        loaded = pp.load(path, Trajectory)
    except FileError as error:
        assert "damaged.npz" in str(error)
    else:
        assert_equal(loaded, motion)


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("q", lambda q: q.astype(str), "q (type) is '<U32'; allowed: numbers"),
        ("q", lambda q: np.where(np.arange(len(q))[:, None] == 1, np.nan, q), "q[1, 0] is nan"),
        ("q", np.zeros_like, "allowed: those of the configuration in this row"),
        ("points", lambda points: points + 0.01, "allowed: those of the configuration in this row"),
        ("point_errors", lambda errors: errors * np.inf, "point_errors"),
        ("active", lambda active: active.astype(float), "active (type) is 'float64'; allowed: True or False"),
        ("violated_constraints", lambda texts: np.zeros(len(texts)), "(type) is 'float64'; allowed: text"),
        ("info_more", lambda _: np.zeros(1), "info_more is 'float64 (1,)'"),
        ("target_weights", None, "weights"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_arrays_of_other_content_are_refused(
    name: str, change: Any, says: str, motion: Trajectory, tmp_path: Path
) -> None:
    stored = dict(np.load(pp.save(motion.run, tmp_path / "run.npz")))
    if change is None:
        del stored[name]
    else:
        stored[name] = change(stored.get(name))
    np.savez(tmp_path / "other.npz", **stored)
    with pytest.raises(FileError) as caught:
        pp.load(tmp_path / "other.npz")
    assert says in str(caught.value)


def test_joint_trajectories_of_a_motion_keep_its_rows_and_rest_at_both_ends(motion: Trajectory) -> None:
    joints = motion.joint_trajectory()
    assert len(joints.time) == motion.steps + 3
    np.testing.assert_allclose(np.diff(joints.time), 0.05)
    assert not np.any(joints.velocities[0]) and not np.any(joints.velocities[-1])
