"""`python -m benchmarks`: studies, the experiments of the thesis, and the score of other programs."""

from __future__ import annotations

import typer

from benchmarks.reproduce import command
from benchmarks.studies import arms, clutter, cycles, headings, leader, methods, postures, scenes
from pinposture.cli.app import OPTIONS_OF_ARGUMENTS, Commands, add_verb

OPTIONS_OF_ARGUMENTS |= {"absolute": "index", "first_seed": "seed0", "threshold": "kappa"}

STUDIES = {
    "arms": arms.run,
    "methods": methods.run,
    "postures": postures.run,
    "headings": headings.run,
    "scenes": scenes.run,
    "clutter": clutter.run,
    "cycles": cycles.run,
    "leader": leader.run,
}
"""The studies by name, in help order."""

SETTINGS = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(name="benchmarks", cls=Commands, pretty_exceptions_enable=False, context_settings=SETTINGS)
study = typer.Typer()


@app.callback(invoke_without_command=True)
def _evidence(ctx: typer.Context) -> None:
    """The evidence for what pinposture claims."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


@study.callback(invoke_without_command=True)
def _study(ctx: typer.Context) -> None:
    """Studies of many arms, methods or scenes: one example proves little."""
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())


add_verb("reproduce", command.run, app)
add_verb("score", command.run_score, app)
for name, verb in STUDIES.items():
    add_verb(name, verb, study)
app.add_typer(study, name="study")


def main() -> None:
    """Run the command line of this process and exit."""
    app(prog_name="python -m benchmarks")


if __name__ == "__main__":
    main()
