"""Descriptions that are in order as such, and what becomes of them as arms."""

from __future__ import annotations

import numpy as np
from arm.describing import HERE, LINK, X, Y, Z, arm_text, fixed, limit, links, moving, pairs, robot

from pinposture.errors import InvalidValue, UnknownName, URDFError

FINGERS = (
    links(["f1", "f2"])
    + moving("finger1", "tip", "f1", "prismatic", limits=limit(0, 0.04))
    + moving("finger2", "tip", "f2", "prismatic", limits=limit(0, 0.04), more='<mimic joint="finger1"/>')
)
TWO_ARMS = robot(
    links(["base", "a1", "a2", "b1", "b2"])
    + moving("ja1", "base", "a1")
    + moving("ja2", "a1", "a2", axis=Z)
    + moving("jb1", "base", "b1")
    + moving("jb2", "b1", "b2", axis=Z)
)
FLOATS = arm_text(pairs(2)).replace(
    '<link name="l0"/>',
    links(["world", "l0"])
    + '<joint name="free" type="floating"><parent link="world"/><child link="l0"/></joint>',
)
MIMIC_ON_CHAIN = (
    arm_text(pairs(2))
    .replace("</joint>", '<mimic joint="j1"/></joint>', 3)
    .replace('<mimic joint="j1"/></joint>', "</joint>", 2)
)


def typed(kind, number):
    """An arm whose joint of that number is of that type."""
    return arm_text(pairs(2)).replace(f'name="j{number}" type="revolute"', f'name="j{number}" type="{kind}"')


