"""What is around an arm on the command line: scene files, and how far an arm is from what is in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.output import print_facts, print_table

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.collision import Scene

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
            {"name": name, **obstacle.to_dict(), **beside(name)} for name, obstacle in scene.obstacles.items()
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
