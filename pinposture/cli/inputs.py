"""What verbs read from the command line: arms, curves, starts, limits, controllers, scenes."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from pinposture.cli.output import print_note
from pinposture.errors import FileError, InvalidValue, UnknownName

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.control import Controller, ControlTask, Limits
    from pinposture.curve import Curve
    from pinposture.placement import Target

STARTS = ("straight", "smooth", "random")
AMPLITUDES = (0.2, 1.0)
"""Range of the largest joint position of a smooth start [rad or m]."""


@dataclass(frozen=True)
class Panel:
    """A heading of the help; call it to make an option that is listed below it.

    Attributes:
        heading: the heading.
    """

    heading: str

    def __call__(self, help: str, metavar: str | None = None, flags: str = "") -> Any:
        """An option, for `Annotated`.

        Args:
            help: what the help says of it.
            metavar: what the help writes for its value; None for the type.
            flags: its names, separated by blanks; else that of the parameter.
        """
        return typer.Option(*flags.split(), metavar=metavar, help=help, rich_help_panel=self.heading)


ARM, TARGET, MOTION, OUTPUT = map(Panel, ("The arm", "The target", "The motion", "The output"))
LIMITS, TIP, SURROUNDINGS = map(Panel, ("The limits", "The tip", "The surroundings"))

UrdfArgument = Annotated[
    str,
    typer.Argument(
        metavar="URDF",
        help="URDF, xacro or MJCF file of the arm, a name of robot_descriptions, or - for stdin.",
    ),
]


@dataclass(frozen=True)
class ArmOptions:
    """Which part of a description is the arm, and how it is cut into modules."""

    base: Annotated[str | None, ARM("Link at which the arm begins; needs --tip.", "LINK")] = None
    tip: Annotated[str | None, ARM("Link at which it ends, if not the end of the longest chain.", "LINK")] = (
        None
    )
    modules: Annotated[
        str | None,
        ARM(
            "Joints per module, one number for all or one for each, or links at whose origins modules "
            "end: m01_l2,m02_l2; else as few joints as can follow a curve.",
            "N,...",
        ),
    ] = None
    locked: Annotated[
        list[str] | None,
        ARM(
            "Hold a joint still, at a position in rad or metres, or with a unit: elbow=0.5, "
            "elbow=30deg. May be repeated.",
            "NAME=VALUE",
        ),
    ] = None
    couple: Annotated[
        list[str] | None,
        ARM(
            "Let a joint follow another, as <mimic> does: j3=j1, j4=j2,-0.5,5deg. May be repeated.",
            "NAME=LEADER[,RATIO[,OFFSET]]",
        ),
    ] = None
    package_dir: Annotated[
        list[Path] | None,
        ARM("Folder to look for meshes in: a package, or one that holds packages. May be repeated.", "DIR"),
    ] = None

    def read(self, urdf: str) -> Arm:
        """Load an arm as `Arm.load` does; "-" reads the URDF from stdin.

        Raises:
            PostureError: as `Arm.load` and `read_locked`; the name of a template; or nothing between two
                of the commas of `modules`.
        """
        from pinposture.arm import TEMPLATES, Arm

        source: str | Path = Path(urdf)
        if urdf in TEMPLATES and not Path(urdf).exists():
            advice = f"make an arm of the template first: pinposture generate {urdf} --modules 20 -o arm.urdf"
            raise FileError(urdf, f"no such file; {advice}")
        if urdf == "-":
            source = sys.stdin.read()
            if not source.lstrip("\ufeff \t\r\n").startswith("<"):
                raise FileError("stdin", "holds no URDF; allowed: XML text, which begins with '<'")
        sizes = None if self.modules is None else read_modules(self.modules)
        held, couplings = read_locked(self.locked), read_couplings(self.couple)
        return Arm.load(source, self.base, self.tip, sizes, held, self.package_dir, couplings=couplings)

    def refuse(self, allowed: str) -> None:
        """Raise InvalidValue if one was given where something else says what the arm is."""
        refuse_given({f"--{name.replace('_', '-')}": value for name, value in vars(self).items()}, allowed)


DegreesOption = Annotated[
    bool,
    MOTION(
        "Joint positions that are given are in degrees, where joints turn; else in rad.", flags="--degrees"
    ),
]

JsonOption = Annotated[bool, OUTPUT("Print one JSON object on stdout instead.", flags="--json")]
ViewOption = Annotated[bool, OUTPUT("Show the motion in the browser at last.", flags="--view")]

NoBrowserOption = Annotated[
    bool, typer.Option("--no-browser", help="Print the address, but open no browser.")
]

ToleranceOption = Annotated[
    float | None, MOTION("Mean point error at which the arm is there, in metres; else 1e-6 of its length.")
]

JobsOption = Annotated[int, MOTION("Number of processes; -1 for all there can be.", "N")]


def refuse_given(options: Mapping[str, object], allowed: str) -> None:
    """Raise InvalidValue for an option that was given and does not go with another argument."""
    for name, value in options.items():
        if value is not None and value != []:
            raise InvalidValue(name, value if isinstance(value, str) else f"{value}", allowed)


def read_locked(given: list[str] | None) -> dict[str, float]:
    """The joints held still, and where [rad or m]; raises InvalidValue unless NAME=VALUE, each once."""
    locked: dict[str, float] = {}
    for text in given or ():
        name, _, value = (part.strip() for part in text.rpartition("="))
        if not name:
            raise InvalidValue("--locked", text, "NAME=VALUE, such as elbow=0.5 or elbow=30deg")
        if name in locked:
            raise InvalidValue("--locked", text, f"one position of joint {name!r}")
        try:
            locked[name] = _read_position(value)
        except ValueError as error:
            raise InvalidValue("--locked", text, f"NAME=VALUE; the value {error}") from None
    return locked


def _read_position(text: str) -> float:
    """A joint position in rad or metres, or with a unit; raises ValueError for anything else."""
    from pinposture.task.specification import read_quantity

    numbers = _parsed(text)
    return read_quantity(text if numbers is None else numbers[0], "angle", "length")


def read_couplings(given: list[str] | None) -> dict[str, tuple[str, float, float]]:
    """What coupled joints follow: leader, ratio, offset [rad or m]; raises InvalidValue, as for one twice."""
    couplings: dict[str, tuple[str, float, float]] = {}
    for text in given or ():
        name, _, value = (part.strip() for part in text.partition("="))
        leader, *numbers = (part.strip() for part in value.split(","))
        if not name or not leader or len(numbers) > 2 or name in couplings:
            allowed = "NAME=LEADER, NAME=LEADER,RATIO or NAME=LEADER,RATIO,OFFSET, once for each joint"
            raise InvalidValue("--couple", text, allowed)
        try:
            ratio = float(numbers[0]) if numbers else 1.0
            offset = _read_position(numbers[1]) if numbers[1:] else 0.0
        except ValueError as error:
            raise InvalidValue("--couple", text, f"NAME=LEADER,RATIO,OFFSET; a value {error}") from None
        couplings[name] = leader, ratio, offset
    return couplings


def read_curve(name: str) -> Curve:
    """The preset of that name, or the curve in that file.

    Raises:
        UnknownName: neither a preset nor a file.
        FileError: a file that holds no curve.
    """
    from pinposture.curve import CURVES, Curve

    if name in CURVES:
        return CURVES[name]
    if not Path(name).suffix:  # no curve file is without
        raise UnknownName("curve preset or file", name, CURVES)
    return Curve.load(name)


def read_start(arm: Arm, text: str, seed: int, degrees: bool) -> NDArray[np.float64]:
    """The configuration to start from.

    Args:
        arm: the arm.
        text: "straight", "smooth", "random", numbers separated by commas, or the path of a file of numbers.
        seed: what to draw the smooth and the random one from.
        degrees: whether numbers are in degrees, where joints turn.

    Returns:
        Configuration (nq,).

    Raises:
        UnknownName: not one of the names, no numbers, and no file.
        FileError: a file that holds no numbers.
        InvalidValue: as many numbers as the arm cannot use, not finite, or far outside of its limits; a seed
            below 0; degrees that are not numbers.
    """
    import numpy as np

    from pinposture.arm import smooth_configuration

    if seed < 0:
        raise InvalidValue("--seed", seed, "a whole number of at least 0")
    if degrees and text in STARTS:
        raise InvalidValue("--degrees", degrees, f"only where numbers are given; the start is {text!r}")
    rng = np.random.default_rng(seed)
    if text == "straight":
        return arm.straight()
    if text == "random":
        return arm.random(rng)
    if text == "smooth":
        return smooth_configuration(arm, rng, rng.uniform(*AMPLITUDES))
    values = _read_file(Path(text)) if Path(text).suffix.lower() in _READERS else _parsed(text)
    if values is None:
        allowed = (*STARTS, *(f"a {suffix} file" for suffix in _READERS), "numbers separated by commas")
        raise UnknownName("start", text, allowed)
    return as_configuration(arm, values, "start", degrees)


def as_configuration(arm: Arm, values: list[float], name: str, degrees: bool) -> NDArray[np.float64]:
    """The configuration that numbers stand for.

    A continuous joint takes two entries of a configuration, but whoever writes numbers down may think of one
    angle, which is taken as well.

    Args:
        arm: the arm.
        values: a configuration (nq,), or joint positions (nv,) [rad or m].
        name: what to call them in an error.
        degrees: whether they are joint positions in degrees, where joints turn.

    Raises:
        InvalidValue: as many as the arm cannot use, not finite, or far outside of its limits.
    """
    import numpy as np

    if degrees and len(values) != arm.nv:
        raise InvalidValue(f"{name} (numbers)", len(values), f"{arm.nv} with --degrees, one for each joint")
    if degrees:
        values = np.where(arm.slides, values, np.deg2rad(values)).tolist()
    if len(values) == arm.nv != arm.nq:
        arm.check_positions(values, name)
        return arm.configuration(values)
    return arm.checked_start(values, name)


def read_numbers(name: str, text: str) -> list[float]:
    """Numbers separated by commas; raises InvalidValue under that name if they are not."""
    values = _parsed(text)
    if values is None:
        raise InvalidValue(name, text, "numbers separated by commas")
    return values


def read_modules(text: str) -> int | list[int] | list[str]:
    """Joints per module, one number or several, or names of links; raises InvalidValue for an empty field."""
    fields = [field.strip() for field in text.split(",")]
    if not all(fields):
        raise InvalidValue("--modules", text, "whole numbers or names of links, separated by commas")
    try:
        sizes = [int(field) for field in fields]
    except ValueError:
        return fields
    return sizes[0] if len(sizes) == 1 else sizes


def _parsed(text: str) -> list[float] | None:
    try:
        return [float(field) for field in text.split(",")]
    except ValueError:
        return None


def _read_file(path: Path) -> list[float]:
    with numbers_in(path, "list"):
        values = _READERS[path.suffix.lower()](path)
        if not isinstance(values, list):
            raise ValueError("not a list")
        return [float(value) for value in values]


@contextmanager
def numbers_in(path: Path, kind: str) -> Iterator[None]:
    """Turn what goes wrong while a list or a table of numbers is read into a `FileError`."""
    try:
        yield
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except (ValueError, TypeError, EOFError, RecursionError, csv.Error) as error:
        raise FileError(path, f"is not a {kind} of numbers ({error})") from error


def _read_npy(path: Path) -> Any:
    import numpy as np

    values = np.load(path, allow_pickle=False)
    return values.tolist() if isinstance(values, np.ndarray) else values


def _read_csv(path: Path) -> Any:
    return [float(field) for field in path.read_text(encoding="utf-8-sig").replace(",", " ").split()]


def _read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8-sig"))


_READERS = {".npy": _read_npy, ".csv": _read_csv, ".json": _read_json}


# Control points on the command line: their numbers as pictures show them, from 1 at the base to the tip.
def read_region(name: str, text: str, arm: Arm) -> tuple[int, int]:
    """Indices, 0-based, of the first and the last control point of a region "first-last", 1-based.

    Raises:
        InvalidValue: for anything else, or numbers not in order or that no control point has.
    """
    first, hyphen, last = text.partition("-")
    if hyphen and first.strip().isdecimal() and last.strip().isdecimal():
        begin, end = int(first) - 1, int(last) - 1
        if 0 <= begin <= end < arm.n_modules:
            return begin, end
    allowed = f"two numbers of control points from 1 to {arm.n_modules}, in order, as in 1-{arm.n_modules}"
    raise InvalidValue(name, text, allowed)


def read_points(name: str, text: str, arm: Arm) -> tuple[int, ...]:
    """Indices, 0-based, of control points: their numbers, 1-based, separated by commas, or "all".

    Raises:
        InvalidValue: for anything else, or a number given twice or that no control point has.
    """
    if text.strip() == "all":
        return tuple(range(arm.n_modules))
    try:
        points = tuple(int(field) - 1 for field in text.split(","))
    except ValueError:
        points = ()
    valid = all(0 <= point < arm.n_modules for point in points) and len(set(points)) == len(points)
    if not (points and valid):
        allowed = (
            f"numbers of control points from 1 to {arm.n_modules}, each once, separated by commas, or all"
        )
        raise InvalidValue(name, text, allowed)
    return points


# The limits of a step on the command line.
@dataclass(frozen=True)
class LimitOptions:
    """The limits of a step."""

    step_limit: Annotated[
        float, LIMITS("Largest motion of a joint in one step, in rad or metres; inf for none.")
    ] = 0.1
    velocity: Annotated[
        str | None,
        LIMITS(
            "Largest speed of joints, in rad/s or m/s, one number for all or one for each; else the "
            "arm's own. Needs --dt.",
            "V,...",
        ),
    ] = None
    acceleration: Annotated[
        str | None,
        LIMITS(
            "Largest acceleration of joints, in rad/s^2 or m/s^2, one number or one for each; else "
            "there is no such limit. Needs --dt.",
            "A,...",
        ),
    ] = None
    jerk: Annotated[
        str | None,
        LIMITS(
            "Largest jerk of joints, in rad/s^3 or m/s^3, one number or one for each; else there is no "
            "such limit. Needs --acceleration.",
            "J,...",
        ),
    ] = None
    dt: Annotated[float | None, LIMITS("Duration of a step, in s; else speeds are not limited.")] = None
    position_margin: Annotated[
        float, LIMITS("Distance to keep from the limits of joint positions, in rad or metres.")
    ] = 0.0

    def read(self) -> Limits:
        """The limits that these options ask for, as `Limits` takes them.

        Raises:
            InvalidValue: text in place of numbers, a value that `Limits` does not take, or no `dt` where one
                is needed.
        """
        from pinposture.control import Limits

        given = {"--velocity": self.velocity, "--acceleration": self.acceleration, "--jerk": self.jerk}
        for option, text in given.items():
            if self.dt is None and text is not None:
                raise InvalidValue("--dt", None, f"the duration of a step [s], needed with {option}")
        speed, change, jerk = (_for_joints(option, text) for option, text in given.items())
        return Limits(
            step=self.step_limit,
            velocity=speed,
            dt=self.dt,
            position_margin=self.position_margin,
            acceleration=change,
            jerk=jerk,
        )


def _for_joints(option: str, text: str | None) -> float | NDArray[np.float64] | None:
    import numpy as np

    if text is None:
        return None
    values = read_numbers(option, text)
    return values[0] if len(values) == 1 else np.array(values)


# The controller on the command line.
ControllerOption = Annotated[
    str,
    MOTION(
        "What moves the arm: geodesic (directly, within limits, around obstacles); selection or "
        "projection (those of the thesis) or switching (the two by turns); or, to compare with: joint "
        "(interpolation of joints), pinv (pseudo-inverse), task-constraints (points in its null space), "
        "extended or augmented (Jacobians), dls (damped least squares), lm (Levenberg-Marquardt).",
        "NAME",
    ),
]


@dataclass(frozen=True)
class ControllerOptions:
    """What moves the arm."""

    controller: ControllerOption = "geodesic"
    joint_weight: Annotated[
        float | None,
        MOTION(
            "How far control points may go out of their way to spare joints theirs, in module lengths "
            "per rad; else 0.2. Large numbers lead to interpolation of joints. With geodesic only."
        ),
    ] = None

    def check(self, **only_geodesic: object) -> None:
        """Refuse a controller that does not exist, or that does not know what is asked of it.

        Args:
            only_geodesic: options besides the weight that only geodesic knows, and their values; None or
                False if not given.

        Raises:
            UnknownName: there is no such controller.
            InvalidValue: it is not geodesic, and one of the options is given.
        """
        _controller_named(self.controller)
        told = {"joint_weight": self.joint_weight, **only_geodesic}
        given = [f"--{name.replace('_', '-')}" for name, value in told.items() if value not in (None, False)]
        if given and self.controller != "geodesic":
            allowed = f"'geodesic', which alone knows {', '.join(given)}"
            raise InvalidValue("--controller", self.controller, allowed)

    def build(self, task: ControlTask | None = None) -> Controller:
        """The controller of that name; geodesic with its joint_weight and a task besides the shape.

        Raises:
            UnknownName: there is no such controller.
            InvalidValue: a joint_weight that is not a positive number.
        """
        from pinposture.control import Geodesic

        chosen = _controller_named(self.controller)
        if not isinstance(chosen, Geodesic):
            return chosen
        weight = chosen.joint_weight if self.joint_weight is None else self.joint_weight
        return replace(chosen, joint_weight=weight, tasks=() if task is None else (task,))


def _controller_named(name: str) -> Controller:
    """The controller of that name, which may be one of those to compare with."""
    from pinposture.control import controller_named
    from pinposture.study import register_baselines

    register_baselines()
    return controller_named(name)


# The target on the command line: a curve, how it is laid, and which control points are to follow it.
CurveOption = Annotated[
    str, TARGET("A .json, .csv or .txt file, or a preset: line (1.1 m), helix (1.62 m).", "CURVE")
]


@dataclass(frozen=True)
class PlacementOptions:
    """How a curve is laid, and which control points are to follow it."""

    placement: Annotated[
        str | None,
        TARGET(
            "How the curve is laid: as_is, translate (to the base) or align (turned to the arm too); "
            "else as_is among obstacles, and align without.",
            "NAME",
        ),
    ] = None
    roll: Annotated[float, TARGET("Turn of an aligned curve about the axis of the arm, in rad.")] = 0.0
    method: Annotated[
        str,
        TARGET(
            "How modules are placed: sequential (one by one, exactly), smooth (all at once, bending "
            "little), closest (all at once), or auto.",
            "NAME",
        ),
    ] = "auto"
    partial: Annotated[
        bool, TARGET("Leave points free that have no place on the curve.", flags="--partial")
    ] = False
    region: Annotated[
        str | None,
        TARGET("Control points that are to take the shape, as in 10-20; the others are free.", "FIRST-LAST"),
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


# What is around an arm on the command line: scene files, and how far an arm is from what is in them.
SceneOption = Annotated[
    Path | None, SURROUNDINGS("A .toml or .json file of obstacles.", "FILE", flags="--scene")
]


@dataclass(frozen=True)
class SceneOptions:
    """What the arm must keep clear of."""

    scene: SceneOption = None
    self_collision: Annotated[
        bool, SURROUNDINGS("Count the arm itself among what it must keep clear of.", flags="--self-collision")
    ] = False

    @property
    def file(self) -> str | None:
        """The file, for a summary."""
        return None if self.scene is None else str(self.scene)

    def read(self) -> Scene | None:
        """The scene of the file, with self-collision if asked for; None if there is neither."""
        from pinposture.collision import Scene

        scene = None if self.scene is None else Scene.load(self.scene)
        if not self.self_collision:
            return scene
        return Scene(self_collision=True) if scene is None else replace(scene, self_collision=True)
