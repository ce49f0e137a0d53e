"""Xacro: the packages and the arguments of one file decide, whatever was loaded before."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import pinposture as pp
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName, URDFError

ROBOT = '<robot name="s" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def chain(pitch: str) -> str:
    """Two links of a length, which is an expression."""
    joint = (
        '<joint name="j{0}" type="revolute"><parent link="l{1}"/><child link="l{0}"/><origin xyz="{2} 0 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    links = "".join(f'<link name="{name}"/>' for name in ("l0", "l1", "l2", "tip"))
    end = (
        '<joint name="end" type="fixed"><parent link="l2"/><child link="tip"/>'
        f'<origin xyz="{pitch} 0 0"/></joint>'
    )
    return links + joint.format(1, 0, 0) + joint.format(2, 1, pitch) + end


def package(folder: Path, name: str) -> Path:
    """Make a package with a folder for descriptions, which is returned."""
    (folder / "urdf").mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    return folder / "urdf"


def dimensions(pitch: float) -> str:
    return f'{ROBOT}<xacro:property name="pitch" value="{pitch}"/></robot>'


CHOICE = f'{ROBOT}<xacro:if value="false"><xacro:arg name="unused" default="1"/></xacro:if>{{chain}}</robot>'
TOP = f'{ROBOT}<xacro:include filename="$(find snake)/urdf/dims.xacro"/>{chain("${pitch}")}</robot>'


def workspace(folder: Path, pitch: float, name: str = "snake") -> Path:
    """Make a package whose description includes a file of the package; returns the description."""
    urdf = package(folder / name, "snake")
    (urdf / "dims.xacro").write_text(dimensions(pitch))
    file = urdf / "top.urdf.xacro"
    file.write_text(TOP)
    return file


def test_a_package_is_that_of_the_file_whatever_was_loaded_before(tmp_path: Path) -> None:
    files = [workspace(tmp_path / f"ws{k}", 0.1 * k) for k in (1, 2, 3)]
    for file, pitch in ((files[0], 0.1), (files[1], 0.2), (files[0], 0.1), (files[2], 0.3)):
        assert pp.Arm.load(file).length == pytest.approx(2.0 * pitch)
    alone = tmp_path / "alone.urdf.xacro"  # is in no package: that of an earlier file is not its own
    alone.write_text(TOP)
    with pytest.raises(FileError, match=r"\$\(find snake\): no such package .*package_dirs"):
        pp.Arm.load(alone)


def test_threads_find_each_the_package_of_its_own_file(tmp_path: Path) -> None:
    files = [workspace(tmp_path / f"ws{k}", 0.1 * k) for k in (1, 2, 3, 4)]
    with ThreadPoolExecutor(4) as pool:
        arms = list(pool.map(pp.Arm.load, files * 6))
    np.testing.assert_allclose([arm.length for arm in arms], [0.2, 0.4, 0.6, 0.8] * 6)


def test_a_nested_include_finds_the_package_in_which_it_is(tmp_path: Path) -> None:
    parts = package(tmp_path / "elsewhere" / "parts", "parts")
    (parts / "dims.xacro").write_text(dimensions(0.7))
    (parts / "all.xacro").write_text(
        f'{ROBOT}<xacro:include filename="$(find parts)/urdf/dims.xacro"/></robot>'
    )
    urdf = package(tmp_path / "snake", "snake")
    for include in ("../../elsewhere/parts/urdf/all.xacro", "$(find beside)/all.xacro"):
        (urdf / "top.xacro").write_text(
            f'{ROBOT}<xacro:include filename="{include}"/>{chain("${pitch}")}</robot>'
        )
        (tmp_path / "beside").mkdir(exist_ok=True)
        (tmp_path / "beside" / "package.xml").write_text("<package><name>beside</name></package>")
        (tmp_path / "beside" / "all.xacro").write_text(dimensions(0.7))
        assert pp.Arm.load(urdf / "top.xacro").length == pytest.approx(1.4)


def test_folders_that_are_given_go_before_those_of_the_file_and_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, third = (workspace(tmp_path / f"ws{k}", 0.1 * k) for k in (1, 2, 3))
    alone = tmp_path / "other" / "top.urdf.xacro"
    alone.parent.mkdir()
    alone.write_text(TOP)
    (alone.parent / "snake").mkdir()  # a folder of that name that is no package
    path = f"{tmp_path / 'ws3'}:{tmp_path / 'ws2'}"
    monkeypatch.setenv("ROS_PACKAGE_PATH", path)
    assert pp.Arm.load(alone).length == pytest.approx(0.6)
    assert pp.Arm.load(first).length == pytest.approx(0.2)
    for folder in (tmp_path / "ws2", tmp_path / "ws2" / "snake", second.parent):
        assert pp.Arm.load(alone, package_dirs=[folder]).length == pytest.approx(0.4)
        assert pp.Arm.load(first, package_dirs=[folder]).length == pytest.approx(0.4)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'ws2'}:{tmp_path / 'ws3'}")
    assert pp.Arm.load(alone).length == pytest.approx(0.4)
    installed = tmp_path / "install" / "share" / "snake"
    installed.parent.mkdir(parents=True)
    third.parent.parent.rename(installed)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    assert pp.Arm.load(alone).length == pytest.approx(0.6)
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    (alone.parent / "snake").rmdir()
    with pytest.raises(FileError, match="no such package"):
        pp.Arm.load(alone)


def test_the_name_of_a_package_is_that_in_its_manifest(tmp_path: Path) -> None:
    file = workspace(tmp_path / "ws", 0.3, name="snake-main")
    wrong = tmp_path / "ws" / "snake-main" / "urdf" / "snake"  # a folder of this name is none
    wrong.mkdir()
    (wrong / "package.xml").write_text("<package><name>adder</name></package>")
    assert pp.Arm.load(file).length == pytest.approx(0.6)


@pytest.fixture
def parametric(tmp_path: Path) -> Path:
    """A file with an argument of no default, and one that hides the whole robot."""
    file = tmp_path / "arm.urdf.xacro"
    file.write_text(
        f'{ROBOT}<xacro:arg name="with_arm" default="true"/><xacro:if value="$(arg with_arm)">'
        f"{chain('$(arg pitch)')}</xacro:if></robot>"
    )
    return file


def test_arguments_are_given_in_python_and_kept(parametric: Path) -> None:
    for value in (0.25, "0.25", np.float64(0.25)):
        arm = pp.Arm.load(parametric, xacro_args={"pitch": value})
        assert arm.length == pytest.approx(0.5)
        assert arm.spec is not None
        assert pp.Arm.from_spec(arm.spec).length == pytest.approx(0.5)
    assert arm.spec.xacro_args == {"pitch": "0.25"}
    text = pp.Arm.load(parametric.read_text(), xacro_args={"pitch": 0.3})
    assert text.length == pytest.approx(0.6)
    assert pp.Arm.from_spec(text.spec).length == pytest.approx(0.6)  # which has the expanded text
    other = CHOICE.format(chain=chain("$(arg pitch)"))  # an argument may be asked for under a condition only
    assert pp.Arm.load(other, xacro_args={"pitch": 0.3, "unused": 1}).length == pytest.approx(0.6)


def test_what_arguments_miss_is_said_with_the_next_step(parametric: Path, tmp_path: Path) -> None:
    def refused(error: type[Exception], *words: str, source: object = parametric, **given: object) -> None:
        with pytest.raises(error) as caught:
            pp.Arm.load(source, **given)
        assert all(word in str(caught.value) for word in words), str(caught.value)

    refused(URDFError, "argument 'pitch'", "no default", "--xacro-arg pitch:=...", str(parametric))
    hidden = {"pitch": 1, "with_arm": False}
    refused(URDFError, "no links", "with_arm:=false", "--xacro-arg NAME:=VALUE", xacro_args=hidden)
    refused(UnknownName, "pitsch", "did you mean 'pitch'?", xacro_args={"pitch": 1, "pitsch": 2})
    refused(InvalidValue, "xacro_args", xacro_args=["pitch"])
    refused(InvalidValue, "xacro_args['pitch']", xacro_args={"pitch": [1.0]})
    plain = pp.Arm.from_template("RyRz", 2).urdf
    refused(InvalidValue, "xacro_args", "not xacro", source=plain, xacro_args={"pitch": 1})
    only_macros = tmp_path / "macros.xacro"
    only_macros.write_text(
        f'{ROBOT}<xacro:macro name="m" params="x"><link name="${{x}}"/></xacro:macro></robot>'
    )
    refused(URDFError, "no links", "load the file that calls the macros", source=only_macros)


def test_a_failed_expansion_leaves_nothing_behind(parametric: Path, tmp_path: Path) -> None:
    import xacro
    from xacro import substitution_args

    before = (vars(xacro).copy().keys(), substitution_args._eval_find, xacro.parse)
    with pytest.raises(PostureError):
        pp.Arm.load(parametric)
    assert (vars(xacro).keys(), substitution_args._eval_find, xacro.parse) == before
    assert pp.Arm.load(parametric, xacro_args={"pitch": 1}).length == pytest.approx(2.0)


def test_xacro_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog) -> None:
    file = tmp_path / "talks.xacro"
    file.write_text(
        f'{ROBOT}<xacro:property name="pi" value="3"/>${{xacro.warning("careful")}}'
        f'<xacro:include filename="none*.xacro"/><xacro:include filename="none.xacro" optional="true"/>'
        f"{chain('0.1')}</robot>"
    )
    assert pp.Arm.load(file).length == pytest.approx(0.2)
    assert capfd.readouterr() == ("", "")
    assert "careful" in caplog.text


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "windows-1252", "utf-16", "utf-8"])
def test_xacro_and_its_includes_are_read_in_their_encoding(tmp_path: Path, encoding: str) -> None:
    declaration = f'<?xml version="1.0" encoding="{encoding}"?>'
    part = f'{ROBOT}<xacro:property name="name" value="Rüssel"/></robot>'
    whole = f'{ROBOT}<xacro:include filename="part.xacro"/>{chain("0.1")}</robot>'.replace("tip", "${name}")
    (tmp_path / "part.xacro").write_bytes((declaration + part).encode(encoding))
    (tmp_path / "whole.xacro").write_bytes((declaration + whole).encode(encoding))
    arm = pp.Arm.load(tmp_path / "whole.xacro", tip="Rüssel")
    assert arm.report.tip == "Rüssel"


def test_entities_are_refused_in_xacro_as_in_urdf(tmp_path: Path) -> None:
    file = tmp_path / "bomb.xacro"
    file.write_text('<!DOCTYPE robot [<!ENTITY a "b">]>' + ROBOT + chain("0.1") + "</robot>")
    with pytest.raises(URDFError, match="DOCTYPE"):
        pp.Arm.load(file)


def test_without_the_extra_the_message_names_it(parametric: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(FileError, match=r"pinposture\[descriptions\]"):
        pp.Arm.load(parametric)
