"""`pinposture reach`: find postures that bring the tip to a position."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from pinposture.cli.inputs import (
    MOTION,
    OUTPUT,
    TARGET,
    ArmOptions,
    ChangeOptions,
    DegreesOption,
    JsonOption,
    SceneOptions,
    StartOptions,
    UrdfArgument,
    read_declared,
    read_option,
)
from pinposture.cli.output import (
    FILES,
    File,
    check_directory,
    end_with,
    examples,
    print_json,
    print_note,
    print_table,
    progress_bar,
    run_files,
    write_files,
)
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.control.reach import ReachedPosture


@examples(
    "pinposture reach arm.urdf --to 0.4,0.1,0.5",
    "pinposture reach arm.urdf --to 0.4,0.1,0.5 --direction 1,0,0",
    "pinposture reach arm.urdf --to 0.4,0.1,0.5 --scene scene.toml --count 3",
    "pinposture reach arm.urdf --to 0.4,0.1,0.5 --start straight -o out",
    "pinposture reach arm.urdf --to 0.4,0.1,0.5 --effort 3 --objective torque",
    "pinposture reach arm.urdf --to 0.4,0.1,0.5 --seed 2 --budget 20 --json",
)
def run(
    *,
    urdf: UrdfArgument,
    arm_options: ArmOptions,
    goal_options: GoalOptions,
    scene_options: SceneOptions,
    search_options: SearchOptions,
    output: Annotated[
        Path | None,
        OUTPUT(
            "Save postures.png, and posture_1.json etc. for each posture, here; with --start also the "
            "run to the best one: run.npz, run.png and run.html.",
            "DIR",
            flags="--output -o",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find postures that bring the tip to a position, clear of the scene, and the paths to them.

    They are listed best first. The score is the mean of four values from 0 to 1: the clearance (1 from a
    twentieth of the arm length), the smallest distance of a joint from its limits relative to half its range,
    the distance of the tip from a singular posture, and with --start the directness of the path. Postures
    with a clear path come before those without. Torque is the largest share of its limit that a joint needs
    to hold still, if masses and limits are known. The help of track describes scene files.

    This is a search: finding nothing does not prove that there is nothing. The exit code is 0 if the best
    posture and the path to it are clear, 1 if no clear path was found, 2 if there is no posture.
    """
    import numpy as np

    from pinposture.control.reach import reach
    from pinposture.motion import track
    from pinposture.schema import Length
    from pinposture.storage import write_figure, write_text
    from pinposture.task import TipGoal

    start = search_options.start
    seed = search_options.seed
    degrees = search_options.degrees
    if degrees and start is None:
        raise InvalidValue("--degrees", degrees, "only with --start")
    change_options = search_options.change_options
    change_options.check("arm", "scene")
    arm = change_options.apply("arm", arm_options.read(urdf))
    surroundings = change_options.apply("scene", scene_options.read(arm))
    told = {"position": goal_options.to, "direction": goal_options.direction}
    goal = read_declared(TipGoal, {**told, "budget": search_options.budget})
    first = None if start is None else StartOptions(start, degrees, seed).read(arm, surroundings).q
    check_directory(output)
    with progress_bar("searching", "", first="postures"):
        postures = reach(
            arm,
            goal.position,
            direction=goal.direction,
            scene=surroundings,
            start=first,
            count=goal_options.count,
            seed=seed,
            budget=goal.budget,
            tolerance=read_option("--tolerance", goal_options.tolerance, Length),
            objective=cast("Any", goal_options.objective),  # checked there
        )
    blocked_by = postures[0].path.blocked_by if postures[0].path else ""
    files: list[File] = []
    if output is not None:
        for number, posture in enumerate(postures, start=1):
            text = json.dumps(posture.q.tolist()) + "\n"
            files.append((f"{number}", output / f"posture_{number}.json", partial(write_text, text=text)))
        picture = _draw(arm, postures, np.asarray(goal.position), surroundings)
        files.append(("picture", output / FILES.postures, partial(write_figure, figure=picture)))
        if first is not None and not blocked_by:
            files += run_files(track(arm, postures[0].target, first, scene=surroundings), output)
    written, failure = write_files(files)
    if as_json:
        asked = {"urdf": urdf, "to": goal.position, "direction": goal.direction, "start": start, "seed": seed}
        summaries = [posture.summary() for posture in postures]
        kept = {"scene": scene_options.scene, "postures": summaries, "files": list(written.values())}
        print_json({**asked, **kept})
    else:
        _print_postures(postures)
        if output is None:
            print_note("--output DIR (-o) writes the postures, and --json prints them")
    for file in written.values():
        print_note(f"wrote {file}")
    if failure is not None:
        raise failure
    end_with([blocked_by] if blocked_by else [])


