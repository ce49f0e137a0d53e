from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import pinposture as pp
import pinposture.viz

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


def test_axes_are_in_the_world_frame_at_zero_positions(command):
    text = robot([(f"j{k}", "revolute", f"l{k}", f"l{k + 1}") for k in range(3)])  # axes y, z, y
    text = text.replace('<origin xyz="0.1 0 0"/>', '<origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/>')
    joints = json.loads(command("inspect", "-", "--json", input=text).out)["joints"]
    axes = [joint["axis"] for joint in joints]
    # Each joint makes a quarter turn about z from the one before.
    np.testing.assert_allclose(axes, [[-1, 0, 0], [0, 0, 1], [1, 0, 0]], atol=1e-12)
    rows = [line.split() for line in command("inspect", "-", input=text).out.splitlines()]
    written = [" ".join(row[5:8]) for row in rows if row[2:3] == ["revolute"]]
    assert written == ["-1 0 0", "0 0 1", "1 0 0"]


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
    options = ("--base", "m02_l2", "--tip", "tip", "--split", "3,5")
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


def test_reach_is_the_farthest_that_the_tip_gets_from_the_base(command):
    # Two links at a right angle, which reach farther than they do at zero joint positions.
    text = robot(
        [("j1", "revolute", "base", "a"), ("j2", "revolute", "a", "b"), ("end", "fixed", "b", "tip")]
    )
    text = text.replace("0 1 0", "0 0 1").replace('lower="-1"', 'lower="-3"')
    *_, last = text.rpartition('<origin xyz="0.1 0 0"/>')
    text = text.removesuffix(last).removesuffix('<origin xyz="0.1 0 0"/>') + '<origin xyz="0 0.2 0"/>' + last
    about = json.loads(command("inspect", "-", "--json", input=text).out)
    assert np.linalg.norm(about["control_points"][-1]["position"]) == pytest.approx(math.hypot(0.2, 0.2))
    assert about["reach"] == pytest.approx(0.3)
    assert about["length"] == pytest.approx(0.3)
    assert "reach       300 mm" in command("inspect", "-", input=text).out


def test_it_says_why_the_modules_were_cut_so(command, arm_file):
    arm = pp.Arm.load(arm_file)
    for options, expected in (((), arm), (("--split", 4), pp.Arm.load(arm_file, split=4))):
        assert json.loads(command("inspect", arm_file, *options, "--json").out)["modules_reason"] == (
            expected.segmentation.reason
        )
        assert expected.segmentation.reason in command("inspect", arm_file, *options).out


def test_it_says_which_module_has_no_closed_form_kinematics(command, arm_file):
    about = json.loads(command("inspect", arm_file, "--json").out)
    assert (about["closed_form"], about["closed_form_reason"]) == (True, "")
    assert "closed form for every module" in command("inspect", arm_file).out
    options = ("--split", "2,2,4,4")
    about = json.loads(command("inspect", arm_file, *options, "--json").out)
    assert about["closed_form"] is False
    assert about["kinematics"] == ["Torus", "Torus", "NumericModule", "NumericModule"]
    assert "Torus (2), NumericModule (2)" in command("inspect", arm_file, *options).out
    assert about["closed_form_reason"].startswith("module 3 (joints m03_j1_y, m03_j2_z, m04_j1_y, m04_j2_z)")
    assert about["closed_form_reason"] in command("inspect", arm_file, *options).out


def test_modules_end_at_links_that_are_named(command, arm_file):
    options = ("--split", "m02_l2, m03_l2,tip")
    about = json.loads(command("inspect", arm_file, *options, "--json").out)
    arm = pp.Arm.load(arm_file, split=["m02_l2", "m03_l2", "tip"])
    assert arm.n_modules == 3
    assert [joint["module"] for joint in about["joints"]] == [
        k for k, names in enumerate(arm.module_joints, start=1) for _ in names
    ]
    places = [point["position"] for point in about["control_points"]]
    np.testing.assert_allclose(places, arm.at(arm.neutral()).points, atol=1e-12)
    one = json.loads(command("inspect", arm_file, "--split", "m03_l2", "--json").out)
    assert (one["tip"], one["modules"], one["dof"]) == ("m03_l2", 1, 6)


