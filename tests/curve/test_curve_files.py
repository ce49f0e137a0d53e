"""Curves in files, and as plain data."""

import json

import numpy as np
import pytest

from pinposture.curve import Curve
from pinposture.errors import FileError, PostureError

POINTS = [[0, 0, 0], [0.1, 0.2, 0], [0.3, 0.2, 0.1], [0.4, 0, 1 / 3], [0.5, 0.1, 0.2]]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Curve.spline(POINTS),
        lambda: Curve.spline(POINTS, 4, through=True),
        lambda: Curve.line((0, 0), (1 / 3, np.pi)),
        lambda: Curve.helix(0.06, 0.15, 4, phase=0.1),
        lambda: Curve.points(POINTS, 0.01),
        lambda: Curve.spline(POINTS).trimmed(0.1, 0.3),
    ],
    ids=["spline", "through", "line", "helix", "points", "trimmed"],
)
def test_saved_curve_comes_back_equal_to_the_last_bit(make, tmp_path):
    curve = make()
    path = tmp_path / "curve.json"
    curve.save(path)
    again = Curve.load(str(path))
    assert again == curve
    np.testing.assert_array_equal(again.resample(100), curve.resample(100))
    assert Curve.from_dict(json.loads(json.dumps(curve.to_dict()))) == curve


@pytest.mark.parametrize("name", ["curve.csv", "curve.json"])
def test_a_file_in_millimetres_is_loaded_with_a_scale(name, tmp_path):
    path = tmp_path / name
    thousand = (1000 * np.array(POINTS)).tolist()
    rows = "\n".join(",".join(map(str, row)) for row in thousand)
    path.write_text(rows if path.suffix == ".csv" else json.dumps(thousand))
    curve = Curve.load(path, scale=0.001)
    np.testing.assert_allclose(curve.resample(50), Curve.points(POINTS).resample(50), atol=1e-12)
    for scale in (0, -1, np.inf, "mm", None):
        with pytest.raises(PostureError, match="scale is"):
            Curve.load(path, scale=scale)


def test_saving_replaces_a_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "curve.json"
    path.write_text("old")
    Curve.line((0, 0), (1, 0)).save(path)
    Curve.line((0, 0), (2, 0)).save(path)
    assert Curve.load(path).length == 2
    assert [p.name for p in tmp_path.iterdir()] == ["curve.json"]


def test_a_failed_save_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "curve.json"
    Curve.line((0, 0), (1, 0)).save(path)

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(FileError, match="No space left"):
        Curve.line((0, 0), (2, 0)).save(path)
    assert Curve.load(path).length == 1
    assert [p.name for p in tmp_path.iterdir()] == ["curve.json"]


@pytest.mark.parametrize(
    ("content", "make"),
    [
        ({"type": "spline", "control_points": POINTS}, lambda: Curve.spline(POINTS)),
        (
            {"type": "spline", "control_points": POINTS, "degree": 2, "through": True},
            lambda: Curve.spline(POINTS, degree=2, through=True),
        ),
        ({"type": "line", "a": [0, 0], "b": [1, 2, 3]}, lambda: Curve.line((0, 0, 0), (1, 2, 3))),
        (
            {"type": "helix", "radius": 0.06, "pitch": 0.15, "turns": 4, "handedness": "left"},
            lambda: Curve.helix(0.06, 0.15, 4, handedness="left"),
        ),
        ({"type": "points", "points": POINTS}, lambda: Curve.points(POINTS)),
        ({"type": "points", "points": POINTS, "smoothing": 0.02}, lambda: Curve.points(POINTS, 0.02)),
        (POINTS, lambda: Curve.points(POINTS)),
    ],
)
def test_handwritten_json_calls_the_constructor(content, make, tmp_path):
    path = tmp_path / "curve.json"
    path.write_text(json.dumps(content))
    assert Curve.load(path) == make()


@pytest.mark.parametrize(
    "text",
    [
        "0,0,0\n0.1,0.2,0\n0.3,0.2,0.1\n",
        "x,y,z\n0,0,0\n0.1,0.2,0\n0.3,0.2,0.1\n",
        '# measured on the bench\n"X";"Y";"Z"\n\n0; 0; 0\n.1;.2;0 # a note\n0.3;2e-1;0.1',
        "x y z\r\n0 0 0\r\n0.1\t0.2  0\r\n0.3 0.2 0.1\r\n",
        "\ufeff0 0 0\n0.1 0.2 0\n  0.3 0.2 0.1",
    ],
)
@pytest.mark.parametrize("suffix", ["csv", "TXT"])
def test_tables_are_read_with_any_separator_and_headings(text, suffix, tmp_path):
    path = tmp_path / f"curve.{suffix}"
    path.write_bytes(text.encode())
    assert Curve.load(path) == Curve.points([[0, 0, 0], [0.1, 0.2, 0], [0.3, 0.2, 0.1]])


@pytest.mark.parametrize(
    ("header", "per_metre"),
    [
        ("x [m],y [m],z [m]", 1),
        ('"x [mm]";"y [mm]";"z [mm]"', 1000),
        ("X[cm], Y[cm], Z[cm]", 100),
        ("x (mm), y (mm), z (mm)", 1000),
        ("x_mm y_mm z_mm", 1000),
    ],
)
def test_the_header_of_a_table_gives_the_unit(header, per_metre, tmp_path):
    path = tmp_path / "curve.csv"
    points = [[0, 0, 0], [3, 2, 0], [7, 2, -1]]
    separator = next(each for each in ";, " if each in header)
    path.write_text("\n".join([header, *(separator.join(map(str, row)) for row in points)]))
    assert Curve.load(path) == Curve.points(np.array(points) / per_metre)


