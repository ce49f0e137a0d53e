"""Joint states from real files, pipes and the standard input: the latest is kept, what is wrong is told."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arm.driven_arms import DRIVES, Robot, driven_arm
from arms import template_arm
from sampling import cases

import pinposture as pp
from pinposture.editor import measured_arm
from pinposture.editor.measured_arm import READING, JointStateLines, JointStates
from pinposture.errors import FileError, InvalidValue, PostureWarning


@pytest.fixture(scope="session")
def arm():
    return template_arm("RyRz", 3)


@pytest.fixture(scope="session")
def names(arm):
    return list(arm.joint_names)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def continuous():
    """An arm with a joint that turns round and round, and one that slides."""
    model = pin.Model()
    parent = 0
    for k, joint in enumerate((pin.JointModelRUBY(), pin.JointModelPX(), pin.JointModelRY())):
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([0.2 * (k > 0), 0, 0])), f"j{k}")
    model.addFrame(
        pin.Frame("tip", parent, pin.SE3(np.eye(3), np.array([0.2, 0, 0])), pin.FrameType.OP_FRAME)
    )
    model.lowerPositionLimit[2:] = -2.0
    model.upperPositionLimit[2:] = 2.0
    return pp.Arm.from_model(model, ["tip"])


def until(states, condition, patience=20.0):
    """The latest that fulfils a condition; what is said at last if none does."""
    end = time.monotonic() + patience
    while not condition(states.latest):
        assert time.monotonic() < end, states.latest
        time.sleep(0.01)
    return states.latest


def line(positions, names=None, **more):
    said = {"position": np.asarray(positions).tolist(), **more}
    return json.dumps(said if names is None else {"name": list(names), **said}) + "\n"


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "states.jsonl"
    path.write_text("")
    return path


def test_before_anything_is_told_the_arm_is_at_zero_and_infinitely_old(arm, names, path):
    with JointStates(arm, path) as states:
        latest = states.latest
        np.testing.assert_array_equal(latest.q, arm.neutral())
        assert (latest.age, latest.count, latest.complaint) == (np.inf, 0, "")
        assert latest.unheard == tuple(names) and not states.ended
    assert states.ended


def test_a_file_that_grows_is_followed_line_by_line(arm, rng, path):
    with JointStates(arm, str(path)) as states, path.open("a") as file:
        for number in range(1, 6):
            q = rng.normal(size=6)
            file.write(line(q))
            file.flush()
            latest = until(states, lambda now, n=number: now.count == n)
            np.testing.assert_array_equal(latest.q, q)
            assert 0.0 <= latest.age < 20.0 and latest.complaint == "" and latest.unheard == ()
        before = states.latest.age
        time.sleep(0.02)
        assert states.latest.age > before
        with pytest.raises(ValueError, match="read-only"):
            latest.q[0] = 1.0


def test_all_three_kinds_of_lines_tell_the_same(arm, names, rng, path):
    q = rng.normal(size=6)
    order = rng.permutation(6)
    for text in (
        line(q),
        line(q[order], [names[k] for k in order]),
        json.dumps({"q": q.tolist()}) + "\n",
        json.dumps({"header": {"stamp": {"sec": 3, "nanosec": 5}}, "name": names, "position": q.tolist(),
                    "velocity": [0.0] * 6, "effort": []}) + "\n",
    ):  # fmt: skip
        path.write_text(text)
        with JointStates(arm, path) as states:
            latest = until(states, lambda now: now.count == 1)
            np.testing.assert_array_equal(latest.q, q)
    assert latest.stamp == 3.000000005


def test_a_robot_with_coupled_joints_tells_where_its_drives_are(path):
    with pytest.warns(PostureWarning, match="locked"):
        driven = driven_arm()
    robot = Robot(dict(zip(DRIVES, (0.2, -0.05, 8.0, 0.1, -0.3), strict=True)))
    states = robot.states()
    del states["gripper"]
    with JointStates(driven, path) as heard, path.open("a") as file:
        assert heard.latest.unheard == DRIVES
        file.write(line([*states.values()], [*states]))  # the joints that follow are known, too
        file.flush()
        latest = until(heard, lambda now: now.count == 1)
        assert (latest.complaint, latest.unheard) == ("", ())
        np.testing.assert_allclose(driven.at(latest.q).points[-1], robot.tip(), atol=1e-12)
        file.write(line([-0.1, 0.0], ["motor", "gripper"]))
        file.flush()
        latest = until(heard, lambda now: now.count == 2)
        assert "unknown joints: 'gripper'" in latest.complaint
        moved = Robot(robot.driven | {"motor": -0.1})
        np.testing.assert_allclose(driven.at(latest.q).points[-1], moved.tip(), atol=1e-12)


def test_joints_that_a_line_does_not_tell_of_keep_their_last_position(arm, names, path):
    path.write_text(line([0.1, 0.2], [names[4], names[1]]))
    with JointStates(arm, path) as states, path.open("a") as file:
        latest = until(states, lambda now: now.count == 1)
        np.testing.assert_array_equal(latest.q, [0, 0.2, 0, 0, 0.1, 0])
        assert latest.unheard == (names[0], names[2], names[3], names[5])
        assert all(repr(name) in latest.complaint for name in latest.unheard)
        file.write(line([0.3], [names[1]]) + line([0.4, 0.5], [names[0], names[2]]) + line([9.0], [names[5]]))
        file.write(line([0.6, 0.7], [names[5], names[3]]))
        file.flush()
        latest = until(states, lambda now: now.count == 5)
        np.testing.assert_array_equal(latest.q, [0.4, 0.3, 0.5, 0.7, 0.1, 0.6])
        assert latest.unheard == () and latest.complaint == ""


def test_joints_that_the_arm_has_not_are_named_once(arm, names, path):
    path.write_text(line([1, 2], ["gripper", names[0]]))
    with JointStates(arm, path) as states, path.open("a") as file:
        latest = until(states, lambda now: now.count == 1)
        assert (
            "line 1" in latest.complaint and "'gripper'" in latest.complaint and names[0] in latest.complaint
        )
        file.write("broken\n")
        file.write(
            line([1, 3], ["gripper", names[0]]) + line([1], ["gripper"]) + line([1, 4], ["hand", names[0]])
        )
        file.flush()
        latest = until(states, lambda now: now.count == 3)
        assert "line 5" in latest.complaint and "'hand'" in latest.complaint
        assert "gripper" not in latest.complaint
        assert latest.q[0] == 4.0 and latest.refused == 1 and latest.skipped == 1


def test_joints_that_turn_round_and_round_and_joints_that_slide(path):
    arm = continuous()
    assert arm.nq == 4 and arm.nv == 3
    path.write_text(line([7.0, 0.3, -0.2]))
    with JointStates(arm, path) as states, path.open("a") as file:
        latest = until(states, lambda now: now.count == 1)
        np.testing.assert_allclose(latest.q, [np.cos(7.0), np.sin(7.0), 0.3, -0.2], atol=1e-15)
        file.write(line([-2.0], ["j0"]))
        file.flush()
        latest = until(states, lambda now: now.count == 2)
        np.testing.assert_allclose(latest.q, [np.cos(2.0), -np.sin(2.0), 0.3, -0.2], atol=1e-15)
        file.write('{"q": [0.6, 0.8, 0.1, 0.2]}\n{"q": [1, 1, 0, 0]}\n')
        file.flush()
        latest = until(states, lambda now: now.refused == 1)
        np.testing.assert_allclose(latest.q, [0.6, 0.8, 0.1, 0.2], atol=1e-15)
        assert "line 4: q is" in latest.complaint and "cosine" in latest.complaint


WRONG = {
    "hello": "an object",
    "[1, 2]": "an object",
    "{}": "an object",
    '{"positions": [1]}': "an object",
    "3": "an object",
    '{"position": [1, 2, 3]': "column",
    '{"position": [1, 2]}': "position (length) is 2; allowed: 6",
    '{"position": 3}': "a list of 6 numbers",
    '{"position": null}': "a list of 6 numbers",
    '{"position": [1, 2, 3, 4, 5, NaN]}': r"position[5] is nan; allowed: a finite number",
    '{"position": [1, 2, 3, 4, 5, -Infinity]}': r"position[5] is -inf",
    '{"position": [1, 2, 3, 4, 5, 1e300]}': r"position[5]",
    '{"position": [1, 2, 3, 4, 5, 1%s]}' % ("0" * 400): r"position[5]",
    '{"position": [1, 2, 3, 4, 5, 1%s]}' % ("0" * 5000): "an object",
    '{"position": [1, 2, 3, 4, 5, true]}': r"position[5] is True",
    '{"position": [1, 2, 3, 4, 5, "6"]}': r"position[5] is '6'",
    '{"q": [1, 2, 3]}': "q (length) is 3; allowed: 6",
    '{"q": [1, 2, 3, 4, 5, null]}': "q[5] is not given",
    '{"q": [0, 0, 0, 0, 0, 0], "position": [0, 0, 0, 0, 0, 0]}': "one of them",
    '{"name": "a", "position": [1]}': "a list of joint names",
    '{"name": [3], "position": [1]}': "a list of joint names",
    '{"name": ["a", "a"], "position": [1, 2]}': "each joint once",
    '{"name": ["a", "b"], "position": [1]}': "(length) is 1; allowed: 2",
    '{"name": [], "position": [1, 2, 3, 4, 5, 6]}': "(length) is 6; allowed: 0",
    '{"position": [0, 0, 0, 0, 0, 0], "time": "noon"}': "time is 'noon'; allowed: seconds",
    '{"position": [0, 0, 0, 0, 0, 0], "stamp": NaN}': "stamp is nan",
    '{"position": [0, 0, 0, 0, 0, 0], "stamp": {"sec": 1}}': "sec and nanosec",
    "[" * 100_000: "an object",
    "\xff\xfe": "an object",
    "\x00": "an object",
}


@pytest.mark.parametrize("text", cases(WRONG, quick=8), ids=cases(range(len(WRONG)), quick=8))
def test_lines_that_are_malformed_are_counted_and_the_arm_stays(arm, rng, path, text):
    q = rng.normal(size=6)
    with JointStates(arm, path) as states, path.open("ab") as file:
        file.write(line(q).encode() + b"\n" + text.encode("latin-1") + b"\n")
        file.flush()
        latest = until(states, lambda now: now.refused == 1)
        assert latest.complaint.startswith("line 3: ") and WRONG[text] in latest.complaint
        np.testing.assert_array_equal(latest.q, q)
        file.write(line(-q).encode())
        file.flush()
        latest = until(states, lambda now: now.count == 2)
        np.testing.assert_array_equal(latest.q, -q)
        assert latest.refused == 1 and latest.complaint.startswith("line 3: ")


def test_of_several_complaints_the_last_is_told(arm, path):
    path.write_text("one\n" + line(np.ones(6)) + '{"position": []}\n' + line(np.zeros(6)))
    with JointStates(arm, path) as states:
        latest = until(states, lambda now: now.count == 2)
        assert latest.refused == 2 and latest.complaint.startswith("line 3: position (length) is 0")


def test_messages_without_positions_tell_nothing(arm, names, path):
    path.write_text(line([], names) + line([], []) + line([1.0], ["other"]) + line(np.ones(6)))
    with JointStates(arm, path) as states:
        latest = until(states, lambda now: now.count == 1)
        assert latest.skipped == 3 and latest.refused == 0 and latest.age < 20.0


def test_half_a_line_waits_for_the_other_half(arm, rng, path):
    q = rng.normal(size=6)
    text = line(q)
    with JointStates(arm, path) as states, path.open("a") as file:
        file.write(line(np.ones(6)) + text[:25])
        file.flush()
        until(states, lambda now: now.count == 1)
        time.sleep(3 * READING.poll)
        assert states.latest.count == 1 and states.latest.refused == 0
        file.write(text[25:])
        file.flush()
        latest = until(states, lambda now: now.count == 2)
        np.testing.assert_array_equal(latest.q, q)
        assert latest.refused == 0


def test_a_line_at_the_end_of_a_file_needs_no_end_and_is_counted_once(arm, rng, path):
    q = rng.normal(size=6)
    path.write_text(line(np.ones(6)) + line(q).rstrip("\n"))
    with JointStates(arm, path) as states, path.open("a") as file:
        latest = until(states, lambda now: now.count == 2)
        np.testing.assert_array_equal(latest.q, q)
        file.write("\n")
        file.flush()
        time.sleep(3 * READING.poll)
        file.write("x\n")
        file.flush()
        latest = until(states, lambda now: now.refused == 1)
        assert latest.count == 2 and latest.complaint.startswith("line 3: ")


def test_an_object_in_an_object_is_no_end_of_a_line(arm, path):
    with JointStates(arm, path) as states, path.open("a") as file:
        file.write('{"header": {"stamp": {"sec": 1, "nanosec": 0}}')
        file.flush()
        time.sleep(3 * READING.poll)
        assert states.latest.refused == 0
        file.write(', "position": [1, 2, 3, 4, 5, 6]}\n')
        file.flush()
        latest = until(states, lambda now: now.count == 1)
        assert latest.refused == 0 and latest.stamp == 1.0


def test_a_file_that_is_cut_short_or_replaced_is_read_anew(arm, path, tmp_path):
    path.write_text("bad\n" * 3 + line(np.ones(6)) * 3)
    with JointStates(arm, path) as states:
        until(states, lambda now: now.count == 3)
        path.write_text("bad\n" + line(np.zeros(6)))
        latest = until(states, lambda now: now.count == 4)
        np.testing.assert_array_equal(latest.q, np.zeros(6))
        assert latest.complaint.startswith("line 1: ") and latest.refused == 4
        for number in range(5, 8):  # in the way of those who write a new file and rename it
            other = tmp_path / "draft"
            other.write_text(line(np.full(6, number)).rstrip("\n"))
            other.replace(path)
            latest = until(states, lambda now, n=number: now.count == n)
            np.testing.assert_array_equal(latest.q, np.full(6, number))
        other.write_text(line(np.full(6, 7)).rstrip("\n"))  # the same again is news all the same
        other.replace(path)
        until(states, lambda now: now.count == 8)
        path.unlink()
        time.sleep(3 * READING.poll)
        path.write_text(line(np.ones(6)))
        latest = until(states, lambda now: now.count == 9)
        np.testing.assert_array_equal(latest.q, np.ones(6))


def test_a_burst_leaves_the_last_of_its_lines(arm, rng, path):
    burst = rng.normal(size=(10_000, 6))
    with JointStates(arm, path) as states, path.open("a") as file:
        file.write("".join(line(q) for q in burst))
        file.flush()
        latest = until(states, lambda now: now.count + now.skipped == 10_000)
        np.testing.assert_array_equal(latest.q, burst[-1])
        assert latest.refused == 0 and latest.complaint == ""


def test_of_many_lines_the_old_ones_are_not_read(arm, path, monkeypatch):
    read = []
    ordinary = JointStateLines.read
    monkeypatch.setattr(
        JointStateLines, "read", lambda self, text: (read.append(text), ordinary(self, text))[1]
    )
    path.write_text("".join(line(np.full(6, k / 10)) for k in range(10_000)))
    with JointStates(arm, path) as states:
        latest = until(states, lambda now: now.count + now.skipped == 10_000)
    np.testing.assert_array_equal(latest.q, np.full(6, 999.9))
    assert latest.count == len(read) == READING.most_lines


def test_but_for_joints_that_only_old_ones_tell_of(arm, names, path):
    start = line(np.arange(6.0)) + line([50.0], [names[3]])
    path.write_text(line(np.ones(6)) * 100 + start + "".join(line([k], [names[2]]) for k in range(3000)))
    with JointStates(arm, path) as states:
        latest = until(states, lambda now: now.count + now.skipped == 3102)
    np.testing.assert_array_equal(latest.q, [0, 1, 2999, 50, 4, 5])
    assert latest.skipped == 100


def test_a_named_pipe_and_those_who_write_into_it_one_after_the_other(arm, tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with JointStates(arm, path) as states:  # nobody has opened it yet
        time.sleep(2 * READING.poll)
        assert not states.ended
        for number in range(1, 4):
            with path.open("w") as file:
                file.write(line(np.full(6, number)))
                file.flush()
                until(states, lambda now, n=number: now.count == 2 * n - 1)
                file.write(line(np.full(6, -number)).rstrip("\n"))  # the end of which nobody writes
            latest = until(states, lambda now, n=number: now.count == 2 * n)
            np.testing.assert_array_equal(latest.q, np.full(6, -number))
        with path.open("w") as file:
            file.write("x\n" + line(np.zeros(6))[:20])
        latest = until(states, lambda now: now.refused == 2)
        # Where the next one writes before the end of the one before was seen, their lines are one.
        assert re.match("line [5-8]: ", latest.complaint)
    assert states.ended


def test_a_burst_through_a_pipe(arm, rng, tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    burst = rng.normal(size=(10_000, 6))
    with JointStates(arm, path) as states, path.open("w") as file:
        file.write("".join(line(q) for q in burst))
        file.flush()
        latest = until(states, lambda now: now.count + now.skipped == 10_000)
        np.testing.assert_array_equal(latest.q, burst[-1])


@pytest.mark.long
def test_the_standard_input_until_it_ends(names):
    program = """
