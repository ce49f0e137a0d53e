"""Soft limits in <safety_controller>: where the controller of the robot stops a joint."""

from __future__ import annotations

import numpy as np
import pytest

import pinposture as pp
from pinposture.arm.description import read_description
from pinposture.errors import InvalidValue, PostureWarning, URDFError

HARD = "hard_limits=True (--hard-limits)"


def arm(*joints: str) -> str:
    """A chain of joints: for each its type, what is in its <limit>, and what else it has, separated by |."""
    parts = ['<robot name="s"><link name="l0"/>']
    for number, words in enumerate(joints, start=1):
        kind, limit, more = words.split("|")
        parts.append(
            f'<link name="l{number}"/><joint name="j{number}" type="{kind}"><parent link="l{number - 1}"/>'
            f'<child link="l{number}"/><origin xyz="0.1 0 0"/><axis xyz="0 0 1"/>'
            f'<limit effort="1" velocity="1" {limit}/>{more}</joint>'
        )
    tip = f'<link name="t"/><joint name="f" type="fixed"><parent link="l{len(joints)}"/><child link="t"/>'
    return "".join(parts) + tip + '<origin xyz="0.1 0 0"/></joint></robot>'


def soft(**limits: float) -> str:
    given = "".join(f' soft_{name}_limit="{value}"' for name, value in limits.items())
    return f'<safety_controller k_velocity="10" k_position="20"{given}/>'


WIDE = 'lower="-2" upper="2"'


@pytest.mark.parametrize(
    ("joint", "expected"),
    [
        (f"revolute|{WIDE}|{soft(lower=-0.5, upper=0.75)}", (-0.5, 0.75)),
        (f"prismatic|{WIDE}|{soft(lower=-0.5, upper=0.75)}", (-0.5, 0.75)),
        (f"revolute||{soft(lower=-0.5, upper=0.75)}", (-0.5, 0.75)),  # no hard limits
        (f"revolute|{WIDE}|{soft()}", (-2.0, 2.0)),  # only velocity is limited
        (f"revolute|{WIDE}|{soft(lower=0, upper=0)}", (-2.0, 2.0)),  # the values if not given
        (f"revolute|{WIDE}|", (-2.0, 2.0)),
    ],
)
def test_soft_limits_narrow_those_of_the_joint(joint: str, expected: tuple[float, float]) -> None:
    text = arm(joint, f"revolute|{WIDE}|")
    loaded = pp.Arm.load(text)
    assert (loaded.limits.lower[0], loaded.limits.upper[0]) == expected
    assert (loaded.limits.lower[1], loaded.limits.upper[1]) == (-2.0, 2.0)
    with_soft = expected != (-2.0, 2.0)
    assert loaded.report.soft_limited == (("j1",) if with_soft else ())
    assert loaded.warnings == ()


def test_hard_limits_are_those_of_limit_whatever_the_controller_has() -> None:
    text = arm(f"revolute|{WIDE}|{soft(lower=0.5, upper=-0.5)}", f"revolute|{WIDE}|{soft(upper=1)}")
    loaded = pp.Arm.load(text, hard_limits=True)
    np.testing.assert_array_equal(loaded.limits.upper, [2.0, 2.0])
    np.testing.assert_array_equal(loaded.limits.lower, [-2.0, -2.0])
    assert (loaded.warnings, loaded.report.soft_limited) == ((), ())
    np.testing.assert_array_equal(pp.Arm.from_spec(loaded.spec).limits.upper, [2.0, 2.0])
    with pytest.raises(InvalidValue, match="hard_limits"):
        pp.Arm.load(text, hard_limits="yes")


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"lower": 0.5, "upper": -0.5}, ("soft limits are 0.5 to -0.5", "lower <= upper")),
        ({"lower": 3.0, "upper": 4.0}, ("soft limits are 3 to 4", "no range within -2 to 2")),
        ({"lower": 0.5, "upper": 0.5}, ("soft limits are 0.5 to 0.5", "no range")),
        ({"lower": 0.5}, ("soft limits are 0.5 to 0", "0 if not given")),
    ],
)
def test_soft_limits_that_leave_no_range_are_refused(
    limits: dict[str, float], words: tuple[str, ...]
) -> None:
    with pytest.raises(URDFError) as caught:
        pp.Arm.load(arm(f"revolute|{WIDE}|{soft(**limits)}"))
    assert all(word in str(caught.value) for word in ("joint 'j1'", HARD, *words))


def test_soft_limits_on_one_side_or_beyond_the_hard_ones_are_named() -> None:
    text = arm(
        f"revolute|{WIDE}|{soft(upper=1.0)}",
        f"revolute|{WIDE}|{soft(lower=-3.0, upper=1.5)}",
        f"continuous||{soft(lower=-1.0, upper=1.0)}",
    )
    with pytest.warns(PostureWarning):
        loaded = pp.Arm.load(text)
    np.testing.assert_array_equal(loaded.limits.lower[:2], [0.0, -2.0])
    np.testing.assert_array_equal(loaded.limits.upper[:2], [1.0, 1.5])
    continuous, one_sided, beyond = loaded.warnings
    assert "joint 'j3'" in continuous
    assert "continuous" in continuous
    assert "joint 'j1'" in one_sided
    assert "the other is 0" in one_sided
    assert "joint 'j2'" in beyond
    assert "<limit>" in beyond


def test_followers_keep_their_soft_limits() -> None:
    mimic = '<mimic joint="j1" multiplier="-2" offset="0.1"/>'
    text = arm(
        f"revolute|{WIDE}|{soft(lower=-1, upper=1)}", f"revolute|{WIDE}|{mimic}{soft(lower=-1, upper=0.5)}"
    )
    loaded = pp.Arm.load(text, split=[2])
    assert loaded.nv == 1
    # -1 <= 0.1 - 2 x <= 0.5, and -1 <= x <= 1
    np.testing.assert_allclose([loaded.limits.lower[0], loaded.limits.upper[0]], [-0.2, 0.55])
    by_hand = pp.Arm.load(text.replace(mimic, ""), couplings={"j2": ("j1", -2.0, 0.1)}, split=[2])
    np.testing.assert_allclose(by_hand.limits.lower, loaded.limits.lower)


def test_a_joint_off_the_chain_stays_within_its_soft_limits() -> None:
    branch = (
        '<link name="b"/><joint name="k" type="revolute"><parent link="l1"/><child link="b"/>'
        f'<limit effort="1" velocity="1" {WIDE}/>{soft(lower=0.5, upper=1)}</joint>'
        '<link name="c"/><joint name="g" type="fixed"><parent link="b"/><child link="c"/></joint></robot>'
    )
    text = arm(f"revolute|{WIDE}|", f"revolute|{WIDE}|").replace("</robot>", branch)
    assert read_description(text).joints[-2].soft is not None
    with pytest.warns(PostureWarning):
        loaded = pp.Arm.load(text, tip="t")
    frame = loaded.model.frames[loaded.model.getFrameId("c")]
    assert np.arccos(frame.placement.rotation[1, 1]) == pytest.approx(0.5)
