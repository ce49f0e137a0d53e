"""A declared class is the same in a call and in a file: values, refusals, and what is written.

`python tests/test_schema.py` writes the words of the refusals to refusals.txt; read the difference before you
keep it.
"""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Hashable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from sampling import examples

import pinposture as pp
from pinposture.arm import ArmSpec, Cable, FeedSpec, Load, Weight
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName
from pinposture.schema import key_path_in_words, mistakes_of, read_as
from pinposture.sim import ContactModel, DriveModel, Sensing, Servos
from pinposture.task import Carrying, Leader, Release, TipGoal, Withdrawal, Wrapping


class File:
    """Where values are read from and written to, without a file."""

    embeds = False

    def __init__(self) -> None:
        self.arm = template_arm("RyRz", 6).with_effort(3.0)
        self.scene = None
        self.described: dict[Hashable, object] = {}

    def resolve(self, name: str) -> Path:
        return Path("/somewhere") / name

    def find(self, part: Hashable, kind: Any) -> None:
        return None


@cache
def line() -> pp.Curve:
    return pp.Curve.line((0, 0, 0), (0.3, 0, 0))


NEEDED: dict[type, dict[str, Any]] = {
    pp.Keyframe: {"curve": line},
    pp.Limits: {"dt": 0.02, "acceleration": 3.0},
    pp.EndEffector: {"position": (0.1, 0.2, 0.3)},
    Leader: {"path": line, "speed": 0.1},
    TipGoal: {"position": (0.1, 0.2, 0.3)},
    Withdrawal: {},
    Wrapping: {"obstacle": "can"},
    Carrying: {"position": (0.1, 0.2, 0.3)},
    Release: {},
    FeedSpec: {"stroke": 0.3},
    ArmSpec: {"template": "RyRz", "modules": 3},
    Load: {"mass": 0.5},
    Cable: {"mass_per_length": 0.1},
    Weight: {},
    pp.Sphere: {"center": (0.1, 0.2, 0.3), "radius": 0.1},
    pp.Capsule: {"start": (0.1, 0.2, 0.3), "end": (0.4, 0.5, 0.6), "radius": 0.1},
    pp.Box: {"center": (0.1, 0.2, 0.3), "size": (0.1, 0.2, 0.3)},
    pp.HalfSpace: {"point": (0.1, 0.2, 0.3), "normal": (0.0, 0.0, 1.0)},
    pp.Scan: {"points": [(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)]},
    pp.Scene: {},
    pp.Carried: {"frame": "tip"},
    Servos: {},
    Sensing: {},
    ContactModel: {},
    pp.Touch: {"threshold": 0.5},
    DriveModel: {},
}
IN_FILE: dict[type, dict[str, Any]] = {
    pp.Limits: {"cycle": 0.02, "acceleration": 3.0},
    pp.EndEffector: {"position": [0.1, 0.2, 0.3]},
    TipGoal: {"position": [0.1, 0.2, 0.3]},
    Carrying: {"position": [0.1, 0.2, 0.3]},
}


def needed(kind: type) -> dict[str, Any]:
    """The arguments that a class needs."""
    return {name: value() if callable(value) else value for name, value in NEEDED[kind].items()}


VALUES = (
    *(-1.0, 0.0, 1.5, 3, -3, True, math.nan, math.inf, -math.inf, 1e100, 10**400, 10**5000, 1e-320),
    *(
        "",
        "20 ms",
        "90 deg",
        "-3 cm",
        "3 kg",
        "align",
        "torque",
        "closest",
        "soon",
        [],
        [1.0],
        [0.0, 1.0, 2.0],
        [0.5, 1.0, 2.0],
        [1, "2", 3],
        {},
        {"a": 1},
    ),
)
SHARED = [
    (pp.Keyframe, ("time", "duration", "hold", "name", "placement", "roll", "method", "trim", "speed")),
    (pp.Limits, ("position_margin",)),
    (pp.EndEffector, ("weight", "priority", "length")),
    (Leader, ("speed", "depth", "placement", "method", "and_back", "pipe")),
    (TipGoal, ("position", "direction", "rotation", "duration", "hold", "budget", "objective")),
    (Withdrawal, ("speed",)),
    (Wrapping, ("obstacle", "turns", "friction", "squeeze", "force")),
    (Carrying, ("position", "turn", "onto")),
    (FeedSpec, ("stroke", "length", "speed")),
    (ArmSpec, ("joint_limits", "characteristic_length")),
    (Load, ("mass", "com")),
    (Cable, ("mass_per_length", "start", "end")),
    (Weight, ("effort", "stiffness", "gravity", "density")),
    (pp.Sphere, ("center", "radius")),
    (pp.Capsule, ("start", "end", "radius")),
    (pp.Box, ("center", "size", "rotation")),
    (pp.HalfSpace, ("point", "normal")),
    (pp.Scan, ("center", "rotation", "point_radius")),
    (pp.Carried, ("frame", "position", "rotation", "beside")),
    (Servos, ("frequency", "damping", "torque_limits", "speed_reference", "armature", "timestep")),
    (Sensing, ("noise", "resolution", "dropped", "latency", "period", "seed", "torque_noise")),
    (ContactModel, ("friction", "time_constant", "damping", "masses")),
    (pp.Touch, ("threshold", "time_constant")),
    (DriveModel, ("lag", "friction", "stiction", "delay")),
    (pp.Scene, ("self_collision", "margin", "arm_radius", "velocities", "touchable")),
]
FIELDS = [(kind, name) for kind, names in SHARED for name in names]
REFUSALS = Path(__file__).with_name("refusals.txt")
"""What is said of the values that each field refuses: the first of the values for each of the reasons."""


