"""`pinposture view`: show a saved run or motion."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import OUTPUT, NoBrowserOption, RunArgument, read_points
from pinposture.cli.output import examples, find_kept, load_kept, print_note, write_animation, write_plot
from pinposture.errors import InvalidValue
from pinposture.storage import require_suffix

if TYPE_CHECKING:
    from pinposture.motion import Run, Trajectory


@examples(
    "pinposture view out",
    "pinposture view out/run.npz --no-browser",
    "pinposture view out --ellipsoids 5,10,20",
    "pinposture view out --viewer foxglove",
    "pinposture view out -o motion.html",
    "pinposture view out -o motion.png",
)
def run(
    *,
    path: RunArgument,
    output: Annotated[
        Path | None,
        OUTPUT("Write the animation (.html) or plot (.png); show nothing.", "FILE", "--output -o"),
    ] = None,
    no_browser: NoBrowserOption = False,
    viewer: Annotated[
        str, typer.Option(metavar="meshcat|foxglove", help="What shows it; foxglove needs the extra.")
    ] = "meshcat",
    ellipsoids: Annotated[
        str | None,
        OUTPUT(
            "Show the manipulability ellipsoids of these control points, counted from 1 at the base.",
            "N,...|all",
        ),
    ] = None,
) -> None:
    """Show a saved run or motion.

    From a directory with both, the newer one is shown. It plays in the browser until Ctrl-C, a motion in real
    time; the address is printed, so that other browsers can watch, too. With -o, the animation or the plot is
    written to a file instead. Ellipsoids are red and flat where the arm is singular, green far from that, and
    yellow in between.
    """
    with hold_interrupt():
        from pinposture._validation import require_known
        from pinposture.viz import VIEWERS

        file, chosen = find_kept(path)
        motion = load_kept(file)
    if chosen:
        print_note(f"taken: {chosen}")
    require_known("viewer", viewer, VIEWERS)
    kind = "" if output is None else require_suffix(output, ".html", ".png")
    if ellipsoids is not None and kind == ".png":
        raise InvalidValue("--ellipsoids", ellipsoids, "nothing with a .png file; the plot shows none")
    points = () if ellipsoids is None else read_points("--ellipsoids", ellipsoids, motion.arm)
    if output is None:
        show(motion, not no_browser, typer.echo, points, viewer)
        return
    if kind == ".html":
        write_animation(motion, output, points)
    else:
        write_plot(motion, output)
    print_note(f"wrote {output}")


def show(
    motion: Run | Trajectory,
    open_browser: bool,
    announce: Callable[[str], object],
    ellipsoids: Sequence[int] = (),
    viewer: str = "meshcat",
) -> None:
    """Play a run or motion in a viewer until Ctrl-C, which is not a failure.

    Args:
        motion: the run or motion.
        open_browser: whether to also open a browser.
        announce: called with the address.
        ellipsoids: 0-based indices of the control points whose manipulability ellipsoids are shown.
        viewer: the program that shows it, as for `pinposture.viz.view`.
    """
    shown = None
    try:
        with hold_interrupt():
            from pinposture.viz import view
            from pinposture.viz.postures import scale_in_words

            shown = view(motion.arm, motion, viewer=viewer, open_browser=open_browser, ellipsoids=ellipsoids)
        announce(shown.url)
        if ellipsoids:
            print_note(f"ellipsoids: {scale_in_words(motion.arm, ellipsoids)}")
        shown.play()
        print_note("press Ctrl-C to end")
        wait()
    except KeyboardInterrupt:
        print_note("")
    finally:
        if shown is not None:
            shown.close()


@contextmanager
def hold_interrupt() -> Iterator[None]:
    """Hold the first Ctrl-C back: trimesh and llvmlite may lose it, and meshcat leave its server running."""
    held: list[int] = []

    def hold(number: int, _: object) -> None:
        if held:
            raise KeyboardInterrupt
        held.append(number)

    before = signal.signal(signal.SIGINT, hold)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if held:
        raise KeyboardInterrupt


def wait() -> None:
    """Wait for Ctrl-C."""
    while True:
        time.sleep(3600.0)
