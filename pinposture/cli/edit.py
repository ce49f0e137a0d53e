"""`pinposture edit`: edit the postures of an arm in the browser."""

from __future__ import annotations

import os
import signal
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.compile import compile_missing
from pinposture.cli.inputs import ArmOptions, NoBrowserOption, refuse_given
from pinposture.cli.output import examples, print_note
from pinposture.errors import FileError, InvalidValue
from pinposture.storage import require_suffix

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.task import Task

MODULES = 20
"""Default number of modules of an arm from a template."""


@examples(
    "pinposture edit",
    "pinposture edit examples/tasks/keyframes.toml",
    "pinposture edit RyRz --modules 40 --save-as snake.toml",
    "pinposture edit arm.urdf --split 2 --save-as dance.toml",
    "pinposture edit dance.toml --joint-states measured.jsonl --port 8090",
)
def run(
    *,
    source: Annotated[
        str,
        typer.Argument(
            metavar="[TASK|URDF|TEMPLATE]",
            help="A task file (.toml, .json), a robot description, or a module template: {templates}.",
        ),
    ] = "RyRz",
    arm_options: ArmOptions,
    modules: Annotated[
        int | None,
        typer.Option(metavar="N", help=f"Number of modules of a template; {MODULES} by default."),
    ] = None,
    save_as: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Name of a new task file; otherwise it is named after the arm."),
    ] = None,
    joint_states: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-",
            help="Show measured joint positions beside the plan: JSON lines such as "
            '{"name": [...], "position": [...]}, from a growing file, a pipe, or - for stdin.',
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Where the page opens and saves files; otherwise the folder of the task file.",
        ),
    ] = None,
    page_options: PageOptions,
) -> None:
    """Edit the postures of an arm in the browser: drag the curve, watch the arm.

    The arm follows the curve of the selected keyframe while you drag its control points, with the controller
    and within the limits of the task. The keyframes form a motion that can be played, checked and exported;
    `pinposture run` performs the saved task file. Changes are continuously saved beside it, and restored if
    the editor ends without saving.

    Any number of browsers can watch and edit, with the printed address, which ends in a secret. They open and
    save files in one folder only. The editor runs until Ctrl-C.
    """
    # Matrices are small, and threads of linear algebra that wait for each other slow down the other parts of
    # the editor. Numpy reads these when it is imported, which is below.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        os.environ.setdefault(name, "1")
    from pinposture.editor import Editor
    from pinposture.editor.files import autosave_path
    from pinposture.editor.ui.server import is_loopback

    task, path = read_task(source, arm_options, save_as, folder, modules)
    compile_missing()  # now, with a progress bar; otherwise the page would remain empty
    host = page_options.host
    editor = Editor(task, path, host, page_options.port, joint_states, folder)
    try:
        for name in ("SIGTERM", "SIGHUP"):  # end the editor like Ctrl-C, after the last changes are written
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.default_int_handler)
        editor.start()
        typer.echo(editor.url)
        if not is_loopback(host):
            print_note(
                f"listening on {host} for other machines, unencrypted: anyone who has the address can edit, "
                f"and open and save files in {editor.session.folder}"
            )
        print_note("press Ctrl-C to end")
        if not page_options.no_browser:
            webbrowser.open(editor.url)
        editor.wait()
    except KeyboardInterrupt:
        print_note("")
    finally:
        editor.close()
        now = editor.session.path  # another file may have been opened
        if now is not None and autosave_path(now).exists():
            print_note(f"unsaved changes of {now.name} are kept and restored at the next start")


@dataclass(frozen=True)
class PageOptions:
    """Where the page is."""

    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 accepts other machines.")] = (
        "127.0.0.1"
    )
    port: Annotated[int, typer.Option(help="Port to listen on; if it is in use, the next free one.")] = 8080
    no_browser: NoBrowserOption = False


def read_task(
    source: str,
    arm_options: ArmOptions,
    save_as: Path | None,
    folder: Path | None = None,
    modules: int | None = None,
) -> tuple[Task, Path]:
    """Return the task to edit and its file, which may not exist yet; new files are created in `folder`.

    `modules` is the number of modules of a template.

    Raises:
        PostureError: no such file or template, or as in `Task.load` and `Arm.load`.
    """
    from pinposture.document import SUFFIXES
    from pinposture.editor.files import recover, version_of
    from pinposture.task import Task

    suffix = Path(source).suffix.lower()
    if suffix in SUFFIXES:
        arm_options.refuse("nothing: the task file defines it")
        saves = f"nothing: the page saves {source}, and others by File > Save under this name"
        refuse_given({"--save-as": save_as}, saves)
        refuse_given({"--modules": modules}, "nothing: the task file defines it")
        path = Path(source).absolute()
        # If the file was never saved or is gone, restore the automatically saved changes.
        left = None if version_of(path) else recover(path)
        return (Task.load(path) if left is None or left.task is None else left.task), path
    from pinposture.editor.files import first_task

    if suffix in (".urdf", ".xml", ".xacro") or version_of(Path(source)):
        refuse_given({"--modules": modules}, "nothing: a description has its own; --split groups joints")
        arm = arm_options.read(source)
        name = Path(source).stem
    else:
        arm_options.refuse("nothing: a template has no links yet")
        count = MODULES if modules is None else modules
        arm = _templated(source, count)
        name = f"{source.lower()}{count}"
    path = ((folder or Path()) / f"{name}.toml" if save_as is None else save_as).absolute()
    require_suffix(path, *SUFFIXES)
    if version_of(path):
        raise FileError(
            path, f"exists already; edit it (pinposture edit {path.name}), or give another --save-as"
        )
    return first_task(arm, name), path


def _templated(name: str, modules: int) -> Arm:
    """Return an arm from a template."""
    from pinposture._validation import require_known
    from pinposture.arm import Arm
    from pinposture.arm.specification import MOST_MODULES_IN_FILE
    from pinposture.arm.template import TEMPLATES

    require_known("task file, robot description or template", name, TEMPLATES)
    if modules > MOST_MODULES_IN_FILE:  # the limit of task files
        raise InvalidValue("--modules", modules, f"at most {MOST_MODULES_IN_FILE}")
    return Arm.from_template(name, modules)
