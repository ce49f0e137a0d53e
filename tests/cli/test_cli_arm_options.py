"""Options that every verb which loads an arm has, and starts in degrees."""

from __future__ import annotations

import json

import numpy as np
import pytest

import pinposture as pp

DEGREES = np.array([10.0, -25.0, 30.0, 15.0, -40.0, 20.0, 35.0, -5.0, 12.0, 0.0, 7.5, -60.0])


@pytest.mark.usefixtures("no_pictures")
def test_a_start_in_degrees_is_refused_with_the_option_that_takes_it(command, arm_file, tmp_path):
    asked = ("track", arm_file, "--curve", "helix", "--steps", 1, "-o", tmp_path)
    start = ",".join(map(str, DEGREES))
    refused = command(*asked, "--start", start)
    assert (refused.code, refused.out) == (2, "")
    assert "is it in degrees?" in refused.err
    assert "--degrees" in refused.err
    np.savetxt(tmp_path / "q.csv", DEGREES)
    for given in (start, tmp_path / "q.csv"):
        assert command(*asked, "--start", given, "--degrees").code == 1
        found = pp.load(tmp_path / "run.npz", pp.Run).q[0]
        np.testing.assert_allclose(found, DEGREES * np.pi / 180.0, rtol=1e-15)
    named = command(*asked, "--start", "smooth", "--degrees")
    assert (named.code, "only with numbers" in named.err) == (2, True)


@pytest.mark.long
def test_continuous_joints_in_degrees_are_angles(command, arm_file, tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(arm_file.read_text().replace('type="revolute"', 'type="continuous"'))
    asked = ("batch", file, "--curve", "helix", "--steps", 1, "-o", tmp_path)
    np.savetxt(tmp_path / "starts.csv", np.vstack([DEGREES, 3 * DEGREES]), delimiter=",")
    assert command(*asked, "--starts", tmp_path / "starts.csv", "--degrees").code == 1
    angles = np.concatenate([DEGREES, 3 * DEGREES]) * np.pi / 180.0
    pairs = np.column_stack([np.cos(angles), np.sin(angles)]).ravel()
    np.testing.assert_allclose(pp.load(tmp_path / "batch.npz", pp.Batch).q_start.ravel(), pairs, atol=1e-15)
    # Without the option they are many turns, which may be meant: it is asked.
    turned = command(*asked, "--starts", tmp_path / "starts.csv")
    assert turned.code == 1
    assert "wound by more than 4 turns" in turned.err and "--degrees" in turned.err


def test_joints_follow_others_as_it_is_said(command, arm_file):
    given = ("--couple", "m02_j1_y=m01_j1_y", "--couple", "m02_j2_z = m01_j2_z, -0.5, 6deg")
    found = json.loads(command("inspect", arm_file, *given, "--json").out)
    assert found["dof"] == 10
    follower = next(joint for joint in found["joints"] if joint["name"] == "m02_j2_z")
    assert (follower["follows"], follower["ratio"]) == ("m01_j2_z", -0.5)
    assert follower["offset"] == pytest.approx(np.pi / 30)
    shown = command("inspect", arm_file, *given).out
    assert "2 joints follow others" in shown


@pytest.mark.parametrize("given", ["m02_j1_y", "m02_j1_y=", "m02_j1_y=a,1,2,3", "m02_j1_y=a,b", "x=y,1,2 kg"])
def test_couplings_that_are_none_are_refused(command, arm_file, given):
    refused = command("inspect", arm_file, "--couple", given)
    assert (refused.code, refused.out) == (2, "")
    assert "--couple" in refused.err


def test_joints_are_locked_where_it_is_said(command, arm_file):
    given = ("--locked", "m01_j1_y=0.5", "--locked", "m02_j2_z=30deg")
    found = json.loads(command("inspect", arm_file, *given, "--json").out)
    assert found["dof"] == 10
    assert set(found["held"]) == {"m01_j1_y", "m02_j2_z"}
    expected = pp.Arm.load(arm_file, locked={"m01_j1_y": 0.5, "m02_j2_z": np.pi / 6})
    tip = expected.at(expected.neutral()).points[-1]
    np.testing.assert_allclose(found["control_points"][-1]["position"], tip, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (("m01_j1_y",), "--locked is 'm01_j1_y'; allowed: NAME=VALUE"),
        (("=0.5",), "NAME=VALUE"),
        (("m01_j1_y=up",), "--locked m01_j1_y is 'up'; allowed: a number in SI units"),
        (("m01_j1_y=3 lb",), "'lb' is not a known unit"),
        (("m01_j1_y=0", "m01_j1_y=1"), "NAME=VALUE, each name once"),
        (("nobody=0",), "'nobody'"),
    ],
)
def test_locks_that_are_none_are_refused_in_one_line(command, arm_file, given, says):
    result = command("inspect", arm_file, *(each for text in given for each in ("--locked", text)))
    assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    assert says in result.err


