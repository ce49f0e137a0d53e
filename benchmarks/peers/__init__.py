"""Methods that are timed against each other, ours and others', behind one small protocol.

This file is read in every environment: the standard library only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from benchmarks.peers.method import Method
    from benchmarks.peers.problem import Problem


class Entry(NamedTuple):
    """A method that can be timed.

    Attributes:
        label: what tables call it.
        home: module of this package that defines the class `Peer`.
        environment: name of the environment that it runs in, as `environments.ENVIRONMENTS`.
        option: passed to the class; which of several methods it shall be.
        largest: most DOF that make sense: dense methods take minutes a run beyond.
    """

    label: str
    home: str
    environment: str
    option: str = ""
    largest: int = 100_000


DENSE = 400

METHODS = {
    "geodesic": Entry("geodesic (default)", "ours", "ours", "geodesic"),
    "geodesic-points": Entry("geodesic, points only", "ours", "ours", "geodesic-points"),
    "selection": Entry("selection", "ours", "ours", "selection"),
    "projection": Entry("projection", "ours", "ours", "projection"),
    "switching": Entry("switching", "ours", "ours", "switching"),
    "joint": Entry("joint", "ours", "ours", "joint"),
    "lm": Entry("lm", "ours", "ours", "lm", DENSE),
    "dls": Entry("dls", "ours", "ours", "dls", DENSE),
    "placo": Entry("placo (C++)", "placo", "placo", largest=DENSE),
    "numpy-lm": Entry("LM, numpy", "numpy_lm", "ours", largest=DENSE),
    "pink": Entry("pink, daqp", "pink", "pink", largest=DENSE),
    "mink": Entry("mink, daqp", "mink", "mink", largest=DENSE),
    "scipy": Entry("scipy (evaluation)", "scipy", "ours", largest=DENSE),
}
"""All methods, by the name that the command line takes. The first is what the others are compared with."""

REFERENCE = "geodesic"


def build(name: str, problem: Problem) -> Method:
    """Set a method up for an arm; imports what it needs."""
    entry = METHODS[name]
    made: Method = import_module(f"benchmarks.peers.{entry.home}").Peer(problem, entry.option)
    return made
