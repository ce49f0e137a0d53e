"""The command itself: its verbs, and its behaviour on errors, broken pipes and Ctrl-C."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import partial, wraps
from importlib import import_module
from inspect import Parameter, signature
from typing import Annotated, Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from pinposture.cli import (
    batch,
    compile,
    drive,
    edit,
    export,
    generate,
    identify,
    inspect,
    operate,
    reach,
    run,
    simulate,
    track,
    view,
)
from pinposture.cli.output import print_error, verb_examples, warnings_as_notes
from pinposture.errors import ControllerError, InvalidValue, PostureError

REFUSED = 2
"""Exit code after wrong usage or unusable input."""

# Newer versions of Typer bundle their own Click, so the class is not imported by name.
_UsageError: Any = typer.BadParameter.__bases__[0]


class Commands(TyperGroup):
    """A group of verbs that reports errors to the user in one line, without a traceback."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command line; exit with its code, or return it if `standalone_mode` is false."""
        try:
            with warnings_as_notes():
                code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra) or 0
        except _UsageError as error:
            hint = f"; see {error.ctx.command_path} --help" if error.ctx else ""
            print_error(error.format_message().rstrip(".") + hint)
            code = REFUSED
        except OSError as error:  # of standard output, such as on a full disk, or of a name that cannot be
            reason = "the output cannot be written" if error.filename is None else error.filename
            print_error(f"{reason} ({error.strerror or error})")
            code = REFUSED
        except typer.Abort:  # Ctrl-C in older versions of Typer; newer ones return the code
            code = 130  # as in shells
        if standalone_mode:
            sys.exit(code)
        return code


REGISTERED = {
    "{controllers}": ("pinposture.control.registry", "controller_names"),
    "{curves}": ("pinposture.curve", "CURVES"),
    "{templates}": ("pinposture.arm", "TEMPLATES"),
    "{types of obstacles}": ("pinposture.collision.obstacles", "describe_types"),
}
"""What stands for registered names in the help of verbs and options, and the module and attribute that has or
returns them: they are imported where the help is printed."""


def _described_field(reference: re.Match[str], options: Mapping[str | None, str]) -> str:
    """Return what a declared class says of a field, as {control.Limits.dt}, with options for arguments."""
    from pinposture.schema import describe_field

    words = describe_field(getattr(import_module(f"pinposture.{reference[1]}"), reference[2]), reference[3])
    named = re.sub(r"`(\w+)`", lambda quoted: options.get(quoted[1], quoted[1]), words)
    return named.replace("[", "(").replace("]", ")")  # Typer takes brackets for markup


def _with_registered_names(written: str | None, options: Mapping[str | None, str]) -> str | None:
    """Return a help text with the names that are registered, and the words of declared classes."""
    if written is not None:
        described = partial(_described_field, options=options)
        written = re.sub(r"\{([\w.]+)\.(\w+)\.(\w+)\}", described, written)
    for placeholder, (home, attribute) in REGISTERED.items():
        if written is not None and placeholder in written:
            names = getattr(import_module(home), attribute)
            written = written.replace(placeholder, ", ".join(names() if callable(names) else names))
    return written


def verb_with_examples(examples: tuple[str, ...]) -> type[TyperCommand]:
    """Return a class of verbs whose help ends with examples, one per line, without rewrapping.

    They print errors in one line, with arguments of Python functions as the options of the verb.
    """

    class Verb(TyperCommand):
        def invoke(self, ctx: Any) -> Any:
            try:
                return super().invoke(ctx)
            except PostureError as error:
                if isinstance(error, ControllerError):  # of the user: --verbose shows where it failed
                    logging.getLogger("pinposture").debug("the controller failed", exc_info=error)
                print_error(
                    _text_with_options(
                        error, {parameter.name: parameter.opts[0] for parameter in self.params}
                    )
                )
                raise typer.Exit(REFUSED) from error

        def format_help(self, ctx: Any, formatter: Any) -> None:
            described: list[Any] = [self, *self.params]
            written = [item.help for item in described]
            options: dict[str | None, str] = {item.name: item.opts[0] for item in self.params}
            for item in described:
                item.help = _with_registered_names(item.help, options)
            super().format_help(ctx, formatter)
            for item, text in zip(described, written, strict=True):
                item.help = text
            lines = "".join(f"   $ {example}\n" for example in examples)
            formatter.write(f" Examples:\n\n{lines}\n")

    return Verb