def test_what_loading_warns_of_is_told_in_the_table_in_the_json_and_in_one_line_each(command):
    text = robot([*CHAIN, ("finger", "revolute", "a", "nail")])
    with pytest.warns(pp.PostureWarning) as warned:
        arm = pp.Arm.load(text)
    assert [str(warning.message) for warning in warned] == list(arm.warnings)
    assert len(arm.warnings) == 2
    words = command("inspect", "-", input=text)
    data = command("inspect", "-", "--json", input=text)
    assert json.loads(data.out)["warnings"] == list(arm.warnings)
    assert f"note        {arm.warnings[0]}\n" in "\n".join(map(str.rstrip, words.out.splitlines())) + "\n"
    assert words.err == data.err == "".join(f"note: {warning}\n" for warning in arm.warnings)


def test_several_warnings_are_all_in_the_table(command):
    text = robot([*CHAIN, ("finger", "revolute", "a", "nail")]).replace('lower="-1" upper="2" ', "", 1)
    about = json.loads(command("inspect", "-", "--json", input=text).out)
    assert len(about["warnings"]) == 3
    out = command("inspect", "-", input=text).out
    assert all(warning in out for warning in about["warnings"])


@pytest.mark.parametrize("as_json", [(), ("--json",)])
def test_a_picture_is_left_under_whatever_name(command, arm_file, tmp_path, as_json):
    path = tmp_path / "sub" / "picture"
    result = command("inspect", arm_file, "--plot", path, *as_json)
    assert result.err == f"wrote {path}\n"
    assert path.read_bytes().startswith(b"\x89PNG\r\n")
    if as_json:
        assert json.loads(result.out)["plot"] == str(path)


@pytest.mark.long
def test_the_picture_is_that_of_the_arm(command, arm_file, tmp_path, monkeypatch):
    seen = []
    real = pinposture.viz.plot_arm

    def plot_arm(arm, ellipsoids, scene, torques):
        assert not torques  # no limit is known
        seen.append((arm.n_modules, ellipsoids, scene and list(scene.obstacles)))
        return real(arm, ellipsoids=ellipsoids, scene=scene)

    monkeypatch.setattr("pinposture.viz.plot_arm", plot_arm)
    command("inspect", arm_file, "--split", 4, "--plot", tmp_path / "arm.png")
    command("inspect", arm_file, "--plot", tmp_path / "arm.png", "--ellipsoids", "2,6")
    command("inspect", arm_file, "--plot", tmp_path / "arm.png", "--ellipsoids", "all")
    (tmp_path / "scene.toml").write_text(
        'obstacles.post = {type = "sphere", center = [0, 1, 0], radius = 0.1}'
    )
    command("inspect", arm_file, "--plot", tmp_path / "arm.png", "--scene", tmp_path / "scene.toml")
    assert seen == [(3, (), None), (6, (1, 5), None), (6, (0, 1, 2, 3, 4, 5), None), (6, (), ["post"])]


def bent(joints: int) -> str:
    """URDF text of an arm in a plane, each link of which stands across the one before."""
    text = robot(
        [(f"j{k}", "revolute", f"l{k}", f"l{k + 1}") for k in range(joints)]
        + [("end", "fixed", f"l{joints}", "tip")]
    ).replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"')
    turned = '<origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/>'
    return text.replace('<origin xyz="0.1 0 0"/>', turned)


