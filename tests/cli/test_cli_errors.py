from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from pinposture.errors import InvalidValue


class Case(NamedTuple):
    """A command line that cannot work, and what the one line about it must contain."""

    name: str
    line: str
    says: tuple[str, ...]


CASES = [
    # usage
    Case("unknown verb", "tracc", ("'tracc'", "pinposture --help")),
    Case("unknown option", "inspect ARM --depth 3", ("--depth", "pinposture inspect --help")),
    Case("missing option", "track ARM", ("'--curve'", "pinposture track --help")),
    Case("missing argument", "generate --modules 3", ("TEMPLATE is not given", "pinposture generate --list")),
    Case("not a number", "track ARM --curve helix --steps many", ("--steps", "integer")),
    # generate
    Case("unknown template", "generate RyRx --modules 3", ("'RyRx'", "did you mean 'RyRz'", "RzRzRz")),
    Case("modules not given", "generate RyRz", ("--modules is not given", "1 to 10000")),
    Case("no modules", "generate RyRz --modules 0", ("--modules is 0", "1 to 10000")),
    Case("too many modules", "generate RyRz --modules 10001", ("--modules is 10001", "1 to 10000")),
    Case(
        "a length too few", "generate RyRz -n 3 --link-lengths 0.1", ("--link-lengths is [0.1]", "2 lengths")
    ),
    Case(
        "length NaN", "generate RyRz -n 3 --link-lengths 0.1,nan", ("--link-lengths[1]", "nan", "0 to 1e6 m")
    ),
    Case("length -1", "generate RyRz -n 3 --link-lengths=-1,1", ("--link-lengths[0]", "-1", "0 to 1e6 m")),
    Case("no lengths", "generate RyRz -n 3 --link-lengths a,b", ("--link-lengths", "'a,b'", "numbers")),
    Case("output is a directory", "generate RyRz -n 3 -o DIR", ("DIR", "is a directory", "a file")),
    Case("output under a file", "generate RyRz -n 3 -o ARM/x.urdf", ("ARM", "a directory")),
    Case("output is a pipe", "generate RyRz -n 3 -o DIR/pipe", ("DIR/pipe", "a device", "allowed: a file")),
    # the arm
    Case("missing arm", "inspect DIR/none.urdf", ("DIR/none.urdf", "no such file")),
    Case(
        "template for a file", "track RyRz --curve helix", ("RyRz: no such file", "pinposture generate RyRz")
    ),
    Case("no name of an arm", "inspect EMPTY", ("URDF is ''", "- for stdin")),
    Case("missing folder of meshes", "inspect ARM --package-dir DIR/none", ("--package-dir is 'DIR/none'",)),
    Case("arm is a directory", "inspect DIR", ("DIR", "directory")),
    Case("malformed URDF", "inspect DIR/broken.urdf", ("DIR/broken.urdf", "line 3", "XML")),
    Case("no link of the joint", "track DIR/orphan.urdf --curve helix", ("joint 'j'", "'nowhere'")),
    Case("nothing on stdin", "inspect -", ("stdin", "no URDF", "XML")),
    Case("unknown tip", "inspect ARM --tip tipp", ("'tipp'", "did you mean 'tip'", "base, m01_l1")),
    Case("unknown base", "track ARM --base x --tip tip --curve helix", ("'x'", "base, m01_l1")),
    Case("base alone", "inspect ARM --base base", ("tip is not given", "tip=")),
    Case("indivisible", "inspect ARM --split 5", ("split", "5", "1, 2, 3, 4, 6, 12")),
    Case("sizes that do not add up", "inspect ARM --split 5,5", ("[5, 5]", "add up to 12")),
    Case("no sizes", "inspect ARM --split 2,,2", ("--split is '2,,2'", "whole numbers or names")),
    Case("unknown link", "inspect ARM --split tipp", ("'tipp'", "did you mean 'tip'")),
    Case("unknown link of several", "track ARM --curve line --split m9,tip", ("link", "'m9'", "m01_l1")),
    Case("sizes and links", "inspect ARM --split 2,tip", ("'2'", "link")),
    Case("links out of order", "inspect ARM --split m03_l2,m02_l2,tip", ("'m02_l2'", "in order")),
    Case("plot under a file", "inspect ARM --plot ARM/x.png", ("ARM", "a directory")),
    Case("name too long", f"view {'x' * 300}", ("x" * 300, "File name too long")),
    Case("plot is a directory", "inspect ARM --plot DIR/a.png", ("DIR/a.png", "is a directory", "a file")),
    # the curve
    Case("unknown preset", "track ARM --curve helx", ("'helx'", "did you mean 'helix'", "line, helix")),
    Case("missing curve", "track ARM --curve DIR/none.csv", ("DIR/none.csv", "no such file")),
    Case("odd kind of curve", "track ARM --curve DIR/one.xyz", ("DIR/one.xyz", ".json, .csv, .txt")),
    Case("one point", "track ARM --curve DIR/one.csv", ("DIR/one.csv", "2")),
    Case("repeated points", "track ARM --curve DIR/twice.csv", ("DIR/twice.csv", "line 3")),
    Case("NaN in a CSV", "track ARM --curve DIR/nan.csv", ("DIR/nan.csv", "line 2")),
    Case("text in a CSV", "track ARM --curve DIR/text.csv", ("DIR/text.csv", "line 2", "'hello'")),
    Case("malformed JSON", "track ARM --curve DIR/broken.json", ("DIR/broken.json", "line 1")),
    Case("curve too short", "track ARM --curve DIR/short.json", ("module 4", "lengthen the curve")),
    Case(
        "curve in millimetres",
        "track ARM --curve DIR/mm.csv",
        ("33 m long; allowed: 30 m", "load it with --scale 0.001"),
    ),
    Case("scale 0", "batch ARM --curve DIR/mm.csv --scale 0", ("scale is 0.0", "> 0")),
    Case("preset with a scale", "track ARM --curve line --scale 2", ("--scale is 2.0", "only with a file")),
    Case("scale of nothing", "inspect ARM --scale 2", ("--scale is 2.0", "only with --curve")),
    Case("curve out of plane", "track DIR/flat.urdf --curve helix", ("module 1", "off the plane")),
    Case("curve elsewhere", "track ARM --curve DIR/far.json --placement as_is", ("module 1", "5 m", "align")),
    Case(
        "no place at all", "track ARM --curve DIR/tiny.json --partial", ("--curve", "DIR/tiny.json", "first")
    ),
    Case("unknown placement", "track ARM --curve helix --placement up", ("'up'", "as_is, translate, align")),
    Case(
        "unknown method", "track ARM --curve helix --method best", ("'best'", "auto, sequential, smooth, cl")
    ),
    Case("roll NaN", "track ARM --curve helix --roll nan", ("--roll is nan", "finite")),
    # the motion
    Case("unknown controller", "track ARM --curve line --controller magic", ("'magic'", "selection, projec")),
    Case("no steps", "track ARM --curve line --steps 0", ("--steps is 0", "at least 1")),
    Case("step limit 0", "track ARM --curve line --step-limit 0", ("--step-limit is 0", "positive")),
    Case("step limit NaN", "track ARM --curve line --step-limit nan", ("--step-limit is nan", "not finite")),
    Case("tolerance 0", "track ARM --curve line --tolerance 0", ("--tolerance is 0", "more than 0")),
    Case("tolerance inf", "track ARM --curve line --tolerance inf", ("--tolerance is inf", "not finite")),
    Case("seed -1", "track ARM --curve line --seed -1", ("--seed is -1", "at least 0")),
    # the start
    Case("unknown start", "track ARM --curve line --start strait", ("'strait'", "did you mean 'straight'")),
    Case("short start", "track ARM --curve line --start 0.1,0.2", ("start", "(2,)", "(12,)")),
    Case("start NaN", f"track ARM --curve line --start 0{',nan' * 11}", ("start[1] is nan", "finite")),
    Case("start inf", f"track ARM --curve line --start 0{',inf' * 11}", ("start[1] is inf", "finite")),
    Case("missing start", "track ARM --curve line --start DIR/q.npy", ("DIR/q.npy", "no such file")),
    Case(
        "pickled start",
        "track ARM --curve line --start DIR/pickled.npy",
        ("DIR/pickled.npy", "list of numbers"),
    ),
    Case(
        "archived start",
        "track ARM --curve line --start DIR/archive.npy",
        ("DIR/archive.npy", "(not a list)"),
    ),
    Case("start matrix", "track ARM --curve line --start DIR/matrix.npy", ("DIR/matrix.npy", "numbers")),
    Case("start in words", "track ARM --curve line --start DIR/text.csv", ("DIR/text.csv", "'hello'")),
    Case("empty start", "track ARM --curve line --start DIR/empty.csv", ("DIR/empty.csv", "it is empty")),
    Case(
        "start of bytes", "track ARM --curve line --start DIR/bytes.csv", ("DIR/bytes.csv", "not UTF-8", "0")
    ),
    Case("array of bytes", "track ARM --curve line --start DIR/bytes.npy", ("DIR/bytes.npy", "no array")),
    Case("starts of bytes", "batch ARM --curve line --starts DIR/bytes.csv", ("DIR/bytes.csv", "not UTF-8")),
    Case("table of bytes", "batch ARM --curve line --starts DIR/bytes.npy", ("DIR/bytes.npy", "no array")),
    Case("start object", "track ARM --curve line --start DIR/far.json", ("DIR/far.json", "(not a list)")),
    Case("deep start", "track ARM --curve line --start DIR/deep.json", ("DIR/deep.json", "nested too deep")),
    Case("start NaN in a file", "track ARM --curve line --start DIR/nan.json", ("start[3] is nan", "finite")),
    Case("nul bytes", "track ARM --curve DIR/nul.csv", ("DIR/nul.csv", "line 1", r"\x00\x1b[31m", " ...")),
    # numbers without measure
    Case("too many jobs", "batch ARM --curve line --jobs 100000000000", ("'--jobs'", "1000")),
    # the output
    Case("output is a file", "track ARM --curve line -o ARM", ("ARM", "is a file", "a directory")),
    *(
        Case(
            f"{verb} into a file",
            f"{verb} {line} -o DIR/new.npz",
            ("--output is 'DIR/new.npz'", "a directory"),
        )
        for verb, line in {
            "track": "ARM --curve line",
            "batch": "ARM --curve line",
            "reach": "ARM --to 0,0,0.1",
            "run": "DIR/task.toml",
        }.items()
    ),
    Case("output under a file ", "track ARM --curve line -o ARM/out", ("ARM", "is a file")),
    # view
    Case("missing run", "view DIR/none.npz", ("DIR/none.npz", "no such file")),
    Case("directory without a run", "view DIR", ("DIR/run.npz", "no such file")),
    Case("not a run", "view DIR/matrix.npy", ("DIR/matrix.npy", "is not a saved run")),
    Case("picture under a file", "view RUN -o ARM/x.png", ("ARM", "a directory")),
    Case("unknown viewer", "view RUN --viewer x -o DIR/x.html", ("'x'", "meshcat, foxglove")),
    Case("neither picture", "view RUN -o DIR/x.pdf", ("DIR/x.pdf", "'.pdf'", "allowed: .html, .png")),
    Case("picture is a directory", "view RUN -o DIR/a.png", ("DIR/a.png", "is a directory", "a file")),
    Case("animation under a file", "view RUN -o ARM/x.html", ("ARM", "is a file")),
]


