"""What every test shares: the reference in `tests/analytic`, and the sets of tests."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

TESTS = str(Path(__file__).resolve().parent)
if TESTS not in sys.path:  # so that `from analytic import ryrz` works from any test, in any import mode
    sys.path.insert(0, TESTS)

from sampling import draw_fully, draws_more  # noqa: E402

from benchmarks.baselines import register_baselines  # noqa: E402
from pinposture.arm import Arm  # noqa: E402
from pinposture.curve import Curve  # noqa: E402

register_baselines()  # so that tests can name them

SLOW = {
    "site": "builds the documentation site",
    "tutorial": "runs the tutorial and the examples",
    "pictures": "draws whole pictures and reads their pixels",
    "browser": "drives a real browser",
    "soak": "runs for many cycles, or is killed and started again",
    "studies": "runs a study in small",
    "reproduction": "runs figures and claims of the thesis",
    "statistics": "counts over many seeds",
    "long": "takes over a third of a second",
    "process": "starts the command in processes of its own, or kills them",
}
"""Markers of tests that the quick set leaves out."""

FIRST = ("process", "browser", "site", "tutorial", "studies", "soak")
"""Markers of the longest tests. They begin first, so that no process is left alone with one at the end."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="every test, with many and random examples")
    parser.addoption("--rest", action="store_true", help="what --full adds to the quick tests")


BUILT_EARLY = pytest.StashKey[list[str]]()
"""Classes of what was built while the tests were collected, which costs every worker of every run."""

_untouched: dict[type, Callable[..., None]] = {}


def pytest_configure(config: pytest.Config) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs would ignore it
    for name, meaning in SLOW.items():
        config.addinivalue_line("markers", f"{name}: {meaning}; only with --full")
    full = config.getoption("full") or config.getoption("rest")
    draw_fully(full, repeatable=not full or config.getoption("hypothesis_seed") is not None)
    built = config.stash[BUILT_EARLY] = []
    for kind in (Arm, Curve):
        original = _untouched[kind] = kind.__init__

        def noted(self: Any, *args: Any, original: Any = original, **named: Any) -> None:
            built.append(type(self).__name__)
            original(self, *args, **named)

        kind.__init__ = noted


def pytest_collection_finish() -> None:
    for kind, original in _untouched.items():
        kind.__init__ = original
    _untouched.clear()
    gc.freeze()  # thousands of tests that stay: not to be looked through again and again
    gc.set_threshold(
        50_000, 20, 20
    )  # hypothesis counts each collection; the usual 700 make up 5 % of the time


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out tests that are not of the chosen set, unless one is named; long ones come first."""
    if not config.getoption("full") and not any("::" in argument for argument in config.args):
        chosen = in_the_rest if config.getoption("rest") else in_the_quick_set
        left_out = [item for item in items if not chosen(item)]
        items[:] = [item for item in items if chosen(item)]
        config.hook.pytest_deselected(items=left_out)
    items.sort(key=turn_of)  # those of one turn stay in their order


def turn_of(test: pytest.Item) -> int:
    return min(
        (FIRST.index(mark.name) for mark in test.iter_markers() if mark.name in FIRST), default=len(FIRST)
    )


def in_the_quick_set(test: pytest.Item) -> bool:
    return not any(mark.name in SLOW for mark in test.iter_markers())


def in_the_rest(test: pytest.Item) -> bool:
    return draws_more(test) or not in_the_quick_set(test)


@pytest.fixture
def built_early(pytestconfig: pytest.Config) -> list[str]:
    """Classes of arms and curves that were built while the tests were collected."""
    return pytestconfig.stash[BUILT_EARLY]


@pytest.fixture(scope="session", autouse=True)
def no_kernel_was_compiled_twice() -> Iterator[None]:
    """Whatever the tests did, kernels got the arguments that they are annotated with, and no others."""
    yield
    if "pinposture.kernels.compiled" in sys.modules:
        from pinposture import kernels
        from pinposture.kernels.compiled import arguments_of

        for kernel in (getattr(kernels, name) for name in kernels.NAMES):
            assert set(kernel.signatures) <= {arguments_of(kernel)}, kernel.py_func.__name__
