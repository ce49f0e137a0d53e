"""Command line arguments of the verbs: arms, curves, starts, limits, controllers, scenes."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from pinposture.cli.output import FILES, print_note
from pinposture.errors import FileError, InvalidValue, UnknownName
from pinposture.storage import decode_xml, parse_json, read_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.control import Controller, ControlTask, Limits
    from pinposture.curve import Curve
    from pinposture.placement import Target

STARTS = ("straight", "smooth", "random")


@dataclass(frozen=True)
class Panel:
    """A heading of the help; call it to create an option listed below the heading.

    Attributes:
        heading: the heading.
    """

    heading: str

    def __call__(self, help: str, metavar: str | None = None, flags: str = "", **bounds: float) -> Any:
        """Return an option for `Annotated`.

        Args:
            help: its help text.
            metavar: placeholder for its value in the help; None: the type.
            flags: its names, separated by blanks; by default that of the parameter.
            bounds: the smallest (`min`) and largest (`max`) number allowed, if any.
        """
        panel: dict[str, Any] = {"rich_help_panel": self.heading, **bounds}
        return typer.Option(*flags.split(), metavar=metavar, help=help, **panel)


ARM, TARGET, MOTION, OUTPUT = map(Panel, ("The arm", "The target", "The motion", "The output"))
LIMITS, TIP, SURROUNDINGS = map(Panel, ("The limits", "The tip", "The surroundings"))

UrdfArgument = Annotated[
    str,
    typer.Argument(
        metavar="URDF",
        help="URDF, xacro or MJCF file of the arm, a name of robot_descriptions, or - for stdin.",
    ),
]


RunArgument = Annotated[
    Path,
    typer.Argument(
        metavar="RUN", help=f"A saved run or motion, or the directory of its {FILES.motion} or {FILES.run}."
    ),
]


@dataclass(frozen=True)
class ArmOptions:
    """The part of a description that is the arm, and its division into modules."""

    base: Annotated[str | None, ARM("{arm.ArmSpec.base}", "LINK")] = None
    tip: Annotated[str | None, ARM("{arm.ArmSpec.tip}", "LINK")] = None
    split: Annotated[str | None, ARM("{arm.ArmSpec.split}", "N,...")] = None
    locked: Annotated[
        list[str] | None, ARM("{arm.ArmSpec.locked} elbow=0.5, elbow=30deg. May be repeated.", "NAME=VALUE")
    ] = None
    couple: Annotated[
        list[str] | None,
        ARM(
            "{arm.ArmSpec.couplings} j3=j1, j4=j2,-0.5,5deg. May be repeated.",
            "NAME=LEADER[,RATIO[,OFFSET]]",
        ),
    ] = None
    package_dir: Annotated[list[Path] | None, ARM("{arm.ArmSpec.package_dirs} May be repeated.", "DIR")] = (
        None
    )
    xacro_arg: Annotated[
        list[str] | None, ARM("{arm.ArmSpec.xacro_args} pitch:=0.2. May be repeated.", "NAME:=VALUE")
    ] = None
    hard_limits: Annotated[bool, ARM("{arm.ArmSpec.hard_limits}", flags="--hard-limits")] = False
    effort: Annotated[str | None, ARM("{arm.weight.Weight.effort}", "TORQUE")] = None
    stiffness: Annotated[str | None, ARM("{arm.weight.Weight.stiffness}", "STIFFNESS")] = None
    payload: Annotated[
        list[str] | None,
        ARM(
            "Mass that the arm carries, in kg or with a unit, at its tip or at the origin of a link: 0.5, "
            "m04_l2=80g. May be repeated.",
            "[LINK=]MASS",
        ),
    ] = None
    density: Annotated[
        str | None,
        ARM("Density of the shapes of links to which the description gives no mass, in kg/m3.", "DENSITY"),
    ] = None

    def read(self, urdf: str) -> Arm:
        """Load an arm as `Arm.load` does; "-" reads the URDF from stdin.

        Raises:
            PostureError: as in `Arm.load` and `ArmSpec`; a template name; an empty field in `split`.
        """
        from pinposture.arm import TEMPLATES, Arm, ArmSpec
        from pinposture.schema import read_field

        if not urdf:
            raise InvalidValue("URDF", urdf, "a file, a name of robot_descriptions, or - for stdin")
        for folder in self.package_dir or ():
            if not folder.is_dir():
                raise InvalidValue("--package-dir", str(folder), "a folder that exists")
        source: str | Path = Path(urdf)
        if urdf in TEMPLATES and not Path(urdf).exists():
            advice = f"create an arm from the template: pinposture generate {urdf} --modules 20 -o arm.urdf"
            raise FileError(urdf, f"no such file; {advice}")
        if urdf == "-":
            source = "" if sys.stdin is None else decode_xml(sys.stdin.buffer.read(), "stdin")
            if not source.lstrip("\ufeff \t\r\n").startswith("<"):
                raise FileError("stdin", "contains no URDF; allowed: XML text, which starts with '<'")
        allowed = "NAME=LEADER, NAME=LEADER,RATIO or NAME=LEADER,RATIO,OFFSET, each name once"
        locked = {name: as_data(text) for name, text in read_pairs("--locked", self.locked).items()}
        couplings = {
            name: [leader.strip(), *map(as_data, numbers)]  # a joint may be called by a number
            for name, text in read_pairs("--couple", self.couple, allowed).items()
            for leader, *numbers in [text.split(",")]
        }
        arm = Arm.load(
            source,
            base=self.base,
            tip=self.tip,
            split=None if self.split is None else read_split(self.split),
            locked=read_field(ArmSpec, "locked", locked),
            package_dirs=self.package_dir,
            couplings=read_field(ArmSpec, "couplings", couplings),
            xacro_args=read_pairs("--xacro-arg", self.xacro_arg, "NAME:=VALUE, each name once", ":="),
            hard_limits=self.hard_limits,
        )
        return self._weighed(arm)

    def _weighed(self, arm: Arm) -> Arm:
        """Return an arm with the weight of the options."""
        from pinposture.arm.weight import Mass
        from pinposture.collision import weigh
        from pinposture.schema import PositiveNumber

        if self.density is not None:
            arm = weigh(arm, read_option("--density", self.density, PositiveNumber))
        for text in self.payload or ():
            frame, sign, mass = text.rpartition("=")
            arm = arm.with_payload(
                read_option("--payload", mass, Mass), frame=frame.strip() if sign else None
            )
        if self.stiffness is not None:
            arm = arm.with_stiffness(as_data(self.stiffness))
        return arm if self.effort is None else arm.with_effort(as_data(self.effort))

    def refuse(self, allowed: str) -> None:
        """Raise InvalidValue for any given option if the arm is defined elsewhere."""
        refuse_given({f"--{name.replace('_', '-')}": value for name, value in vars(self).items()}, allowed)


DegreesOption = Annotated[
    bool,
    MOTION("Given positions of revolute joints are in degrees rather than rad.", flags="--degrees"),
]

JsonOption = Annotated[bool, OUTPUT("Print one JSON object on stdout instead.", flags="--json")]
ViewOption = Annotated[bool, OUTPUT("Show the motion in the browser at the end.", flags="--view")]

NoBrowserOption = Annotated[
    bool, typer.Option("--no-browser", help="Print the address, but do not open a browser.")
]

MOST_JOBS = 1000
MOST_RUNS = 1_000_000
"""Largest numbers of processes, and of runs of a batch or study."""

JobsOption = Annotated[int, MOTION("Number of processes; -1 for all cores.", "N", max=MOST_JOBS)]


def refuse_given(options: Mapping[str, object], allowed: str) -> None:
    """Raise InvalidValue for a given option that is incompatible with another argument."""
    for name, value in options.items():
        if value is not None and value is not False and value != []:
            raise InvalidValue(name, value if isinstance(value, str) else f"{value}", allowed)


def read_pairs(
    option: str, texts: list[str] | None, allowed: str = "NAME=VALUE, each name once", separator: str = "="
) -> dict[str, str]:
    """Return the values of a repeated option by name; raise InvalidValue for other text, or a name twice."""
    pairs: dict[str, str] = {}
    for text in texts or ():
        name, sign, value = (part.strip() for part in text.partition(separator))
        if not name or not sign or (separator == "=" and not value) or name in pairs:
            raise InvalidValue(option, text, allowed)
        pairs[name] = value
    return pairs


def read_changes(texts: list[str] | None) -> dict[str, object]:
    """Return values by key of a task file; raise InvalidValue unless KEY=VALUE, each once."""
    from pinposture.storage import parse_toml

    changes: dict[str, object] = {}
    allowed = "KEY=VALUE, such as limits.velocity=2, each key once"
    for key, value in read_pairs("--set", texts, allowed).items():
        try:
            changes[key] = parse_toml(f"value = {value}")["value"]
        except ValueError:  # text without quotes, such as 20 ms
            changes[key] = value
    return changes


@dataclass(frozen=True)
class ChangeOptions:
    """Values of what has no option of its own."""

    changes: Annotated[
        list[str] | None,
        MOTION(
            "Value of a field that has no option of its own, with a unit or without: limits.effort=true, "
            "scene.margin=5mm, arm.weight.gravity=[0,0,-3.7]. May be repeated.",
            "KEY=VALUE",
            flags="--set",
        ),
    ] = None

    def check(self, *parts: str) -> None:
        """Raise an error for a key that is not of these parts, or text that is not KEY=VALUE."""
        for key in read_changes(self.changes):
            part, dot, _ = key.partition(".")
            if part not in parts or not dot:
                raise UnknownName("key for --set", key, [f"{field}.FIELD" for field in parts])

    def apply(self, part: str, to: Any, arm: Arm | None = None) -> Any:
        """Return a part with the values that are set of it.

        Args:
            part: "arm", "limits" or "scene".
            to: the part.
            arm: the arm to which it belongs, if it is known.

        Raises:
            UnknownName: a field that there is not.
            InvalidValue: a value that is refused.
        """
        from pinposture.arm import Arm
        from pinposture.schema import with_value

        changed: Any = to.spec if isinstance(to, Arm) else to
        key_paths = [key.split(".") for key in read_changes(self.changes)]
        for (first, *rest), value in zip(key_paths, read_changes(self.changes).values(), strict=True):
            if first == part:
                changed = with_value(changed, rest, value, f"--set {part}", arm)
        if not any(first == part for first, *_ in key_paths):
            return to
        return Arm.from_spec(changed) if isinstance(to, Arm) else changed


def read_curve(name: str, arm: Arm, scale: float = 1.0) -> Curve:
    """Return the preset of a name, scaled to an arm, or the curve in a file, with a scale factor.

    Presets are those of the thesis on an arm of 1 m with 20 modules. A module of an arm with fewer modules
    covers a larger share of the arm, so the helix is wider for it, and bends by the same angle per module.

    Raises:
        UnknownName: neither a preset nor a file.
        FileError: a file without a curve.
        InvalidValue: an invalid scale factor, or one for a preset.
    """
    from pinposture._validation import require_known
    from pinposture.curve import CURVES, Curve

    if Path(name).suffix:  # as all curve files have
        return Curve.load(name, scale)
    require_known("curve preset or file", name, CURVES)
    if scale != 1.0:
        raise InvalidValue("--scale", scale, "only with a file; presets are scaled to the arm")
    preset = CURVES[name]
    wider = max(1.0, 20 / arm.n_modules) if name == "helix" else 1.0  # it is made for 20 modules
    return Curve(preset.knots, arm.length * wider * preset.coefficients, preset.degree)


class Start(NamedTuple):
    """The configuration at which a motion starts.

    Attributes:
        q: the configuration, (nq,).
        words: how it was chosen.
    """

    q: NDArray[np.float64]
    words: str


@dataclass(frozen=True)
class StartOptions:
    """The start of a motion."""

    start: Annotated[
        str,
        MOTION(
            "straight, smooth or random, a .npy, .csv or .json file of joint positions, or 0.1,0.2,...",
            "START",
        ),
    ] = "smooth"
    degrees: DegreesOption = False
    seed: Annotated[int, MOTION("Seed of a smooth or random start.")] = 0

    def read(self, arm: Arm, scene: Scene) -> Start:
        """Return the start.

        A smooth or random posture that is not clear of the scene is bent less, until it is.

        Args:
            arm: the arm.
            scene: what a smooth or random start must be clear of, if possible.

        Raises:
            UnknownName: neither one of `STARTS`, nor numbers, nor a file of numbers.
            FileError: a file without numbers.
            InvalidValue: numbers of the wrong count, not finite, or far outside the limits of the arm; a seed
                below 0; or degrees for a start without numbers.
        """
        import numpy as np

        from pinposture.arm import smooth_configuration

        text = self.start
        seed = self.seed
        if seed < 0:
            raise InvalidValue("--seed", seed, "a whole number of at least 0")
        if self.degrees and text in STARTS:
            raise InvalidValue("--degrees", self.degrees, f"only with numbers; the start is {text!r}")
        rng = np.random.default_rng(seed)
        if text == "straight":
            return Start(arm.straight(), "the straight arm")
        if text == "random":
            return _bend_until_clear(arm, arm.random(rng), scene, f"a random posture, seed {seed}")
        if text == "smooth":
            # largest joint position [rad or m]
            drawn = smooth_configuration(arm, rng, rng.uniform(0.2, 1.0))
            return _bend_until_clear(arm, drawn, scene, f"a smooth random posture, seed {seed}")
        suffixes = (".npy", ".csv", ".json")
        try:
            listed = Path(text).suffix.lower() in suffixes
            values = _read_file(Path(text)) if listed else read_numbers("start", text)
        except InvalidValue:
            allowed = (*STARTS, *(f"a {suffix} file" for suffix in suffixes), "numbers separated by commas")
            raise UnknownName("start", text, allowed) from None
        return Start(as_configuration(arm, values, "start", self.degrees), f"as given by --start {text}")


def _bend_until_clear(arm: Arm, q: NDArray[np.float64], scene: Scene, words: str) -> Start:
    """Return the first start that is clear of a scene on the way from q to the straight arm; else q."""
    from pinposture.collision import CollisionModel

    model = CollisionModel(arm, scene)
    way = arm.difference(q, arm.straight())
    steps = 40
    for step in range(steps):
        share = step / steps
        start = arm.integrate(q, share * way)
        if model.minimum(start).distance >= scene.margin:
            bent = f", bent only {100.0 * (1.0 - share):.3g} % as much, to be clear" if step else ""
            return Start(start, words + bent)
    return Start(q, words)


def as_configuration(arm: Arm, values: list[float], name: str, degrees: bool) -> NDArray[np.float64]:
    """Convert numbers to a configuration.

    A continuous joint has two entries in a configuration, but a single angle is also accepted.

    Args:
        arm: the arm.
        values: a configuration, (nq,), or joint positions, (nv,) [rad or m].
        name: name of the values in error messages.
        degrees: whether they are joint positions, in degrees for revolute joints.

    Raises:
        InvalidValue: values of the wrong count, not finite, or far outside the limits.
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
    """Parse numbers separated by commas; raise InvalidValue with the given name if invalid."""
    try:
        return [float(field) for field in text.split(",")]
    except ValueError:
        raise InvalidValue(name, text, "numbers separated by commas") from None


