"""What is said in the log of a driver, and how often."""

from __future__ import annotations

from pinposture.ros2.diagnostics import Occurrences


def test_a_reason_that_comes_and_goes_is_said_once_and_again_when_it_was_away_for_long() -> None:
    heard = Occurrences()
    computing = "holding: the controller is still computing"
    said = [heard.begin(computing, 0.02 * cycle) for cycle in range(0, 3000, 2)]  # for a minute
    assert said == [True] + [False] * (len(said) - 1)
    assert heard.begin("stalled: joint 'm04_j1_y' stands 0.0005 rad from its target", 60.0)
    assert not heard.begin("stalled: joint 'm04_j1_y' stands -1.25e-05 rad from its target", 61.0)
    assert heard.begin("stalled: joint 'm05_j1_y' stands 0.0005 rad from its target", 62.0)
    assert heard.begin(computing, 75.0)