def test_it_tells_how_near_a_singularity_the_tip_is(command, arm_file):
    straight = json.loads(command("inspect", arm_file, "--json").out)["manipulability"]
    assert straight == [
        {
            "name": "module_06",
            "module": 6,
            "measure": 0.0,
            "condition": None,
            "minimum_singular_value": 0.0,
            "index": 0.0,
        }
    ]
    rows = [line.split() for line in command("inspect", arm_file).out.splitlines()]
    assert ["6", "module_06", "0", "inf", "0", "0"] in rows
    (two,) = json.loads(command("inspect", "-", "--json", input=bent(2)).out)["manipulability"]
    # Two links of 0.1 m at a right angle: J = 0.1 [[-1, -1], [1, 0]] but for the choice of axes.
    sigma = np.linalg.svd(0.1 * np.array([[-1.0, -1.0], [1.0, 0.0]]), compute_uv=False)
    assert two["measure"] == pytest.approx(0.01)
    assert two["condition"] == pytest.approx(sigma[0] / sigma[1])
    assert two["minimum_singular_value"] == pytest.approx(sigma[1])
    assert two["index"] == pytest.approx(sigma[1] / sigma[0])


def test_it_tells_so_of_the_points_that_are_asked_for_in_the_table_and_in_the_json(command):
    options = ("--split", 1, "--ellipsoids", "3, 2")
    told = json.loads(command("inspect", "-", *options, "--json", input=bent(3)).out)["manipulability"]
    assert [one["module"] for one in told] == [3, 2]
    assert told[1]["measure"] == pytest.approx(0.01)
    rows = [line.split() for line in command("inspect", "-", *options, input=bent(3)).out.splitlines()]
    for one in told:
        keys = ("measure", "condition", "minimum_singular_value", "index")
        numbers = [f"{one[key]:.4g}" for key in keys]
        assert [str(one["module"]), one["name"], *numbers] in rows


@pytest.mark.parametrize("points", ["0", "7", "tip", "1,1", ","])
def test_numbers_of_no_control_point_are_refused(command, arm_file, points):
    result = command("inspect", arm_file, "--ellipsoids", points)
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith(f"error: --ellipsoids is '{points}'; allowed: numbers of control points")


def test_the_tables_say_what_the_json_says(command, arm_file):
    out = command("inspect", arm_file).out
    about = json.loads(command("inspect", arm_file, "--json").out)
    rows = [line.split() for line in out.splitlines()]
    for joint in about["joints"]:
        words = [joint["name"], joint["type"], joint["parent"], joint["child"]]
        words += ["0", "1", "0"] if joint["axis"][1] else ["0", "0", "1"]
        assert [str(joint["module"]), *words, f"{-math.pi:.4g}", f"{math.pi:.4g}", "2"] in rows
    for k, point in enumerate(about["control_points"], start=1):
        assert [str(k), point["name"], "0.05", f"{0.05 * k:.4g}", "0", "0"] in rows
    for heading in ("length [m]", "x [m]", "speed"):
        assert heading in out


def test_the_tables_of_our_own_arms_fit_a_terminal_of_80_columns(command):
    text = command("generate", "RyRz", "--modules", 12).out
    lines = command("inspect", "-", input=text).out.splitlines()
    tables = lines[
        next(k for k, line in enumerate(lines) if line.startswith(" module")) :
    ]  # not the sentences
    assert max(len(line.rstrip()) for line in tables) <= 80


def test_nothing_is_cut_short_in_a_pipe(command):
    names = ["j" * 90 + str(k) for k in range(4)]
    chain = [(name, *joint[1:]) for name, joint in zip([*names, "end"], CHAIN, strict=True)]
    out = command("inspect", "-", input=robot(chain), env={"COLUMNS": "40"}).out
    rows = [line.split() for line in out.splitlines()]
    for name in names:
        assert sum(name in row for row in rows) == 1
    assert "…" not in out
    assert "\x1b" not in out