def read_split(text: str) -> int | list[int] | list[str]:
    """Parse one or several numbers of joints, or link names; raise InvalidValue for an empty field."""
    fields = [field.strip() for field in text.split(",")]
    if not all(fields):
        raise InvalidValue("--split", text, "whole numbers or names of links, separated by commas")
    try:
        sizes = [int(field) for field in fields]
    except ValueError:
        return fields
    return sizes[0] if len(sizes) == 1 else sizes


def _read_file(path: Path) -> list[float]:
    with numbers_in(path, "list"):
        suffix = path.suffix.lower()
        if suffix == ".npy":
            values = read_array(path)
        elif suffix == ".json":
            values = parse_json(path, read_text(path))
        else:
            values = read_text(path).replace(",", " ").split()
        if not isinstance(values, list):
            raise ValueError("not a list")
        if not values:
            raise ValueError("it is empty")
        return [float(value) for value in values]


@contextmanager
def numbers_in(path: Path, kind: str) -> Iterator[None]:
    """Convert exceptions while reading a list or table of numbers into a `FileError`."""
    try:
        yield
    except FileError:
        raise
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except (ValueError, TypeError, EOFError, RecursionError, csv.Error) as error:
        raise FileError(path, f"is not a {kind} of numbers ({error})") from error


def read_array(path: Path) -> Any:
    """Read the array in a .npy file, as lists; raise ValueError if it holds none of numbers."""
    import numpy as np

    try:
        values = np.load(path, allow_pickle=False)
    except ValueError:  # which advises to unpickle it
        raise ValueError("it holds no array of plain numbers") from None
    return values.tolist() if isinstance(values, np.ndarray) else values


