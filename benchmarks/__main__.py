"""`python -m benchmarks`: studies, the experiments of the thesis, and the score of other programs."""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path

import typer

from benchmarks.reproduce import command
from benchmarks.studies import arms, clutter, cycles, headings, leader, methods, postures, repair, scenes
from pinposture.cli.app import OPTIONS_OF_ARGUMENTS, Commands, add_verb

STUDIES = {
    "arms": arms.run,
    "methods": methods.run,
    "postures": postures.run,
    "headings": headings.run,
    "scenes": scenes.run,
    "clutter": clutter.run,
    "repair": repair.run,
    "cycles": cycles.run,
    "leader": leader.run,
}
"""The studies by name, in help order."""

SCRIPTS = (
    "coupled_joints",
    "curve_fits",
    "depth_images",
    "drives",
    "editor",
    "failures",
    "holding",
    "identification",
    "many_runs",
    "mapping",
    "moving_obstacles",
    "obstacle_joints",
    "parameters",
    "qp_solvers",
    "rate",
    "reach",
    "retreat",
    "ros2",
    "scan_obstacles",
    "sensed",
    "settings",
    "shape",
    "soak",
    "steering",
    "switching",
    "thesis_claims",
    "torque_cost",
    "torque_limits",
    "touch",
    "ways",
    "wrap",
)
"""Modules of `benchmarks.studies` with a command line of their own."""

OPTIONS_OF_ARGUMENTS |= {"absolute": ("index",), "first_seed": ("seed0",), "threshold": ("kappa",)}

SETTINGS = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(name="benchmarks", cls=Commands, pretty_exceptions_enable=False, context_settings=SETTINGS)
study = typer.Typer()


@app.callback(invoke_without_command=True)
def _evidence(ctx: typer.Context) -> None:
    """The evidence for what the documentation of pinposture says."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


@study.callback(invoke_without_command=True)
def _study(ctx: typer.Context) -> None:
    """Studies of many arms, methods or scenes: one example proves little."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


def _add_script(name: str) -> None:
    """Add a module whose function `main` reads its options from the command line."""
    file = Path(__file__).with_name("studies") / f"{name}.py"
    words = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").splitlines()
    unread = {"allow_extra_args": True, "ignore_unknown_options": True}

    @study.command(name, help=words[0], add_help_option=False, context_settings=unread)
    def script(ctx: typer.Context) -> None:
        sys.argv = [f"study {name}", *ctx.args]
        raise typer.Exit(import_module(f"benchmarks.studies.{name}").main() or 0)


add_verb("reproduce", command.run, app)
add_verb("score", command.run_score, app)
for name, verb in STUDIES.items():
    add_verb(name, verb, study)
for name in SCRIPTS:
    _add_script(name)
app.add_typer(study, name="study")


def main() -> None:
    """Run the command line of this process and exit."""
    app(prog_name="python -m benchmarks")


if __name__ == "__main__":
    main()
