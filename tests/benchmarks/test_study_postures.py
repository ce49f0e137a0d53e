"""The study over postures: its cases, their order, and what it says of them."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from joblib import parallel_config

from benchmarks.cases.families import Subject, built_subject
from benchmarks.harness import Row
from benchmarks.studies.postures import COMPARED, GROUPS, by_group, draw_postures, study_postures
from benchmarks.studies.runs import arrived, lawful, near
from pinposture.errors import InvalidValue, UnknownName

NAMES = ("joint", "lm")


@pytest.fixture(scope="session")
def small():
    return Subject("small", template_arm("RyRz", 4), ("random", "folded"))


@pytest.fixture(scope="session")
def flat():
    return Subject("flat", template_arm("RzRz", 4), ("random",))


def untimed(records):
    return [record.but(seconds=0.0) for record in records]


@pytest.fixture(scope="module")
def records(small, flat):
    seen = []
    found = study_postures([small, flat], NAMES, cases=12).rows(progress=lambda *at: seen.append(at))
    assert seen == [(k, 24) for k in range(1, 25)]
    return found


def test_every_family_has_its_turn_and_every_controller_the_same_cases(small, flat, records):
    assert len(records) == 2 * 12 * 2
    assert [record.controller for record in records] == list(NAMES) * 24
    cases = [tuple(record.values())[:4] for record in records]
    assert cases[::2] == cases[1::2]
    expected = [("small", *small.families[k % 10], k // 10) for k in range(12)]
    expected += [("flat", *flat.families[k % 5], k // 5) for k in range(12)]
    assert cases[::2] == expected
    for first, second in zip(records[::2], records[1::2], strict=True):
        assert first.turn == second.turn


@pytest.mark.long
def test_results_do_not_depend_on_the_number_of_processes(small, flat, records):
    again = study_postures([small, flat], NAMES, cases=12).rows(jobs=2)
    assert untimed(again) == untimed(records)


def test_backends_of_joblib_apply(small, records):
    with parallel_config(backend="threading"):
        again = study_postures([small], NAMES, cases=3).rows(jobs=2)
    assert untimed(again) == untimed(records[:6])


def test_a_shorter_study_with_other_controllers_has_the_same_cases(small, records):
    shorter = study_postures([small], ["lm"], cases=7).rows()
    assert untimed(shorter) == untimed(records[1:14:2])
    later = study_postures([small], ["lm"], cases=2, first_seed=1).rows()
    assert untimed(later) == untimed([records[21], records[23]])


def test_joint_interpolation_gets_everywhere_within_the_limits(records):
    joint = [record for record in records if record.controller == "joint"]
    assert all(arrived(record) and lawful(record) for record in joint)
    assert all(record.status == "converged" for record in joint)
    assert max(record.stride for record in joint) == pytest.approx(1.0)


def test_the_default_is_a_thousand_cases_with_the_controllers_of_interest():
    study = study_postures([built_subject("planar45")])
    assert len(study.cases) == 1000
    assert tuple(each.name for each in study.methods) == COMPARED
    assert COMPARED == ("geodesic", "selection", "projection", "switching", "lm", "joint")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"subjects": []}, "subjects"),
        ({"controllers": []}, "controllers"),
        ({"cases": 0}, "cases"),
        ({"cases": 1.5}, "cases"),
        ({"first_seed": -1}, "first_seed"),
    ],
)
def test_what_makes_no_study_is_refused(small, change, message):
    with pytest.raises(InvalidValue, match="jobs"):
        study_postures([small], NAMES, 1).rows(jobs=0)
    with pytest.raises(InvalidValue, match=message):
        study_postures(**{"subjects": [small], "controllers": NAMES, "cases": 1, **change})
    with pytest.raises(UnknownName, match="simplex"):
        study_postures([small], ["simplex"], 1)


def one(start="smooth", target="random", controller="lm", error=0.0, steps=10, **fields) -> Row:
    """A row made by hand."""
    known = Row(arm="a", start=start, target=target, seed=0, controller=controller, status="converged")
    known |= {"steps": steps, "error": error, "rising": 0.1, "escaping": 0.0, "peak": 1.0, "path": 1.2}
    known |= {"turn": 2.0, "seconds": 1e-3, "violation": 0.0, "stride": 1.0}
    return known.but(**fields)


def test_a_summary_of_runs_made_by_hand():
    runs = [one(error=e, steps=s, path=p) for e, s, p in ((0, 10, 1.0), (1e-5, 20, 1.5), (0, 60, 3.0))]
    runs += [
        one(error=0.2, steps=400, path=9.0, violation=0.02, status="refused")
    ]  # tells nothing of the way
    runs += [one(steps=0, path=1.0)]  # nor does this
    (row,) = by_group(runs)
    assert (row.arm, row.group, row.controller, row.runs, row.refused) == ("a", "smooth", "lm", 5, 1)
    assert row.arrived == pytest.approx(3 / 5)
    assert row.near == pytest.approx(4 / 5)
    assert row.steps == {"median": 20.0, "high": pytest.approx(20 + 0.8 * 40)}
    assert row.path == {"median": 1.5, "high": pytest.approx(1.5 + 0.8 * 1.5)}
    assert row.rising == pytest.approx({"median": 0.1, "high": 0.1})
    assert (row.violation, row.stride, lawful(row)) == (0.02, 1.0, False)
    (lost,) = by_group([one(error=0.2)])
    assert lost.steps is lost.path is lost.peak is None
    assert lawful(lost)


def test_groups_are_by_start_but_folds_by_target():
    runs = [
        one(start, target, controller)
        for start in ("straight", "noise", "uniform-0.6", "uniform-1.5", "smooth")
        for target in ("random", "folded")
        for controller in ("geodesic", "lm")
    ]
    rows = by_group(runs)
    assert [(row.group, row.controller) for row in rows[::2]] == [(group, "geodesic") for group in GROUPS]
    assert [row.runs for row in rows[::2]] == [1, 2, 2, 5]
    families = by_group(runs, families=True)
    assert len(families) == 20
    assert families[0].group == "straight -> random"
    assert sum(row.runs for row in families) == sum(row.runs for row in rows) == 20


def test_the_picture_shows_the_shares_and_the_paths(records):
    figure = draw_postures(records)
    assert figure.get_size_inches()[0] * figure.dpi == 1200
    shares, paths, *_ = figure.axes
    assert len(figure.axes) == 4
    rows = [row for row in by_group(records, families=True) if row.arm == "small"]
    shown = [text.get_text() for text in shares.texts]
    assert shown == [f"{int(100 * row.arrived + 1e-9)}" for row in rows]
    assert [tick.get_text() for tick in shares.get_xticklabels()] == list(NAMES)
    assert [tick.get_text() for tick in paths.get_xticklabels()] == list(GROUPS)
    assert len(paths.patches) == sum(
        any(near(run) and run.steps for run in records if run.arm == "small" and wanted(run, row))
        for row in by_group(records)
        if row.arm == "small"
    )
    figure.canvas.draw()
    with pytest.raises(InvalidValue, match="at least one run"):
        draw_postures([])


def wanted(run, row):
    (own,) = by_group([run])
    return (own.group, own.controller) == (row.group, row.controller)


def test_medians_are_those_of_the_runs_on_record(records):
    (row,) = [r for r in by_group(records) if (r.arm, r.group, r.controller) == ("small", "folds", "joint")]
    steps = [r.steps for r in records if r.controller == "joint" and r.target == "folded"]
    assert row.steps.median == np.median(steps)
    assert row.runs == len(steps)
