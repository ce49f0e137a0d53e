"""Half and twice of each setting: which results change, and by how much.

    python -m benchmarks.studies.settings PLAN AVOIDANCE --jobs 2
    python -m benchmarks.studies.settings                    # all of planner, targets, and trackers: hours
    python -m benchmarks.studies.settings FEEDBACK.rest_averages --factors 0.25 4 --kinds drives
    python -m benchmarks.studies.settings --list

A setting is a number in a named tuple in capitals, such as `PLAN.task_gain`. It is changed in the source that
a process imports, so that all that is derived from it changes as well. Results are the runs of
`benchmarks.same_results`, plans among obstacles as in `study clutter`, and motions of a `Tracker` whose
drives lag and sag, measured with noise. Settings of compiled kernels are not varied: each would have to be
compiled anew.
"""

from __future__ import annotations

import argparse
import ast
import multiprocessing
import pkgutil
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from pathlib import Path
from time import process_time
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

import benchmarks

Results = dict[str, list[float]]
"""Some numbers of each run, by its name; none if it failed."""

PACKAGES = ("placement", "control", "motion")
"""Packages of pinposture whose settings are varied."""

KINDS = ("run", "plan", "drives")
"""Kinds of results: runs of `benchmarks.same_results`, plans among obstacles, and late drives."""

SEEDS = 2
"""Problems of each kind of clutter."""

SAME = 1e-6
"""Largest difference of joint positions, lengths and times that counts as none."""

CYCLES = 900
"""Most cycles of a motion of a tracker."""

EXCLUDED = ("closed", "pipe")
"""Kinds of clutter that are not planned: one where no way exists, and the slowest."""

SLOWEST = "through/unrepeating12"
"""Runs of `benchmarks.same_results` that take as long as all others together, and are not made."""


class Setting(NamedTuple):
    """A number that tunes something: its module, its place from the named tuple on, and its value."""

    module: str
    place: tuple[str, ...]
    value: float

    @property
    def name(self) -> str:
        """The setting as the source says it, such as PLAN.task_gain."""
        return ".".join(self.place)

    def times(self, factor: float) -> float:
        """Return a multiple of the value; of a whole number the closest one, at least 1."""
        return max(round(factor * self.value), 1) if isinstance(self.value, int) else factor * self.value


def all_settings() -> list[Setting]:
    """Return the settings of `PACKAGES`, in the order of modules and of their source."""
    settings: list[Setting] = []
    for package in PACKAGES:
        root = import_module(f"pinposture.{package}")
        for found in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
            if found.ispkg:
                continue
            module = import_module(found.name)
            for statement in ast.parse(source_of(found.name).read_bytes()).body:
                name = assigned_name(statement)
                if name is not None and name.isupper() and is_record(vars(module).get(name)):
                    settings += numbers_of(found.name, (name,), vars(module)[name])
    return settings


def source_of(module: str) -> Path:
    """Return the file of a module, which is not imported."""
    root = Path(str(benchmarks.__file__)).parents[1]
    return root.joinpath(*module.split(".")).with_suffix(".py")


def assigned_name(statement: ast.stmt) -> str | None:
    """Return the name to which a statement assigns a call; None for other statements."""
    if not isinstance(statement, ast.Assign) or not isinstance(statement.value, ast.Call):
        return None
    target = statement.targets[0]
    return target.id if isinstance(target, ast.Name) else None


def is_record(value: object) -> bool:
    """Return whether a value is a named tuple."""
    return isinstance(value, tuple) and hasattr(value, "_fields")


def numbers_of(module: str, place: tuple[str, ...], record: Any) -> Iterator[Setting]:
    """Return the numbers of a named tuple, and of named tuples in it, that are neither zero nor infinite."""
    for name, value in zip(record._fields, record, strict=True):
        if is_record(value):
            yield from numbers_of(module, (*place, name), value)
        elif isinstance(value, int | float) and not isinstance(value, bool) and value and np.isfinite(value):
            yield Setting(module, (*place, name), value)


# Importing a module with another value.


def with_value(tree: ast.Module, place: Sequence[str], value: float) -> ast.Module:
    """Change a number of a named tuple in the source of its module.

    Raises:
        LookupError: the source does not say it.
    """
    name, *fields = place
    call = next(each.value for each in tree.body if assigned_name(each) == name)  # type: ignore[attr-defined]
    for depth, field in enumerate(fields):
        holder, member = declaration(tree, call, field)
        if depth == len(fields) - 1:
            setattr(holder, member, ast.copy_location(ast.Constant(value), getattr(holder, member)))
        call = getattr(holder, member)
    return ast.fix_missing_locations(tree)