def refusals() -> str:
    """The words of all refusals, by class and field."""
    lines = []
    for kind, name in FIELDS:
        reasons: dict[str, str] = {}
        for value in VALUES:
            try:
                read_as(kind, {**IN_FILE.get(kind, needed(kind)), name: value}, File())
            except ValidationError as error:
                place, refusal = mistakes_of(error)[0]
                reason = str(refusal)
                reasons.setdefault(
                    reason.partition("; allowed: ")[2] or reason, f"{key_path_in_words(place)}: {reason}"
                )
        lines += [f"{kind.__name__}.{each}" for each in reasons.values()]
    return "".join(f"{each}\n" for each in lines)


def test_the_words_of_refusals_are_those_of_the_snapshot() -> None:
    assert refusals() == REFUSALS.read_text(encoding="utf-8")


@pytest.mark.parametrize(("kind", "name"), FIELDS, ids=lambda each: getattr(each, "__name__", each))
def test_a_call_and_a_file_accept_and_refuse_the_same(kind: type, name: str) -> None:
    accepted = 0
    for value in VALUES:
        if kind is pp.Limits and not isinstance(value, int | float):
            continue  # an arm is needed to read the unit of a limit
        table = {**IN_FILE.get(kind, needed(kind)), name: value}
        call: Any = None
        file: Any = None
        try:
            call = kind(**{**needed(kind), name: value})
        except PostureError as error:
            call = error
        try:
            file = read_as(kind, table, File())
        except ValidationError as error:
            _, file = mistakes_of(error)[0]
        assert isinstance(call, PostureError) == isinstance(file, ValueError), (value, call, file)
        if isinstance(call, InvalidValue) and kind is not pp.Limits:
            assert call.allowed in str(file) or isinstance(file.error, PostureError), (value, call, file)
        elif not isinstance(call, PostureError):
            accepted += 1
            assert getattr(call, name) == getattr(file, name)
    assert accepted > 0 or name == "joint_limits"


def test_text_with_a_unit_is_a_quantity_in_a_call_too() -> None:
    assert pp.Keyframe(line(), time="200 ms", roll="90 deg").time == pytest.approx(0.2)  # type: ignore[arg-type]
    assert pp.Limits(dt="20 ms").dt == 0.02  # type: ignore[arg-type]
    assert TipGoal(("10 cm", 0, 0)).position == (0.1, 0.0, 0.0)  # type: ignore[arg-type]
    with pytest.raises(InvalidValue, match=r"^dt is '20 mm'; allowed: .* s, ms, min$"):
        pp.Limits(dt="20 mm")  # type: ignore[arg-type]


def test_obstacles_and_curves_are_given_with_units_in_calls_and_files() -> None:
    ball = pp.Sphere(("10 cm", 0, 0.3), "25 mm")  # type: ignore[arg-type]
    assert ball == pp.Sphere((0.1, 0.0, 0.3), 0.025)
    described = {"type": "box", "center": ["1 cm", 0, 0], "size": [1, 1, 1], "rotation": ["90 deg", 0, 0]}
    turned = pp.Box((0.01, 0, 0), (1, 1, 1), (math.pi / 2, 0, 0))
    scene = pp.Scene.from_dict({"margin": "5 mm", "obstacles": {"box": described}})
    assert scene == pp.Scene({"box": turned}, margin=0.005)
    helix: Any = pp.Curve.helix
    assert helix("6 cm", "150 mm", 4, phase="90 deg") == pp.Curve.helix(0.06, 0.15, 4, phase=math.pi / 2)
    with pytest.raises(
        InvalidValue, match=r"^radius is '6 lb', and 'lb' is not a known unit; allowed: .* m, cm, mm$"
    ):
        helix("6 lb", 0.1, 4)


