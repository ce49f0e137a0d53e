from __future__ import annotations

import json
import re
from itertools import pairwise

import numpy as np
import pytest

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.cli.inputs import read_curve
from pinposture.curve import CURVES
from pinposture.units import error_text, length_text


def track(command, arm_file, *options):
    result = command("track", arm_file, "--curve", "helix", "--json", *options)
    summary = json.loads(result.out)
    assert result.code == (0 if summary["converged"] else 1), result.err
    return summary


@pytest.mark.usefixtures("no_pictures")
def test_the_summary_describes_the_run_that_was_kept(command, arm_file, tmp_path):
    summary = track(command, arm_file, "--steps", 10, "-o", tmp_path / "out")
    run = pp.load(tmp_path / "out" / "run.npz", pp.Run)
    errors = [np.linalg.norm(points - run.target.points, axis=1).sum() for points in run.points]
    assert summary["steps"] == len(run.q) - 1 == 10
    assert summary["start_error"] == pytest.approx(errors[0])
    assert summary["final_error"] == pytest.approx(errors[-1])
    assert summary["lowest_error"] == pytest.approx(min(errors))
    assert summary["mean_error"] == pytest.approx(errors[-1] / 6)
    assert summary["status"] == run.status == "max_steps"
    assert summary["converged"] is False
    assert summary["first_active_points"] == len(run.active_sets[0])
    assert summary["last_active_points"] == len(run.active_sets[-1])
    assert summary["control_points"] == summary["placed_points"] == 6


@pytest.mark.long
def test_all_three_files_are_there_and_are_what_they_are_called(command, arm_file, tmp_path):
    out = tmp_path / "deep" / "out"
    summary = track(command, arm_file, "--steps", 3, "-o", out)
    assert summary["files"] == {
        kind: str(out / name) for kind, name in zip(("run", "plot", "animation"), NAMES, strict=True)
    }
    assert sorted(path.name for path in out.iterdir()) == sorted(NAMES)
    assert (out / "run.png").read_bytes().startswith(b"\x89PNG\r\n")
    assert "<html" in (out / "run.html").read_text(encoding="utf-8").lower()


NAMES = ("run.npz", "run.png", "run.html")


