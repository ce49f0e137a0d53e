"""The shipped arms are those of the thesis, in the files as in the data, for Pinocchio as for yourdfpy."""

from __future__ import annotations

import io
import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.cases import scenarios
from pinposture.arm.description import read_description
from pinposture.arm.template import DENSITY
from pinposture.errors import FileError

DIRECTORY = Path(__file__).resolve().parents[2] / "urdf"
# name: joint letters, links [m], length [m]; written down here from Sections 6.1 and 6.2
EXPECTED = {
    "ryrz20": ("yz" * 20, [0.025] * 40, 1.0),
    "planar45": ("z" * 45, [0.15] * 45, 6.75),
    "mixed12": ("yzzy" * 6, [0.03, 0.04, 0.02, 0.035] * 6, 0.75),
}
NAMES = list(EXPECTED)
UNIT = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}


def path_of(name):
    return DIRECTORY / f"{name}.urdf"


def load(name):
    model = pin.buildModelFromUrdf(str(path_of(name)))
    return model, model.createData()


def tip_placement(model, data, q):
    pin.framesForwardKinematics(model, data, q)
    return np.array(data.oMf[model.getFrameId("tip")].homogeneous)


def test_the_files_are_not_stale():
    written = {path.name: path.read_bytes().decode() for path in DIRECTORY.glob("*.urdf")}
    assert written == scenarios.urdf_files(), "run `make urdf`"


def test_the_data_are_the_arms_of_the_thesis():
    assert set(scenarios.urdf_files()) == {f"{name}.urdf" for name in NAMES}
    assert [module.name for module in scenarios.SPATIAL] == ["RyRz"] * 20
    assert [module.name for module in scenarios.PLANAR] == ["Rz"] * 45
    assert [module.name for module in scenarios.MIXED] == ["RyRz", "RzRy"] * 6