def test_table_of_two_columns_lies_in_the_plane(tmp_path):
    path = tmp_path / "curve.csv"
    path.write_text("x,y\n0,0\n1,0\n1,1\n0,1\n")
    assert Curve.load(path) == Curve.points([[0, 0], [1, 0], [1, 1], [0, 1]])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.csv", "0,0\n1,0\n1,zero\n", ["line 3", "column 2", "'zero'"]),
        ("a.csv", "# c\nx,y\n0,0\n\n1,\n", ["line 5", "column 2", "''"]),
        ("a.csv", "0,0\n1,nan\n", ["line 2", "y is nan"]),
        ("a.csv", "0,0\n1,1e999\n", ["line 2", "y is inf"]),
        ("a.csv", "0,0\n1,1,1\n", ["line 2", "3 columns", "2"]),
        ("a.csv", "0,0,0\n1,1\n", ["line 2", "2 columns", "3, as before"]),
        ("a.csv", "x,y,z\n0,0\n", ["line 2", "2 columns", "3"]),
        ("a.csv", "0\n1\n", ["line 1", "1 columns", "2 (then z = 0) or 3"]),
        ("a.csv", "0,0\n1,1\n\n1,1\n2,3\n", ["line 2 and line 4", "same place"]),
        ("a.csv", "t,x,y\n0,0,0\n", ["line 1", "t, x, y", "x, y or x, y, z"]),
        ("a.csv", "x [mm],y\n0,0\n1,0\n", ["line 1", "x [mm], y;", "in one unit", "x [mm], x [cm]"]),
        ("a.csv", "x [in],y [in]\n0,0\n1,0\n", ["line 1", "x [in]", "in one unit"]),
        ("a.csv", "t,x,y,z\n0,0,0,0\n", ["line 1", "t, x, y, z"]),
        ("a.csv", "0,0\nx,y\n", ["line 2", "column 1", "'x'"]),
        ("a.csv", "0;0\n1,5;2\n", ["line 2", "'1,5'"]),
        ("a.csv", "# nothing\n", ["no points"]),
        ("a.csv", "x,y\n0,0\n", ["1 point given", "at least 2"]),
        ("a.txt", "0 0\n0 0 # again\n", ["line 1 and line 2"]),
        ("a.json", '{"type": "line",\n "a": [0, 0,\n}', ["line 3"]),
        ("a.json", "3", ["3", "an object with a 'type'"]),
        ("a.json", "[[0, 0], [1, NaN]]", ["point 1", "y is nan"]),
        ("a.json", '[[0, 0], [1, "2"], [2, 3]]', ["point 1", "'2'"]),
        ("a.json", "[[0, 0], [1, 2, 3]]", ["point 1", "3 coordinates"]),
        ("a.json", "[[0, 0], 7]", ["point 1", "7"]),
        ("a.json", "[]", ["0 points given"]),
        ("a.json", "[[0, 0], [1" + "0" * 5000 + ", 1]]", ["digits"]),
        ("a.json", '{"a": [0, 0], "b": [1, 1]}', ["'type'", "spline, line, helix, points, bspline"]),
        ("a.json", '{"type": "lime", "a": [0, 0]}', ["'lime'", "did you mean 'line'", "helix"]),
        ("a.json", '{"type": 3}', ["type", "3", "helix"]),
        ("a.json", '{"type": "line", "a": [0, 0], "c": [1, 1]}', ["c: there is no such key; allowed: a, b"]),
        ("a.json", '{"type": "line", "a": [0, 0]}', ["the key 'b' is missing"]),
        (
            "a.json",
            '{"type": "line", "a": [0, 0], "b": "far"}',
            ["b is 'far'", "units m, cm, mm"],
        ),
        ("a.json", '{"type": "helix", "radius": -1, "pitch": 1, "turns": 1}', ["radius", "-1"]),
        ("a.json", '{"type": "spline", "control_points": [[0, 0], [1, 1]]}', ["degree 3", "at least 4"]),
        (
            "a.json",
            '{"type": "spline", "control_points": [[0, 0], [1, 1]], "degree": "1"}',
            ["degree", "'1'"],
        ),
        (
            "a.json",
            '{"type": "spline", "control_points": [[0, 0], [1, 1]], "degree": 1, "through": 1}',
            ["through"],
        ),
        (
            "a.json",
            '{"type": "bspline", "degree": 1, "knots": [0, 0, 1], "coefficients": [[0, 0], [1, 1]]}',
            ["knots"],
        ),
        ("a.yaml", "", [".yaml", ".json, .csv, .txt"]),
    ],
)
def test_a_bad_file_is_named_with_its_culprit(name, text, words, tmp_path):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        Curve.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    for word in words:
        assert word in caught.value.reason


def test_files_that_cannot_be_read_or_written(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        Curve.load(tmp_path / "none.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(FileError, match="directory"):
        Curve.load(tmp_path / "folder.csv")
    (tmp_path / "latin.csv").write_bytes(b"0,0\n1,1 # \xe9t\xe9\n")
    with pytest.raises(FileError, match="UTF-8"):
        Curve.load(tmp_path / "latin.csv")
    line = Curve.line((0, 0), (1, 0))
    with pytest.raises(FileError, match="is a file"):
        line.save(tmp_path / "latin.csv" / "curve.json")
    line.save(tmp_path / "new" / "curve.json")
    assert Curve.load(tmp_path / "new" / "curve.json") == line
    with pytest.raises(FileError, match=r"allowed: \.json"):
        line.save(tmp_path / "curve.csv")


def test_description_must_be_an_object():
    with pytest.raises(PostureError, match="allowed: a table with a 'type'"):
        Curve.from_dict(POINTS)