@dataclass(frozen=True)
class GoalOptions:
    """The postures that are sought."""

    to: Annotated[str, TARGET("{task.TipGoal.position}", "X,Y,Z", flags="--to")]
    direction: Annotated[str | None, TARGET("{task.TipGoal.direction}", "X,Y,Z")] = None
    tolerance: Annotated[
        str | None, TARGET("Allowed error of the tip, in metres; default: 1e-6 of the arm length.", "LENGTH")
    ] = None
    count: Annotated[int, TARGET("Number of different postures.")] = 1
    objective: Annotated[
        str,
        TARGET("What postures are best: dexterity, as above, or torque: they need little of it.", "NAME"),
    ] = "dexterity"


@dataclass(frozen=True)
class SearchOptions:
    """The start of the paths, and the search."""

    change_options: ChangeOptions
    start: Annotated[
        str | None,
        MOTION(
            "Start of the paths: straight, smooth or random, a .npy, .csv or .json file of joint "
            "positions, or 0.1,0.2,.... Default: no paths are computed.",
            "START",
        ),
    ] = None
    degrees: DegreesOption = False
    seed: Annotated[int, MOTION("Seed of the search, and of a smooth or random start.")] = 0
    budget: Annotated[str | None, MOTION("{task.TipGoal.budget}", "TIME")] = None


def _print_postures(postures: Sequence[ReachedPosture]) -> None:
    headings = (
        "rank",
        "clearance [m]",
        "from limits",
        "manipulability",
        "path ratio",
        "score",
        "torque",
        "path",
    )
    rows = [
        (
            str(number),
            posture.clearance,
            posture.limit_distance,
            posture.manipulability,
            posture.path_ratio,
            posture.score,
            "-" if posture.load is None else f"{100.0 * posture.load.share:.3g} % ({posture.load.joint})",
            "-" if posture.path is None else posture.path.blocked_by or "clear",
        )
        for number, posture in enumerate(postures, start=1)
    ]
    print_table(headings, rows)


def _draw(
    arm: Arm, postures: Sequence[ReachedPosture], goal: NDArray[np.float64], scene: Scene | None
) -> Figure:
    """Draw the scene, the goal and all postures, with the best on top."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from pinposture.viz.palette import THEME
    from pinposture.viz.postures import PosturePanel

    figure = Figure(figsize=(9.0, 8.0))
    planar = arm.dimension == 2
    if planar:
        ax = figure.add_subplot()
    else:  # as large as the figure, since the scales of a space do not fill its axes
        ax = figure.add_axes((0.0, 0.0, 1.0, 0.9), projection="3d", computed_zorder=False)
    panel = PosturePanel(arm, ax)
    colors = mpl.colormaps["viridis"]
    for rank in reversed(range(len(postures))):
        color = mpl.colors.to_hex(colors(0.85 * rank / max(len(postures) - 1, 1)))
        panel.posture(postures[rank].q, color, f"posture {rank + 1}", width=3.0 if rank == 0 else 1.6)
    style: dict[str, Any] = {"ls": "none", "marker": "*", "ms": 14, "mec": "white", "zorder": 7}
    panel.line(goal[None, :3], label="goal of the tip", color=THEME.mark, **style)
    panel.finish(scene)
    figure.legend(loc="upper left", fontsize=9, frameon=False, ncols=2)
    return figure
