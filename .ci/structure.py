"""How large the library is, how its parts hang together, and what a reader of it meets.

    python .ci/structure.py                  # what is counted from the source
    python .ci/structure.py --flows          # and what usual tasks run through
    python .ci/structure.py --check          # exit code 1 if a ceiling is exceeded; `make lint` does this
    python .ci/structure.py --list           # every cycle, name, statement and file that was counted
    python .ci/structure.py --flows --list   # and every call from `pp.track` to the first step

Counted are files, definitions and constants; cycles of imports, at run time and with those that only types
and functions need; imports that go up in the order of packages; names that two classes have; names of
constants that mean two things where both are in sight; functions of many parameters by position; calls of
kernels spread from a tuple; assignments that share a line; and the mechanisms that do one job. With `--flows`
also the files in which a function runs and the calls that it takes: from `pp.track` to the first step of the
default controller; while `pinposture run` performs a task file; and from a drag in the editor to the step of
the controller, those of `control` not counted. Lines are printed and not limited: under a ceiling on lines,
statements came to share one.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from statistics import median

from flows import Flow, follow_all
from imports import Module, cycles, doubled_classes, doubled_constants, import_graph, read_package, upward
from statements import (
    constants,
    definitions,
    long_parameter_lists,
    shared_lines,
    spread_calls,
    subtractions_from_targets,
)

ROOT = Path(__file__).resolve().parents[1]

DEFINITIONS = (ast.FunctionDef, ast.ClassDef)

CEILINGS = {
    # What there is today, to be lowered whenever it falls; behind it, what it is to come to.
    "files": 229,  # 170
    "definitions": 5481,
    "constants": 400,
    "import cycles at run time": 0,  # 0
    "import cycles with types": 0,  # 0
    "imports that go up": 0,  # 0
    "class names defined twice": 0,  # 0
    "constants of two meanings in sight": 0,  # 0
    "long parameter lists": 0,  # 0
    "kernel calls spread from tuples": 0,  # 0
    "assignments that share a line": 1,  # 0
    "subtractions from a target": 1,  # 1
    "codecs": 7,  # 6
    "control loops": 1,  # 1
    "least-squares loops": 5,  # 3
    "box solvers": 5,  # 2
    "finders of a goal": 2,  # 1
    "forms of Algorithm 1": 1,  # 1
    "chain descriptions": 1,  # 1
    "files of a step": 22,  # 12
    "files of a task": 78,  # 40
    "files of a drag": 44,  # 15
    "calls of the first step": 157,  # 140
    "switches between files of the first step": 75,  # 90
    "calls of the second step": 38,  # 50
    "calls of the second step in a scene": 69,  # 80
    "calls of Task.load": 2081,  # 2500
    "calls of a cycle of perform": 87,  # 80
}
"""The most that there may be of each."""

MECHANISMS: dict[str, tuple[str, ...]] = {
    "codecs": (
        "arm.urdf",
        "collision.files",  # meshes and scans
        "motion.files",  # results: arrays by the names of fields, and the other fields
        "motion.joint_files",  # tables of joints
        "motion.ros",  # ROS messages, goals and bags
        "schema",  # of declared classes and functions, and of what is in them
        "toml",  # text and lines
    ),
    "control loops": ("motion.loop.Loop",),
    "least-squares loops": (
        "descent.descend",  # points on a curve; points, tasks, the tip and obstacles
        "control.planner.trajectory_optimization._PathRelaxation",  # all waypoints of a path
        "kernels.branch_search.correct",  # ends of a few modules
        "kernels.branch_search.minimise_posture_errors",  # points
        "kernels.path_relaxation.relax_waypoints",  # one waypoint after another
    ),
    "box solvers": (
        "quadratic_program.solve",  # dense, with rows
        "kernels.branch_search.correct",
        "kernels.chain_solver.minimise_in_box",  # along the chain
        "kernels.constrained_step.minimise_with_rows",  # by the one before, with rows
        "kernels.path_relaxation.step_waypoints",
    ),
    "finders of a goal": (
        "control.planner.goal.find_goal",  # near the state alone within a cycle
        "control.reach._Search",  # many, of the tip
    ),
    "forms of Algorithm 1": ("placement.resolve.Walk",),  # by a kernel for modules with closed forms
    "chain descriptions": ("kernels.arrays.Joints",),
}
"""The modules, classes and functions that do one job, by the job, without the name of the package."""

ORDER = (
    ("units",),
    ("errors",),
    ("storage",),
    ("_validation",),
    ("schema",),
    ("toml",),
    ("document",),
    ("quadratic_program",),
    ("kernels",),
    ("descent",),
    ("curve",),
    ("arm",),
    ("placement",),
    ("collision",),
    ("control",),
    ("motion",),
    ("task",),
    ("sim",),
    ("ros2",),
    ("viz",),
    ("editor",),
    ("operate",),
    ("notebook",),
    ("cli",),
    ("__main__",),
)
"""The packages from the lowest to the highest; one imports from those below it, and from itself."""


def main() -> int:
    """Count, print, and check."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="exit code 1 if a ceiling is exceeded")
    parser.add_argument("--flows", action="store_true", help="run the flows as well")
    parser.add_argument("--list", action="store_true", help="list everything that is counted, in full")
    given = parser.parse_args()
    modules = read_package(ROOT / "pinposture")
    listed = list_from_source(modules)
    counted = {"files": len(modules)} | {name: len(each) for name, each in listed.items()}
    flows: dict[str, Flow] = {}
    if given.flows:
        sys.path.insert(0, str(ROOT))
        flows, calls = follow_all()
        listed |= {f"files of a {name}": flow.files for name, flow in flows.items()}
        counted |= {f"files of a {name}": len(flow.files) for name, flow in flows.items()} | calls
    lines = [module.lines for module in modules.values()]
    print(f"{'':42} {'now':>6} {'ceiling':>8}")
    print(f"{'lines':42} {sum(lines):6}")
    print(f"{'lines of a file, median':42} {median(lines):6g}")
    for name, count in counted.items():
        over = "  exceeded" if count > CEILINGS[name] else ""
        print(f"{name:42} {count:6} {CEILINGS[name]:8}{over}")
    for name, flow in flows.items():
        parts = Counter(file.partition("/")[0] for file in flow.files)
        print(f"\nfiles of a {name}: {', '.join(f'{part} {count}' for part, count in parts.items())}")
    for name, each in listed.items():
        if given.list or counted[name] > CEILINGS[name]:
            print(f"\n{name}:", *each, sep="\n  ")
    if given.list and flows:
        print("\ncalls of the first step:")
        for depth, call in flows["step"].tree:
            print(f"  {'  ' * depth}{call}")
    missing = missing_mechanisms(modules)
    if missing:
        print("\nMECHANISMS names what is not there:", *missing, sep="\n  ")
    exceeded = [name for name, count in counted.items() if count > CEILINGS[name]]
    return 1 if given.check and (exceeded or missing) else 0


