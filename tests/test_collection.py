"""What the tests themselves must keep to."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import mutation
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sampling import examples, seeds

TESTS = Path(__file__).parent


def test_nothing_is_built_while_tests_are_collected(built_early: list[str]) -> None:
    assert built_early == []


def test_the_quick_set_draws_a_few_cases_of_each(pytestconfig) -> None:
    full = pytestconfig.getoption("full") or pytestconfig.getoption("rest")
    seeded = pytestconfig.getoption("hypothesis_seed") is not None
    every = [3, 13, 233] if seeded else [3, 40, 700]
    assert [examples(count).max_examples for count in (3, 40, 700)] == (every if full else [3, 6, 8])
    assert [len(seeds(count)) for count in (2, 40)] == ([2, 40] if full else [2, 3])


def test_cases_do_not_depend_on_the_source_of_the_library(pytestconfig, tmp_path, monkeypatch) -> None:
    if pytestconfig.getoption("full") and pytestconfig.getoption("hypothesis_seed") is None:
        pytest.skip("draws new cases each time, with constants of the source among them")
    before = floats_drawn()
    numbers = np.random.default_rng(0).normal(size=400).tolist()
    (tmp_path / "full_of_constants.py").write_text(f"NUMBERS = {numbers}")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("full_of_constants")
    assert floats_drawn() == before


def floats_drawn() -> list[str]:
    drawn: list[str] = []

    @settings(derandomize=True, database=None)
    @given(st.lists(st.floats(), min_size=20))
    def draw(values: list[float]) -> None:
        drawn.extend(map(repr, values))

    draw()
    return drawn


def test_numbers_of_examples_are_left_to_the_sets() -> None:
    for path in TESTS.rglob("test_*.py"):
        assert not re.search(r"max_examples ?=", path.read_text(encoding="utf-8")), path.name


def test_faults_are_seeded_in_packages_that_have_tests() -> None:
    for package in mutation.PACKAGES:
        assert list((TESTS.parent / "pinposture" / package).glob("*.py")), package
        for folder in mutation.FIRST.get(package, (package,)):
            assert list((TESTS / folder).glob("test_*.py")), folder


@pytest.mark.process
def test_the_quick_tests_and_the_rest_are_all_tests() -> None:
    folder = TESTS / "kernels"
    sets = (["--full"], [], ["--rest"])
    printed = outputs_of_pytest(*(({}, ["--collect-only", *options, str(folder)]) for options in sets))
    every, quick, rest = ({line for line in each.splitlines() if "::" in line} for each in printed)
    assert quick | rest == every
    drawn = {test.partition("::")[2].partition("[")[0] for test in quick & rest}
    source = "".join(path.read_text(encoding="utf-8") for path in folder.glob("test_*.py"))
    assert drawn == set(re.findall(r"@given(?:.*\n)+?def (\w+)", source))
    assert drawn and len(rest - quick) > 20


@pytest.mark.process
def test_a_seed_draws_the_same_cases_wherever_the_tests_run() -> None:
    one = "tests/kernels/test_bounded.py::test_the_minimum_is_the_best_of_all_choices_of_sides"
    options = ("--full", "--hypothesis-verbosity=verbose", "--capture=no", one)
    printed = outputs_of_pytest(
        *(
            (ci, [*options, f"--hypothesis-seed={seed}"])
            for ci, seed in (({}, 0), ({}, 1), ({"CI": "true"}, 1))
        )
    )
    zero, first, in_ci = (re.findall(r"\bseed=\d+", each) for each in printed)
    assert zero != first == in_ci and len(first) >= 10


# Each run is a process of its own, forked from one that has loaded the library.
RUNS_OF_PYTEST = """
import json, os, sys
import benchmarks.baselines
assert not {"pytest", "hypothesis"} & set(sys.modules)  # what they do may depend on the environment
os.environ.pop("CI", None)
for environment, options in json.loads(sys.argv[1]):
    child = os.fork()
    if child == 0:
        os.environ.update(environment)
        import pytest
        sys.exit(pytest.main(options))
    assert os.waitpid(child, 0)[1] == 0, options
    print("end of a run", flush=True)
"""


def outputs_of_pytest(*runs: tuple[dict[str, str], list[str]]) -> list[str]:
    """What pytest prints, for each addition to the environment and the options with it."""
    command = [sys.executable, "-c", RUNS_OF_PYTEST, json.dumps(runs)]
    done = subprocess.run(command, cwd=TESTS.parent, check=True, capture_output=True, text=True, timeout=120)
    return done.stdout.split("end of a run\n")[:-1]