@pytest.mark.parametrize("name", NAMES)
def test_joints_axes_limits_and_links_are_as_stated(name):
    axes, lengths, total = EXPECTED[name]
    model, data = load(name)
    assert (model.name, model.nq, model.nv) == (name, len(axes), len(axes))
    assert [joint.shortname() for joint in list(model.joints)[1:]] == [
        f"JointModelR{a.upper()}" for a in axes
    ]
    assert list(model.lowerPositionLimit) == [-math.pi] * len(axes)
    assert list(model.upperPositionLimit) == [math.pi] * len(axes)
    assert np.all(model.velocityLimit > 0.0) and np.all(np.isfinite(model.velocityLimit))
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    tip = tip_placement(model, data, pin.neutral(model))
    for index in range(model.nv):
        np.testing.assert_allclose(data.oMi[index + 1].translation, [starts[index], 0.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(tip[:3, 3], [total, 0.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(tip[:3, :3], np.eye(3), atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_pinocchio_and_yourdfpy_agree_on_joints_limits_and_the_tip(name):
    import yourdfpy

    model, data = load(name)
    other = yourdfpy.URDF.load(str(path_of(name)), build_collision_scene_graph=False, load_meshes=False)
    assert other.actuated_joint_names == list(model.names)[1:]
    assert [joint.limit.lower for joint in other.actuated_joints] == list(model.lowerPositionLimit)
    assert [joint.limit.upper for joint in other.actuated_joints] == list(model.upperPositionLimit)
    assert [joint.limit.velocity for joint in other.actuated_joints] == list(model.velocityLimit)
    assert [joint.limit.effort for joint in other.actuated_joints] == list(model.effortLimit)
    rng = np.random.default_rng(20)
    for _ in range(5):
        q = rng.uniform(-math.pi, math.pi, model.nq)
        other.update_cfg(q)
        np.testing.assert_allclose(
            tip_placement(model, data, q), other.get_transform("tip", "base"), rtol=0.0, atol=1e-9
        )


@pytest.mark.parametrize("name", NAMES)
def test_our_own_reading_agrees_and_finds_the_whole_chain(name):
    axes, _, _ = EXPECTED[name]
    read = read_description(path_of(name))
    assert read.longest_chain() == ("base", "tip")
    chain = read.chain("base", "tip")
    assert [joint.axis for joint in chain[:-1]] == [tuple(UNIT[axis]) for axis in axes]
    assert chain[-1].type == "fixed"


@pytest.mark.parametrize("name", NAMES)
def test_masses_are_density_times_volume_and_inertias_physical(name):
    _, lengths, _ = EXPECTED[name]
    radius = 0.02 if name == "planar45" else 0.01
    model, _ = load(name)
    for inertia, length in zip(list(model.inertias)[1:], lengths, strict=True):
        ball, tube = 4.0 / 3.0 * math.pi * radius**3, math.pi * radius**2 * length
        assert inertia.mass == pytest.approx(DENSITY * (ball + tube), rel=1e-12)
        assert inertia.lever == pytest.approx([tube * length / 2.0 / (ball + tube), 0.0, 0.0], abs=1e-15)
        moments = np.linalg.eigvalsh(inertia.inertia)
        assert moments[0] > 0.0
        assert moments[0] + moments[1] > moments[2]


def test_masses_match_the_shapes_that_the_file_draws():
    for name in NAMES:
        for link in ET.parse(path_of(name)).getroot().findall("link"):
            for tag in ("visual", "collision"):
                volume = sum(
                    4 / 3 * math.pi * float(s.get("radius")) ** 3 for s in link.findall(f"{tag}//sphere")
                )
                for tube in link.findall(f"{tag}//cylinder"):
                    volume += math.pi * float(tube.get("radius")) ** 2 * float(tube.get("length"))
                mass = link.find("inertial/mass")
                assert (0.0 if mass is None else float(mass.get("value"))) == pytest.approx(DENSITY * volume)


def test_the_planar_arm_has_parallel_axes_and_the_others_do_not():
    for name in NAMES:
        model, data = load(name)
        pin.computeJointJacobians(model, data, np.random.default_rng(3).uniform(-2.0, 2.0, model.nv))
        spread = np.linalg.svd(data.J[3:], compute_uv=False)
        assert bool(spread[1] < 1e-12) is (name == "planar45")


@pytest.mark.parametrize("kind", [pin.GeometryType.VISUAL, pin.GeometryType.COLLISION])
@pytest.mark.parametrize("name", NAMES)
def test_each_joint_has_a_ball_and_each_link_a_cylinder(name, kind):
    model, _ = load(name)
    shapes = pin.buildGeomFromUrdf(model, str(path_of(name)), kind)
    kinds = [type(shape.geometry).__name__ for shape in shapes.geometryObjects]
    assert kinds.count("Sphere") == kinds.count("Cylinder") == model.nv
    assert shapes.ngeoms == 2 * model.nv


def test_writing_makes_the_directory_replaces_files_and_leaves_nothing_else(tmp_path):
    directory = tmp_path / "deep" / "urdf"
    directory.mkdir(parents=True)
    (directory / "ryrz20.urdf").write_text("old")
    with (directory / "ryrz20.urdf").open() as reader:
        paths = scenarios.write_urdf_files(directory)
        assert reader.read() == "old"  # whoever has the old file open keeps it whole
    assert {
        path.name: path.read_text(encoding="utf-8") for path in directory.iterdir()
    } == scenarios.urdf_files()
    assert sorted(paths) == sorted(directory.iterdir())


def test_where_nothing_can_be_written_the_file_is_named_and_no_draft_stays(tmp_path):
    blocked = tmp_path / "blocked"
    blocked.write_text("a file, not a directory")
    with pytest.raises(FileError, match="blocked: is a file"):
        scenarios.write_urdf_files(blocked)
    (tmp_path / "ryrz20.urdf").mkdir()
    with pytest.raises(FileError):
        scenarios.write_urdf_files(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["blocked", "ryrz20.urdf"]


def test_the_command_says_what_it_wrote(tmp_path, monkeypatch):
    out, err = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    assert scenarios.main([str(tmp_path)]) == 0
    assert out.getvalue().count("\n") == 1 and str(tmp_path / "mixed12.urdf") in out.getvalue()
    assert [scenarios.main(arguments) for arguments in ([], ["--help"], ["a", "b"])] == [2, 2, 2]
    assert err.getvalue().count("usage") == 3
    assert scenarios.main([str(tmp_path / "mixed12.urdf")]) == 1
    assert "is a file" in err.getvalue()


@pytest.mark.process
def test_the_command_runs_as_a_module(tmp_path):
    command = [sys.executable, "-m", "benchmarks.cases", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=DIRECTORY.parent, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert {path.name for path in tmp_path.iterdir()} == set(scenarios.urdf_files())