OPTIONS_OF_ARGUMENTS = {
    "max_steps": ("steps",),
    "step": ("step_limit",),
    "weight": ("tip_weight",),
    "position": ("tip_position", "tip_pose", "to"),
    "rotation": ("tip_pose",),
    "couplings": ("couple",),
}
"""Parameters of the verbs that are called otherwise in Python: the first of these that a verb has."""


def _text_with_options(error: PostureError, options: Mapping[str | None, str]) -> str:
    """Return the text of an error, with options of a verb in place of the arguments of Python functions.

    Replaced are the name of an invalid value, and advice such as placement="align" or scale=0.1.
    """

    def option(match: re.Match[str]) -> str:
        name = match["name"]
        values = match["values"].replace('"', "")
        return f"{options[name]} {values}" if name in options else match[0]

    text = str(error)
    if isinstance(error, InvalidValue):
        name = re.split(r"\W", error.name, maxsplit=1)[0]  # locked, of locked.elbow or locked[2]
        known = [
            options[argument]
            for argument in (name, *OPTIONS_OF_ARGUMENTS.get(name, ()))
            if argument in options
        ]
        if known:
            text = known[0] + text.removeprefix(name).replace(".", " ", error.name.startswith(f"{name}."))
    return re.sub(r'\b(?P<name>\w+)=(?P<values>"\w+"( or "\w+")*|[\d.]*\d)', option, text)


app = typer.Typer(
    name="pinposture",
    cls=Commands,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(value: bool) -> None:
    if value:
        from pinposture import __version__

        typer.echo(f"pinposture {__version__}")
        raise typer.Exit


def _log_verbosely(value: bool) -> None:
    if value:
        logging.basicConfig(format="%(name)s: %(message)s")
        logging.getLogger("pinposture").setLevel(logging.DEBUG)


@app.callback(invoke_without_command=True)
def command(
    ctx: typer.Context,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", callback=_log_verbosely, help="Log to stderr.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Posture control of modular hyper-redundant serial arms: draw a curve, and the arm takes its shape."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


def _paragraphs(docstring: str) -> str:
    """Put each paragraph of a docstring on one line: Typer keeps line breaks and adds its own."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in docstring.split("\n\n"))


def add_verb(name: str, run: Callable[..., None], group: typer.Typer) -> None:
    """Add a verb to a group, with its docstring as help, its examples, and the options of its dataclasses."""
    verb = verb_with_examples(verb_examples[run])
    group.command(name, cls=verb, help=_paragraphs(run.__doc__ or ""))(_with_single_options(run))


def _with_single_options(run: Callable[..., None]) -> Callable[..., None]:
    """Return a verb with the fields of its option dataclasses as single parameters, as Typer requires."""
    single = list(_single_options(run))

    @wraps(run)
    def verb(**values: Any) -> None:
        run(**_grouped_options(run, values))

    verb.__signature__ = signature(run).replace(parameters=single)  # type: ignore[attr-defined]
    verb.__annotations__ = {parameter.name: parameter.annotation for parameter in single}
    return verb


def _single_options(reader: Callable[..., object]) -> Iterator[Parameter]:
    """Yield the parameters of a verb or of a dataclass, and those of dataclasses among them."""
    for parameter in signature(reader, eval_str=True).parameters.values():
        if is_dataclass(parameter.annotation):
            yield from _single_options(cast("type", parameter.annotation))
        else:
            yield parameter.replace(kind=Parameter.KEYWORD_ONLY)


def _grouped_options(reader: Callable[..., object], values: Mapping[str, object]) -> dict[str, object]:
    """Return the arguments of a verb or of a dataclass, given the options by name."""
    arguments: dict[str, object] = {}
    for name, parameter in signature(reader, eval_str=True).parameters.items():
        grouped = is_dataclass(parameter.annotation)
        arguments[name] = (
            parameter.annotation(**_grouped_options(parameter.annotation, values))
            if grouped
            else values[name]
        )
    return arguments


VERBS: dict[str, Callable[..., None]] = {
    "generate": generate.run,
    "inspect": inspect.run,
    "track": track.run,
    "reach": reach.run,
    "batch": batch.run,
    "run": run.run,
    "edit": edit.run,
    "view": view.run,
    "export": export.run,
    "simulate": simulate.run,
    "identify": identify.run,
    "drive": drive.run,
    "robot": drive.run_robot,
    "operate": operate.run,
    "compile": compile.run,
}
for name, verb in VERBS.items():
    add_verb(name, verb, app)


def main() -> None:
    """Run the command line of this process and exit."""
    app(prog_name="pinposture")
