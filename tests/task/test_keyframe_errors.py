"""What is wrong with keyframes is said in one line, with the number and the name of the keyframe."""

from __future__ import annotations

import math
import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from arms import template_arm
from task.keyed_arms import coil, snake, straight

import pinposture as pp
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    InvalidValue,
    PostureError,
    TargetError,
    TaskError,
    UnknownName,
)
from pinposture.task.keyframes import Keyframe, keyframe_reference

J = pp.JointSpec


def start() -> Keyframe:
    return Keyframe(straight(1.0))


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    (
        ({"curve": None}, InvalidValue, "keyframe: curve is not given; allowed: a Curve"),
        ({"name": 3}, InvalidValue, "name is 3; allowed: text"),
        ({"time": 1.0, "duration": 1.0}, InvalidValue, "keyframe: time and duration"),
        (
            {"name": "b", "time": -1.0},
            InvalidValue,
            "keyframe 'b': time is -1.0; allowed: a finite number >=",
        ),
        ({"duration": math.nan}, InvalidValue, "duration is nan"),
        ({"hold": True}, InvalidValue, "hold is True"),
        ({"roll": math.inf}, InvalidValue, "roll is inf"),
        ({"placement": "aligned"}, UnknownName, r"keyframe: no placement is called 'aligned' \(did you mean"),
        ({"method": "best"}, UnknownName, "no method is called 'best'"),
        ({"tip": (0, 0, 1)}, InvalidValue, r"tip is \(0, 0, 1\); allowed: EndEffector\("),
        ({"region": (3, 1)}, InvalidValue, r"region is \(3, 1\)"),
        ({"region": 3}, InvalidValue, "region is 3"),
        ({"trim": 1}, InvalidValue, "trim is 1"),
    ),
)
def test_values_of_a_keyframe(options: dict[str, Any], kind: type[PostureError], message: str) -> None:
    with pytest.raises(kind, match=message):
        Keyframe(**{"curve": straight(1.0), **options})


@pytest.mark.parametrize(
    ("make", "options", "kind", "message"),
    (
        (lambda: [start()], {}, InvalidValue, "keyframes is .*; allowed: two or more"),
        (lambda: [start(), straight(1.0)], {}, InvalidValue, "keyframes is"),
        (lambda: [start(), start()], {}, TaskError, "keyframe 2: it has neither a time nor a duration"),
        (lambda: [start(), start()], {"interval": 0.0}, InvalidValue, "interval is 0.0"),
        (lambda: [start(), start()], {"continuity": "jerk"}, UnknownName, "no continuity is called 'jerk'"),
        (
            lambda: [start(), Keyframe(straight(1.0), duration=1.0, region=(0, 20), name="b")],
            {},
            TaskError,
            r"keyframe 2 'b': its region is \(0, 20\); the arm has control points 0 to 19",
        ),
        (
            lambda: [
                start(),
                Keyframe(straight(1.0), duration=1.0, tip=pp.EndEffector((2, 0, 0), priority=True)),
            ],
            {},
            TaskError,
            r"^keyframe 2: its tip task with priority is missed by 1 m in the closest posture found",
        ),
        (
            lambda: [start(), Keyframe(straight(1.0), duration=1.0, tip=pp.EndEffector((1, 0, 0), point=33))],
            {},
            InvalidValue,
            "keyframe 2: point is 33",
        ),
    ),
)
def test_motions(
    make: Callable[[], list[Any]], options: dict[str, Any], kind: type[PostureError], message: str
) -> None:
    arm = template_arm("RyRz", 20)
    keyframes = make()
    with pytest.raises(kind, match=message):
        keyframe_reference(arm, keyframes, **{"interval": 0.02, **options})


def test_a_curve_longer_than_the_arm_is_trimmed_with_a_warning_unless_that_is_asked() -> None:
    arm = template_arm("RyRz", 20)
    long = Keyframe(coil(1.0), duration=1.0, name="coil")
    words = r"^keyframe 2 'coil': the arm takes the first .* of 1\.145 m; set trim"
    with pytest.warns(pp.PostureWarning, match=words) as said:
        warned = keyframe_reference(arm, [start(), long], 0.02)
    assert len(said) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asked = keyframe_reference(arm, [start(), replace(long, trim=True)], 0.02)
    np.testing.assert_array_equal(warned.offsets, asked.offsets)


def test_a_tip_goal_beyond_the_reach_draws_a_warning() -> None:
    keyframes = [start(), Keyframe(straight(1.0), duration=1.0, tip=pp.EndEffector((0, 0.75, -1)))]
    with pytest.warns(pp.PostureWarning, match=r"^keyframe 2: .* it is 1\.25 m from the base .* reaches 1 m"):
        keyframe_reference(template_arm("RyRz", 20), keyframes, 0.02)


@pytest.mark.parametrize(
    ("make", "kind"),
    (
        (lambda: (template_arm("RyRz", 20), straight(0.8)), CurveEndsEarly),
        (
            lambda: (snake(J("y", lower=-0.1, upper=0.1), J("z")), pp.Curve.helix(0.1, 0, 1)),
            CurveBendsTooMuch,
        ),
    ),
)
def test_curves_that_cannot_be_taken_keep_the_kind_of_their_error(
    make: Callable[[], tuple[pp.Arm, pp.Curve]], kind: type[TargetError]
) -> None:
    arm, curve = make()
    with pytest.raises(kind) as alone:
        pp.resolve_targets(arm, curve, samples=200_000, placement="align")
    keyframes = [Keyframe(straight(arm.length)), Keyframe(curve, duration=1.0, name="bad", trim=True)]
    with pytest.raises(kind) as found:
        keyframe_reference(arm, keyframes, 0.02)
    assert str(found.value) == f"keyframe 2 'bad': {alone.value}"
    assert found.value.module == alone.value.module
    assert found.value.reason == alone.value.reason
    again = pickle.loads(pickle.dumps(found.value))
    assert (type(again), str(again), again.module) == (kind, str(found.value), found.value.module)


def test_the_error_of_a_task_has_its_parts_and_pickles() -> None:
    error = TaskError("keyframe 3", "too late")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.where, again.reason) == ("keyframe 3: too late", "keyframe 3", "too late")
    assert isinstance(again, ValueError)