import sys, time, numpy as np, pinposture as pp
from pinposture.editor.measured_arm import JointStates
states = JointStates(pp.Arm.from_template("RyRz", modules=3), "-")
while not states.ended:
    time.sleep(0.01)
latest = states.latest
states.close()
print(latest.q.tolist(), latest.count, latest.refused)
"""
    run = [sys.executable, "-c", program]
    given = line(np.ones(6)) + "bad\n" + line([0.5], [names[0]]).rstrip("\n")
    result = subprocess.run(run, input=given, capture_output=True, text=True, timeout=100, check=True)
    assert result.stdout.strip() == "[0.5, 1.0, 1.0, 1.0, 1.0, 1.0] 2 1"


def test_a_line_without_end_takes_no_memory(arm, path, monkeypatch):
    monkeypatch.setattr(measured_arm, "READING", READING._replace(longest_line=1000))
    with JointStates(arm, path) as states, path.open("a") as file:
        file.write('{"position": [' + "1, " * 2000)
        file.flush()
        latest = until(states, lambda now: now.refused == 1)
        assert latest.complaint.startswith("line 1: ")
        file.write("1, " * 2000 + "1]}\n" + line(np.ones(6)) + "bad\n")
        file.flush()
        latest = until(states, lambda now: now.refused == 2)
        assert latest.count == 1 and latest.complaint.startswith("line 3: ")


def test_what_is_no_source_is_refused_at_once(arm, tmp_path):
    with pytest.raises(FileError, match="no such file"):
        JointStates(arm, tmp_path / "missing")
    with pytest.raises(FileError, match="directory"):
        JointStates(arm, tmp_path)
    with pytest.raises(FileError, match="cannot be read"):
        JointStates(arm, "a\0b")
    with pytest.raises(InvalidValue, match="source"):
        JointStates(arm, 3)
    with pytest.raises(InvalidValue, match="an Arm"):
        JointStates("arm", tmp_path / "missing")


def test_a_source_that_breaks_is_told_of_and_nothing_is_raised(arm, path, monkeypatch):
    path.write_text(line(np.ones(6)))
    states = JointStates(arm, path)
    until(states, lambda now: now.count == 1)
    for error in (OSError(5, "Input/output error"), RuntimeError("broken")):

        def fail(*_, error=error):
            raise error

        monkeypatch.setattr(measured_arm.os, "read", fail)
        path.write_text(line(np.ones(6)) * 2)
        latest = until(states, lambda now: now.complaint != "")
        assert (error.strerror if isinstance(error, OSError) else "broken") in latest.complaint
        monkeypatch.undo()
        assert latest.count >= 1
        np.testing.assert_array_equal(latest.q, np.ones(6))
        states.close()
        assert states.ended
        path.write_text(line(np.ones(6)))
        states = JointStates(arm, path)
        until(states, lambda now: now.count == 1)
    states.close()
    states.close()


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="the open files cannot be counted")
def test_many_come_and_go_without_a_trace(arm, path):
    path.write_text(line(np.ones(6)))
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(20):
        with JointStates(arm, path) as states:
            until(states, lambda now: now.count == 1)
    assert len(list(Path("/proc/self/fd").iterdir())) == before