def list_from_source(modules: Mapping[str, Module]) -> dict[str, list[str]]:
    """Everything that is counted in the source, by what it is."""
    doubled = doubled_classes(modules)
    meanings = doubled_constants(modules)
    return {
        "import cycles at run time": [_cycle(each) for each in cycles(import_graph(modules, False))],
        "import cycles with types": [_cycle(each) for each in cycles(import_graph(modules, True))],
        "imports that go up": upward(modules, ORDER),
        "class names defined twice": [f"{name}: {', '.join(where)}" for name, where in doubled.items()],
        "constants of two meanings in sight": [f"{name}: {', '.join(at)}" for name, at in meanings.items()],
        "definitions": definitions(modules),
        "constants": constants(modules),
        "long parameter lists": long_parameter_lists(modules),
        "kernel calls spread from tuples": spread_calls(modules),
        "assignments that share a line": shared_lines(modules),
        "subtractions from a target": subtractions_from_targets(modules),
        **{name: list(each) for name, each in MECHANISMS.items()},
    }


def missing_mechanisms(modules: Mapping[str, Module]) -> list[str]:
    """Names in `MECHANISMS` that the package does not have."""
    defined = set(modules)
    for module in modules.values():
        defined |= {
            f"{module.name}.{node.name}" for node in module.tree.body if isinstance(node, DEFINITIONS)
        }
    named = [f"pinposture.{name}" for each in MECHANISMS.values() for name in each]
    return [name for name in named if name not in defined]


def _cycle(names: list[str]) -> str:
    return f"{len(names)} modules: {', '.join(names)}"


if __name__ == "__main__":
    sys.exit(main())