REFUSED = {
    # text, arguments of Arm.load, kind of error, words in the message
    "two arms": (TWO_ARMS, {}, URDFError, "links 'a2', 'b2': are the ends of chains with equally many"),
    "two arms, one asked for": (TWO_ARMS, {"base": "a1", "tip": "b2"}, URDFError, "not below link 'a1'"),
    "base alone": (arm_text(pairs(2)), {"base": "l1"}, InvalidValue, "pass tip= as well"),
    "unknown base": (arm_text(pairs(2)), {"base": "x", "tip": "tip"}, UnknownName, "link is called 'x'"),
    "unknown tip": (arm_text(pairs(2)), {"tip": "typ"}, UnknownName, "did you mean 'tip'"),
    "tip that is no name": (arm_text(pairs(2)), {"tip": ["tip"]}, InvalidValue, "allowed: text"),
    "base beyond tip": (arm_text(pairs(2)), {"base": "l3", "tip": "l1"}, URDFError, "not below"),
    "base is tip": (arm_text(pairs(2)), {"base": "l3", "tip": "l3"}, URDFError, "has no moving joint"),
    "nothing moves": (robot(links("ab") + fixed("j", "a", "b")), {}, URDFError, "has no moving joint"),
    "a lone link": (robot(links("a")), {}, URDFError, "has no moving joint"),
    "limits of zero lock everything": (
        arm_text([("revolute", Y, LINK, limit(0, 0))]),
        {"tip": "tip"},
        URDFError,
        "limits allow a single position of: 'j1'",
    ),
    "one limit missing and the other zero": (
        arm_text([("revolute", Y, LINK, limit(0))]),
        {"tip": "tip"},
        URDFError,
        "limits allow a single position",
    ),
    "no length": (arm_text([("revolute", Y, HERE)] * 3, tip=HERE), {}, URDFError, "has zero length"),
    "too short": (
        arm_text(pairs(1), tip="1e-11 0 0").replace(LINK, "1e-11 0 0"),
        {},
        URDFError,
        "allowed: 1e-09",
    ),
    "too long": (arm_text(pairs(2)).replace(LINK, "1e60 0 0"), {}, URDFError, "m long; allowed"),
    "mimic of a joint that does not exist": (
        MIMIC_ON_CHAIN.replace('mimic joint="j1"', 'mimic joint="j9"'),
        {"tip": "tip"},
        URDFError,
        "'j3': mimics joint 'j9', which does not exist",
    ),
    "modules that cut through coupled joints": (
        MIMIC_ON_CHAIN,
        {"tip": "tip", "split": 2},
        InvalidValue,
        "between coupled joints",
    ),
    "floating mid-chain": (typed("floating", 3), {"tip": "tip"}, URDFError, "'j3': type 'floating' cannot"),
    "planar mid-chain": (typed("planar", 2), {"tip": "tip"}, URDFError, "'j2': type 'planar' cannot"),
    "lock of no joint": (arm_text(pairs(2)), {"locked": {"j9": 0.0}}, UnknownName, "'j9'"),
    "lock of a fixed joint": (arm_text(pairs(2)), {"locked": {"jt": 0.0}}, UnknownName, "'jt'"),
    "lock at nan": (arm_text(pairs(2)), {"locked": {"j1": float("nan")}}, InvalidValue, "locked.j1"),
    "lock at a word": (arm_text(pairs(2)), {"locked": {"j1": "up"}}, InvalidValue, "locked.j1 is 'up'"),
    "lock of a floating joint": (FLOATS, {"locked": {"free": 0.0}}, InvalidValue, "not a single number"),
    "all locked": (
        arm_text([("revolute", Y, LINK)]),
        {"locked": {"j1": 0.0}, "tip": "tip"},
        URDFError,
        "has no moving joint; locked= locks: 'j1'",
    ),
    "nothing but floating joints": (
        arm_text([("floating", Y, LINK, "")] * 9),
        {"tip": "tip"},
        URDFError,
        "has no joint that can move an arm; floating and planar joints do not count (only revolute, "
        "continuous, prismatic): 'j1', 'j2'",
    ),
    "modules do not divide": (
        arm_text(pairs(2)),
        {"split": 3},
        InvalidValue,
        "a divisor of 4 joints: 1, 2, 4",
    ),
    "modules of nothing": (arm_text(pairs(2)), {"split": 0}, InvalidValue, "divisor"),
    "modules of minus one": (arm_text(pairs(2)), {"split": -2}, InvalidValue, "divisor"),
    "modules do not add up": (arm_text(pairs(2)), {"split": [2, 3]}, InvalidValue, "add up to 4"),
    "an empty module": (arm_text(pairs(2)), {"split": [2, 0, 2]}, InvalidValue, "add up to 4"),
    "no modules": (arm_text(pairs(2)), {"split": []}, InvalidValue, "names of links"),
    "half a joint": (arm_text(pairs(2)), {"split": 2.5}, InvalidValue, "names of links"),
    "modules true": (arm_text(pairs(2)), {"split": True}, InvalidValue, "names of links"),
    "names and numbers": (arm_text(pairs(2)), {"split": ["l2", 2]}, InvalidValue, "names of links"),
    "module ends at no link": (arm_text(pairs(2)), {"split": ["l9", "tip"]}, UnknownName, "'l9'"),
    "modules out of order": (
        arm_text(pairs(2)),
        {"split": ["l3", "l2", "tip"]},
        InvalidValue,
        "in order from base to tip",
    ),
    "module without a joint": (arm_text(pairs(2)), {"split": ["l1", "tip"]}, InvalidValue, "link 'l1'"),
    "joints left over": (arm_text(pairs(2)), {"split": ["l2"], "tip": "tip"}, InvalidValue, "all 4 joints"),
    "locked without positions": (
        arm_text(pairs(2)),
        {"locked": ["j1"]},
        InvalidValue,
        "locked is ['j1']; allowed: a mapping",
    ),
    "couplings of no mapping": (
        arm_text(pairs(2)),
        {"couplings": 3},
        InvalidValue,
        "couplings is 3; allowed: a",
    ),
    "folders of numbers": (arm_text(pairs(2)), {"package_dirs": [3]}, InvalidValue, "paths of folders"),
}

