"""`pinposture simulate`: a run, a motion or exported joints under gravity; one line for what cannot be."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pinposture as pp
from pinposture.sim import Simulation


@pytest.fixture(scope="module")
def timed_run(run_directory: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a run of 10 cycles of 0.02 s."""
    arm = pp.load(run_directory / "run.npz", pp.Run).arm
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.1))
    limits = pp.Limits(dt=0.02, acceleration=20.0)
    run = pp.track(arm, target, arm.neutral(), limits=limits, max_steps=10)
    return pp.save(run, tmp_path_factory.mktemp("timed") / "run.npz").parent


@pytest.mark.long
@pytest.mark.parametrize("loop", ["open", "closed"])
def test_a_run_is_simulated_kept_and_told(command, timed_run, tmp_path, loop):
    out = tmp_path / "sim"
    options = ["--closed"] if loop == "closed" else []
    result = command("simulate", timed_run, *options, "--hold", 0.2, "-o", out)
    assert (result.code, sorted(path.name for path in out.iterdir())) == (
        0,
        ["simulation.npz", "simulation.png"],
    )
    kept = pp.load(out / "simulation.npz", Simulation)
    assert kept.loop == loop
    assert f"{loop} loop, gravity 9.81 m/s², {len(kept.time) - 1} cycles of 0.02 s" in result.out
    assert ("\ntarget " in result.out) == (loop == "closed")
    assert result.err.splitlines()[-2:] == [
        f"wrote {out / name}" for name in ("simulation.png", "simulation.npz")
    ]
    assert (out / "simulation.png").read_bytes().startswith(b"\x89PNG\r\n")


