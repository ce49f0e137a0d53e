"""Limits of the command line hold on every step of the run, whatever moves the arm."""

from __future__ import annotations

import numpy as np
import pytest

import pinposture as pp
from pinposture.schema import describe_field

SLACK = 1e-9


@pytest.fixture
def track(command, arm_file, tmp_path, no_pictures):
    def run(*options) -> pp.Run:
        result = command("track", arm_file, "--curve", "helix", "--steps", 40, "-o", tmp_path, *options)
        assert result.code in (0, 1), result.err  # some limits leave too little time
        return pp.load(tmp_path / "run.npz", pp.Run)

    return run


@pytest.mark.parametrize("controller", ["geodesic", "switching"])
def test_speed_and_acceleration_limits_hold_and_bind(track, controller):
    asked = ("--velocity", 1.5, "--acceleration", 20, "--dt", 0.02, "--controller", controller)
    q = track(*asked).q
    steps = np.diff(q, axis=0)
    changes = np.diff(steps, axis=0, prepend=np.zeros((1, q.shape[1])))
    assert 0.9 * 1.5 * 0.02 < np.abs(steps).max() <= 1.5 * 0.02 + 1e-9
    assert 0.6 * 20 * 0.02**2 < np.abs(changes).max() <= 20 * 0.02**2 + 1e-9


def test_a_limit_of_jerk_holds_and_binds(track):
    q = track("--acceleration", 5, "--jerk", 30, "--dt", 0.05, "--steps", 400).q
    jerks = np.diff(np.pad(np.diff(q, axis=0), ((2, 2), (0, 0))), 2, axis=0) / 0.05**3
    assert 0.2 * 30 < np.abs(jerks).max() <= 30 + 1e-6


def test_the_summary_has_what_the_motion_takes_of_each_limit(command, arm_file, tmp_path, no_pictures):
    asked = ("--acceleration", 5, "--jerk", 30, "--dt", 0.05, "--steps", 400, "-o", tmp_path)
    out = command("track", arm_file, "--curve", "helix", *asked).out
    facts = {line[:15].strip(): line[15:].strip() for line in out.splitlines()}
    run = pp.load(tmp_path / "run.npz", pp.Run)
    moved = np.pad(np.diff(run.q, axis=0), ((2, 2), (0, 0)))
    rates = {}
    for order, (kind, most) in enumerate({"speed": 0.1 / 0.05, "acceleration": 5.0, "jerk": 30.0}.items()):
        rates[kind] = np.abs(np.diff(moved, order, axis=0)).max() / 0.05 ** (order + 1) / most
        assert facts[kind].startswith(f"at most {100.0 * rates[kind]:.4g} % of the limit")
    assert facts["steps"] == f"{run.steps}, {0.05 * run.steps:.4g} s"


def test_one_number_for_each_joint(track):
    speeds = np.linspace(0.5, 1.6, 12)
    run = track("--velocity", ",".join(map(str, speeds)), "--dt", 0.05)
    largest = np.abs(np.diff(run.q, axis=0)).max(axis=0)
    assert np.all(largest <= 0.05 * speeds + SLACK)
    assert np.any(largest > 0.05 * speeds - SLACK)


def test_with_a_duration_alone_joints_keep_their_own_speed(track):
    run = track("--dt", 0.01)
    assert np.abs(np.diff(run.q, axis=0)).max() == pytest.approx(0.01 * run.arm.limits.velocity[0])


def test_a_margin_keeps_joints_away_from_their_limits(track):
    margin = np.pi - 0.3  # on either side 0.3 rad are left
    free = track()
    kept = track("--position-margin", margin)
    assert np.abs(free.q[-1]).max() > 0.3
    assert np.abs(kept.q[-1]).max() == pytest.approx(0.3)
    assert kept.limits.position_margin == margin


def test_limits_are_given_with_units(track):
    limits = track("--velocity", "90 deg/s", "--dt", "20 ms", "--position-margin", "1 deg").limits
    assert (limits.velocity, limits.dt) == (pytest.approx(np.pi / 2), 0.02)
    assert limits.position_margin == pytest.approx(np.pi / 180)
    assert limits.step == pp.Limits().step


@pytest.mark.parametrize("name", ["step", "velocity", "acceleration", "jerk", "dt", "position_margin"])
def test_the_help_has_the_words_of_the_class(command, name):
    said = describe_field(pp.Limits, name)
    assert (said and "`" in said) or name in ("step", "dt", "position_margin")
    words = said.partition(" [")[0]
    assert words in " ".join(command("track", "--help", env={"COLUMNS": "300"}).out.split())