TASK = """
[arm]
template = "RyRz"
modules = 4
[limits]
cycle = "50 ms"
[output]
formats = ["npz", "csv", "json"]
[[keyframes]]
joints = [0, 0, 0, 0, 0, 0, 0, 0]
[[keyframes]]
time = "1 s"
joints = [0.1, 0, 0, 0, 0, 0, 0, 0]
"""


@pytest.fixture(scope="module")
def directory(command, tmp_path_factory):
    """Files that hold what they should not, and a planar arm."""
    path = tmp_path_factory.mktemp("bad")
    command("generate", "Rz", "--modules", 4, "-o", path / "flat.urdf")
    files = {
        "broken.urdf": '<robot name="r">\n<link name="a">\n',
        "orphan.urdf": '<robot name="r"><link name="a"/><joint name="j" type="revolute"><parent link="a"/>'
        '<child link="nowhere"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
        "</joint></robot>",
        "task.toml": TASK,
        "empty.csv": "",
        "nul.csv": "\0\x1b[31m" * 1000,
        "one.csv": "x,y,z\n0,0,0\n",
        "one.xyz": "0 0 0\n1 0 0\n",
        "twice.csv": "0,0,0\n1,0,0\n1,0,0\n2,0,0\n",
        "mm.csv": "0,0,0\n33,0,0\n",
        "nan.csv": "0,0,0\nnan,0,0\n2,0,0\n",
        "text.csv": "0,0,0\n1,hello,0\n",
        "broken.json": '{"type": "line",',
        "deep.json": "[" * 100_000,
        "nan.json": json.dumps([0.0] * 3 + [float("nan")] * 9),
        "short.json": json.dumps({"type": "line", "a": [0, 0, 0], "b": [0.17, 0, 0]}),
        "tiny.json": json.dumps({"type": "line", "a": [0, 0, 0], "b": [0.01, 0, 0]}),
        "far.json": json.dumps({"type": "line", "a": [0, 5, 0], "b": [1, 5, 0]}),
    }
    for name, text in files.items():
        (path / name).write_text(text)
    np.save(path / "pickled.npy", np.zeros(12).astype(object), allow_pickle=True)
    np.save(path / "matrix.npy", np.zeros((1, 12)))
    os.mkfifo(path / "pipe")
    (path / "a.png").mkdir()
    for name in ("bytes.csv", "bytes.npy"):
        (path / name).write_bytes(bytes(range(255, 0, -1)))
    with (path / "archive.npy").open("wb") as file:
        np.savez(file, q=np.zeros(12))
    return path


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_wrong_input_is_refused_in_one_line_that_names_it(
    command, arm_file, run_directory, directory, case, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    places = {"ARM": str(arm_file), "DIR": str(directory), "RUN": str(run_directory)}

    def placed(text: str) -> str:
        for name, place in places.items():
            text = text.replace(name, place)
        return text.replace("EMPTY", "")

    result = command(*(placed(word) for word in case.line.split()), input="hello")
    assert result.code == 2
    assert result.out == ""
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1
    assert result.err.endswith("\n")
    assert result.err[:-1].isprintable() and len(result.err) < 1100
    for text in case.says:
        assert placed(text) in result.err
    assert list(tmp_path.iterdir()) == []


def test_bytes_on_stdin_are_no_robot(command):
    error = "error: stdin: is not UTF-8 text (byte 5)\n"
    assert command("inspect", "-", input=b"<robo\xff>") == (2, "", error)


def test_a_refused_output_directory_costs_no_run(command, arm_file, monkeypatch):
    def never(*_, **__):
        raise AssertionError("tracked first")

    monkeypatch.setattr("pinposture.motion.track", never)
    assert command("track", arm_file, "--curve", "line", "-o", arm_file).code == 2


def test_a_message_of_several_lines_becomes_one(command, arm_file, monkeypatch):
    def refused(*_, **__):
        raise InvalidValue("points", "", "first line,\n   second line")

    monkeypatch.setattr("pinposture.motion.track", refused)
    result = command("track", arm_file, "--curve", "line")
    assert result.err == "error: points is ''; allowed: first line, second line\n"


@pytest.mark.parametrize(
    ("verb", "says"),
    [
        ("track", 'use --placement translate or align, not speed="low"'),
        ("inspect", 'use placement="translate" or "align", not speed="low"'),  # has no such option
    ],
)
def test_arguments_in_a_message_are_written_as_options_of_the_verb(command, monkeypatch, verb, says):
    def refuse(*_: object, **__: object) -> None:
        raise InvalidValue("curve", 1, 'use placement="translate" or "align", not speed="low"')

    monkeypatch.setattr("pinposture.cli.inputs.ArmOptions.read", refuse)
    options = ("--curve", "line") if verb == "track" else ()
    assert command(verb, "arm.urdf", *options) == (2, "", f"error: --curve is 1; allowed: {says}\n")


def test_brackets_in_a_message_are_text_and_no_markup(command):
    assert "'[red]x[/red]'" in command("generate", "[red]x[/red]", "--modules", 2).err


@pytest.mark.long
@pytest.mark.parametrize("options", [(), ("--json",)], ids=["words", "json"])
@pytest.mark.parametrize(
    ("line", "wrote", "lost", "others"),
    [
        ("track ARM --curve helix --steps 3", ["run.png"], "run.html", "; not written either: run.npz"),
        ("run TASK", ["motion.json", "motion.csv"], "motion.npz", ""),
        ("batch ARM --curve helix --count 1 --steps 3", [], "batch.npz", ""),
        ("simulate RUN --dt 1 --hold 0 --no-gravity", ["simulation.png"], "simulation.npz", ""),
        ("reach ARM --to 0.1,0,0.1", ["posture_1.json"], "postures.png", ""),
    ],
)
@pytest.mark.usefixtures("no_pictures")
def test_a_full_disk_costs_the_files_but_not_the_summary(
    command, arm_file, run_directory, tmp_path, monkeypatch, options, line, wrote, lost, others
):
    (tmp_path / "task.toml").write_text(TASK)
    places = {"ARM": str(arm_file), "RUN": str(run_directory), "TASK": str(tmp_path / "task.toml")}
    words = [places.get(word, word) for word in line.split()]
    out = tmp_path / "out"
    replace = Path.replace
    alone = command(*words, *options)
    assert alone.code in (0, 1)

    def replace_while_there_is_space(draft: Path, final: Path) -> Path:
        if final.name not in (*wrote, "status.json"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return replace(draft, final)

    monkeypatch.setattr(Path, "replace", replace_while_there_is_space)
    result = command(*words, *options, "-o", out)
    assert result.code == 2
    error = f"error: {out / lost}: cannot be written (No space left on device){others}"
    notes = [f"wrote {out / name}" for name in wrote]
    assert [each for each in result.err.splitlines() if "note: " not in each] == [*notes, error]
    assert sorted(path.name for path in out.rglob("*") if path.name != "status.json") == sorted(wrote)
    if options:
        told = json.loads(result.out)
        expected = json.loads(alone.out)
        files = told.pop("files", None) or []
        assert [*(files.values() if isinstance(files, dict) else files)] == [
            str(out / name) for name in wrote
        ]
        assert told.keys() == expected.keys() - {"files"}
    else:
        assert result.out == alone.out


def test_an_interrupted_picture_leaves_nothing(command, run_directory, tmp_path, monkeypatch):
    def interrupted(motion):
        raise KeyboardInterrupt

    monkeypatch.setattr("pinposture.viz.plot", interrupted)
    assert command("view", run_directory, "-o", tmp_path / "new" / "plot.png").code == 130
    assert list(tmp_path.iterdir()) == []


def test_an_exception_in_the_own_controller_is_one_line(command, arm_file, tmp_path, monkeypatch):
    (tmp_path / "faulty_controller.py").write_text(
        "class Faulty:\n    name = 'faulty'\n\n    def step(self, *given):\n        return 1 / 0\n"
    )
    monkeypatch.chdir(tmp_path)
    asked = ("--curve", "line", "--controller", "faulty_controller:Faulty")
    result = command("track", arm_file, *asked)
    said = "Faulty.step(...) raised ZeroDivisionError: division by zero (faulty_controller.py, line 5)"
    assert (result.code, result.out, result.err) == (2, "", f"error: {said}\n")
    assert command("batch", arm_file, *asked, "--count", 1) == result
