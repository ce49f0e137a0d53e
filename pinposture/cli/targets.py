"""The target on the command line: the curve, the tip, and what is around the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from pinposture.cli.inputs import TARGET, read_curve, read_numbers, read_region
from pinposture.cli.output import print_facts, print_note, print_table
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.arm import Arm, ArmState
    from pinposture.collision import Scene
    from pinposture.control import EndEffector
    from pinposture.motion import Trajectory
    from pinposture.placement import Target


# The target on the command line: a curve, how it is laid, and which control points are to follow it.

CurveOption = Annotated[
    str,
    typer.Option(
        metavar="CURVE",
        help="A .json, .csv or .txt file, or a preset: line (1.1 m), helix (1.62 m).",
        rich_help_panel=TARGET,
    ),
]
PlacementOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="How the curve is laid: as_is, translate (to the base) or align (turned to the arm too); else "
        "as_is among obstacles, and align without.",
        rich_help_panel=TARGET,
    ),
]
RollOption = Annotated[
    float,
    typer.Option(help="Turn of an aligned curve about the axis of the arm, in rad.", rich_help_panel=TARGET),
]
MethodOption = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="How modules are placed: sequential (one by one, exactly), smooth (all at once, bending "
        "little), closest (all at once), or auto.",
        rich_help_panel=TARGET,
    ),
]
PartialOption = Annotated[
    bool,
    typer.Option(
        "--partial", help="Leave points free that have no place on the curve.", rich_help_panel=TARGET
    ),
]
RegionOption = Annotated[
    str | None,
    typer.Option(
        metavar="FIRST-LAST",
        help="Control points that are to take the shape, as in 10-20; the others are free.",
        rich_help_panel=TARGET,
    ),
]


def read_target(
    arm: Arm,
    curve: str,
    placement: str | None,
    roll: float,
    method: str,
    partial: bool,
    region: str | None,
    scene: Scene | None,
) -> Target:
    """Place the control points on a curve as these options ask; say on stderr if some have no place.

    Raises:
        PostureError: as `read_curve`, `resolve_targets` and `read_region`.
        InvalidValue: a curve on which not even the first module has a place.
    """
    from pinposture.placement import resolve_targets
    from pinposture.task.keyframe import usual_placement

    placement = usual_placement(scene) if placement is None else placement
    target = resolve_targets(
        arm,
        read_curve(curve),
        placement=cast(Literal["as_is", "translate", "align"], placement),  # checked there
        roll=roll,
        incomplete="partial" if partial else "raise",
        method=cast(Literal["auto", "sequential", "smooth", "closest"], method),
    )
    if not target.has_target.any():
        raise InvalidValue("--curve", curve, f"one with a place for the first module: {target.incomplete}")
    chosen = target if region is None else target.region(*read_region("--region", region, arm))
    if target.incomplete:
        print_note(f"only the first {target.has_target.sum()} of {arm.n_modules} control points have a place")
    return chosen


# What is asked of the tip on the command line, besides the shape.

TIP = "The tip"
"""Heading under which the help lists these options."""

TipPositionOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="Bring the tip here, in metres, as the arm takes its shape.",
        rich_help_panel=TIP,
    ),
]
TipPoseOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="Bring it here, turned from the axes of the world by roll about x, then pitch about y, then yaw "
        "about z, in rad.",
        rich_help_panel=TIP,
    ),
]
HoldTipOption = Annotated[
    str | None,
    typer.Option(
        metavar="WHAT",
        help="Keep the tip where the start has it: its position, or its pose.",
        rich_help_panel=TIP,
    ),
]
TipWeightOption = Annotated[
    float | None,
    typer.Option(
        help="What the tip counts, where a control point on the curve counts 1; else 1.", rich_help_panel=TIP
    ),
]
StrictTipOption = Annotated[
    bool,
    typer.Option("--strict-tip", help="The tip comes first, the shape after it.", rich_help_panel=TIP),
]


def read_tip(
    start: ArmState,
    position: str | None,
    pose: str | None,
    hold: str | None,
    weight: float | None,
    priority: bool,
) -> EndEffector | None:
    """The task of the tip that these options ask for; None if they ask for none.

    Args:
        start: where the arm begins.
        position: three numbers [m], or None.
        pose: three numbers [m] and three [rad], or None.
        hold: "position" or "pose", or None.
        weight: weight of the task; 1 if None.
        priority: whether it comes before the shape.

    Raises:
        InvalidValue: more than one place for the tip; a weight, or a priority, without any; other numbers.
        UnknownName: something else to hold.
    """
    from pinposture.control import EndEffector

    places = {"--tip-position": position, "--tip-pose": pose, "--hold-tip": hold}
    given = {option: text for option, text in places.items() if text is not None}
    if len(given) > 1:
        first, second, *_ = given
        raise InvalidValue(second, given[second], f"without {first}")
    options: dict[str, Any] = {"weight": 1.0 if weight is None else weight, "priority": priority}
    if position is not None:
        return EndEffector(position=_finite("--tip-position", position, "X,Y,Z"), **options)
    if pose is not None:
        return EndEffector(pose=_placement(_finite("--tip-pose", pose, "X,Y,Z,ROLL,PITCH,YAW")), **options)
    if hold is not None:
        return EndEffector.held(start, hold, **options)
    for option, value in (("--tip-weight", weight), ("--strict-tip", priority or None)):
        if value is not None:
            raise InvalidValue(option, value, f"together with one of {', '.join(places)}")
    return None


def _finite(option: str, text: str, names: str) -> list[float]:
    import numpy as np

    values = read_numbers(option, text)
    if len(values) != names.count(",") + 1 or not np.all(np.isfinite(values)):
        raise InvalidValue(option, text, f"finite numbers, {names}")
    return values


def _placement(values: list[float]) -> Any:
    import numpy as np
    import pinocchio as pin

    return pin.SE3(pin.rpy.rpyToMatrix(*values[3:]), np.array(values[:3]))


def tip_off(task: EndEffector, motion: Trajectory) -> dict[str, float | None]:
    """How far the tip is from what was asked of it, at the end of a run.

    Returns:
        "distance" [m], of a planar arm within its plane; and "turn" [rad], about axes about which the tip can
        turn, or None if no pose was asked for.
    """
    import numpy as np

    arm = motion.arm
    off = task.rows(arm.at(motion.q[-1]), motion.target).error
    turn = (
        None if task.pose is None else float(np.linalg.norm(off[arm.dimension :])) / arm.characteristic_length
    )
    return {"distance": float(np.linalg.norm(off[: arm.dimension])), "turn": turn}


# What is around an arm on the command line: scene files, and how far an arm is from what is in them.

SURROUNDINGS = "The surroundings"
"""Heading under which the help lists these options."""

SceneOption = Annotated[
    Path | None,
    typer.Option(
        "--scene", metavar="FILE", help="A .toml or .json file of obstacles.", rich_help_panel=SURROUNDINGS
    ),
]
SelfCollisionOption = Annotated[
    bool,
    typer.Option(
        "--self-collision",
        help="Count the arm itself among what it must keep clear of.",
        rich_help_panel=SURROUNDINGS,
    ),
]


def read_scene(file: Path | None, self_collision: bool) -> Scene | None:
    """The scene of a file, with self-collision if asked for; None if there is neither.

    Raises:
        FileError: the file is missing, or holds no scene.
    """
    from pinposture.collision import Scene

    scene = None if file is None else Scene.load(file)
    if not self_collision:
        return scene
    return Scene(self_collision=True) if scene is None else replace(scene, self_collision=True)


def describe_scene(scene: Scene, arm: Arm) -> dict[str, Any]:
    """A scene around an arm at zero joint positions, as data that JSON can hold; lengths in metres."""
    import numpy as np

    from pinposture.collision import CollisionModel

    clearance = CollisionModel(arm, scene)
    near = clearance.nearest(arm.at(arm.neutral()), np.inf)
    nearest: dict[str, tuple[str, float]] = {}
    for pair, distance in zip(near.pairs, near.distances, strict=True):
        for one, other in (pair, pair[::-1]):
            nearest.setdefault(one, (other, float(distance)))

    def beside(name: str) -> dict[str, Any]:
        other, distance = nearest.get(name, (None, None))
        return {"nearest": other, "distance": distance}

    return {
        "margin": scene.margin,
        "self_collision": scene.self_collision,
        "pairs": len(clearance.pairs),
        "excluded_pairs": [each._asdict() for each in clearance.excluded_pairs],
        "obstacles": [
            {"name": name, **obstacle.to_dict(embed=False), **beside(name)}
            for name, obstacle in scene.obstacles.items()
        ],
        "bodies": [{"name": name, **beside(name)} for name in dict.fromkeys(clearance.bodies)],
    }


def print_scene(about: Mapping[str, Any]) -> None:
    """Print what `describe_scene` found: obstacles, bodies of the arm, and what is nearest to each."""
    excluded = [f"{each['first']} to {each['second']}" for each in about["excluded_pairs"]]
    facts = {
        "margin": f"{about['margin']:.4g} m",
        "to itself": "distances of the arm from itself count" if about["self_collision"] else "not looked at",
        "pairs": f"{about['pairs']}, nearest at zero joint positions below",
    }
    print_facts({**facts, **({"excluded pairs": ", ".join(excluded)} if excluded else {})})
    for kind, headings in (("obstacles", ("obstacle", "type")), ("bodies", ("body",))):
        rows = [
            (one["name"], *([one["type"]] if "type" in one else []), one["nearest"] or "-", one["distance"])
            for one in about[kind]
        ]
        if rows:
            print_table((*headings, "nearest to it", "distance [m]"), rows)
