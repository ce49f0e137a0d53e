"""The three spatial scenarios of the thesis, by Selection and by Projection: one table, pictures, animations.

make demo
"""

import time
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import pinposture as pp
from pinposture.study import case
from pinposture.thesis.scenarios import SPATIAL_SCENARIOS

SEED = 17
OUT = Path("out")
URDF = Path(__file__).parents[1] / "urdf/ryrz20.urdf"


def main() -> None:
    """Run, tabulate, draw."""
    begun = time.perf_counter()
    console = Console()
    if not console.is_terminal:
        console = Console(width=140)  # whoever reads a pipe or a log wants whole lines
    arm = pp.Arm.from_urdf(URDF)
    console.print(f"{URDF.name}: {arm}")
    console.print(f"start and roll of the curve from seed {SEED}, |dq| <= 0.1 rad per step")
    table = Table("scenario", "controller", r"posture error \[m]", "steps", "points used", "ending")
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("tracking", total=2 * len(SPATIAL_SCENARIOS))
        for scenario in SPATIAL_SCENARIOS:
            start, target = case(arm, scenario, SEED)
            runs = {}
            for name in ("selection", "projection"):
                run = runs[name] = pp.track(arm, target, start, name)
                errors, points = run.posture_error, run.active.sum(axis=1)
                used = f"{points[0]} -> {points[-1]}" if run.steps else "none"
                change = f"{errors[0]:.3g} -> {errors[-1]:.3g}"
                ending = f"{run.status}: {run.reason}"
                table.add_row(scenario.title, name, change, str(run.steps), used, ending)
                folder = OUT / scenario.name / name
                run.save(folder / "run.npz")
                pp.plot(run).savefig(folder / "run.png", dpi=120)
                pp.save_html(arm, run, folder / "run.html")
                progress.advance(task)
            pp.plot_comparison(runs).savefig(OUT / scenario.name / "comparison.png", dpi=120)
    console.print(table)
    console.print(f"pictures: {OUT}/*/comparison.png and {OUT}/*/*/run.png")
    console.print(f"animations, to open in a browser: {OUT}/*/*/run.html")
    console.print(f"took {time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