def test_how_the_whole_arm_follows_a_curve_is_told(command, arm_file, tmp_path):
    arm = pp.Arm.load(arm_file)
    bend = pp.Curve.spline([(0, 0, 0), (0.1, 0, 0), (0.2, 0.05, 0.02), (0.3, 0.15, 0.05), (0.4, 0.2, 0)])
    bend.save(tmp_path / "bend.json")
    target = pp.resolve_targets(arm, bend)
    about = json.loads(command("inspect", arm_file, "--curve", tmp_path / "bend.json", "--json").out)["curve"]
    assert about["placed_by"] == target.method
    assert about["distance_from_curve"] == pytest.approx(target.distance_from_curve(arm), rel=1e-9)
    assert about["largest_residual"] == pytest.approx(target.residual.max(), abs=1e-12)
    out = command("inspect", arm_file, "--curve", tmp_path / "bend.json").out
    assert f"largest distance of a link from the curve {1e3 * about['distance_from_curve']:.3g} mm" in out
    assert json.loads(command("inspect", arm_file, "--json").out)["curve"] is None


def test_a_curve_that_the_modules_cannot_follow_is_told_with_what_is_too_much(command, arm_file, tmp_path):
    pp.Curve.helix(radius=0.01, pitch=0.02, turns=8).save(tmp_path / "tight.json")
    about = json.loads(command("inspect", arm_file, "--curve", tmp_path / "tight.json", "--json").out)[
        "curve"
    ]
    assert any(text.startswith("curvature up to") for text in about["too_much"])
    assert about["too_much"][0] in command("inspect", arm_file, "--curve", tmp_path / "tight.json").out


def test_it_tells_how_far_the_arm_is_held_out(command, arm_file):
    text = arm_file.read_text()
    about = json.loads(command("inspect", arm_file, "--json").out)["weight"]
    assert about["held_out"] is None
    joints = [f"m{m:02}_{name}" for m in range(1, 7) for name in ("j1_y", "j2_z")]
    assert about["joints_without_effort"] == joints
    assert "not known: no torque limits of m01_j1_y" in " ".join(command("inspect", arm_file).out.split())
    weak = text.replace('effort="0.0"', 'effort="0.1"')
    arm = pp.Arm.load(weak, split=2)
    found = arm.held_out()
    told = json.loads(command("inspect", "-", "--json", input=weak).out)["weight"]
    assert told["held_out"]["length"] == found.length < arm.length
    assert told["held_out"]["gives_up"]["joint"] == found.load.joint
    assert told["mass"] == pytest.approx(sum(body.mass for body in arm.model.inertias))
    shown = " ".join(command("inspect", "-", input=weak).out.split())
    assert f"{found.load.joint} gives up first ({found.load.needed:.4g} of 0.1 N m)" in shown
    strong = " ".join(command("inspect", "-", input=text.replace('effort="0.0"', 'effort="9"')).out.split())
    assert "held out wholly, in the worst direction, and 2.9" in strong
    bare = command("inspect", "-", input=weak.replace("inertial", "ignored")).out
    assert "masses of links 'm01_l1', 'm01_l2'" in " ".join(bare.split())


def test_options_give_what_the_description_does_not_say(command, arm_file):
    options = ("--effort", "50 N cm", "--payload", "0.1", "--payload", "m02_l2 = 80 g")
    told = json.loads(command("inspect", arm_file, "--json", *options).out)["weight"]
    arm = pp.Arm.load(arm_file).with_payload(0.1).with_payload(0.08, frame="m02_l2").with_effort(0.5)
    assert told["held_out"]["length"] == arm.held_out().length
    assert told["held_out"]["gives_up"] == arm.held_out().load.as_data()
    shown = " ".join(command("inspect", arm_file, *options).out.split())
    assert "carries 0.1 kg at the tip, 0.08 kg at m02_l2" in shown
    bare = arm_file.with_name("bare.urdf")
    bare.write_text(arm_file.read_text().replace("inertial", "ignored"))
    weighed = json.loads(command("inspect", bare, "--json", "--density", "2700").out)["weight"]
    assert weighed["mass"] == pytest.approx(
        2.7 * sum(body.mass for body in pp.Arm.load(arm_file).model.inertias)
    )
    assert "from a density of 2700 kg/m" in command("inspect", bare, "--density", "2700").out
    for wrong in (("--effort", "-1"), ("--payload", "hand=1"), ("--payload", "tip="), ("--density", "heavy")):
        assert command("inspect", arm_file, *wrong).code == 2