def test_the_mistakes_in_a_scene_file_are_told_together(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    ball = '[obstacles.a]\ntype = "sphere"\ncenter = [0, 0]\nradius = -1\n'
    file.write_text(f"{ball}\n[obstacles.b]\ntype = 3\n")
    with pytest.raises(FileError) as caught:
        pp.Scene.load(file)
    said = [error.reason for error in caught.value.reasons if isinstance(error, FileError)]
    assert said == [
        "line 3: obstacles.a.center: is [0, 0]; allowed: three finite numbers",
        "line 4: obstacles.a.radius: is -1; allowed: a length of 1e-09 to 10000 m",
        "line 7: obstacles.b.type: is 3; allowed: 'sphere', 'capsule', 'cylinder', 'box', 'half_space', "
        "'mesh', 'scan'",
    ]


def test_a_description_in_which_nothing_is_left_out_is_read() -> None:
    turn = np.eye(3).tolist()
    described = {
        "version": 1,
        "self_collision": True,
        "margin": 0.005,
        "obstacles": {
            "box": {"type": "box", "center": [0.0, 0.0, 1.0], "size": [1.0, 1.0, 1.0], "rotation": turn},
            "cloud": {
                "type": "scan",
                "points": [[0.0, 0.0, 1.0]],
                "center": [0.0, 0.0, 0.0],
                "rotation": turn,
            },
        },
    }
    obstacles = {"box": pp.Box((0, 0, 1), (1, 1, 1)), "cloud": pp.Scan([(0, 0, 1)])}
    assert pp.Scene.from_dict(described) == pp.Scene(obstacles)


@pytest.mark.parametrize("kind", NEEDED, ids=lambda each: each.__name__)
def test_calls_raise_what_python_functions_raise_for_wrong_arguments(kind: type) -> None:
    with pytest.raises(TypeError, match=f"{kind.__name__}: unexpected argument 'colour'"):
        kind(**needed(kind), colour="red")
    made = kind(**needed(kind))
    assert pickle.loads(pickle.dumps(made)) == made == copy.deepcopy(made)
    if kind not in (ArmSpec, ContactModel):  # which have dictionaries
        assert hash(made) == hash(kind(**needed(kind)))
    with pytest.raises(AttributeError):
        made.colour = "red"


@pytest.mark.parametrize("name", [10**5000, 10**400, 3.5, [1]], ids=["huge", "large", "number", "list"])
def test_what_is_no_text_is_an_unknown_name(name: Any) -> None:
    for call in (
        lambda: pp.Keyframe(line(), placement=name),
        lambda: pp.Scene.from_dict({"obstacles": {"a": {"type": name}}}),
        lambda: pp.Curve.from_dict({"type": name}),
        lambda: pp.Arm.from_template(name, modules=2),
    ):
        with pytest.raises(UnknownName) as caught:
            call()
        assert len(str(caught.value)) < 400


def test_a_part_of_a_value_is_named() -> None:
    with pytest.raises(InvalidValue, match=r"^position\[1\] is 'x'; allowed: a number in SI units"):
        TipGoal((0.1, "x", 0.3))  # type: ignore[arg-type]
    with pytest.raises(InvalidValue, match=r"^position is \(0.1, 0.2\); allowed: a list of 3"):
        TipGoal((0.1, 0.2))
    with pytest.raises(InvalidValue, match=r"^keyframe 'bow': time is -1; allowed"):
        pp.Keyframe(line(), time=-1, name="bow")
    with pytest.raises(TypeError, match="Leader: missing argument 'speed'"):
        Leader(line())  # type: ignore[call-arg]


@given(
    position=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    angles=st.none() | st.tuples(*[st.floats(-1.5, 1.5)] * 3),
    point=st.integers(-6, 5),
    weight=st.floats(0.1, 10.0),
    priority=st.booleans(),
)
@examples(60)
def test_a_tip_that_was_written_reads_back(
    position: Any, angles: Any, point: int, weight: float, priority: bool
) -> None:
    values: dict[str, Any] = {"position": position}
    if angles is not None:
        import pinocchio as pin

        values = {"pose": pin.SE3(pin.rpy.rpyToMatrix(*angles), np.array(position))}
    tip = pp.EndEffector(**values, point=point, weight=weight, priority=priority)
    file = File()
    again = read_as(pp.EndEffector, tip.to_table(file), file)
    assert (again.point, again.weight, again.priority) == (tip.point, tip.weight, tip.priority)
    for one, other in ((again.position, tip.position), (again.pose, tip.pose)):
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)


@given(
    velocity=st.none() | st.floats(0.1, 2.0) | st.lists(st.floats(0.1, 2.0), min_size=12, max_size=12),
    acceleration=st.none() | st.floats(0.1, 50.0),
    step=st.none() | st.floats(0.01, 1.0),
    dt=st.floats(1e-3, 0.9),
    effort=st.none()
    | st.just(True)
    | st.floats(0.1, 9.0)
    | st.lists(st.floats(0.1, 9.0), min_size=12, max_size=12),
)
@examples(60)
def test_limits_that_were_written_read_back(
    velocity: Any, acceleration: Any, step: Any, dt: float, effort: Any
) -> None:
    given_velocity = np.array(velocity) if isinstance(velocity, list) else velocity
    torques = np.array(effort) if isinstance(effort, list) else effort
    limits = pp.Limits(step=step, velocity=given_velocity, dt=dt, acceleration=acceleration, effort=torques)
    file = File()
    assert read_as(pp.Limits, limits.to_table(file), file) == limits


if __name__ == "__main__":
    REFUSALS.write_text(refusals(), encoding="utf-8")
