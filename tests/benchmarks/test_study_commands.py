from __future__ import annotations

import json

import pytest

import pinposture as pp
from benchmarks.__main__ import STUDIES
from benchmarks.harness import Case, Study
from benchmarks.studies.arms import UNKNOWN, compressed, survey_arms
from benchmarks.studies.methods import by_method, compare_methods


@pytest.fixture(scope="module")
def arms(command, tmp_path_factory):
    """Two generated arms, one of them with a joint off its chain, a malformed one, and a short one."""
    path = tmp_path_factory.mktemp("arms")
    (path / "deep").mkdir()
    command("generate", "RyRz", "--modules", 4, "-o", path / "a.urdf")
    command("generate", "Rz", "--modules", 6, "-o", path / "deep" / "flat.urdf")
    command("generate", "Rz", "--modules", 3, "-o", path / "short.urdf")
    (path / "broken.urdf").write_text('<robot name="r">\n<link name="a">\n')
    file = path / "deep" / "flat.urdf"
    finger = (
        '<link name="nail"/><joint name="finger" type="revolute"><parent link="base"/><child link="nail"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    file.write_text(file.read_text().replace("</robot>", finger))
    return path


@pytest.fixture(scope="module")
def surveyed(command, arms):
    return command("study", "arms", arms), command("study", "arms", arms, "--json")


def cells(out):
    """The rows of the tables by their first word."""
    return {line.split()[0]: line.split() for line in out.splitlines() if line.strip()}


def test_the_json_is_what_the_library_found(arms, surveyed):
    about = json.loads(surveyed[1].out)
    assert (about["directory"], about["least_joints"], about["seed"]) == (str(arms), 5, 0)
    expected = survey_arms(arms).rows()
    assert [arm["file"] for arm in about["arms"]] == ["a.urdf", "broken.urdf", "flat.urdf"]
    for shown, found in zip(about["arms"], expected, strict=True):
        for name, value in found.items():
            assert shown[name] == (list(value) if isinstance(value, tuple) else value), name
        if not found.refused:
            assert shown["ok"] is (found.residual <= 1.05 * found.reference + 1e-6)
            assert shown["ok"]


def test_the_table_says_what_the_json_says(surveyed):
    rows = cells(surveyed[0].out)
    first, _, flat = json.loads(surveyed[1].out)["arms"]
    for arm, sizes, kind in ((first, "2 x 4", "spatial"), (flat, "1 x 6", "planar")):
        row = [arm["file"], str(arm["joints"]), *sizes.split(), kind, f"{arm['length']:.4g}", arm["method"]]
        row += [f"{arm['residual']:.2g}", f"{arm['reference']:.2g}"]
        row += ["ok" if arm["ok"] else f"{arm['ratio']:.2g}", f"{arm['farthest']:.2g}"]
        row += [f"{arm[name]:.2g}" for name in ("reached", "switching", "geodesic")]
        row += [str(arm["geodesic_steps"]), f"{arm['path_length_ratio']:.2g}", "yes"]
        assert rows[arm["file"]] == row
    assert first["joints"] == 8
    assert flat["joints"] == 6
    headings = (
        "placed by",
        "residual",
        "reference",
        "ratio",
        "farthest",
        "joint",
        "Switching",
        "geodesic",
        "geodesic steps",
    )
    for heading in (*headings, "geodesic paths", "limits held"):
        assert heading in surveyed[0].out


def test_a_file_that_is_refused_says_why_and_stops_nothing(surveyed):
    row = cells(surveyed[0].out)["broken.urdf"]
    refused = json.loads(surveyed[1].out)["arms"][1]
    assert " ".join(row) == f"broken.urdf refused: {refused['refused']}"
    assert "line 3" in refused["refused"]
    assert refused["ok"] is refused["ratio"] is refused["residual"] is None


def test_notes_go_to_stderr(surveyed):
    for result in surveyed:
        assert result.code == 0
        (note,) = result.err.splitlines()
        assert note.startswith("note: flat.urdf: 1 joint off the chain")
        assert "'finger'" in note


def test_short_arms_are_left_out_unless_asked_for(command, arms, tmp_path):
    file = tmp_path / "short.urdf"
    file.write_text((arms / "short.urdf").read_text())
    result = command("study", "arms", tmp_path)
    assert (result.code, result.out) == (0, "")
    assert result.err == "no arm of at least 5 moving joints\n"
    assert json.loads(command("study", "arms", tmp_path, "--json").out)["arms"] == []
    (arm,) = json.loads(command("study", "arms", tmp_path, "--least-joints", 3, "--json").out)["arms"]
    assert (arm["file"], arm["joints"]) == ("short.urdf", 3)


def test_options_reach_the_study(command, arms, monkeypatch):
    asked = []

    def survey(*given):
        asked.append(given)
        return Study([], [], dict)

    monkeypatch.setattr("benchmarks.studies.arms.survey_arms", survey)
    command("study", "arms", arms, "--least-joints", 7, "--seed", 3, "--jobs", 2)
    command("study", "arms", arms, "--jobs", -1)
    assert asked == [(arms, 7, 3), (arms, 5, 0)]


def found_by_hand(rows):
    """A study of arms with known rows."""
    return Study([Case({}, lambda: None)], rows, lambda _, row: row)


def test_an_arm_placed_worse_than_the_reference_shows_the_ratio(command, arms, monkeypatch):
    worse = UNKNOWN.but(file="w.urdf", joints=7, modules=(2, 2, 3), dimension=3)
    worse = worse.but(residual=0.03, reference=0.02)
    exact = worse.but(file="e.urdf", residual=9e-10, reference=0.0, within_limits=False)
    far = worse.but(file="f.urdf", residual=1e-3, reference=0.0, reached=0.5)
    found = [worse, exact, far]
    monkeypatch.setattr("benchmarks.studies.arms.survey_arms", lambda *_: found_by_hand(found))
    out = command("study", "arms", arms).out
    rows = cells(out)
    assert rows["w.urdf"][2:5] == ["2,", "2,", "3"]
    assert rows["w.urdf"][-10:] == ["0.03", "0.02", "1.5", "-", "-", "-", "-", "-", "-", "yes"]
    assert rows["e.urdf"][-10:] == ["9e-10", "0", "ok", "-", "-", "-", "-", "-", "-", "no"]
    assert rows["f.urdf"][-10:] == ["0.001", "0", "1e+03", "-", "0.5", "-", "-", "-", "-", "yes"]
    about = json.loads(command("study", "arms", arms, "--json").out)
    assert [(arm["ok"], arm["ratio"]) for arm in about["arms"]] == [
        (False, pytest.approx(1.5)),
        (True, pytest.approx(1.0)),
        (False, pytest.approx(1e3)),
    ]


def test_an_arm_of_which_a_part_has_no_place_says_so_in_the_table_and_why_in_a_note(command, tmp_path):
    stiff = command("generate", "RyRz", "--modules", 6).out.replace("3.141592653589793", "0.001")
    assert 'lower="-0.001"' in stiff
    (tmp_path / "stiff.urdf").write_text(stiff)
    result = command("study", "arms", tmp_path)
    (arm,) = json.loads(command("study", "arms", tmp_path, "--json").out)["arms"]
    method, _, reason = arm["method"].partition(": ")
    assert cells(result.out)["stiff.urdf"][7:9] == [method, "(partial)"]
    assert result.err.splitlines() == [f"note: stiff.urdf: {reason}"]
    assert reason.startswith("module ")


@pytest.mark.parametrize(
    ("sizes", "text"),
    [((2,) * 8, "2 x 8"), ((2, 2, 3), "2, 2, 3"), ((1,) * 18 + (2,), "1 x 18, 2"), ((4,), "4"), ((), "")],
)
def test_sizes_that_repeat_are_written_once(sizes, text):
    assert compressed(sizes) == text


NAMES = ["selection", "switching", "lm"]


@pytest.fixture(scope="module")
def urdf(command, tmp_path_factory):
    path = tmp_path_factory.mktemp("methods") / "arm.urdf"
    command("generate", "RyRz", "--modules", 6, "-o", path)
    return path


@pytest.mark.long
def test_json_and_table_are_what_the_library_found(command, urdf):
    asked = ("study", "methods", urdf, "--controllers", ",".join(NAMES), "--seeds", 2, "--steps", 60)
    found = json.loads(command(*asked, "--json").out)
    expected = by_method(compare_methods(pp.Arm.load(urdf), NAMES, range(2), 60).rows())
    assert [method["controller"] for method in found["methods"]] == NAMES
    for shown, result in zip(found["methods"], expected, strict=True):
        assert shown["posture_error"] == result.posture_error
        assert tuple(shown["peaks"]) == result.peaks
    table = command(*asked).out
    for result in expected:
        line = next(line for line in table.splitlines() if line.split()[:1] == [result.controller])
        assert f"{100 * result.reached:.0f} %" in line
        assert f"{result.posture_error:.2g}" in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--controllers", "simplex"), "simplex"),
        (("--seeds", "0"), "--seeds"),
        (("--steps", "0"), "--steps"),
        (("--jobs", "0"), "jobs is 0"),
    ],
)
def test_wrong_usage_is_one_line(command, arguments, message):
    done = command("study", "methods", *arguments)
    assert done.code == 2
    assert message in done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("study scenes --seeds 100000000000", ("'--seeds'", "1000000")),
        ("reproduce 6.3 --width 1e300 -o DIR/rep", ("'--width'", "1000")),
        ("reproduce 6.3 --width 1e-300 -o DIR/rep", ("'--width'", "20")),
        ("study scenes --seed0 -1", ("--seed0 is -1", "at least 0")),
        ("study postures --cases 1 -o DIR/new.npz", ("--output is 'DIR/new.npz'", "a directory")),
        ("study armz", ("'armz'", "arms", "benchmarks study --help")),
        ("study arms DIR/none", ("DIR/none", "not a directory")),
        ("study arms DIR", ("DIR", "no file that ends in .urdf")),
        ("study arms DIR --seed -1", ("--seed is -1", "at least 0")),
        ("study leader --jobs 0", ("jobs is 0", "from 1 to 10000")),
    ],
)
def test_what_cannot_be_studied_is_one_line(command, tmp_path, line, words):
    done = command(*line.replace("DIR", str(tmp_path)).split())
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert all(word.replace("DIR", str(tmp_path)) in done.err for word in words)


@pytest.mark.parametrize("verb", ["methods", "postures"])
def test_a_study_of_any_arm_has_the_options_of_arms(command, verb):
    text = command("study", verb, "--help", env={"COLUMNS": "200"}).out
    assert all(option in text for option in ("--locked", "--package-dir", "--xacro-arg", "--hard-limits"))


@pytest.mark.parametrize("arguments", [(), ("--help",), ("-h",)])
def test_the_group_alone_tells_of_its_studies(command, arguments):
    result = command("study", *arguments)
    assert (result.code, result.err) == (0, "")
    assert all(f" {name} " in result.out for name in STUDIES)