def test_without_a_directory_nothing_is_written(command, arm_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert track(command, arm_file, "--steps", 2)["files"] == {}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_pictures")
def test_words_and_json_tell_the_same(command, arm_file, tmp_path):
    summary = track(command, arm_file, "--steps", 4)
    result = command("track", arm_file, "--curve", "helix", "--steps", 4, "-o", tmp_path)
    lines = dict(line.split("  ", 1) for line in result.out.splitlines())
    facts = {name.strip(): text.strip() for name, text in lines.items()}
    assert facts["verdict"] == summary["verdict"].replace("max_steps to", "--steps to")
    assert summary["verdict"] == f"did not reach the target (max_steps): {summary['reason']}"
    assert facts["steps"] == "4"
    first, last = (summary[key] / 6 for key in ("start_error", "final_error"))
    said = f"mean {length_text(first)} at the start, {length_text(last)}, "
    assert facts["point errors"].startswith(said)
    run = pp.load(tmp_path / "run.npz", pp.Run)
    largest = np.linalg.norm(run.points[-1] - run.target.points, axis=1).max()
    assert facts["point errors"].endswith(f"; largest {length_text(largest)}")
    assert summary["largest_error"] == pytest.approx(largest)
    assert not {"speed", "acceleration", "jerk"} & set(facts)  # without a duration of steps
    first = summary["first_active_points"]
    last = summary["last_active_points"]
    assert facts["active points"] == f"{first} at the first step, {last} at the last, of 6"
    assert all(line == line.rstrip() for line in result.out.splitlines())
    # What it says besides the result goes to stderr, and no progress bar when that is no terminal.
    assert sorted(result.err.splitlines()) == sorted(f"wrote {tmp_path / name}" for name in NAMES)


@pytest.mark.usefixtures("no_pictures")
def test_options_reach_the_run(command, arm_file, tmp_path):
    options = ("--controller", "projection", "--step-limit", 0.02, "--roll", 0.5, "--placement", "align")
    track(command, arm_file, *options, "--steps", 8, "-o", tmp_path)
    run = pp.load(tmp_path / "run.npz", pp.Run)
    assert run.controller.startswith("Projection")
    assert np.abs(np.diff(run.q, axis=0)).max() == pytest.approx(0.02)
    target = pp.resolve_targets(pp.Arm.load(arm_file), CURVES["helix"], roll=0.5, placement="align")
    np.testing.assert_allclose(run.target.points, target.points, atol=1e-12)


def test_a_curve_file_in_millimetres_is_scaled(command, arm_file, tmp_path):
    curve = tmp_path / "curve.csv"
    curve.write_text("0,0,0\n200,50,0\n330,50,0\n")
    asked = (arm_file, "--curve", curve, "--scale", 0.001, "--json")
    assert json.loads(command("track", *asked).out)["curve_length"] == pytest.approx(0.338, abs=1e-2)
    assert json.loads(command("batch", *asked, "--count", 1).out)["faults"] == []
    assert json.loads(command("inspect", *asked).out)["curve"]["placed_points"] == 6


@pytest.mark.long
@pytest.mark.parametrize(("modules", "length"), [(20, 0.5), (20, 5.0), (6, 0.5), (50, 5.0)])
def test_presets_are_scaled_to_the_arm(command, tmp_path, modules, length):
    links = ",".join([str(length / modules / 2)] * 2)
    made = command("generate", "RyRz", "-n", modules, "--link-lengths", links, "-o", tmp_path / "arm.urdf")
    assert made.code == 0
    arm = pp.Arm.load(tmp_path / "arm.urdf")
    for name, least in (("line", 1.1), ("helix", 1.6)):
        summary = track(command, tmp_path / "arm.urdf", "--curve", name)
        assert summary["converged"] and summary["mean_error"] < 1e-6 * length
        curve = read_curve(name, arm)
        assert curve.length > 0.99 * least * arm.length
    turns = np.unwrap(np.arctan2(*curve.resample(2000)[:, 1:].T))
    covered = arm.length / curve.length * abs(turns[-1] - turns[0]) / (2.0 * np.pi)
    assert covered == pytest.approx(2.5 if modules >= 20 else modules / 8, rel=0.02)


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("method", ["auto", "sequential", "smooth", "closest"])
def test_modules_are_placed_by_the_method_asked_for_and_the_summary_tells(
    command, arm_file, tmp_path, method
):
    summary = track(command, arm_file, "--method", method, "--steps", 1, "-o", tmp_path)
    target = pp.resolve_targets(pp.Arm.load(arm_file), CURVES["helix"], method=method, placement="align")
    np.testing.assert_allclose(pp.load(tmp_path / "run.npz", pp.Run).target.points, target.points, atol=1e-12)
    assert summary["placed_by"] == target.method != "auto"
    distances = target.curve.nearest(target.points)[1]
    assert summary["largest_residual"] == pytest.approx(distances.max(), rel=1e-3, abs=1e-7)
    out = command("track", arm_file, "--curve", "helix", "--method", method, "--steps", 1).out
    off = error_text(summary["largest_residual"], summary["arm_length"])
    assert f"{target.method} placement; largest distance of a control point from the curve {off}" in out


@pytest.mark.long
@pytest.mark.usefixtures("no_pictures")
def test_the_summary_tells_how_far_the_whole_arm_is_from_the_curve(command, arm_file, tmp_path):
    summary = track(command, arm_file, "--steps", 3, "-o", tmp_path)
    run = pp.load(tmp_path / "run.npz", pp.Run)
    corners = [run.arm.chain.base]
    for k, joints in enumerate(run.arm.chain.module_slices):
        corners += [*run.arm.at(run.q[-1]).origins[joints], run.points[-1][k]]
    shares = np.linspace(0.0, 1.0, 800)[:, None]
    places = np.concatenate([a + shares * (b - a) for a, b in pairwise(corners)])
    farthest = run.target.curve.nearest(places).distance.max()
    assert summary["distance_from_curve"] == pytest.approx(farthest, rel=1e-3)
    out = command("track", arm_file, "--curve", "helix", "--steps", 3).out
    assert f"largest distance of a link from the curve {length_text(farthest)}" in out


def test_smooth_placement_leaves_the_curve_and_sequential_does_not(command, arm_file):
    off = {
        method: track(command, arm_file, "--method", method, "--steps", 1)["largest_residual"]
        for method in ("sequential", "smooth")
    }
    assert 3 * off["sequential"] < off["smooth"]


def test_the_largest_residual_is_that_of_the_points_that_have_a_place(command, arm_file, tmp_path):
    short = tmp_path / "short.json"
    short.write_text(json.dumps({"type": "line", "a": [0, 0, 0], "b": [0.17, 0, 0]}))
    result = command("track", arm_file, "--curve", short, "--partial", "--steps", 1, "--json")
    assert json.loads(result.out)["largest_residual"] < 1e-9  # the others are 0.13 m beyond its end


@pytest.mark.usefixtures("no_pictures")
def test_modules_end_at_links_that_are_named(command, arm_file, tmp_path):
    track(command, arm_file, "--split", "m02_l2,m04_l2,tip", "--steps", 1, "-o", tmp_path)
    run = pp.load(tmp_path / "run.npz", pp.Run)
    named = pp.Arm.load(arm_file, split=["m02_l2", "m04_l2", "tip"])
    assert run.arm.module_joints == named.module_joints
    assert run.arm.n_modules == 3


def test_what_loading_warns_of_is_a_note_on_stderr(command, arm_file, tmp_path):
    file = tmp_path / "limitless.urdf"
    file.write_text(re.sub(r'lower="\S+" upper="\S+"', "", arm_file.read_text(), count=1))
    with pytest.warns(pp.PostureWarning) as warned:
        pp.Arm.load(file)
    result = command("track", file, "--curve", "helix", "--steps", 1, "--json")
    assert json.loads(result.out)["steps"] == 1
    assert result.err == "".join(f"note: {warning.message}\n" for warning in warned)
    assert len(warned) == 1


def test_a_tolerance_as_wide_as_the_start_ends_the_run_there(command, arm_file):
    summary = track(command, arm_file, "--tolerance", 1.0)
    assert (summary["status"], summary["steps"]) == ("converged", 0)
    assert summary["first_active_points"] == 0


def test_the_same_seed_gives_the_same_run_and_another_seed_another(command, arm_file):
    runs = [track(command, arm_file, "--start", "random", "--steps", 2, "--seed", seed) for seed in (4, 4, 5)]
    assert runs[0] == runs[1]
    assert runs[0]["start_error"] != runs[2]["start_error"]


@pytest.mark.usefixtures("no_pictures")
def test_named_starts_are_those_of_the_library(command, arm_file, tmp_path):
    arm = pp.Arm.load(arm_file)
    rng = np.random.default_rng(9)
    expected = {
        "straight": np.zeros(12),
        "random": arm.random(np.random.default_rng(9)),
        "smooth": smooth_configuration(arm, rng, rng.uniform(0.2, 1.0)),
    }
    free = ("--seed", 9, "--steps", 1, "--no-self-collision")
    for start, q in expected.items():
        track(command, arm_file, "--start", start, *free, "-o", tmp_path / start)
        np.testing.assert_array_equal(pp.load(tmp_path / start / "run.npz", pp.Run).q[0], q)


@pytest.mark.long
@pytest.mark.parametrize("start", ["random", "smooth"])
def test_a_drawn_start_that_is_not_clear_is_bent_less(command, arm_file, start):
    arm = pp.Arm.load(arm_file)
    model = pp.CollisionModel(arm, pp.Scene())
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        smooth = start == "smooth"
        drawn = smooth_configuration(arm, rng, rng.uniform(0.2, 1.0)) if smooth else arm.random(rng)
        told = track(command, arm_file, "--start", start, "--seed", seed, "--steps", 1)
        taken = np.array(told["start_positions"])
        share = float(taken @ drawn / (drawn @ drawn))
        np.testing.assert_allclose(taken, share * drawn, atol=1e-12)
        assert model.minimum(taken).distance >= 0.005
        bent = f"bent only {100 * share:.3g} % as much" if share < 0.999 else ""
        assert f"{start.replace('smooth', 'smooth random')} posture, seed {seed}" in told["start_taken"]
        assert bent in told["start_taken"]
        if bent:
            assert model.minimum((share + 1 / 40) * drawn).distance < 0.005
        shares.append(share)
    assert min(shares) < 0.999 or smooth


@pytest.mark.long
@pytest.mark.usefixtures("no_pictures")
def test_a_start_is_the_same_from_numbers_and_from_every_kind_of_file(command, arm_file, tmp_path):
    q = np.random.default_rng(1).uniform(-1, 1, 12)
    np.save(tmp_path / "q.npy", q)
    (tmp_path / "row.csv").write_text(", ".join(map(repr, q.tolist())))
    (tmp_path / "column.CSV").write_text("\n".join(map(repr, q.tolist())) + "\n")
    (tmp_path / "q.json").write_text(json.dumps(q.tolist()))
    files = [tmp_path / name for name in ("q.npy", "row.csv", "column.CSV", "q.json")]
    for number, start in enumerate([*files, ",".join(map(repr, q.tolist()))]):
        out = tmp_path / str(number)
        track(command, arm_file, "--start", start, "--steps", 1, "-o", out)
        np.testing.assert_array_equal(pp.load(out / "run.npz", pp.Run).q[0], q)


@pytest.mark.usefixtures("no_pictures")
def test_a_continuous_joint_may_be_given_as_one_angle_or_as_cosine_and_sine(command, arm_file, tmp_path):
    text = arm_file.read_text().replace('type="revolute"', 'type="continuous"')
    file = tmp_path / "arm.urdf"
    file.write_text(text)
    angles = np.linspace(-1, 1, 12)
    pairs = np.column_stack([np.cos(angles), np.sin(angles)]).ravel()
    for values, out in ((angles, tmp_path / "angles"), (pairs, tmp_path / "pairs")):
        track(command, file, "--start", ",".join(map(repr, values.tolist())), "--steps", 1, "-o", out)
        np.testing.assert_allclose(pp.load(out / "run.npz", pp.Run).q[0], pairs, atol=1e-12)


@pytest.mark.usefixtures("no_pictures")
def test_a_curve_from_a_file_is_followed(command, arm_file, tmp_path):
    t = np.linspace(0, 0.5, 30)
    np.savetxt(tmp_path / "c.csv", np.column_stack([t, 0.5 * t**2, 0 * t]), delimiter=",")
    result = command(
        "track", arm_file, "--curve", tmp_path / "c.csv", "--steps", 2, "-o", tmp_path / "out", "--json"
    )
    assert result.code == 1  # in two steps it does not get there
    x, y, z = pp.load(tmp_path / "out" / "run.npz", pp.Run).target.points.T
    np.testing.assert_allclose(y, 0.5 * x**2, atol=1e-5)
    np.testing.assert_allclose(z, 0, atol=1e-6)


def test_partial_leaves_points_free_and_says_so(command, arm_file, tmp_path):
    short = tmp_path / "short.json"
    short.write_text(json.dumps({"type": "line", "a": [0, 0, 0], "b": [0.17, 0, 0]}))
    result = command("track", arm_file, "--curve", short, "--partial", "--steps", 2, "--json")
    summary = json.loads(result.out)
    assert result.code == 1
    assert summary["placed_points"] == 3
    assert "module 4" in summary["incomplete"]
    assert "only the first 3 of 6 control points" in result.err


def words(result):
    return {name.strip(): text for name, text in (line.split("  ", 1) for line in result.out.splitlines())}


def test_the_summary_tells_how_much_of_a_long_curve_the_arm_covers(command, arm_file, tmp_path):
    line = tmp_path / "line.json"
    line.write_text(json.dumps({"type": "line", "a": [0, 0, 0], "b": [0.7, 0, 0]}))
    asked = ("track", arm_file, "--curve", line, "--steps", 1)
    summary = json.loads(command(*asked, "--json").out)
    assert summary["curve_length"] == pytest.approx(0.7)
    assert summary["covered_to"] == pytest.approx(0.3, rel=0.02)  # a straight arm, to its last control point
    said = words(command(*asked))["curve"].strip()
    assert said.startswith(f"700 mm long, covered by the arm up to {length_text(summary['covered_to'])}")


def test_a_run_that_needs_more_steps_names_the_option(command, arm_file):
    asked = ("track", arm_file, "--curve", "helix")
    verdict = words(command(*asked, "--steps", 2))["verdict"]
    (needed,) = re.findall(r"; raise --steps to (\d+)$", verdict)
    assert command(*asked, "--steps", needed).code == 0
    assert json.loads(command(*asked, "--steps", 2, "--json").out)["status"] == "max_steps"


@pytest.mark.parametrize(("height", "inside"), [(-0.05, True), (-1.0, False)])
def test_a_start_in_collision_names_the_options_of_the_start(command, arm_file, tmp_path, height, inside):
    scene = tmp_path / "scene.toml"
    scene.write_text(f'obstacles.ball = {{type = "sphere", center = [0.25, 0, {height}], radius = 0.06}}\n')
    asked = ("track", arm_file, "--curve", "line", "--placement", "align", "--start", "straight")
    told = words(command(*asked, "--scene", scene, "--steps", 1))
    assert "the straight arm; the motion begins there" in told["start"]
    assert ("in collision, choose another one by --start or --seed" in told["start"]) == inside


def test_the_exit_code_tells_whether_the_arm_got_there(command, arm_file, tmp_path):
    target = pp.resolve_targets(pp.Arm.load(arm_file), CURVES["helix"], placement="align")
    np.save(tmp_path / "there.npy", target.q)
    base = ("track", arm_file, "--curve", "helix", "--steps", 1)
    assert command(*base).code == 1
    summary = json.loads(command(*base, "--json").out)
    assert summary["converged"] is False
    assert summary["faults"] == [f"it ran out of steps: {summary['reason']}"]
    there = command(*base, "--start", tmp_path / "there.npy")
    assert there.code == 0
    assert "reached the target (converged): mean point error " in there.out.splitlines()[0]


def test_an_arm_comes_through_a_pipe(command):
    text = command("generate", "RyRz", "--modules", 3).out
    result = command("track", "-", "--curve", "helix", "--steps", 1, "--json", input=text)
    assert json.loads(result.out)["control_points"] == 3


@pytest.mark.usefixtures("no_pictures")
def test_an_interrupted_run_leaves_an_earlier_one_as_it_was(command, arm_file, tmp_path, monkeypatch):
    base = ("track", arm_file, "--curve", "helix", "-o", tmp_path)
    command(*base, "--steps", 1)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("pinposture.motion.track", interrupted)
    assert command(*base, "--steps", 2).code == 130
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("variables", "coloured"),
    [({}, False), ({"FORCE_COLOR": "1"}, True), ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, False)],
)
def test_colours_come_when_forced_and_never_against_no_color(
    command, arm_file, monkeypatch, variables, coloured
):
    for name in ("FORCE_COLOR", "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    env = {**variables, "TERM": "xterm-256color"}
    out = command("track", arm_file, "--curve", "helix", "--steps", 1, env=env).out
    assert ("\x1b[33mdid not reach the target" in out) is coloured
    assert coloured or "\x1b" not in out.replace("\x1b[1m", "").replace("\x1b[0m", "")


def test_an_unexpected_error_is_not_swallowed(command, arm_file, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("pinposture.motion.track", broken)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        command("track", arm_file, "--curve", "helix")


@pytest.mark.usefixtures("no_pictures")
def test_a_region_leaves_the_other_points_free(command, arm_file, tmp_path):
    asked = ("track", arm_file, "--curve", "helix", "--region", "3-5", "-o", tmp_path / "out")
    found = json.loads(command(*asked, "--json").out)
    assert (found["placed_points"], found["control_points"]) == (3, 6)
    kept = pp.load(tmp_path / "out" / "run.npz", pp.Run)
    np.testing.assert_array_equal(np.flatnonzero(kept.target.has_target), [2, 3, 4])


@pytest.mark.parametrize("region", ["0-3", "5-3", "3", "3-7", "a-b", "-", "1-2-3"])
def test_a_region_that_is_none_is_refused(command, arm_file, region):
    done = command("track", arm_file, "--curve", "helix", "--region", region)
    assert done.code == 2
    assert "--region" in done.err
    assert "from 1 to 6" in done.err
