"""The study of following the leader: its paths, its numbers against closed forms, its picture."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.studies.leader import (
    ARMS,
    MODULE,
    MODULES,
    SHAPES,
    bent_path,
    draw_leader,
    fed_arm,
    study_leader,
)
from pinposture.errors import InvalidValue, UnknownName


@pytest.fixture(scope="module")
def found():
    return study_leader(["ryrz", "hinge"], (0.2, 1.0)).rows()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("curvature", [2.0, 20.0])
def test_paths_have_the_curvature_asked_for(shape, curvature):
    path = bent_path(shape, curvature)
    s = np.linspace(0.0, path.length, 50)
    assert path.curvature(s) == pytest.approx(curvature, rel=1e-5)
    assert np.abs(path.torsion(s)) == pytest.approx(curvature / 2 if shape == "helix" else 0.0, rel=1e-5)
    assert path.length <= 0.9 * MODULE * MODULES * (1 + 1e-9)
    if shape == "arc":
        assert path.length * curvature <= 1.5 * np.pi * (1 + 1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_arms_are_a_metre_long_behind_a_feed(name):
    arm = fed_arm(name)
    assert arm.n_modules == MODULES + 1
    assert arm.chain.length - MODULE == pytest.approx(1.0)


@pytest.mark.studies
def test_every_arm_shape_method_and_bending_has_a_row(found):
    asked = [(each.arm, each.shape, each.method, each.bending) for each in found]
    methods = ("closest", "sequential")
    assert asked == [
        (arm, shape, method, bending)
        for arm, shape in (*(("ryrz", shape) for shape in SHAPES), ("hinge", "arc"))
        for bending in (0.2, 1.0)
        for method in methods
    ]
    assert not any(each.refused for each in found)


@pytest.mark.studies
def test_hinges_on_the_path_are_a_sagitta_off(found):
    for each in found:
        radius = MODULE / each.bending
        sagitta = radius - np.sqrt(radius**2 - MODULE**2 / 4)
        assert each.sagitta == pytest.approx(100.0 * sagitta)  # percent of 1 m
        if each.arm == "hinge":
            assert each.body == pytest.approx(each.sagitta, rel=1e-2)
            assert each.joints == pytest.approx(2 * np.arcsin(each.bending / 2), rel=5e-3)
            assert each.points < 1e-3
        if each.method == "sequential":
            assert each.points < 1e-3
            assert each.body > 0.99 * each.sagitta


@pytest.mark.studies
def test_the_whole_arm_is_closer_where_it_is_placed_as_a_whole(found):
    bodies = {(each.shape, each.method, each.bending): each.body for each in found if each.arm == "ryrz"}
    for shape in SHAPES:
        for bending in (0.2, 1.0):
            assert bodies[shape, "closest", bending] < 0.75 * bodies[shape, "sequential", bending]


@pytest.mark.long
def test_progress_counts_and_wrong_names_are_refused():
    counted = []
    study_leader(["hinge"], (0.1,), ("closest",)).rows(progress=lambda *each: counted.append(each))
    assert counted == [(1, 1)]
    for arguments, error in (
        ((["snake"],), UnknownName),
        ((["hinge"], (0.0,)), InvalidValue),
        ((["hinge"], (2.0,)), InvalidValue),
        ((["hinge"], (0.1,), ("smooth",)), UnknownName),
    ):
        with pytest.raises(error):
            study_leader(*arguments)
    with pytest.raises(UnknownName):
        bent_path("knot", 1.0)


@pytest.mark.studies
def test_the_picture_has_a_line_for_each_arm_and_method(found):
    figure = draw_leader(found)
    arc, helix = figure.axes
    labels = ["sagitta of a module", "ryrz, closest", "ryrz, sequential"]
    assert [line.get_label() for line in helix.lines] == labels
    assert [line.get_label() for line in arc.lines] == [*labels, "hinge, closest", "hinge, sequential"]
    drawn = {line.get_label(): line.get_xydata() for line in arc.lines}
    own = [(each.bending, each.body) for each in found if (each.arm, each.method) == ("hinge", "closest")]
    assert drawn["hinge, closest"] == pytest.approx(np.array(own))
    with pytest.raises(InvalidValue):
        draw_leader([])
