from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import pytest

import pinposture as pp
from pinposture.arm import TEMPLATES


def test_the_file_holds_the_arm_that_was_asked_for(command, tmp_path):
    file = tmp_path / "arm.urdf"
    result = command("generate", "RyRz", "--modules", 7, "--link-lengths", "0.03,0.02", "-o", file)
    assert result.code == 0
    assert result.out == ""
    joints = ET.parse(file).getroot().findall("joint")
    assert [joint.find("axis").get("xyz").split() for joint in joints if joint.get("type") == "revolute"] == [
        ["0.0", "1.0", "0.0"],
        ["0.0", "0.0", "1.0"],
    ] * 7
    assert pp.Arm.load(file).length == pytest.approx(7 * 0.05)


def test_stdout_gets_the_same_text_as_the_file(command, tmp_path):
    file = tmp_path / "arm.urdf"
    command("generate", "Rz", "-n", 3, "-o", file)
    assert command("generate", "Rz", "-n", 3).out == file.read_text(encoding="utf-8")


@pytest.mark.parametrize("template", TEMPLATES)
def test_the_json_summary_agrees_with_what_loads(command, tmp_path, template):
    file = tmp_path / "arm.urdf"
    summary = json.loads(command("generate", template, "--modules", 4, "-o", file, "--json").out)
    arm = pp.Arm.load(file)
    assert summary["file"] == str(file)
    assert summary["dof"] == arm.nv
    assert summary["length"] == pytest.approx(arm.length, rel=1e-12)


def test_an_arm_on_a_feed_can_be_steered(command, tmp_path):
    file = tmp_path / "fed.urdf"
    made = command("generate", "RyRz", "-n", 3, "--feed", "400 mm", "-o", file, "--json")
    arm = pp.Arm.load(file)
    summary = json.loads(made.out)
    assert (summary["dof"], summary["length"]) == (arm.nv, pytest.approx(arm.length))
    assert arm.limits.upper[0] == 0.4
    pp.Steering(arm, pp.Limits(dt=0.1)).step(0.01)
    assert command("generate", "RyRz", "-n", 3, "--feed", "0").code == 2


def test_json_without_a_file_writes_none(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert json.loads(command("generate", "RyRz", "--modules", 2, "--json").out)["file"] is None
    assert list(tmp_path.iterdir()) == []


def test_an_arm_far_beyond_what_a_model_could_hold_is_written_all_the_same(command):
    text = command("generate", "RyRz", "--modules", 400).out
    assert sum(joint.get("type") == "revolute" for joint in ET.fromstring(text).iter("joint")) == 800


def test_every_template_is_listed(command):
    rows = command("generate", "--list").out.splitlines()
    assert [row.split()[0] for row in rows if row.strip() and row.split()[0] in TEMPLATES] == list(TEMPLATES)


@pytest.mark.parametrize("options", [("--list", "--json"), ("--json", "--list")])
def test_the_templates_in_json_can_be_built(command, options):
    result = command("generate", *options)
    listed = json.loads(result.out)["templates"]
    assert (result.code, result.err) == (0, "")
    for template in listed:
        joints = [pp.arm.JointSpec(**joint) for joint in template.pop("joints")]
        length = template.pop("length")
        module = pp.arm.ModuleTemplate(joints=tuple(joints), **template)
        assert pp.Arm.from_modules([module] * 2).length == pytest.approx(2 * length - module.lead)
    assert [template["name"] for template in listed] == list(TEMPLATES)


def test_a_link_is_followed_and_stays_a_link(command, tmp_path):
    real = tmp_path / "real.urdf"
    link = tmp_path / "link.urdf"
    real.write_text("old")
    link.symlink_to(real)
    assert command("generate", "Rz", "-n", 2, "-o", link).code == 0
    assert link.is_symlink()
    assert real.read_text().startswith("<?xml")
