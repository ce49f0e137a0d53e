"""Xacro: the packages and the arguments of one file decide, whatever was loaded before."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.dom.minidom import parseString

import numpy as np
import pytest

import pinposture as pp
from pinposture.arm import expressions
from pinposture.arm.macros import expand_macros
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
    refused(InvalidValue, "xacro_args.pitch", xacro_args={"pitch": [1.0]})
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


VALUES = [
    "0.05 * 2",
    "2**8 + 7 // 2 - 7 % 4 + (1 &lt;&lt; 3) + (9 >> 1) + (6 &amp; 3 | 8 ^ 1)",
    "max(0.1, min(0.05, 1)) * math.cos(0) + radians(180)",
    "'%.3f %s' % (0.1, 'a')",
    "[2, 0.1][1:] + [3] * 2",
    "python.sum([x * 2 for x in python.range(4) if x > 1])",
    "python.sum(x for x in (1, 2))",
    "(lambda x, y=1, *z: x / 2 + y)(0.2, 3)",
    "'a_0.1'.split('_')[1].upper().rjust(9)",
    "''.join(['0', '.', '1']).replace('.', '__')",
    "0.1 if True and not 1 &lt; 2 &lt; 3 else None",
    "dict(a=0.1, b=[1])['b'][0]",
    "python.sorted([3, 0.1, 2], key=lambda x: -x)",
    "list(map(str.strip, [' a ', 'b ']))",
    "[b for a, b in python.zip([1], [0.1])] + [i for i, _ in python.enumerate('ab')]",
    "max(*[0.1, 0.05]) + (lambda y: y)(y=2) + math.factorial(5) + math.prod([2, 3]) + round(1.26, 1)",
    "[[x + y for y in [1, 2]] for x in [1, 2]]",
    "(x := 3) + x",
    "python.isinstance('a', str) and 'a' in 'abc' and 1 in [1]",
    "-1.5 if ~1 == -2 else +2",
]


@pytest.mark.parametrize("expression", VALUES)
def test_expressions_have_the_values_of_xacro(expression: str) -> None:
    import xacro

    text = f'{ROBOT}<link name="b" value="${{{expression}}}"/></robot>'
    document = parseString(text)
    xacro.process_doc(document)
    assert expand_macros(text, {}) == document.toxml()


def test_expressions_format_text_with_arguments(tmp_path: Path) -> None:
    (tmp_path / "sizes.yaml").write_text("text: '{0:.2f} {a:>{1}} {1!r}'\na: &a {n: 0.1}\nb: {<<: *a}")
    sizes = f"${{xacro.load_yaml('{tmp_path}/sizes.yaml')}}"
    name = "${s.text.format(2, 5, a='x')} ${s.b.n + s['a']['n']} ${len(s.keys())}"
    link = f'<xacro:property name="s" value="{sizes}"/><link name="{name}"/><link name="$(eval 1 + n)"/>'
    expanded = expand_macros(f"{ROBOT}{link}</robot>", {"n": "3"})
    assert 'name="2.00     x 5 0.2 3"' in expanded
    assert 'name="4"' in expanded


SEVERAL = "(lambda f, x: f(f(f(f(f(f(f(f(f(f(x)))))))))))"
ENDLESS = [
    "9**9**9",
    "(-9)**9**9",
    "1 &lt;&lt; 10**10",
    "~(1 &lt;&lt; 10**9)",
    "10**3000 * 10**3000",
    "'a' * 10**10",
    "10**10 * (1, 2)",
    "[[0] * 1000] * 1000",
    "b'a' * 10**10",
    "list(python.range(10**9))",
    "list(python.range(10**30))",
    "python.sum(python.range(10**9))",
    "[0 for a in python.range(9999) for b in python.range(9999) for c in python.range(9999)]",
    "python.sum(1 for a in python.range(99999) for b in python.range(99999))",
    "python.any(map(lambda a: a &lt; 0, python.range(10**9)))",
    pytest.param(
        "(lambda f, n: f(f, n))(lambda f, n: 1 if n == 0 else f(f, n - 1) + f(f, n - 1), 100)",
        marks=pytest.mark.long,
    ),
    pytest.param("[l.append(1) for l in [[1]] for x in l]", marks=pytest.mark.long),
    "[l.extend(l) for l in [[1]] for x in python.range(60)]",
    "[l.extend(python.zip(l)) for l in [[1] * 99999] for x in [1, 2]]",
    "[str(l) for l in [[1]] for x in [l.append(l)]]",
    SEVERAL + "(lambda x: [*x, *x, *x, *x], [1, 2])",
    "str(" + SEVERAL + "(lambda x: [x] * 40, 1))",
    "(1, " + SEVERAL + "(lambda x: (x, x, x, x), 1)) == 1",
    "python.hash(" + SEVERAL + "(lambda x: (x, x, x, x), 1))",
    "math.factorial(10**7)",
    "math.comb(10**6, 5 * 10**5)",
    "list(map(math.perm, [10**6]))",
    "math.prod([10**300] * 9999)",
    "round(5, -10**10)",
    "list(map('a'.ljust, [10**10]))",
    "'a'.zfill(10**10)",
    "'a'.expandtabs(10**10)",
    "('a' * 1000).replace('a', 'b' * 10000)",
    "('a' * 1000).join('b' * 1000)",
    "''.join(['a' * 1000] * 1000)",
    "('a' * 90000).rfind('b' + 'a' * 9000)",
    "'%1000000000d' % 1",
    "'%*d' % (10**9, 1)",
    "b'%.1000000000f' % 1",
    "python.sum([[0] * 500] * 500, [])",
    "xacro.tokenize('a' * 30, ']|(a+)+$|[b')",
    "xacro.load_yaml('/dev/zero')",
    "(1).to_bytes(10**10, 'big')",
    "+".join(["1"] * 9999),
]


@pytest.mark.parametrize("expression", ENDLESS)
def test_an_expression_that_takes_too_long_is_refused_by_name(
    expression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(expressions, "BOUNDS", expressions.BOUNDS._replace(work=1_000_000))  # half a second
    text = f'{ROBOT}<link name="b" value="${{{expression}}}"/></robot>'
    with pytest.raises(PostureError) as caught:
        expand_macros(text, {})
    if "/dev" not in expression:
        assert isinstance(caught.value, URDFError)
        assert repr(expression.replace("&lt;", "<"))[1:150] in caught.value.element


def test_all_places_of_expressions_are_bounded(tmp_path: Path) -> None:
    (tmp_path / "unit.yaml").write_text("a: !degrees 9**9**9")
    (tmp_path / "long.yaml").write_text("[1, 1]" * 100_000)
    bomb = "${9**9**9}"
    for inside in (
        '<link name="$(eval 9**9**9)"/>',
        f'<xacro:property name="{bomb}" value="1"/>',
        f'<xacro:property name="a" value="{bomb}"/>${{a}}',
        f'<xacro:arg name="a" default="{bomb}"/>',
        f'<xacro:if value="{bomb}"/>',
        f'<xacro:element xacro:name="{bomb}"/>',
        f'<xacro:macro name="m" params="a:={bomb}"><link name="a"/></xacro:macro><xacro:m/>',
        f'<xacro:call macro="{bomb}"/>',
        f'<xacro:include filename="{bomb}"/>',
        *(f"${{xacro.load_yaml('{tmp_path}/{name}.yaml')}}" for name in ("unit", "long")),
        '<link name="' + "${1}" * 90_000 + '"/>',
    ):
        with pytest.raises(PostureError, match=r"bits|too long|too large"):
            expand_macros(f"{ROBOT}{inside}</robot>", {})
    for grown in ("${{a{0}}}${{a{0}}}", "${{a{0} + a{0}}}", "${{[a{0}, a{0}]}}", "${{dict(a=a{0}, b=a{0})}}"):
        properties = "".join(
            f'<xacro:property name="a{k + 1}" value="{grown.format(k)}"/>' for k in range(99)
        )
        with pytest.raises(URDFError, match="more than 100000 characters and items"):
            expand_macros(f'{ROBOT}<xacro:property name="a0" value="aa"/>{properties}${{a99}}</robot>', {})
    default = "a:=" + "a" * 60 + "'"  # on which the pattern of xacro would take years
    expand_macros(f'{ROBOT}<link name="b"/><xacro:macro name="m" params="{default}"/></robot>', {})
    expand_macros(f'{ROBOT}<link name="b"/><!--{"<xacro:arg " * 20_000}--></robot>', {})


@pytest.mark.parametrize(
    "expression",
    [
        "(lambda: ().__class__)()",
        "[a.__class__ for a in [1]]",
        "(a for a in [1]).gi_frame",
        "(lambda: __import__('os'))()",
        "(lambda __builtins__: 1)(2)",
        "python.vars(python.type)",
        "python.type('A', (), dict())",
        "python.type(1).mro()",
        "math.update(pi=3)",
        "python.sum.func",
        "(lambda: (yield))()",
    ],
)
def test_expressions_reach_no_more_than_they_may(expression: str) -> None:
    with pytest.raises(PostureError):
        expand_macros(f'{ROBOT}<link name="b" value="${{{expression}}}"/></robot>', {})
    evaluated = '<xacro:property name="p" value="\')\'"/><link name="$(eval open(\'/etc/hosts\'${p})"/>'
    with pytest.raises(PostureError):  # xacro itself would open the file
        expand_macros(f"{ROBOT}{evaluated}</robot>", {})
