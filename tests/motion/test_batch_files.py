"""A file gives a batch back to the last bit, or says what is wrong with it."""

from __future__ import annotations

import errno
import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.curve import HELIX, LINE
from pinposture.errors import FileError

LIMITS = pp.Limits(step=None, velocity=np.full(8, 1.5), dt=0.05, acceleration=30.0, position_margin=0.01)


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 4)


@pytest.fixture(scope="module")
def starts(arm: pp.Arm) -> list[np.ndarray]:
    rng = np.random.default_rng(2)
    return [smooth_configuration(arm, rng, 0.5) for _ in range(4)]


@pytest.fixture(scope="module")
def targets(arm: pp.Arm, starts: list[np.ndarray]) -> list[pp.Target]:
    return [
        pp.resolve_targets(arm, HELIX, placement="align"),
        pp.Target.from_configuration(arm, starts[0]),
        pp.Target.from_points(arm, arm.at(starts[1]).points, [1, 0, 0.5, 1]),
        pp.resolve_targets(arm, LINE),
    ]


@pytest.fixture(scope="module")
def batch(arm: pp.Arm, targets: list[pp.Target], starts: list[np.ndarray]) -> pp.Batch:
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.0, 0.35), 0.02)})
    return pp.track_many(arm, targets, starts, "geodesic", LIMITS, scene, max_steps=12)


@pytest.fixture(scope="module")
def content(batch: pp.Batch, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return pp.save(batch, tmp_path_factory.mktemp("batch") / "batch.npz").read_bytes()


def assert_equal(one: object, other: object) -> None:
    """All arrays of the two, and numbers and words."""
    for field in fields(other):
        value = getattr(other, field.name)
        got = getattr(one, field.name)
        if isinstance(value, np.ndarray):
            assert got.dtype == value.dtype, field.name
            np.testing.assert_array_equal(got, value, err_msg=field.name)
        elif isinstance(value, str | int | float | pp.Limits | pp.Scene) or value is None:
            assert got == value, field.name


@pytest.mark.parametrize("keep", ["motions", "ends"])
def test_a_file_gives_everything_back(arm: pp.Arm, batch: pp.Batch, keep: str, tmp_path: Path) -> None:
    batch = batch if keep == "motions" else replace(batch, motions=None)
    path = pp.save(batch, tmp_path / "deep" / "many")
    assert path == tmp_path / "deep" / "many.npz"
    assert list(path.parent.iterdir()) == [path]
    loaded = pp.load(path, pp.Batch)
    assert_equal(loaded, batch)
    assert loaded.arm.urdf == arm.urdf
    for one, other in zip(loaded.targets, batch.targets, strict=True):
        assert_equal(one, other)
        assert (one.curve is None) == (other.curve is None)
        if one.curve is not None:
            assert one.curve.to_dict() == other.curve.to_dict()
    assert (loaded.motions is None) == (keep == "ends")
    if keep == "motions":
        for one, other in zip(loaded.motions, batch.motions, strict=True):
            assert one.keys() == other.keys()
            for name, array in other.items():
                np.testing.assert_array_equal(one[name], array, err_msg=name)
        for one, other in zip(loaded, batch, strict=True):
            assert_equal(one, other)
            np.testing.assert_allclose(one.points, other.points, rtol=0.0, atol=1e-15)


def test_one_target_of_all_stays_one(
    arm: pp.Arm, targets: list[pp.Target], starts: list[np.ndarray], tmp_path: Path
) -> None:
    batch = pp.track_many(arm, targets[0], starts, max_steps=2)
    loaded = pp.load(pp.save(batch, tmp_path / "batch.npz"), pp.Batch)
    assert len(loaded.targets) == 1
    assert_equal(loaded, batch)


def test_numpy_alone_reads_the_arrays(batch: pp.Batch, content: bytes, tmp_path: Path) -> None:
    (tmp_path / "batch.npz").write_bytes(content)
    with np.load(tmp_path / "batch.npz", allow_pickle=False) as stored:
        np.testing.assert_array_equal(stored["q_final"], batch.q_final)
        begin, end = stored["motion_offsets"][1:3]
        np.testing.assert_array_equal(stored["motion_q"][begin:end], batch[1].q)


def test_an_interrupted_write_leaves_no_file(
    batch: pp.Batch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    for failure, raised in ((full, FileError), (interrupted, KeyboardInterrupt)):
        with monkeypatch.context() as patch:
            patch.setattr("os.fsync", failure)
            with pytest.raises(raised):
                pp.save(batch, tmp_path / "batch.npz")
        assert list(tmp_path.iterdir()) == []


def changed(content: bytes, path: Path, **arrays: object) -> Path:
    """The same file with other arrays in it; None leaves one out."""
    path.write_bytes(content)
    with np.load(path) as stored:
        kept = {name: stored[name] for name in stored.files} | arrays
    np.savez(path, **{name: value for name, value in kept.items() if value is not None})
    return path


@pytest.mark.parametrize(
    "damage",
    [
        {"q_final": None},
        {"q_final": np.zeros((4, 7))},
        {"status": np.array(["converged"])},
        {"motion_q": np.zeros((3, 8))},
        {"motion_offsets": np.array([0, 1, 2, 3, 4])},
        {"motion_violated_constraints": None},
        {"target_points": np.zeros((3, 4, 3))},
        {"has_q": np.array([True])},
        {"reason": np.array([{}, {}, {}, {}], dtype=object)},
        {"about": np.array("{}")},
    ],
    ids=lambda damage: next(iter(damage)),
)
def test_arrays_that_do_not_belong_together_are_refused(
    damage: dict[str, object], content: bytes, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match="is not a saved batch"):
        pp.load(changed(content, tmp_path / "batch.npz", **damage), pp.Batch)


def test_texts_that_are_not_there_are_refused(batch: pp.Batch, content: bytes, tmp_path: Path) -> None:
    beyond = np.full(batch.steps.sum(), 1000)
    with pytest.raises(FileError, match="numbers of texts"):
        pp.load(changed(content, tmp_path / "batch.npz", motion_violated_constraints=beyond), pp.Batch)


def test_files_that_are_no_batches_are_named(batch: pp.Batch, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no such file"):
        pp.load(tmp_path / "missing.npz", pp.Batch)
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(FileError, match="not a saved batch"):
        pp.load(tmp_path / "text.npz", pp.Batch)
    with pytest.raises(FileError, match=r"'pinposture-run'.*allowed: 'pinposture-batch'"):
        pp.load(pp.save(batch[0], tmp_path / "run.npz"), pp.Batch)
    with pytest.raises(FileError, match="contains many runs"):
        pp.load(pp.save(batch, tmp_path / "batch.npz"), pp.Run)


@examples(40)
@given(data=st.data())
def test_damaged_bytes_are_noticed_or_do_no_harm(
    data: st.DataObject, batch: pp.Batch, content: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    place = data.draw(st.integers(0, len(content) - 1))
    cut = data.draw(st.booleans())
    other = bytes([content[place] ^ data.draw(st.integers(1, 255))])
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    path.write_bytes(content[:place] if cut else content[:place] + other + content[place + 1 :])
    try:
        loaded = pp.load(path, pp.Batch)
    except FileError as error:
        assert error.path == path
    else:
        assert not cut
        assert_equal(loaded, batch)
