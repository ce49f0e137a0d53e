"""Joint motions in files: what is written comes back, and what is damaged or missing is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion.joint_motions import FILES, TABLES, arm, assert_same, motions, of_arm

import pinposture as pp
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_files import SUFFIXES
from pinposture.motion.joint_trajectory import JointTrajectory

PAGE = Path(__file__).parents[2] / "docs/trajectories.md"


def test_the_page_shows_what_its_example_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = {
        kind: re.findall(rf"```{kind}\n(.*?)```", PAGE.read_text(), re.DOTALL)[0]
        for kind in ("python", "csv", "json")
    }
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pp, "JointTrajectory", JointTrajectory, raising=False)
    exec(shown["python"], {})
    assert Path("motion.csv").read_text() == shown["csv"]
    message = json.loads(Path("motion.json").read_text())
    assert message | {"points": message["points"][:2]} == json.loads(shown["json"])


@FILES
@given(motions())
def test_arrays_come_back_to_the_last_bit(tmp_path: Path, motion: JointTrajectory) -> None:
    again = pp.load(pp.save(motion, tmp_path / "motion.npz"), JointTrajectory)
    assert_same(again, motion)
    assert again.name == motion.name


@FILES
@given(st.integers(0, 10**6), st.permutations(range(4)), st.sampled_from([".npz", ".csv", ".json"]))
def test_motions_of_an_arm_come_back_whatever_the_order_of_its_joints(
    tmp_path: Path, seed: int, order: list[int], suffix: str
) -> None:
    motion = of_arm(seed)
    mixed = JointTrajectory(
        [motion.joint_names[k] for k in order],
        motion.time,
        *(getattr(motion, name)[:, order] for name in TABLES[1:]),
    )
    again = pp.load(pp.save(mixed, tmp_path / f"motion{suffix}"), JointTrajectory).matched(arm())
    assert again.units == ("rad", "m", "rad", "rad")
    assert_same(again, motion, TABLES[1:])
    np.testing.assert_allclose(again.time, motion.time, atol=1e-9)
    np.testing.assert_array_equal(again.configurations(arm()), motion.configurations(arm()))


def test_arrays_are_read_without_this_library(tmp_path: Path) -> None:
    motion = of_arm(1)
    with np.load(pp.save(motion, tmp_path / "a.npz"), allow_pickle=False) as stored:
        assert stored["joint_names"].tolist() == ["j1", "j2", "j3", "j4"]
        assert stored["units"].tolist() == ["rad", "m", "rad", "rad"]
        np.testing.assert_array_equal(stored["positions"], motion.positions)


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".json"])
def test_files_appear_whole_or_not_at_all(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = pp.save(of_arm(1), tmp_path / f"a{suffix}")
    old = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(FileError, match="No space left"):
        pp.save(of_arm(2), path)
    assert (path.read_bytes(), [file.name for file in tmp_path.iterdir()]) == (old, [path.name])


def test_damaged_archives_are_refused(tmp_path: Path) -> None:
    path = pp.save(of_arm(3), tmp_path / "a.npz")
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for length in rng.integers(0, len(whole) - 1, 20):
        path.write_bytes(whole[:length])
        with pytest.raises(FileError, match="is not a saved joint trajectory"):
            pp.load(path, JointTrajectory)
    arrays = dict(np.load(pp.save(of_arm(3), path)))
    for change in (
        {"positions": arrays["positions"][:-1]},
        {"time": arrays["time"][::-1]},
        {"velocities": np.array([{}], dtype=object)},
        {"joint_names": arrays["joint_names"][:3]},
        {"about": np.array("[]")},
    ):
        np.savez(path, **(arrays | change))
        with pytest.raises(FileError, match="is not a saved joint trajectory"):
            pp.load(path, JointTrajectory)
    np.savez(path, **(arrays | {"about": np.array(json.dumps({"format": "pinposture-run", "version": 3}))}))
    with pytest.raises(FileError, match="format 'pinposture-run' version 3; allowed: 'pinposture-joint-traj"):
        pp.load(path, JointTrajectory)


class Trap:
    """Leaves a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return Path.touch, (self.path,)


