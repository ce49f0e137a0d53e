"""The URDF guide: the example is an arm, and every message is one that is really given."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

from docs.refusals import CHAIN, FILE, MJCF, SETTLED, refusal, settlements

import pinposture as pp

PAGE = (Path(__file__).parents[2] / "docs/urdf.md").read_text()


def rows(heading: str) -> dict[str, str]:
    """The rows of the table under a heading, by their first cell."""
    part = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return dict(re.findall(r"^\| ([^|]+) \| (`.*`) \|$", part, re.MULTILINE))


def test_every_message_of_a_refusal_is_the_real_one() -> None:
    for heading, cases in (
        ("Refused: the request does not fit", CHAIN),
        ("Refused: MJCF that is no chain", MJCF),
        ("Refused: the file has a fault", FILE),
    ):
        assert rows(heading) == {name: f"`{refusal(load)}`" for name, load in cases.items()}


def test_every_warning_is_the_real_one() -> None:
    real = {name: " ".join(f"`{said}`" for said in settlements(load)) for name, load in SETTLED.items()}
    assert rows("Accepted with a warning") == real


def test_the_description_shown_is_an_arm() -> None:
    (text,) = re.findall(r"```xml\n(.*?)```", PAGE, re.DOTALL)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm = pp.Arm.load(text)
    assert (arm.dimension, arm.segmentation.sizes) == (2, (1, 1))
    assert arm.length == 0.5
    assert "two modules of one joint each, 0.5 m" in PAGE
