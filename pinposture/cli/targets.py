"""The target on the command line: the curve, the tip, and what is around the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class PlacementOptions:
    """How a curve is laid, and which control points are to follow it."""

    placement: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="How the curve is laid: as_is, translate (to the base) or align (turned to the arm too); "
            "else as_is among obstacles, and align without.",
            rich_help_panel=TARGET,
        ),
    ] = None
    roll: Annotated[
        float,
        typer.Option(
            help="Turn of an aligned curve about the axis of the arm, in rad.", rich_help_panel=TARGET
        ),
    ] = 0.0
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="How modules are placed: sequential (one by one, exactly), smooth (all at once, bending "
            "little), closest (all at once), or auto.",
            rich_help_panel=TARGET,
        ),
    ] = "auto"
    partial: Annotated[
        bool,
        typer.Option(
            "--partial", help="Leave points free that have no place on the curve.", rich_help_panel=TARGET
        ),
    ] = False
    region: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST-LAST",
            help="Control points that are to take the shape, as in 10-20; the others are free.",
            rich_help_panel=TARGET,
        ),
    ] = None

    def place(self, arm: Arm, curve: str, scene: Scene | None) -> Target:
        """Place the control points on a curve; say on stderr if some have no place.

        Raises:
            PostureError: as `read_curve`, `resolve_targets` and `read_region`.
            InvalidValue: a curve on which not even the first module has a place.
        """
        from pinposture.placement import resolve_targets
        from pinposture.task.keyframe import usual_placement

        placement = usual_placement(scene) if self.placement is None else self.placement
        target = resolve_targets(
            arm,
            read_curve(curve),
            placement=cast(Literal["as_is", "translate", "align"], placement),  # checked there
            roll=self.roll,
            incomplete="partial" if self.partial else "raise",
            method=cast(Literal["auto", "sequential", "smooth", "closest"], self.method),
        )
        count = target.has_target.sum()
        if not count:
            raise InvalidValue(
                "--curve", curve, f"one with a place for the first module: {target.incomplete}"
            )
        if target.incomplete:
            print_note(f"only the first {count} of {arm.n_modules} control points have a place")
        return target if self.region is None else target.region(*read_region("--region", self.region, arm))


# What is asked of the tip on the command line, besides the shape.

TIP = "The tip"
"""Heading under which the help lists these options."""


@dataclass(frozen=True)
class TipOptions:
    """What is asked of the tip, besides the shape."""

    tip_position: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Bring the tip here, in metres, as the arm takes its shape.",
            rich_help_panel=TIP,
        ),
    ] = None
    tip_pose: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,ROLL,PITCH,YAW",
            help="Bring it here, turned from the axes of the world by roll about x, then pitch about y, then "
            "yaw about z, in rad.",
            rich_help_panel=TIP,
        ),
    ] = None
    hold_tip: Annotated[
        str | None,
        typer.Option(
            metavar="WHAT",
            help="Keep the tip where the start has it: its position, or its pose.",
            rich_help_panel=TIP,
        ),
    ] = None
    tip_weight: Annotated[
        float | None,
        typer.Option(
            help="What the tip counts, where a control point on the curve counts 1; else 1.",
            rich_help_panel=TIP,
        ),
    ] = None
    strict_tip: Annotated[
        bool,
        typer.Option("--strict-tip", help="The tip comes first, the shape after it.", rich_help_panel=TIP),
    ] = False

    def read(self, start: ArmState) -> EndEffector | None:
        """The task of the tip that these options ask for; None if they ask for none.

        Args:
            start: where the arm begins.

        Raises:
            InvalidValue: more than one place for the tip; a weight, or a priority, without any; other
                numbers.
            UnknownName: something else to hold.
        """
        from pinposture.control import EndEffector

        places = {
            "--tip-position": self.tip_position,
            "--tip-pose": self.tip_pose,
            "--hold-tip": self.hold_tip,
        }
        given = {option: text for option, text in places.items() if text is not None}
        if len(given) > 1:
            first, second, *_ = given
            raise InvalidValue(second, given[second], f"without {first}")
        weight = 1.0 if self.tip_weight is None else self.tip_weight
        if self.tip_position is not None:
            position = _finite("--tip-position", self.tip_position, "X,Y,Z")
            return EndEffector(position=position, weight=weight, priority=self.strict_tip)
        if self.tip_pose is not None:
            pose = _placement(_finite("--tip-pose", self.tip_pose, "X,Y,Z,ROLL,PITCH,YAW"))
            return EndEffector(pose=pose, weight=weight, priority=self.strict_tip)
        if self.hold_tip is not None:
            return EndEffector.held(start, self.hold_tip, weight=weight, priority=self.strict_tip)
        for option, value in (("--tip-weight", self.tip_weight), ("--strict-tip", self.strict_tip or None)):
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


@dataclass(frozen=True)
class SceneOptions:
    """What the arm must keep clear of."""

    scene: SceneOption = None
    self_collision: Annotated[
        bool,
        typer.Option(
            "--self-collision",
            help="Count the arm itself among what it must keep clear of.",
            rich_help_panel=SURROUNDINGS,
        ),
    ] = False

    @property
    def file(self) -> str | None:
        """The file, for a summary."""
        return None if self.scene is None else str(self.scene)

    def read(self) -> Scene | None:
        """The scene of the file, with self-collision if asked for; None if there is neither.

        Raises:
            FileError: the file is missing, or holds no scene.
        """
        from pinposture.collision import Scene

        scene = None if self.scene is None else Scene.load(self.scene)
        if not self.self_collision:
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