WARNED = {
    # text, arguments, number of joints and of modules that result, words in the warnings, one string for each
    "no limits": (
        arm_text([("revolute", Y, LINK, limit()), ("prismatic", Z, LINK, limit()), *pairs(1)]),
        {},
        4,
        3,
        [
            "no limits are given for joints 'j1', 'j2'; treated as unlimited",
            "modules 1, 2: too few of their joints' axes differ",
        ],
    ),
    "joints that may not move": (
        arm_text([("revolute", Y, LINK, limit(-1, 1, velocity=0)), ("revolute", Z, LINK), *pairs(1)]),
        {},
        4,
        2,
        ["the velocity limit of joint 'j1' is 0; treated as no limit"],
    ),
    "limits in degrees": (
        arm_text([("revolute", Y, LINK, limit(-90, 90)), ("revolute", Z, LINK, limit(-15, 10)), *pairs(1)]),
        {},
        4,
        2,
        ["limits of joints 'j1', 'j2' are up to 90 rad; are they in degrees?"],
    ),
    "millimetres": (
        arm_text([("revolute", Y, "50 0 0"), ("revolute", Z, "50 0 0")] * 2, tip="50 0 0"),
        {},
        4,
        2,
        ["the arm is 200 m long; is it in millimetres, not metres?"],
    ),
    "locked by limits": (
        arm_text([*pairs(1), ("revolute", X, LINK, limit(0, 0)), *pairs(1)]),
        {},
        4,
        2,
        ["limits that allow a single position lock joint 'j3' on the chain"],
    ),
    "floating base": (
        FLOATS,
        {},
        4,
        2,
        ["joint 'free' (floating) at the base of the arm is treated as fixed"],
    ),
    "floating base above the base": (FLOATS, {"base": "l0", "tip": "tip"}, 4, 2, ["'free' (floating)"]),
    "planar first joint": (typed("planar", 1), {}, 3, 1, ["joint 'j1' (planar) at the base"]),
    "a branch": (
        arm_text(
            pairs(2),
            extra=links("ab") + moving("ja", "l1", "a") + moving("jb", "a", "b"),
        ),
        {},
        4,
        2,
        ["2 joints off the chain from 'l0' to 'tip' locked: 2 at link 'l1' ('ja', 'jb')"],
    ),
    "a gripper of two coupled fingers": (
        arm_text(pairs(2), extra=FINGERS),
        {},
        4,
        2,
        ["2 joints off the chain from 'l0' to 'tip' locked: 2 at link 'tip' ('finger1', 'finger2')"],
    ),
    "one of two coupled fingers": (
        arm_text(pairs(2), extra=FINGERS),
        {"tip": "f1"},
        5,
        2,
        ["1 at link 'tip' ('finger2')", "joint 'finger2' off the chain mimic joints on it"],
    ),
    "a follower of nobody": (
        arm_text(pairs(2), extra=links("a") + moving("ja", "l2", "a", more='<mimic joint="x"/>')),
        {},
        4,
        2,
        ["1 joint off the chain", "mimic joints that do not exist"],
    ),
    "part of the arm": (
        arm_text(pairs(3)),
        {"base": "l2", "tip": "l4"},
        2,
        1,
        ["4 joints off the chain"],
    ),
    "a line that slides": (
        arm_text([("prismatic", X, LINK)] * 3),
        {},
        3,
        1,
        ["no group of its joints allows that, so the arm is one module"],
    ),
}

SILENT = {
    # text, arguments, sizes of the modules that result
    "plain": (arm_text(pairs(3)), {}, [2, 2, 2]),
    "limits of several turns": (
        arm_text([("revolute", Y, LINK, limit(-12.5, 12.5)), ("revolute", Z, LINK, limit(-1e6, 1e6))]),
        {},
        [2],
    ),
    "sensors": (
        arm_text(
            pairs(2),
            extra=links("abc")
            + "".join(fixed(f"s{a}", f"l{k}", a, "0 0 0.01") for k, a in enumerate("abc", 1)),
        ),
        {},
        [2, 2],
    ),
    "a deep camera beside the tip": (
        arm_text(
            pairs(2),
            extra=links("abc")
            + fixed("s1", "l4", "a", "0.02 0 0.01")
            + fixed("s2", "a", "b", "0.001 0 0")
            + fixed("s3", "b", "c", rpy="0 1 0"),
        ),
        {},
        [2, 2],
    ),
    "control points' names taken": (
        arm_text(pairs(2)).replace('"l2"', '"module_01"').replace('"j3"', '"module__02"'),
        {},
        [2, 2],
    ),
    "a link and a joint of one name": (arm_text(pairs(2)).replace('"j2"', '"l2"'), {}, [2, 2]),
    "locked": (arm_text(pairs(2)), {"locked": {"j1": 0.3}}, [3]),
    "mimic on the chain": (MIMIC_ON_CHAIN, {"tip": "tip"}, [4]),
    "mimic joint locked": (MIMIC_ON_CHAIN, {"tip": "tip", "locked": {"j3": 0.1}}, [3]),
    "whole numbers of numpy's kind": (arm_text(pairs(2)), {"split": np.int64(4)}, [4]),
    "links as ends": (arm_text(pairs(2)), {"split": ["l2", "tip"]}, [1, 3]),
    "links as ends, chain cut there": (arm_text(pairs(2)), {"split": ["l3"], "locked": {"j4": 0.0}}, [3]),
    "continuous": (arm_text([("continuous", Y, LINK, ""), ("continuous", Z, LINK, "")]), {}, [2]),
    "infinite speed": (arm_text([("revolute", Y, LINK, limit(-1, 1, "inf")), *pairs(1)[1:]]), {}, [2]),
}
