"""Results come in the order of the calls; a number of processes that is none is refused by every study."""

from __future__ import annotations

import pytest
from arms import template_arm
from joblib import delayed

from pinposture.errors import InvalidValue
from pinposture.motion.processes import in_order
from pinposture.study import compare_methods, study, survey_arms
from pinposture.study.scenarios import SPATIAL_SCENARIOS


@pytest.mark.parametrize("jobs", [1, 2, -1])
def test_results_are_in_the_order_of_the_calls(jobs: int) -> None:
    assert list(in_order((delayed(pow)(n, 2) for n in range(7)), jobs)) == [n**2 for n in range(7)]


@pytest.mark.parametrize("jobs", [0, -2, True, 1.5, "2"])
def test_a_number_of_processes_that_is_none_is_refused(jobs: object, tmp_path) -> None:
    arm = template_arm("RyRz", 3)
    (tmp_path / "arm.urdf").write_text(arm.urdf)
    calls = (
        lambda: study(arm, SPATIAL_SCENARIOS[:1], ["joint"], [0], jobs=jobs),
        lambda: compare_methods(arm, ["joint"], [0], jobs=jobs),
        lambda: survey_arms(tmp_path, jobs=jobs),
    )
    for call in calls:
        with pytest.raises(InvalidValue, match="jobs"):
            call()
