from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

LIMITS = '<limit lower="-1" upper="2" velocity="3" effort="1"/>'


def robot(joints: list[tuple[str, str, str, str]], limits: str = LIMITS) -> str:
    """URDF text; a joint is its name, type, parent and child, and sits 0.1 m along x of the one before."""
    links = dict.fromkeys(link for joint in joints for link in joint[2:])
    text = "".join(f'<link name="{name}"/>' for name in links)
    for number, (name, kind, parent, child) in enumerate(joints):
        axis = ("0 1 0", "0 0 1")[number % 2]
        text += f'<joint name="{name}" type="{kind}"><origin xyz="0.1 0 0"/><axis xyz="{axis}"/>'
        text += f'<parent link="{parent}"/><child link="{child}"/>{limits}</joint>'
    return f'<robot name="r">{text}</robot>'


CHAIN = [
    ("j1", "revolute", "base", "a"),
    ("j2", "continuous", "a", "b"),
    ("j3", "prismatic", "b", "c"),
    ("j4", "revolute", "c", "d"),
    ("end", "fixed", "d", "tip"),
]


def test_the_json_agrees_with_the_xml(command, arm_file):
    about = json.loads(command("inspect", arm_file, "--json").out)
    root = ET.parse(arm_file).getroot()
    moving = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
    assert [joint["name"] for joint in about["joints"]] == [joint.get("name") for joint in moving]
    for shown, joint in zip(about["joints"], moving, strict=True):
        assert shown["type"] == joint.get("type")
        assert shown["parent"] == joint.find("parent").get("link")
        assert shown["child"] == joint.find("child").get("link")
        for key in ("lower", "upper", "velocity"):
            assert shown[key] == float(joint.find("limit").get(key))
    assert [joint["module"] for joint in about["joints"]] == [m for m in range(1, 7) for _ in range(2)]
    assert about["name"] == root.get("name")
    assert (about["base"], about["tip"]) == ("base", "tip")
    assert (about["dimension"], about["modules"], about["dof"]) == (3, 6, 12)
    assert about["length"] == pytest.approx(0.3)
    positions = [point["position"] for point in about["control_points"]]
    np.testing.assert_allclose(positions, [[0.05 * k, 0, 0] for k in range(1, 7)], atol=1e-15)


def test_kinds_units_and_absent_limits_are_told_apart(command):
    about = json.loads(command("inspect", "-", "--json", input=robot(CHAIN)).out)
    kinds = [(joint["type"], joint["unit"], joint["lower"], joint["upper"]) for joint in about["joints"]]
    assert kinds == [
        ("revolute", "rad", -1.0, 2.0),
        ("continuous", "rad", None, None),
        ("prismatic", "m", -1.0, 2.0),
        ("revolute", "rad", -1.0, 2.0),
    ]
    assert (about["dof"], about["nq"]) == (4, 5)


def test_base_tip_and_modules_choose_the_chain(command, arm_file):
    options = ("--base", "m02_l2", "--tip", "tip", "--modules", "3,5")
    about = json.loads(command("inspect", arm_file, *options, "--json").out)
    assert [joint["name"][:3] for joint in about["joints"]] == [f"m0{m}" for m in (3, 3, 4, 4, 5, 5, 6, 6)]
    assert [joint["module"] for joint in about["joints"]] == [1] * 3 + [2] * 5
    assert (about["base"], about["tip"]) == ("m02_l2", "tip")
    assert {"m01_j1_y", "m01_j2_z", "m02_j1_y", "m02_j2_z"} == set(about["held"])


def test_joints_off_the_chain_are_named(command):
    text = robot([*CHAIN, ("finger", "revolute", "a", "nail")])
    about = json.loads(command("inspect", "-", "--json", input=text).out)
    assert about["held"] == ["finger"]
    assert "finger" in command("inspect", "-", input=text).out


def test_the_tables_say_what_the_json_says(command, arm_file):
    out = command("inspect", arm_file).out
    about = json.loads(command("inspect", arm_file, "--json").out)
    rows = [line.split() for line in out.splitlines()]
    for joint in about["joints"]:
        words = [joint["name"], joint["type"], joint["parent"], joint["child"]]
        assert [str(joint["module"]), *words, f"{-math.pi:.4g}", f"{math.pi:.4g}", "2"] in rows
    for k, point in enumerate(about["control_points"], start=1):
        assert [str(k), point["name"], "0.05", f"{0.05 * k:.4g}", "0", "0"] in rows
    for heading in ("length [m]", "x [m]", "speed"):
        assert heading in out


def test_the_tables_of_our_own_arms_fit_a_terminal_of_80_columns(command):
    text = command("generate", "RyRz", "--modules", 12).out
    assert max(len(line.rstrip()) for line in command("inspect", "-", input=text).out.splitlines()) <= 80


def test_nothing_is_cut_short_in_a_pipe(command):
    names = ["j" * 90 + str(k) for k in range(4)]
    chain = [(name, *joint[1:]) for name, joint in zip([*names, "end"], CHAIN, strict=True)]
    out = command("inspect", "-", input=robot(chain), env={"COLUMNS": "40"}).out
    rows = [line.split() for line in out.splitlines()]
    for name in names:
        assert sum(name in row for row in rows) == 1
    assert "…" not in out
    assert "\x1b" not in out
