"""`pinposture view`: look at a run that was kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.output import print_note
from pinposture.cli.results import RUN, write_animation, write_plot

if TYPE_CHECKING:
    from pinposture.motion import Trajectory

EXAMPLES = (
    "pinposture view out",
    "pinposture view out/run.npz --no-browser",
    "pinposture view out --html motion.html --png motion.png",
)


def run(
    *,
    path: Annotated[
        Path, typer.Argument(metavar="RUN", help=f"A saved run, or the directory that holds its {RUN}.")
    ],
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the animation here, and show nothing.")
    ] = None,
    png: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the plot here, and show nothing.")
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address, but open no browser.")
    ] = False,
) -> None:
    """Look at a run that was kept.

    It plays in the browser until Ctrl-C; its address is printed, so that another browser can watch as well.
    With --html or --png its animation or its plot are written to files instead.
    """
    from pinposture.motion import Trajectory

    motion = Trajectory.load(path / RUN if path.is_dir() else path)
    if html is not None:
        print_note(f"wrote {write_animation(motion, html)}")
    if png is not None:
        write_plot(motion, png)
        print_note(f"wrote {png}")
    if html is None and png is None:
        show(motion, not no_browser, typer.echo)


def show(motion: Trajectory, open_browser: bool, announce: Callable[[str], object]) -> None:
    """Play a run in meshcat until Ctrl-C, which is the way to end it and no failure.

    Args:
        motion: the run.
        open_browser: whether to open a browser at its address, too.
        announce: called with that address.
    """
    from pinposture.view import view

    viewer = view(motion.arm, motion, motion.target, open_browser=open_browser)
    try:
        announce(viewer.url)
        viewer.play()
        print_note("press Ctrl-C to end")
        wait()
    except KeyboardInterrupt:
        print_note("")
    finally:
        viewer.close()


def wait() -> None:
    """Wait for Ctrl-C."""
    while True:
        time.sleep(3600.0)
