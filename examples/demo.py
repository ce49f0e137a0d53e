"""Run scenarios of the thesis with four controllers, and a task in time.

make demo
"""

import time
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import pinposture as pp
from benchmarks.cases.scenarios import PLANAR_SCENARIOS, SPATIAL_SCENARIOS, case
from pinposture.units import length_text

SEED = 17
OUT = Path("out")
URDF = Path(__file__).parents[1] / "urdf"
TASK = Path(__file__).parent / "tasks" / "keyframes.toml"
CONTROLLERS = ("geodesic", "selection", "projection", "switching")


def main() -> None:
    """Run the scenarios, print the table, draw the figures."""
    begun = time.perf_counter()
    console = Console()
    if not console.is_terminal:
        console = Console(width=150)  # a pipe or a log gets whole lines
    scenarios = (*SPATIAL_SCENARIOS, *PLANAR_SCENARIOS[:2])
    console.print(f"starts and targets from seed {SEED}, |dq| <= 0.1 rad per step")
    table = Table(
        "arm", "scenario", "controller", "mean point error", "steps", "paths", "points used", "ending"
    )
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("tracking", total=len(CONTROLLERS) * len(scenarios))
        for scenario in scenarios:
            arm = pp.Arm.load(URDF / f"{scenario.arm}.urdf")
            start, target = case(arm, scenario, SEED)
            runs = {}
            for name in CONTROLLERS:
                run = runs[name] = pp.track(arm, target, start, name)
                errors = run.mean_error
                points = run.active.sum(axis=1)
                used = f"{points[0]} -> {points[-1]}" if run.steps else "none"
                change = " -> ".join(length_text(error, arm.length) for error in (errors[0], errors[-1]))
                ending = f"{run.status}: {run.reason}"
                row = (change, str(run.steps), f"{run.path_length_ratio:.2f}", used, ending)
                table.add_row(scenario.arm, scenario.title, name, *row)
                folder = OUT / scenario.name / name
                pp.save(run, folder / "run.npz")
                progress.advance(task)
            folder = OUT / scenario.name / "geodesic"
            pp.plot(runs["geodesic"]).savefig(folder / "run.png", dpi=120)
            pp.save_html(arm, runs["geodesic"], folder / "run.html")
            pp.plot_comparison(runs).savefig(OUT / scenario.name / "comparison.png", dpi=120)
    console.print(table)
    console.print("paths: path length of the control points, relative to straight lines from start to end")
    motion = pp.Task.load(TASK).perform()
    folder = OUT / "keyframes"
    pp.save(motion, folder / "motion.npz")
    pp.save(motion.joint_trajectory(), folder / "motion.json")
    pp.plot(motion).savefig(folder / "motion.png", dpi=120)
    pp.save_html(motion.arm, motion, folder / "motion.html")
    names = ", ".join(f"{place.name} at {place.reached:.2f} s" for place in motion.waypoints)
    console.print(
        f"{TASK.name}: {names}; {motion.time_scale:.2f} times as long as planned, within all limits"
    )
    console.print(f"pictures: {OUT}/*/comparison.png, {OUT}/*/geodesic/run.png and {folder}/motion.png")
    console.print(f"animations, to open in a browser: {OUT}/*/geodesic/run.html and {folder}/motion.html")
    console.print(f"the other runs: pinposture view {OUT}/{scenarios[0].name}/selection -o run.html")
    console.print(f"took {time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