def declaration(tree: ast.Module, call: ast.Call, field: str) -> tuple[ast.AST, str]:
    """Return where a call gets a field from: its argument of that name, or the default of its class."""
    for argument in call.keywords:
        if argument.arg == field:
            return argument, "value"
    for statement in tree.body:
        if isinstance(statement, ast.ClassDef) and statement.name == getattr(call.func, "id", None):
            for each in statement.body:
                if isinstance(each, ast.AnnAssign) and getattr(each.target, "id", None) == field:
                    return each, "value"
    raise LookupError(f"the source does not declare {field} in {ast.unparse(call)}")


class ChangedSource(MetaPathFinder, Loader):
    """Imports one module with another value of a setting."""

    def __init__(self, setting: Setting, value: float) -> None:
        self._setting = setting
        self._value = value

    def find_spec(self, fullname: str, path: object, target: ModuleType | None = None) -> ModuleSpec | None:
        """Find the module."""
        return spec_from_loader(fullname, self) if fullname == self._setting.module else None

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed source."""
        file = source_of(self._setting.module)
        tree = with_value(ast.parse(file.read_bytes()), self._setting.place, self._value)
        exec(compile(tree, file, "exec", dont_inherit=True), vars(module))


# What is measured, in a process of its own.


PRELOADED = (
    "pinocchio",
    "coal",
    "joblib",
    "pydantic",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.spatial",
)
"""Packages that are imported before processes start: all that takes long, and nothing that has settings."""


def measure(kinds: Sequence[str], setting: Setting, value: float) -> Results:
    """Make all runs of some kinds with another value of a setting, in a process that has not imported it."""
    if setting.module in sys.modules:
        raise RuntimeError(f"{setting.module} is imported already")
    sys.meta_path.insert(0, ChangedSource(setting, value))
    from pinposture import PostureError, PostureWarning

    found: Results = {}
    for name, run in runs():
        if name.split()[0] not in kinds:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PostureWarning)
            try:
                found[name] = run()
            except PostureError:
                found[name] = []
    return found


def runs() -> Iterator[tuple[str, Callable[[], list[float]]]]:
    """Return the runs by name."""
    from benchmarks import same_results
    from benchmarks.cases.clutter import KINDS_OF_CLUTTER

    for run in same_results.all_runs():
        if not run.name.startswith(SLOWEST):
            yield f"run {run.name}", partial(summarise_run, run)
    for kind in KINDS_OF_CLUTTER:
        for seed in range(SEEDS if kind not in EXCLUDED else 0):
            yield f"plan {kind} {seed}", partial(plan_among_obstacles, kind, seed)
    for tip in (False, True):
        for noise, lag in ((0.0, 0.05), (3e-4, 0.05), (3e-4, 0.2)):
            yield f"drives {tip} {noise} {lag}", partial(follow_late, tip, noise, lag)


def summarise_run(run: Any) -> list[float]:
    """Return the length of a run, and a number that hardly stays the same if anything in it changes."""
    found = run.make()
    arrays = [np.nan_to_num(np.asarray(each, dtype=float)) for _, each in sorted(found.items())]
    weighted = [float((each * np.cos(np.arange(each.size)).reshape(each.shape)).sum()) for each in arrays]
    return [float(max(len(each) for each in arrays)), *weighted]


def plan_among_obstacles(kind: str, seed: int) -> list[float]:
    """Return the duration of a plan, its length, whether it is clear, and its processor time [s]."""
    from benchmarks.cases.clutter import draw_problem
    from benchmarks.cases.situations import situation_arm
    from benchmarks.studies.clutter import RUN_LIMITS
    from pinposture.control import plan, retime
    from pinposture.motion.run import path_length_ratio

    arm, start, target, scene = draw_problem(situation_arm(), kind, seed)
    state = arm.at(start)
    plan(state, target, scene, RUN_LIMITS)  # what is prepared once is there
    began = process_time()
    path = plan(state, target, scene, RUN_LIMITS)
    took = process_time() - began
    points = np.array([arm.chain_at(q).points for q in path.configurations])
    length = float(path_length_ratio(points))
    return [retime(path, RUN_LIMITS).duration, length, float(not path.blocked_by), took]


def follow_late(tip: bool, noise: float, lag: float) -> list[float]:
    """Return the number of cycles until a tracker reports arrival [1], and how far the arm is off [rad]."""
    import pinposture as pp

    arm = pp.Arm.from_template("RyRz", 6)
    rng = np.random.default_rng(3)
    start, goal = (pp.arm.smooth_configuration(arm, rng, 0.5) for _ in range(2))
    sag = 0.02 * rng.normal(size=arm.nv)
    tasks = (pp.EndEffector.held(arm.at(goal), priority=True),) if tip else ()
    tracker = pp.Tracker(arm, pp.Geodesic(tasks=tasks), pp.Limits(velocity=1.0, acceleration=4.0, dt=0.01))
    tracker.update(pp.Target.from_configuration(arm, goal))
    q = start
    arrived = CYCLES
    for cycle in range(CYCLES):
        tracker.step(q + noise * rng.normal(size=arm.nv))
        q = q + 0.01 / (0.01 + lag) * (tracker.command + sag - q)
        if tracker.report.status == "converged" and arrived == CYCLES:
            arrived = cycle
    return [float(arrived), float(np.abs(q - goal).max())]


# Comparing, in the process that asks.


class Change(NamedTuple):
    """What another value changes.

    Attributes:
        moved: number of results that are not the same.
        failed: number of runs that fail now, and of plans that are not clear any more.
        steps: mean ratio of the lengths of runs.
        duration: mean ratio of the durations of plans.
        length: the same of the lengths of their paths.
        time: ratio of the sums of their processor times.
        arrival: mean ratio of the times until trackers report arrival.
        off: ratio of the distances from the goal then, of the mean.
    """

    moved: int
    failed: int
    steps: float
    duration: float
    length: float
    time: float
    arrival: float
    off: float


def compare(before: Results, after: Results) -> Change:
    """Compare two measurements."""
    moved = 0
    failed = 0
    pairs: dict[str, list[tuple[list[float], list[float]]]] = {"run": [], "plan": [], "drives": []}
    for name, one in before.items():
        other = after.get(name, [])
        kind = name.split()[0]
        known = slice(0, 3) if kind == "plan" else slice(None)
        same = len(one) == len(other) and np.allclose(one[known], other[known], rtol=SAME, atol=SAME)
        moved += not same
        failed += bool(one) and (not other or (kind == "plan" and other[2] < one[2]))
        if one and other:
            pairs[kind].append((one, other))

    def ratio(kind: str, column: int) -> float:
        both = np.array([(one[column], other[column]) for one, other in pairs[kind]])
        return float(np.exp(np.mean(np.log(both[:, 1] / both[:, 0])))) if len(both) else np.nan

    def ratio_of_sums(kind: str, column: int) -> float:
        both = np.array([(one[column], other[column]) for one, other in pairs[kind]])
        return float(both[:, 1].sum() / both[:, 0].sum()) if len(both) else np.nan

    return Change(
        moved,
        failed,
        steps=ratio("run", 0),
        duration=ratio("plan", 0),
        length=ratio("plan", 1),
        time=ratio_of_sums("plan", 3),
        arrival=ratio("drives", 0),
        off=ratio_of_sums("drives", 1),
    )


def main() -> int:
    """Print a row for each setting and factor."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="named tuples or settings; all if none")
    parser.add_argument("--factors", nargs="+", type=float, default=[0.5, 2.0], metavar="X")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, help="kinds of results")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="number of processes")
    parser.add_argument("--list", action="store_true", help="print the settings, and vary none")
    asked = parser.parse_args()
    for name in PRELOADED:
        import_module(name)
    import_module("pinposture.kernels").load()
    with multiprocessing.get_context("fork").Pool(asked.jobs, maxtasksperchild=1) as processes:
        known = processes.apply(all_settings)
        settings = [
            each for each in known if not asked.names or {each.name, each.place[0]} & set(asked.names)
        ]
        if not settings:
            parser.error(f"no setting is called {asked.names[0]!r}; --list prints all")
        if asked.list:
            print(*(f"{each.name:45} {each.value:g}" for each in settings), sep="\n")
            return 0
        variants = [
            (each, each.times(factor))
            for each in settings
            for factor in asked.factors
            if each.times(factor) != each.value
        ]
        usual = (settings[0], settings[0].value)
        measured = processes.imap(partial(measure_variant, asked.kinds), [usual, *variants])
        before = next(measured)
        print(f"{'':52} of {len(before)} results")
        print(f"{'setting':42}{'value':>10} moved failed  steps  lasts length   time arrive    off")
        for (setting, value), after in zip(variants, measured, strict=True):
            row = compare(before, after)
            ratios = "".join(f"{ratio:7.3f}" for ratio in row[2:])
            print(f"{setting.name:42}{value:10.4g}{row.moved:6}{row.failed:7}{ratios}", flush=True)
    return 0


def measure_variant(kinds: Sequence[str], variant: tuple[Setting, float]) -> Results:
    """Call `measure` with a setting and its value."""
    return measure(kinds, *variant)


if __name__ == "__main__":
    sys.exit(main())
