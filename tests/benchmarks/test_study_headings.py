"""The study over changes of heading: its pairs, its bins, and who gets there."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from sampling import seeds

from benchmarks.cases.families import built_subject
from benchmarks.cases.scenarios import curve_along, largest_turn
from benchmarks.harness import Row
from benchmarks.studies.headings import (
    BINS,
    HEADING,
    bin_of,
    by_heading,
    draw_headings,
    draw_pair,
    study_headings,
)
from benchmarks.studies.runs import arrived
from pinposture.errors import InvalidValue, UnknownName
from pinposture.placement import resolve_targets

NAMES = ("planar45", "ryrz20")


@cache
def subject_named(name):
    return built_subject(name)


@pytest.fixture(scope="module")
def subjects():
    return [subject_named(name) for name in NAMES]


@pytest.fixture(scope="module")
def planar():
    return subject_named("planar45")


@pytest.fixture(scope="module")
def records(subjects):
    return study_headings(subjects, ("lm", "joint"), pairs=14).rows()


@pytest.mark.parametrize(
    ("turn", "name"),
    [(0.0, "< 2"), (1.999, "< 2"), (2.0, "2 - pi"), (3.14, "2 - pi"), (np.pi, "pi - 4"), (3.99, "pi - 4")]
    + [(4.0, "4 - 6"), (6.0, "> 6"), (50.0, "> 6")],
)
def test_bins_begin_at_their_lower_edge(turn, name):
    assert bin_of(turn) == name


@pytest.mark.parametrize("name", NAMES)
def test_pairs_fill_every_bin(planar, name):
    subject, turns = subject_named(name), []
    for seed in range(150):
        start, goal = draw_pair(subject.arm, seed)
        turns.append(largest_turn(subject.arm, start, goal))
        assert subject.arm.within_limits(start)
        assert subject.arm.within_limits(goal)
    counts = [sum(bin_of(turn) == name for turn in turns) for name in BINS]
    assert min(counts) >= 4
    assert max(turns[0], largest_turn(planar.arm, *draw_pair(planar.arm, 0))) <= 2 * HEADING


@pytest.mark.studies
def test_joint_interpolation_knows_the_way_round_and_least_squares_does_not(records):
    bins = {(each.arm, each.controller, each.bin): each for each in by_heading(records)}
    assert len(bins) == 2 * 2 * 5
    for name in BINS:
        both = [bins["planar45", controller, name] for controller in ("joint", "lm")]
        assert both[0].runs == both[1].runs
        assert both[0].reached == both[0].runs
    wide = [bins["planar45", "lm", name] for name in BINS[3:]]
    assert sum(each.runs for each in wide) >= 3
    assert sum(each.reached for each in wide) < sum(each.runs for each in wide) / 2
    assert sum(each.runs for each in bins.values()) == len(records)


@pytest.mark.studies
def test_records_say_what_they_are_and_do_not_depend_on_the_number_of_processes(subjects, records):
    assert {(record.start, record.target) for record in records} == {("bent", "configuration")}
    assert [record.seed for record in records[:4]] == [0, 0, 1, 1]
    again = study_headings(subjects, ["joint"], pairs=5, first_seed=3).rows(jobs=2)
    expected = [*records[7:17:2], *records[28 + 7 : 28 + 17 : 2]]
    assert [each.but(seconds=0.0) for each in again] == [each.but(seconds=0.0) for each in expected]


@pytest.mark.parametrize("name", NAMES)
def test_a_curve_through_the_points_keeps_the_way_round(name):
    subject = subject_named(name)
    for seed in seeds(12):
        _, goal = draw_pair(subject.arm, seed)
        target = resolve_targets(subject.arm, curve_along(subject.arm, goal), placement="as_is")
        assert largest_turn(subject.arm, goal, target.q) < np.pi / 2


def test_targets_on_a_curve_are_reached_where_it_puts_them(planar):
    (record,) = study_headings([planar], ["joint"], pairs=1, knowledge="curve").rows()
    start, goal = draw_pair(planar.arm, 0)
    target = resolve_targets(planar.arm, curve_along(planar.arm, goal), placement="as_is")
    assert (record.target, arrived(record)) == ("curve", True)
    assert record.turn == largest_turn(planar.arm, start, target.q)
    assert record.turn != largest_turn(planar.arm, start, goal)


def one(turn, error=0.0, violation=0.0, stride=1.0, path=1.2) -> Row:
    row = Row(arm="a", controller="lm", steps=10, error=error, path=path, turn=turn)
    return row.but(violation=violation, stride=stride)


def test_who_leaves_the_limits_has_not_reached():
    runs = [
        one(1.0),
        one(1.0, error=2e-3),
        one(1.0, violation=1e-6),
        one(1.0, stride=1.1),
        one(5.0, path=2.0),
    ]
    below, *_, wide, top = by_heading([*runs, one(None)])
    assert (below.bin, below.runs, below.reached) == ("< 2", 4, 1)
    assert below.path.median == pytest.approx(1.2)
    assert (wide.bin, wide.runs, wide.reached, wide.path.median) == ("4 - 6", 1, 1, 2.0)
    assert (top.runs, top.reached, top.path, top.steps) == (0, 0, None, None)


@pytest.mark.studies
def test_the_picture_shows_the_shares(records):
    figure = draw_headings(records)
    assert len(figure.axes) == 4
    bars = figure.axes[0].containers
    assert [bar.get_label() for bar in bars] == ["lm", "joint"]
    found = [each for each in by_heading(records) if (each.arm, each.controller) == ("planar45", "joint")]
    heights = [patch.get_height() for patch in bars[1]]
    assert heights == [pytest.approx(1.0 if each.runs else 0.008) for each in found]
    assert [tick.get_text() for tick in figure.axes[0].get_xticklabels()] == list(BINS)
    figure.canvas.draw()
    with pytest.raises(InvalidValue, match="at least one run"):
        draw_headings([one(None)])


def test_what_makes_no_study_is_refused(planar):
    with pytest.raises(InvalidValue, match="pairs"):
        study_headings([planar], ["joint"], pairs=0)
    with pytest.raises(InvalidValue, match="first_seed"):
        study_headings([planar], ["joint"], pairs=1, first_seed=-1)
    with pytest.raises(InvalidValue, match="subjects"):
        study_headings([], ["joint"], pairs=1)
    with pytest.raises(UnknownName, match="configuration, curve"):
        study_headings([planar], ["joint"], pairs=1, knowledge="points")
