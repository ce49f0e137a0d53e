"""Task files: the arm, joints, controller and files in them, and descriptions of parts that still hold."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo

from pinposture._validation import finite_vector
from pinposture.arm import Arm, ArmSpec
from pinposture.arm.loading import description_text
from pinposture.arm.specification import MOST_MODULES_IN_FILE
from pinposture.arm.urdf import load_text
from pinposture.collision import Scene
from pinposture.control import CONTROLLERS, Controller, EndEffector, Geodesic, controller_named
from pinposture.curve import Curve
from pinposture.document import Document, plain_data
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName, warn_caller
from pinposture.schema import (
    InputFile,
    NotAllowed,
    Number,
    Refusal,
    in_file,
    is_file_name,
    is_list_of,
    read_again,
    read_by,
    read_keys,
    read_quantities,
    read_within,
    read_word,
    refusing,
    shown,
)
from pinposture.storage import RESULT_FORMATS, check_writable, relative, settled
from pinposture.toml import TomlLayout, drop_defaults, toml_text

Array = NDArray[np.float64]

# Descriptions of parts of a task, as far as they are still valid.


class Descriptions:
    """The file to be written, and the descriptions of parts of a task in it.

    Attributes:
        file: the file.
        folder: its folder, to which paths are relative.
        arm: the arm of the task.
        scene: its scene.
        just_read: whether the descriptions come from this file, and need no test.
    """

    embeds = False

    def __init__(self, file: Path, task: Any, just_read: bool = False) -> None:
        self.file = file
        self.folder = file.parent
        self.arm = task.arm
        self.scene = task.scene
        self.just_read = just_read
        self._described: Mapping[Hashable, object] = task.described

    def find(self, part: Hashable, kind: Any) -> Any:
        """Return the known description of a part if it still describes that part; otherwise None.

        Args:
            part: the part.
            kind: what a description is read as.
        """
        if part not in self._described:
            return None
        plain = plain_data(self._described[part], self.folder)

        def gives_part() -> bool:
            document = Document(self.file, {"part": plain})
            document.arm = self.arm
            return bool(document.read(kind, ("part",)) == part)

        named = {Curve: "curve", EndEffector: "tip", Scene: "scene"}
        return plain if self.still_holds(named.get(type(part), "obstacle"), plain, gives_part) else None

    def still_holds(self, key: str, plain: object, test: Callable[[], bool]) -> bool:
        """Test a description; warn if it is no longer valid."""
        if self.just_read:
            return True
        reason = "which has changed since"
        try:
            if test():
                return True
        except PostureError as error:
            reason = f"but {getattr(error, 'reason', error)}"
        warn_caller(f"{self.file}: {key} was {shown(plain)}, {reason}; it is written out")
        return False


# The arm: its specification, with a URDF file next to the task if necessary.


def read_arm(document: Document) -> Arm:
    """Return the arm of a task file: a URDF file, or modules of a template, possibly on a feed."""
    spec = document.read(ArmSpec, ("arm",))
    try:
        return Arm.from_spec(spec)
    except PostureError as error:
        table = document.at(("arm",))
        key = _key_of(error, table)
        reason = str(error)
        if isinstance(error, InvalidValue) and key in table:
            value = error.value if key == "split" else table[key]
            reason = f"is {shown(value)}; allowed: {error.allowed}"
        raise document.fault(("arm", key) if key else ("arm",), reason) from error


def _key_of(error: PostureError, table: Mapping[str, Any]) -> str:
    """Return the key to which an error of `Arm.from_spec` refers; empty for the whole table."""
    if isinstance(error, InvalidValue):
        key = "split" if error.name.startswith("split") else error.name
        if key in table:
            return key
    if isinstance(error, UnknownName):
        for key in ("base", "tip", "split", "locked", "couplings", "xacro_args"):
            value = table.get(key)
            if error.name == value or (isinstance(value, list | dict) and error.name in value):
                return key
    return "urdf" if "urdf" in table else ""


def write_arm(arm: Arm, descriptions: Descriptions) -> tuple[ArmSpec, Path | None]:
    """Describe an arm by its specification.

    Returns:
        The specification, and the URDF file to write next to the task, if any.

    Raises:
        FileError: the arm was made from a Pinocchio model, or its URDF file would overwrite another.
    """
    spec = arm.spec
    if spec is None or arm.urdf is None or arm.report is None:
        reason = "it was made from a Pinocchio model and has no URDF; load it with Arm.load"
        raise FileError(descriptions.file, f"arm: no file can describe it: {reason}")
    if spec.template is not None and spec.modules is not None and spec.modules > MOST_MODULES_IN_FILE:
        spec = ArmSpec(
            urdf=arm.urdf,
            split=arm.report.segmentation.sizes,
            placement=spec.placement,
            characteristic_length=spec.characteristic_length,
            weight=spec.weight,
        )
    source = spec.urdf
    folders = spec.package_dirs
    arguments = spec.xacro_args
    if source is None:
        return spec, None
    if isinstance(source, Path):
        name = relative(source, descriptions.folder)

        def gives_arm() -> bool:
            return description_text(source, folders, arguments) == arm.urdf

        if descriptions.still_holds("arm", name, gives_arm):
            return spec, None
    file = settled(descriptions.file.with_suffix(".urdf"))
    searched = [Path(folder) for folder in arm.report.package_dirs if settled(folder) != file.parent]
    spec = replace(spec, urdf=file, package_dirs=tuple(searched), xacro_args={})
    if not file.exists():
        return spec, file
    if load_text(file)[0] != arm.urdf:
        reason = "exists already, and differs from the arm of the task"
        raise FileError(file, f"{reason}; save the task under another name")
    return spec, None


# Joint positions and the start.


def joint_count_misfit(arm: Arm, count: int) -> str:
    """Return the message on a wrong number of joint positions."""
    unit = "rad, m for joints that slide" if np.any(arm.slides) else "rad"
    return f"has {count} value{'s' * (count != 1)}; needed: {arm.nv}, one for each joint [{unit}]"


def read_joints(value: object, arm: Arm) -> tuple[float, ...]:
    """Read the positions of the joints of an arm."""
    if isinstance(value, list) and len(value) != arm.nv:
        raise Refusal(joint_count_misfit(arm, len(value)))
    return read_quantities(value, ["length" if slides else "angle" for slides in arm.slides])


def _read_joints_of_any_arm(value: Any, info: ValidationInfo) -> tuple[float, ...]:
    """Read joint positions; with a curve they may be those of another arm, and are then ignored later."""
    source = in_file(info)
    if source is None:
        with refusing():
            return tuple(finite_vector("joints", value, np.size(value)).tolist())
    arm = source.arm
    if info.data.get("curve") is None or not isinstance(value, list) or len(value) in (0, arm.nv):
        return read_joints(value, arm)
    return read_quantities(value, ["angle"] * len(value))


Joints = Annotated[tuple[float, ...], read_by(_read_joints_of_any_arm)]


def read_start(value: object, info: ValidationInfo) -> Array | None:
    """Read the configuration to start from, (nq,)."""
    table = read_keys(value, ("posture", "joints"))
    if "joints" in table and "posture" in table:
        raise Refusal("does not go with 'joints'", "posture")
    arm: Arm = cast(InputFile, in_file(info)).arm
    if "joints" in table:
        positions = read_within("joints", read_joints, table["joints"], arm)
        with refusing(key="joints"):
            start: Array = arm.checked_start(arm.configuration(positions), "start")
            return start
    if "posture" not in table:
        return None
    posture = read_within("posture", read_word, table["posture"], ("straight", "neutral"))
    return arm.straight() if posture == "straight" else arm.neutral()


def write_start(start: Array, arm: Arm) -> dict[str, Any]:
    """Return the table of the configuration to start from."""
    if np.array_equal(start, arm.straight()):
        return {"posture": "straight"}
    if np.array_equal(start, arm.neutral()):
        return {"posture": "neutral"}
    return {"joints": arm.positions(start)}


# The controller, by name, with the parameters of "geodesic".

_WEIGHTS = ("joint_weight", "relative_position_weight")


def read_controller(value: object, info: ValidationInfo) -> Controller:
    """Read the controller."""
    table = read_keys(value, ("name", *_WEIGHTS))
    name = read_within("name", read_word, table.get("name", "geodesic"), CONTROLLERS)
    controller = controller_named(name)
    for key in _WEIGHTS:
        if key not in table:
            continue
        number = read_within(key, read_again, Number, table[key], in_file(info))
        if not isinstance(controller, Geodesic):
            raise Refusal(f"is for the controller 'geodesic'; it is {name!r}", key)
        with refusing(table, key):
            controller = replace(controller, **{key: number})
    return controller


def write_controller(controller: Controller, file: Path) -> dict[str, Any]:
    """Return the table of the controller; an empty one for the default.

    Raises:
        FileError: it has parameters that a file cannot represent.
    """
    if isinstance(controller, Geodesic):
        weights = {key: getattr(controller, key) for key in _WEIGHTS}
        if replace(Geodesic(), **weights) == controller:
            weights = {key: value for key, value in weights.items() if value != getattr(Geodesic(), key)}
            return {"name": "geodesic", **weights} if weights else {}
    for name, make in CONTROLLERS.items():
        if make() == controller:
            return {"name": name}
    allowed = "a name with its usual parameters; joint_weight and relative_position_weight for 'geodesic'"
    raise FileError(file, f"controller: a file cannot represent {shown(controller)}; allowed: {allowed}")


# Files.


def read_formats(value: object, _: ValidationInfo) -> tuple[str, ...]:
    """Read the formats in which to save the result."""
    formats = read_keys(value, ("formats",)).get("formats", RESULT_FORMATS)
    if not is_list_of(lambda each: each in RESULT_FORMATS)(formats):
        raise NotAllowed(formats, f"a list of {', '.join(RESULT_FORMATS)}", "formats")
    return tuple(name for name in RESULT_FORMATS if name in formats)


def read_scans(value: object, info: ValidationInfo) -> tuple[Path, ...]:
    """Read the files that the editor shows; they need not exist."""
    scans = read_keys(value, ("scans",)).get("scans", [])
    if not isinstance(scans, list):
        raise NotAllowed(scans, "a list of files", "scans")
    for index, name in enumerate(scans):
        if not is_file_name(name):
            raise NotAllowed(name, "the name of a file", "scans", index)
    source = cast(InputFile, in_file(info))
    return tuple(settled(read_within("scans", source.resolve, name)) for name in scans)


# The text.


@contextmanager
def folder_of(path: Path) -> Iterator[None]:
    """Create the folder of a file; remove it again if writing fails.

    Raises:
        FileError: the file cannot be created: a name that is too long, a null byte, circular links, ...
    """
    new: list[Path] = []
    try:
        check_writable(path.parent)
        new = [folder for folder in (path.parent, *path.parents) if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException as error:
        for folder in new:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, PostureError) or not isinstance(error, OSError | RuntimeError | ValueError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise FileError(path, f"cannot be written ({reason})") from error


def document_text(
    path: Path,
    contents: Mapping[str, Any],
    layout: TomlLayout | None,
    check: Callable[[str], None],
) -> str:
    """Return the text of a task file; with the layout if possible.

    Args:
        path: the file, .toml or .json.
        contents: its values, as plain data with `Usual` for defaults.
        layout: the TOML file whose comments and layout are preserved.
        check: raises FileError unless a text reads back as the task.

    Raises:
        FileError: no text reads back as the task.
    """
    if path.suffix.lower() == ".json":
        text = json.dumps(drop_defaults(contents), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    else:
        if layout is not None:
            text = toml_text(contents, layout)
            with suppress(FileError):
                check(text)
                return text
            warn_caller(f"{path}: its comments and layout could not be kept")
        text = toml_text(contents)
    check(text)
    return text
