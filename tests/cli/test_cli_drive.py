"""`pinposture drive` and `robot`: what is refused before anything moves; in tests/ros2 they move."""

from __future__ import annotations

import sys

import pytest


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("drive ARM --dt 0.01", "--dt is '0.01'; allowed: nothing; --rate tells the cycle time"),
        ("drive ARM --curve helix --motion out", "--curve is 'helix'; allowed: nothing with --motion"),
        ("drive ARM --rate 0", "--rate is 0.0; allowed: a finite number > 0"),
        ("drive ARM --command velocity", "no command is called 'velocity'; there are: trajectory, positions"),
        ("drive ARM --max-age 0", "--max-age is 0.0"),
        ("drive ARM --cloud-resolution -1", "--cloud-resolution is -1.0"),
        ("drive ARM --touch=-1", "threshold is -1.0"),
        ("drive ARM --encoders elbow", "no side of encoders is called 'elbow'; there are: joint, motor"),
        ("drive ARM --imus imu --imu-noise 1kg", "--imu-noise is '1kg'"),
        ("drive ARM --imus imu --max-deviation 0", "--max-deviation is 0.0"),
        ("drive ARM --velocity x", "velocity is 'x'"),
        ("drive ARM --scene missing.toml", "missing.toml: no such file"),
        ("robot ARM --noise 1kg", "--noise is '1kg'"),
        ("robot ARM --dropped 1", "--dropped is 1.0; allowed: a number in [0, 1)"),
        ("robot ARM --frequency 0", "--frequency is 0.0"),
        ("robot ARM --rate -5", "--rate is -5.0"),
        ("robot ARM --camera --camera-rate 0", "--camera-rate is 0.0"),
        ("robot ARM --imus=-1", "--imus is -1"),
        ("robot ARM --tip-pose --tip-noise=-1", "--tip-noise is -1.0"),
        ("robot ARM --encoders elbow", "no side of encoders is called 'elbow'; there are: joint, motor"),
        ("robot ARM --start nowhere", "no start is called 'nowhere'"),
        ("robot missing.urdf", "missing.urdf: no such file"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(command, arm_file, arguments, words):
    if arguments.startswith("robot"):
        pytest.importorskip("mujoco")
    told = command(*(str(arm_file) if word == "ARM" else word for word in arguments.split()))
    assert told.code == 2
    assert words in told.err
    assert len(told.err.splitlines()) == 1
    assert told.out == ""


@pytest.mark.parametrize("verb", ["drive", "robot"])
def test_without_rclpy_the_next_step_is_told(command, arm_file, monkeypatch, verb):
    pytest.importorskip("mujoco")
    monkeypatch.setitem(sys.modules, "rclpy", None)
    told = command(verb, arm_file)
    assert told.code == 2
    assert "this needs rclpy of ROS 2" in told.err
    assert "pip install 'pinposture[ros2]', or source the setup file of your ROS 2" in told.err
