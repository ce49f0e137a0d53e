"""What is held counts while its page goes on telling; one page has control."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from pinposture.errors import InvalidValue
from pinposture.operate import Control
from pinposture.operate.control import CONTROL

HELD = {"do": "hold", "ahead": 0.5, "left": -1.0, "up": 0.0, "override": 0.25}


def tell(control: Control, page: str, message: Any, now: float) -> dict[str, Any]:
    return control.take(page, json.dumps({"do": message} if isinstance(message, str) else message), now)


def in_control(page: str = "a") -> Control:
    control = Control()
    assert tell(control, page, "ask", 0.0)["control"] == "yours"
    tell(control, page, "release", 0.0)
    return control


def test_what_is_held_is_ordered_until_it_is_released() -> None:
    control = in_control()
    assert control.order(0.0) is None
    assert tell(control, "a", HELD, 0.01) == {"control": "yours", "asked": False, "held": True}
    order = control.order(0.02)
    assert order is not None
    np.testing.assert_array_equal(order.direction, [0.5, -1.0, 0.0])
    assert (order.override, control.reason) == (0.25, "")
    assert not tell(control, "a", "release", 0.03)["held"]
    assert (control.order(0.03), control.reason) == (None, "nothing is held")


def test_a_page_that_falls_silent_holds_nothing_until_it_has_released() -> None:
    for asked_meanwhile in (True, False):
        control = in_control()
        tell(control, "a", HELD, 1.0)
        assert control.order(0.999 + CONTROL.lost) is not None
        late = 1.001 + CONTROL.lost
        if asked_meanwhile:
            assert control.order(late) is None
        assert not tell(control, "a", HELD, late)["held"]  # such as what the network kept back
        assert control.order(late) is None
        assert "release, and hold again" in control.reason
        tell(control, "a", "release", late)
        assert tell(control, "a", HELD, late)["held"]


def test_another_page_gets_control_by_consent_alone_and_must_release_first() -> None:
    control = in_control()
    assert tell(control, "b", HELD, 0.0) == {"control": "taken", "asked": False, "held": False}
    assert control.order(0.0) is None
    tell(control, "b", "ask", 0.0)
    assert tell(control, "a", HELD, 0.01) == {"control": "yours", "asked": True, "held": True}
    assert not tell(control, "b", "give", 0.02)["held"]
    assert tell(control, "a", HELD, 0.02)["control"] == "yours"
    assert tell(control, "a", "give", 0.03)["control"] == "taken"
    assert control.order(0.03) is None
    assert tell(control, "b", HELD, 0.04) == {"control": "yours", "asked": False, "held": False}
    assert control.reason == "it was held before the page had control; release, and hold again"
    tell(control, "b", "release", 0.05)
    assert tell(control, "b", HELD, 0.06)["held"]


def test_the_end_of_a_page_ends_what_it_holds_and_the_one_that_asks_gets_control() -> None:
    control = in_control()
    tell(control, "a", HELD, 0.0)
    control.leave("a")
    assert (control.order(0.0), control.reason) == (None, "no page has control")
    control = in_control()
    tell(control, "b", "ask", 0.0)
    control.leave("c")
    control.leave("a")
    assert tell(control, "b", "release", 0.0)["control"] == "yours"
    control = in_control()
    tell(control, "b", "ask", 0.0)
    control.leave("b")
    tell(control, "a", "give", 0.0)
    assert tell(control, "b", "release", 0.0)["control"] == "free"


@pytest.mark.parametrize(
    "text",
    ["", "no JSON", "[]", "null", "{}", '{"do": "go"}', '{"do": []}', "[" * 100_000, "1" * 5000]
    + [json.dumps({**HELD, "ahead": value}) for value in (None, "1", True, 1.5, -1.5, float("nan"), [1])]
    + [json.dumps({**HELD, "override": value}) for value in (None, -0.1, 1.1, float("inf"))]
    + ['{"do": "hold"}'],
)
def test_what_is_no_message_is_refused_and_ends_what_was_held(text: str) -> None:
    control = in_control()
    tell(control, "a", HELD, 0.0)
    with pytest.raises(InvalidValue):
        control.take("b", text, 0.0)
    assert control.order(0.0) is not None  # another page cannot end it
    with pytest.raises(InvalidValue):
        control.take("a", text.encode(), 0.0)
    assert control.order(0.0) is None
