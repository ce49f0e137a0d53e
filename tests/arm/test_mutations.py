"""A valid file, mutated at random: an arm in order or a `PostureError`; nothing else, and never for long."""

from __future__ import annotations

import copy
import time
import warnings
import xml.etree.ElementTree as ET
from functools import cache

import numpy as np
from arm.awkward import FINGERS, FLOATS, TWO_ARMS
from arm.describing import LINK, X, Z, arm_text, fixed, limit, links, pairs
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.errors import PostureError, PostureWarning

SECONDS = 2.0
NUMBERS = [
    "0",
    "-0",
    "1",
    "-1",
    "1e-300",
    "1e-9",
    "1e9",
    "1e99",
    "1e308",
    "1e400",
    "nan",
    "inf",
    "-inf",
    "0x1",
    "1,5",
    "",
]
TYPES = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "ball", "Fixed", ""]
WORDS = [
    "l0",
    "l1",
    "l2",
    "j1",
    "j2",
    "tip",
    "base",
    "world",
    "universe",
    "module_01",
    "\u00e9",
    " ",
    "a\nb",
    "x" * 300,
]
TAGS = [
    "robot",
    "link",
    "joint",
    "parent",
    "child",
    "origin",
    "axis",
    "limit",
    "mimic",
    "dynamics",
    "material",
    "g",
]
VECTORS = st.lists(st.sampled_from(NUMBERS), min_size=2, max_size=4).map(" ".join)
VALUES = st.one_of(
    st.sampled_from(NUMBERS + TYPES + WORDS),
    VECTORS,
    st.floats().map(repr),
    st.text("<>&'\"${}[]()\u00e9\u4e2d\t ab1", max_size=6),
)


@cache
def files():
    joints = [("revolute", Z, LINK), ("prismatic", X, LINK, limit(0, 0.1)), ("continuous", Z, LINK, "")] * 2
    return [
        template_arm("RyRz", 3).urdf,
        arm_text(pairs(2), extra=FINGERS + links(["eye"]) + fixed("look", "l2", "eye", "0 0 0.1", "0 1 0")),
        arm_text(joints),
        FLOATS,
        TWO_ARMS,
    ]


def printable(text):
    return (
        "".join(c for c in text if c.isprintable() or c in "\t\n")
        if text.isprintable() or "\n" in text
        else "?"
    )


@st.composite
def mutants(draw):
    root = ET.fromstring(draw(st.sampled_from(files())))
    for _ in range(draw(st.integers(1, 4))):
        pairs_ = [(parent, child) for parent in root.iter() for child in parent]
        if not pairs_:
            break
        parent, child = draw(st.sampled_from(pairs_))
        what = draw(st.integers(0, 8))
        if what == 0:
            parent.remove(child)
        elif what == 1:
            parent.insert(draw(st.integers(0, len(parent))), copy.deepcopy(child))
        elif what == 2:
            child.tag = draw(st.sampled_from(TAGS))
        elif what == 3:
            other = draw(st.sampled_from(pairs_))[1]
            if other is not child and child not in list(other.iter()):
                child.append(copy.deepcopy(other))
        elif what == 4:
            child.set(
                draw(st.sampled_from(["name", "type", "link", "xyz", "rpy", "lower", "velocity", "joint"])),
                printable(draw(VALUES)),
            )
        elif child.attrib:
            name = draw(st.sampled_from(sorted(child.attrib)))
            value = child.attrib[name]
            if what == 5:
                del child.attrib[name]
            elif what == 6:
                child.set(draw(st.sampled_from(["nane", "TYPE", "upper", "xyz"])), child.attrib.pop(name))
            else:
                words = value.split() or [""]
                words[draw(st.integers(0, len(words) - 1))] = printable(draw(VALUES))
                child.set(name, " ".join(words))
    return ET.tostring(root, encoding="unicode")


ARGUMENTS = st.fixed_dictionaries(
    {},
    optional={
        "tip": st.sampled_from(["tip", "l2", "f1", "b2", "nowhere"]),
        "base": st.sampled_from(["l0", "l1", "base"]),
        "split": st.sampled_from([1, 2, 3, [2, 2], ["l2", "tip"], "tip"]),
        "locked": st.sampled_from([{"j1": 0.5}, {"free": 0.0}, {"j2": 1e300}]),
    },
)


@given(mutants(), ARGUMENTS)
@examples(700)
def test_only_our_errors_come_out_and_soon(text, arguments):
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", PostureWarning)
            arm = pp.Arm.load(text, **arguments)
    except PostureError as error:
        assert str(error)
    else:
        assert sum(map(len, arm.module_joints)) == arm.nv >= 1
        assert 0.0 < arm.length < np.inf and np.all(np.isfinite(arm.plane))
        state = arm.at(arm.random(np.random.default_rng(0)))
        for values in (state.points, state.jacobians, state.manipulability(), arm.chain.points):
            assert np.all(np.isfinite(values))
    assert time.perf_counter() - start < SECONDS


def test_the_files_are_valid_before_they_are_mutated():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        for text in files()[:-1]:
            assert pp.Arm.load(text).nv >= 4
        assert pp.Arm.load(files()[-1], tip="b2").nv == 2
