"""Results come in the order of the calls; a number of processes that is none is refused by every study."""

from __future__ import annotations

import pytest
from joblib import delayed

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.motion.processes import in_order
from pinposture.study import compare_methods, study, survey_arms
from pinposture.thesis.scenarios import SPATIAL_SCENARIOS

ARM = pp.Arm.from_template("RyRz", 3)


@pytest.mark.parametrize("jobs", [1, 2, -1])
def test_results_are_in_the_order_of_the_calls(jobs: int) -> None:
    assert list(in_order((delayed(pow)(n, 2) for n in range(7)), jobs)) == [n**2 for n in range(7)]


@pytest.mark.parametrize("jobs", [0, -2, True, 1.5, "2"])
def test_a_number_of_processes_that_is_none_is_refused(jobs: object, tmp_path) -> None:
    (tmp_path / "arm.urdf").write_text(ARM.urdf)
    calls = (
        lambda: study(ARM, SPATIAL_SCENARIOS[:1], ["joint"], [0], jobs=jobs),
        lambda: compare_methods(ARM, ["joint"], [0], jobs=jobs),
        lambda: survey_arms(tmp_path, jobs=jobs),
    )
    for call in calls:
        with pytest.raises(InvalidValue, match="jobs"):
            call()
