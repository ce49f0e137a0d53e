"""`pinposture study methods` prints what `compare_methods` finds."""

from __future__ import annotations

import json

import pytest

import pinposture as pp
from pinposture.study import compare_methods

NAMES = ["selection", "switching", "lm"]


@pytest.fixture(scope="module")
def urdf(command, tmp_path_factory):
    path = tmp_path_factory.mktemp("methods") / "arm.urdf"
    command("generate", "RyRz", "--modules", 6, "-o", path)
    return path


def test_json_and_table_are_what_the_library_found(command, urdf):
    asked = ("study", "methods", urdf, "--controllers", ",".join(NAMES), "--seeds", 2, "--steps", 60)
    found = json.loads(command(*asked, "--json").out)
    expected = compare_methods(pp.Arm.load(urdf), NAMES, range(2), 60)
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