def test_no_code_in_an_archive_is_run(tmp_path: Path) -> None:
    path = pp.save(of_arm(3), tmp_path / "a.npz")
    sprung = tmp_path / "sprung"
    np.savez(path, **(dict(np.load(path)) | {"velocities": np.array([Trap(sprung)], dtype=object)}))
    with pytest.raises(FileError, match=r"is not a saved joint trajectory \(ValueError\)"):
        pp.load(path, JointTrajectory)
    assert not sprung.exists()


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".json"])
@pytest.mark.parametrize("content", [b"\xff\xfe\x00\x01", None])
def test_files_that_are_not_there_or_something_else_are_refused(
    tmp_path: Path, suffix: str, content: bytes | None
) -> None:
    path = tmp_path / f"a{suffix}"
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    for each in (path, tmp_path / f"missing{suffix}"):
        with pytest.raises(FileError) as caught:
            pp.load(each, JointTrajectory)
        assert caught.value.path == each


@pytest.mark.parametrize("name", ["a.txt", "a", "a.npy"])
def test_other_suffixes_are_refused_with_those_there_are(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileError, match=r"allowed: \.npz, \.csv, \.json"):
        pp.save(of_arm(1), tmp_path / name)
    with pytest.raises(FileError, match=r"allowed: \.npz, \.csv, \.json"):
        pp.load(tmp_path / name, JointTrajectory)


def test_joints_of_another_arm_are_named(tmp_path: Path) -> None:
    path = pp.save(of_arm(1), tmp_path / "a.csv")
    with pytest.raises(InvalidValue, match="unknown: 'j1', 'j2'"):
        pp.load(path, JointTrajectory).matched(pp.Arm.from_template("RyRz", 2))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_suffix_that_is_written_is_read(tmp_path, suffix):
    rng = np.random.default_rng(3)
    motion = pp.JointTrajectory.from_positions(("a", "b"), rng.normal(size=(5, 2)), np.arange(5) * 0.125)
    for name in (f"motion{suffix}", f"motion{suffix.upper()}"):
        again = pp.load(pp.save(motion, tmp_path / name), pp.JointTrajectory)
        assert again.joint_names == motion.joint_names
        for part in ("time", "positions", "velocities", "accelerations"):
            np.testing.assert_array_equal(getattr(again, part), getattr(motion, part))


def test_messages_in_yaml_are_read_as_ros_prints_them(tmp_path):
    yaml = pytest.importorskip("yaml")
    motion = pp.JointTrajectory.from_positions(("a", "b"), [[0.0, 1.0], [0.5, 1e-7]], [0.0, 0.5])
    message = json.loads(pp.save(motion, tmp_path / "m.json").read_text())
    file = tmp_path / "m.yaml"
    for content, end in ((message, ""), (message, "---\n"), ({"trajectory": message}, "")):
        file.write_text("# as printed\n" + yaml.safe_dump(content) + end)
        np.testing.assert_array_equal(pp.load(file).positions, motion.positions)
    for text, says in (
        ("a: [1\n b: 2]", "line 2"),
        ("--- {}\n--- {}", "2 documents"),
        ("joint_names: !!python/object:os.system", "line 1"),
        ("joint_names: [a]\npoints: 2026-01-01", "points"),
        ("", "0 documents"),
    ):
        file.write_text(text)
        with pytest.raises(FileError) as caught:
            pp.load(file)
        assert says in str(caught.value)
    message["points"][0]["positions"] = ["2026-01-01", 1]
    file.write_text(yaml.safe_dump(message).replace("'", ""))
    with pytest.raises(FileError, match=r"points\[0\].positions\[0\]"):
        pp.load(file)


@pytest.mark.parametrize(("name", "says"), [("m.mcap", "bag"), ("t.toml", "pp.Task.load")])
def test_what_is_written_and_not_read_as_a_result_is_said(tmp_path, name, says):
    (tmp_path / name).write_text("")
    with pytest.raises(FileError, match=says):
        pp.load(tmp_path / name)