@pytest.mark.parametrize("verb", ["inspect", "track", "batch", "simulate", "edit"])
def test_every_verb_that_loads_an_arm_has_the_options(command, verb):
    text = command(*verb.split(), "--help", env={"COLUMNS": "200"}).out
    assert "--locked" in text
    assert "--package-dir" in text
    assert "--xacro-arg" in text
    assert "--hard-limits" in text


def test_arguments_and_packages_of_xacro_are_given(command, tmp_path):
    parts = tmp_path / "ws" / "snake"
    parts.mkdir(parents=True)
    (parts / "package.xml").write_text("<package><name>snake</name></package>")
    robot = '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (parts / "end.xacro").write_text(
        f'{robot}<joint name="f" type="fixed"><parent link="l"/><child link="t"/>'
        '<origin xyz="$(arg pitch) 0 $(arg height)"/></joint></robot>'
    )
    file = tmp_path / "elsewhere" / "top.urdf.xacro"
    file.parent.mkdir()
    file.write_text(
        f'{robot}<xacro:include filename="$(find snake)/end.xacro"/><link name="b"/><link name="l"/>'
        '<link name="t"/><joint name="j" type="revolute"><parent link="b"/><child link="l"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    given = ("--xacro-arg", "pitch:=0.3", "--xacro-arg", "height:=0.4")
    found = command("inspect", file, "--package-dir", tmp_path / "ws", *given, "--json")
    assert json.loads(found.out)["control_points"][0]["position"] == pytest.approx([0.3, 0.0, 0.4])
    for options, says in (
        (given, "$(find snake): no such package"),
        (("--package-dir", tmp_path / "ws"), "--xacro-arg pitch:=..."),
        (("--xacro-arg", "pitch=0.3"), "NAME:=VALUE"),
        (("--xacro-arg", "pitch:=1", "--xacro-arg", "pitch:=2"), "NAME:=VALUE, each name once"),
    ):
        refused = command("inspect", file, *options)
        assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
        assert says in refused.err


def test_soft_limits_are_told_and_can_be_ignored(command, arm_file, tmp_path):
    soft = '<safety_controller k_velocity="10" soft_lower_limit="-0.5" soft_upper_limit="0.5"/></joint>'
    file = tmp_path / "soft.urdf"
    file.write_text(arm_file.read_text().replace("</joint>", soft, 1))
    told = command("inspect", file, env={"COLUMNS": "200"})
    assert "<safety_controller> limit m01_j1_y; --hard-limits ignores them" in told.out
    found = json.loads(command("inspect", file, "--json").out)
    assert (found["soft_limited"], found["joints"][0]["upper"]) == (["m01_j1_y"], 0.5)
    hard = json.loads(command("inspect", file, "--json", "--hard-limits").out)
    assert hard["soft_limited"] == []
    assert (
        hard["joints"][0]["upper"]
        == json.loads(command("inspect", arm_file, "--json").out)["joints"][0]["upper"]
    )


def test_meshes_are_looked_for_in_the_folders_that_are_given(command, arm_file, tmp_path):
    import trimesh

    parts = tmp_path / "somewhere" / "src" / "parts"
    parts.mkdir(parents=True)
    trimesh.creation.box((0.05, 0.02, 0.02)).export(parts / "bar.stl")
    (parts / "package.xml").write_text(
        '<?xml version="1.0"?>\n<package format="3"><name>snake_description</name></package>\n'
    )
    file = tmp_path / "arm.urdf"
    mesh = '<geometry><mesh filename="package://snake_description/bar.stl"/></geometry>'
    text = arm_file.read_text()
    at = text.index("<collision>")
    begin = text.index("<geometry>", at)
    end = text.index("</geometry>", at) + len("</geometry>")
    file.write_text(text[:begin] + mesh + text[end:])
    without = command("inspect", file, "--self-collision", "--json")
    assert "snake_description/bar.stl: not found" in without.err
    for folder in (tmp_path / "somewhere", parts.parent, parts):
        found = command("inspect", file, "--self-collision", "--json", "--package-dir", folder)
        assert (found.code, found.err) == (0, "")
