"""Links and joints form one tree, and chains are found in it."""

from __future__ import annotations

import time

import pytest
from arm.describing import LIMIT, joint, links, pinocchio_loads, robot
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.arm.description import read_description
from pinposture.errors import UnknownName, URDFError

# Moving joints j1, j2, j3:  a -j1- b -f1- c -j2- d -f2- e -f3- f,  d -f4- g,  a -j3- h
TREE = robot(
    links("abcdegfh")
    + joint("j1", "a", "b", "revolute", LIMIT)
    + joint("f1", "b", "c")
    + joint("j2", "c", "d", "prismatic", LIMIT)
    + joint("f2", "d", "e")
    + joint("f3", "e", "f")
    + joint("f4", "d", "g")
    + joint("j3", "a", "h", "continuous")
)


def test_a_chain_lists_its_joints_from_base_to_tip():
    read = read_description(TREE)
    assert [joint.name for joint in read.chain("a", "f")] == ["j1", "f1", "j2", "f2", "f3"]
    assert [joint.name for joint in read.chain("c", "g")] == ["j2", "f4"]
    assert read.chain("h", "h") == ()


def test_a_chain_between_links_that_are_not_above_each_other_is_refused():
    read = read_description(TREE)
    for base, tip, above in (
        ("e", "g", "'d', 'c', 'b', 'a'"),
        ("g", "d", "'c', 'b', 'a'"),
        ("b", "a", "none"),
    ):
        with pytest.raises(URDFError) as caught:
            read.chain(base, tip)
        assert caught.value.element == f"link {tip!r}"
        assert repr(base) in caught.value.reason and above in caught.value.reason
    for base, tip in (("a", "z"), ("z", "a")):
        with pytest.raises(UnknownName, match="no link is called 'z'"):
            read.chain(base, tip)


def test_of_tips_that_the_same_joints_move_the_deepest_is_taken_then_the_first():
    assert read_description(TREE).longest_chain() == ("a", "f")
    assert read_description(TREE.replace(joint("f3", "e", "f"), joint("f3", "a", "f"))).longest_chain() == (
        "a",
        "e",
    )
    assert read_description(robot(links("a"))).longest_chain() == ("a", "a")


def test_when_different_joints_lead_to_several_tips_the_choice_is_left_to_the_user():
    last = joint("j4", "h", "i", "revolute", LIMIT)
    text = TREE.replace(links("h"), links("hi")).replace("</robot>", last + "</robot>")
    with pytest.raises(URDFError, match="pass tip= to choose") as caught:
        read_description(text).longest_chain()
    assert caught.value.element == "links 'f', 'i'"
    stuck = text.replace(last, last.replace('lower="-1"', 'lower="3"'))
    assert read_description(stuck).longest_chain() == ("a", "f")


@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=9), st.integers(1, 8))
@examples(300)
def test_any_graph_is_a_tree_or_refused_for_what_it_is(edges, size):
    """Against a search by brute force: the root reaches every link by exactly one way."""
    edges = [(parent % size, child % size) for parent, child in edges]
    text = robot(links(range(size)) + "".join(joint(f"j{i}", *edge) for i, edge in enumerate(edges)))

    def ways(start, goal, left):
        reached = int(start == goal)
        return reached + sum(ways(c, goal, left - 1) for p, c in edges if p == start and left > 0)

    roots = [link for link in range(size) if all(child != link for _, child in edges)]
    tree = len(roots) == 1 and all(ways(roots[0], link, 9) == 1 for link in range(size))
    try:
        read = read_description(text)
    except URDFError as error:
        assert not tree
        doubled = any(sum(child == link for _, child in edges) > 1 for link in range(size))
        if "closes a cycle" in error.reason:
            assert not doubled and len(roots) < 2
        elif "has" not in error.reason and "of joint" not in error.reason:
            assert len(roots) > 1 and not doubled
    else:
        assert tree and read.root == str(roots[0])
        assert pinocchio_loads(read.text)
        for tip in map(str, range(size)):
            path = read.chain(read.root, tip)
            assert [j.parent for j in path] + [tip] == [read.root] + [j.child for j in path]


@pytest.mark.long
def test_very_long_chains_and_circles_take_no_time():
    names = [f"l{i}" for i in range(20_000)]
    joints = [joint(f"j{i}", names[i], names[i + 1], "continuous") for i in range(19_999)]
    start = time.perf_counter()
    assert read_description(robot(links(names) + "".join(joints))).longest_chain() == ("l0", "l19999")
    with pytest.raises(URDFError, match=r"closes a cycle.*\.\.\."):
        read_description(robot(links(names) + "".join(joints) + joint("back", names[-1], names[0])))
    assert time.perf_counter() - start < 8.0