def test_json_holds_the_summary_and_nothing_is_kept_unasked(command, timed_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = command("simulate", timed_run, "--no-gravity", "--frequency", 20, "--hold", 0, "--json")
    told = json.loads(result.out)
    assert (told["status"], told["gravity"], told["files"]) == ("converged", [0.0, 0.0, 0.0], {})
    assert told["servos"]["frequency"] == 20.0
    assert told["mean_point_error"]["end"] < 1e-3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", ["csv", "json", "npz"])
def test_exported_joints_are_simulated_with_the_arm_that_is_named(
    command, timed_run, arm_file, tmp_path, suffix
):
    file = tmp_path / f"joints.{suffix}"
    pp.save(pp.load(timed_run / "run.npz", pp.Run).joint_trajectory(), file)
    loops = [["--closed"], []] if suffix == "csv" else [[]]
    for loop in loops:
        result = command("simulate", file, "--urdf", arm_file, "--hold", 0.1, "--json", *loop)
        told = json.loads(result.out)
        assert (told["status"], told["dt"]) == ("converged", pytest.approx(0.02))


def test_servos_at_their_limits_are_mentioned(command, timed_run, tmp_path, arm_file):
    weak = tmp_path / "weak.urdf"
    weak.write_text(arm_file.read_text().replace('effort="0.0"', 'effort="0.01"'))
    file = tmp_path / "joints.csv"
    pp.save(pp.load(timed_run / "run.npz", pp.Run).joint_trajectory(), file)
    result = command("simulate", file, "--urdf", weak, "--hold", 1)
    assert result.code == 1  # the arm hangs down
    assert result.out.startswith("verdict")
    assert "did not reach the target (missed): mean point error " in result.out.splitlines()[0]
    assert "servos were at their limit, up to" in result.err
    assert command("simulate", file, "--urdf", weak, "--hold", 1, "--tolerance", 1).code == 0
    free = command("simulate", file, "--urdf", weak, "--hold", 0.1, "--no-torque-limits")
    assert "no limit" in free.out
    assert free.err == ""


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nowhere"], "no such file"),
        (["nowhere.csv"], "nowhere.csv: no such file"),
        (["nowhere.npz", "--urdf", "ARM"], "nowhere.npz: no such file"),
        (["RUN", "--frequency", "1e300"], "--frequency is 1e+300; allowed: a number above 0, at most 100000"),
        (["RUN", "--hold", "1e300"], "--hold is 1e+300"),
        (["RUN", "--urdf", "ARM"], "--urdf is"),
        (["RUN", "--dt", "0.03"], "dt is 0.03"),
        (["UNTIMED"], "dt is not given"),
        (["RUN", "--frequency", "0"], "frequency is 0"),
        (["RUN", "--hold", "-1"], "hold is -1"),
        (["RUN", "--closed", "--hold", "-1"], "hold is -1"),
        (["CSV"], "--urdf is not given"),
        (["RUN", "-o", "CSV"], "is a file"),
        (["RUN", "--free", "can=0.3"], "allowed: nothing without --contact"),
        (["RUN", "--contact", "--free", "can"], "allowed: NAME=MASS"),
        (["RUN", "--contact", "--free", "can=0.3"], "'can'"),
        (["RUN", "--contact", "--friction", "-1"], "friction is -1"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(
    command, timed_run, run_directory, arm_file, tmp_path, arguments, reason
):
    table = tmp_path / "joints.csv"
    pp.save(pp.load(timed_run / "run.npz", pp.Run).joint_trajectory(), table)
    named = {"RUN": timed_run, "UNTIMED": run_directory, "ARM": arm_file, "CSV": table}
    result = command("simulate", *(named.get(each, each) for each in arguments))
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith("error: ")
    assert reason in result.err
    assert result.err.count("\n") == 1


def test_without_mujoco_one_line_says_how_to_get_it(command, timed_run, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    result = command("simulate", timed_run)
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert "pip install 'pinposture[sim]'" in result.err


@pytest.mark.long
def test_an_arm_that_sags_is_sent_commands_against_it(command, timed_run, tmp_path) -> None:
    run = pp.load(timed_run / "run.npz", pp.Run)
    arm = run.arm.with_stiffness(3.0)
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.1))
    soft = pp.track(arm, target, arm.neutral(), limits=pp.Limits(dt=0.02, acceleration=2.0))
    saved = pp.save(soft, tmp_path / "run.npz")
    told = [json.loads(command("simulate", saved, *more, "--json").out) for more in ([], ["--compensate"])]
    assert told[0]["mean_point_error"]["end"] > 10.0 * told[1]["target_error"]["end"]
    assert told[1]["status"] == "converged"
    assert "stiffness" in command("simulate", timed_run, "--compensate").err


@pytest.mark.long
def test_contact_is_told_and_judged(command, timed_run, tmp_path) -> None:
    run = pp.load(timed_run / "run.npz", pp.Run)
    tip = run.points[-1, -1]
    floor = pp.HalfSpace((0.0, 0.0, -10.0), (0.0, 0.0, 1.0))
    radius = 0.2 * float(run.arm.chain.module_lengths.mean())
    ball = pp.Sphere(tuple(tip), radius)
    scene = pp.Scene({"floor": floor, "ball": ball}, self_collision=False)
    file = scene.save(tmp_path / "scene.json")
    file_of_touchable = replace(scene, touchable=("ball",)).save(tmp_path / "touchable.json")
    options = ["--contact", "--friction", "0.5", "--no-gravity", "--hold", "0.1"]
    free = ["--free", "ball=10g"]
    told = command("simulate", timed_run, "--scene", file, *options, *free)
    assert told.code == 1
    assert "first touch" in told.out
    assert "ball" in told.out.splitlines()[0]
    options += ["--scene", file_of_touchable, "--json"]
    allowed = json.loads(command("simulate", timed_run, *options, *free).out)
    assert allowed["contact"]["first_touch"]["pair"][1] == "ball"
    assert not any("touches" in each for each in allowed["faults"])
    without = json.loads(command("simulate", timed_run, "--no-gravity", "--hold", "0", "--json").out)
    assert without["contact"] is None