def read_region(name: str, text: str, arm: Arm) -> tuple[int, int]:
    """Return the 0-based indices of the first and last control points of a 1-based region "first-last".

    Raises:
        InvalidValue: invalid text, or numbers out of order or out of range.
    """
    first, hyphen, last = text.partition("-")
    if hyphen and first.strip().isdecimal() and last.strip().isdecimal():
        begin = int(first) - 1
        end = int(last) - 1
        if 0 <= begin <= end < arm.n_modules:
            return begin, end
    allowed = f"two numbers of control points from 1 to {arm.n_modules}, in order, as in 1-{arm.n_modules}"
    raise InvalidValue(name, text, allowed)


def read_points(name: str, text: str, arm: Arm) -> tuple[int, ...]:
    """Return the 0-based indices of control points from 1-based numbers separated by commas, or "all".

    Raises:
        InvalidValue: invalid text, or a number that is repeated or out of range.
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


def read_declared(kind: Any, values: Mapping[str, object], arm: Arm | None = None) -> Any:
    """Return what a declared class makes of options: numbers or text with units, alone or with commas.

    Args:
        kind: the class.
        values: by argument; None: not given.
        arm: the arm to which they belong, if any.

    Raises:
        PostureError: the first value that is refused; names the argument.
    """
    from pinposture.schema import read_call

    values = {
        name: as_data(value) if isinstance(value, str) else value
        for name, value in values.items()
        if value is not None
    }
    return read_call(kind, values, arm)


def read_option(option: str, text: str | None, kind: Any) -> Any:
    """Return the value of an option, a number or text with a unit, read as a kind; None if not given."""
    from pinposture.schema import read_plain

    return None if text is None else read_plain(kind, as_data(text), option)


def as_data(text: str) -> Any:
    """Return a number, other text, or a list of both if there are commas, as a file contains it."""
    values: list[float | str] = []
    for field in text.split(","):
        try:
            values.append(float(field))
        except ValueError:
            values.append(field.strip())
    return values[0] if len(values) == 1 else values


@dataclass(frozen=True)
class LimitOptions:
    """The limits of a step, as of `Limits`."""

    step_limit: Annotated[str | None, LIMITS("{control.Limits.step}", "STEP,...")] = None
    velocity: Annotated[str | None, LIMITS("{control.Limits.velocity}", "V,...")] = None
    acceleration: Annotated[str | None, LIMITS("{control.Limits.acceleration}", "A,...")] = None
    jerk: Annotated[str | None, LIMITS("{control.Limits.jerk}", "J,...")] = None
    dt: Annotated[str | None, LIMITS("{control.Limits.dt}", "TIME")] = None
    position_margin: Annotated[str | None, LIMITS("{control.Limits.position_margin}", "MARGIN")] = None

    def read(self, arm: Arm) -> Limits:
        """Return the limits of these options for an arm.

        Raises:
            InvalidValue: an invalid value, one that does not fit the arm, or a missing `dt`.
        """
        from pinposture.control import Limits

        others = {name: text for name, text in vars(self).items() if name != "step_limit"}
        limits: Limits = read_declared(Limits, {"step": self.step_limit, **others}, arm)
        return limits


ControllerOption = Annotated[
    str,
    MOTION(
        "Controller: {controllers}, or package.module:Class. Only geodesic plans and avoids obstacles.",
        "NAME",
    ),
]


@dataclass(frozen=True)
class ControllerOptions:
    """The controller."""

    controller: ControllerOption = "geodesic"
    joint_weight: Annotated[
        float | None,
        MOTION(
            "How far control points may deviate to shorten joint motions, in module lengths per rad; "
            "default: 0.2. Large values approach joint interpolation. Only with geodesic."
        ),
    ] = None

    def check(self, **only_geodesic: object) -> None:
        """Raise an error for an unknown controller, or options that it does not support.

        Args:
            only_geodesic: values of further options that only geodesic supports; None or False if not given.

        Raises:
            UnknownName: an unknown controller.
            InvalidValue: an option of geodesic is given for another controller.
        """
        from pinposture.control import controller_named

        controller_named(self.controller)
        told = {"joint_weight": self.joint_weight, **only_geodesic}
        options = [
            f"--{name.replace('_', '-')}" for name, value in told.items() if value not in (None, False)
        ]
        if options and self.controller != "geodesic":
            allowed = f"'geodesic', which alone supports {', '.join(options)}"
            raise InvalidValue("--controller", self.controller, allowed)

    def build(self, task: ControlTask | None = None) -> Controller:
        """Return the controller; geodesic gets its joint_weight and a task in addition to the shape.

        Raises:
            UnknownName: an unknown controller.
            InvalidValue: joint_weight is not a positive number.
        """
        from pinposture.control import Geodesic, controller_named

        chosen = controller_named(self.controller)
        if not isinstance(chosen, Geodesic):
            return chosen
        weight = chosen.joint_weight if self.joint_weight is None else self.joint_weight
        return replace(chosen, joint_weight=weight, tasks=() if task is None else (task,))


CURVE_HELP = (
    "A .json, .csv or .txt file, or a preset, scaled to the arm: {curves}. The line has 1.1 arm lengths; the "
    "helix turns 2.5 times along the arm, with fewer than 20 modules once for every 8."
)
CurveOption = Annotated[str, TARGET(CURVE_HELP, "CURVE")]
ScaleOption = Annotated[
    float, TARGET("Scale factor of a curve file, such as 0.001 for millimetres.", "FACTOR")
]


@dataclass(frozen=True)
class PlacementOptions:
    """The scale and placement of a curve, and the control points that follow it."""

    scale: ScaleOption = 1.0
    placement: Annotated[str | None, TARGET("{task.Keyframe.placement}", "NAME")] = None
    roll: Annotated[str | None, TARGET("{task.Keyframe.roll}", "ANGLE")] = None
    method: Annotated[str | None, TARGET("{task.Keyframe.method}", "NAME")] = None
    partial: Annotated[
        bool, TARGET("Leave points free that have no place on the curve.", flags="--partial")
    ] = False
    region: Annotated[
        str | None,
        TARGET("Control points that take the shape, such as 10-20; the others are free.", "FIRST-LAST"),
    ] = None

    def place(self, arm: Arm, curve: str, scene: Scene | None) -> Target:
        """Place the control points on a curve; print a note if some have no place.

        Raises:
            PostureError: as in `read_curve`, `resolve_targets` and `read_region`.
            InvalidValue: a curve on which not even the first module has a place.
        """
        from pinposture.curve import CURVES
        from pinposture.placement import resolve_targets
        from pinposture.task.keyframe import Keyframe, usual_placement

        form = read_curve(curve, arm, self.scale)
        placement = self.placement
        if placement is None:
            placement = "align" if curve in CURVES else usual_placement(scene, form)
        options = {"placement": placement, "roll": self.roll, "method": self.method}
        posture: Keyframe = read_declared(Keyframe, {"curve": form, **options})
        target = resolve_targets(
            arm,
            form,
            placement=posture.placement or "align",
            roll=posture.roll,
            incomplete="partial" if self.partial else "raise",
            method=posture.method,
        )
        count = target.has_target.sum()
        if not count:
            raise InvalidValue(
                "--curve", curve, f"one with a place for the first module: {target.incomplete}"
            )
        if target.incomplete:
            print_note(f"only the first {count} of {arm.n_modules} control points have a place")
        return target if self.region is None else target.region(*read_region("--region", self.region, arm))


SceneOption = Annotated[
    Path | None, SURROUNDINGS("A .toml or .json file of obstacles.", "FILE", flags="--scene")
]


@dataclass(frozen=True)
class SceneOptions:
    """What the arm must keep clear of."""

    scene: SceneOption = None
    self_collision: Annotated[
        bool | None,
        SURROUNDINGS(
            "Whether the arm must keep clear of itself. Default: as in the scene file, else yes.",
            flags="--self-collision/--no-self-collision",
        ),
    ] = None

    def read(self, arm: Arm) -> Scene:
        """Return the scene of the file, or that of the arm alone, with self-collision as requested."""
        from pinposture.collision import Scene
        from pinposture.collision.model import arm_alone

        scene = arm_alone(arm) if self.scene is None else Scene.load(self.scene)
        return scene if self.self_collision is None else replace(scene, self_collision=self.self_collision)


@dataclass(frozen=True, kw_only=True)
class TrackOptions:
    """How an arm is driven to the shape of a curve, in `track` and `batch`."""

    placement_options: PlacementOptions
    controller_options: ControllerOptions
    steps: Annotated[
        int | None,
        MOTION(
            "Number of steps after which a run stops. Default: 300; with --dt, if that is more, ten times "
            "those of the straight path in joint space.",
            "N",
        ),
    ] = None
    tolerance: Annotated[
        str | None,
        MOTION("Mean point error that counts as arrived, in metres; default: 1e-6 of the length.", "LENGTH"),
    ] = None
    limit_options: LimitOptions
    scene_options: SceneOptions
    change_options: ChangeOptions