def test_an_infinite_step_is_no_limit(track):
    assert np.abs(np.diff(track("--step-limit", "inf").q, axis=0)).max() > 0.15


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--velocity", 1), ("--dt is not given", "needed to limit the velocity")),
        (("--acceleration", 1), ("--dt is not given", "needed to limit the acceleration")),
        (("--jerk", 1, "--dt", 1), ("--acceleration is not given", "needed to limit the jerk")),
        (("--velocity", "fast", "--dt", 1), ("--velocity is 'fast'", "units rad/s, deg/s, turns/s, rpm")),
        (("--velocity", 0, "--dt", 1), ("velocity is 0", "positive")),
        (("--velocity", "1,nan", "--dt", 1), ("--velocity is [1.0, nan]", "a list of 12")),
        (("--velocity", "1,2", "--dt", 1), ("--velocity is [1.0, 2.0]", "a list of 12")),
        (("--acceleration", "-1", "--dt", 1), ("acceleration is -1", "positive")),
        (("--dt", 0), ("dt is 0", "more than 0")),
        (("--position-margin", "-0.1"), ("--position-margin is -0.1",)),
        (("--position-margin", 4), ("--position-margin is 4", "half the range")),
    ],
)
def test_limits_that_are_none_are_refused_in_one_line(command, arm_file, options, says):
    result = command("track", arm_file, "--curve", "helix", *options)
    assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    for text in says:
        assert text in result.err


def test_places_and_angles_are_given_with_units(command, arm_file):
    asked = ("track", arm_file, "--curve", "line", "--steps", 3, "--json")
    plain = command(*asked, "--roll", 0.5, "--tip-position", "0.2,0.1,0").out
    told = command(*asked, "--roll", "500e-3 rad", "--tip-position", "20 cm,100 mm,0").out
    assert plain == told


def test_a_goal_is_given_with_units(command, arm_file):
    asked = ("reach", arm_file, "--json", "--to")
    plain = command(*asked, "0.1,0.05,0.2").out
    assert plain == command(*asked, "10 cm,0.05,200 mm", "--budget", "5000 ms").out


@pytest.mark.parametrize(("plain", "told"), [(("0.002",), ("2 mm",)), (("0.05",), ("5cm",))])
def test_a_tolerance_is_given_with_a_unit(command, arm_file, plain, told):
    asked = ("track", arm_file, "--curve", "line", "--json", "--tolerance")
    assert command(*asked, *plain).out == command(*asked, *told).out


def test_what_has_no_option_of_its_own_is_set_by_its_key(track):
    run = track("--effort", 5, "--set", "limits.effort=true", "--set", "scene.margin=7 mm")
    assert run.limits.effort is True
    assert run.scene.margin == 0.007
    run = track("--set", "arm.weight.gravity=[0, 0, -3.7]", "--set", "arm.placement.position=[0, 0, '1 m']")
    assert run.arm.weight.gravity == (0.0, 0.0, -3.7)
    np.testing.assert_array_equal(run.arm.chain.base, [0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("verb", "given", "says"),
    [
        ("track", "scene.margn=1", ("no key of --set scene is called 'margn' (did you mean 'margin'?)",)),
        ("track", "scene.margin=5kg", ("--set scene.margin is '5kg'", "units m, cm, mm")),
        ("track", "margin=1", ("no key for --set is called 'margin'", "limits.FIELD")),
        ("track", "scene.margin", ("--set is 'scene.margin'", "KEY=VALUE")),
        ("track", "arm.weight.gravity=1", ("--set arm.weight.gravity is 1", "a list of 3")),
        ("inspect", "limits.effort=true", ("no key for --set is called 'limits.effort'", "arm.FIELD")),
    ],
)
def test_what_cannot_be_set_is_refused_in_one_line(command, arm_file, verb, given, says):
    curve = ("--curve", "line") if verb == "track" else ()
    result = command(verb, arm_file, *curve, "--set", given)
    assert (result.code, result.out) == (2, "")
    assert len(result.err.splitlines()) == 1
    for words in says:
        assert words in result.err


@pytest.mark.parametrize(
    ("verb", "option", "kind", "name"),
    [
        ("inspect", "--tip", pp.arm.ArmSpec, "tip"),
        ("inspect", "--couple", pp.arm.ArmSpec, "couplings"),
        ("inspect", "--stiffness", pp.arm.weight.Weight, "stiffness"),
        ("track", "--roll", pp.Keyframe, "roll"),
        ("track", "--method", pp.Keyframe, "method"),
    ],
)
def test_options_of_declared_fields_have_their_words(command, verb, option, kind, name):
    out = " ".join(command(verb, "--help", env={"COLUMNS": "300"}).out.replace("│", " ").split())
    said = describe_field(kind, name).partition(" [")[0]
    assert said.partition("`")[0] in out[out.index(f" {option} ") :]


def test_a_default_is_told_whichever_way_the_class_tells_it():
    assert describe_field(pp.arm.ArmSpec, "base").endswith("needs a tip. Default: the root.")
    assert describe_field(pp.arm.weight.Weight, "stiffness").endswith(". Default: unknown.")
    assert "Default" not in describe_field(pp.arm.ArmSpec, "locked")
