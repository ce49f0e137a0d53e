"""Drift of the joints over closed cycles of postures."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from benchmarks.cases.families import Subject
from benchmarks.studies.cycles import CLOSE, cycle_drift, study_cycles
from pinposture.control.controller import Step
from pinposture.errors import InvalidValue, UnknownName


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 3)


@pytest.fixture(scope="session")
def subject(arm: pp.Arm) -> Subject:
    return Subject("small", arm, ("random",))


def postures() -> tuple[list[pp.Target], np.ndarray]:
    arm = template_arm("RyRz", 3)
    q = np.random.default_rng(0).uniform(-0.4, 0.4, (3, arm.nv))
    return [pp.Target.from_configuration(arm, each) for each in q], q[-1]


@dataclass(frozen=True)
class Slipping:
    """Goes to its target in one step, but its last joint, which moves no control point, slips on."""

    slip: float
    name: str = "slipping"
    seen: list[int] = field(default_factory=list)

    def step(self, state, target, limits=None, memory=None):
        self.seen.append(1)
        dq = target.q - state.q
        dq[-1] = self.slip
        return Step(dq, (0,))


def test_drift_is_how_far_the_worst_joint_is_from_where_it_began() -> None:
    # A wrist that turns about the last link, so that no control point knows of it.
    wrist = pp.ModuleTemplate("wrist", (pp.JointSpec("z"), pp.JointSpec("x")), (0.1, 0.1))
    arm = pp.Arm.from_modules([pp.template("Rz"), wrist])
    corners = np.array([[0.2, 0.1, 0.0], [-0.1, 0.3, 0.0]])
    targets = [pp.Target.from_configuration(arm, q) for q in corners]
    controller = Slipping(0.05)
    went = cycle_drift(arm, targets, corners[-1], rounds=3, controller=controller)
    assert went.drift == pytest.approx((0.1, 0.2, 0.3))  # two postures a round
    assert (went.steps, len(controller.seen)) == (6, 6)
    assert went.error <= CLOSE


def test_known_configurations_do_not_drift_and_points_do_not_where_they_settle_the_joints(
    arm: pp.Arm,
) -> None:
    targets, start = postures()
    known = cycle_drift(arm, targets, start, 2)
    assert known.error <= CLOSE
    assert max(known.drift) < 1e-7
    points = [pp.Target.from_points(arm, target.points) for target in targets]
    unknown = cycle_drift(arm, points, start, 2)
    assert unknown.error <= CLOSE
    assert max(unknown.drift) < 1e-6


def test_a_posture_that_is_not_reached_shows_in_the_error(arm: pp.Arm) -> None:
    targets, start = postures()
    far = pp.Target.from_points(arm, 2.0 * targets[0].points)
    went = cycle_drift(arm, [far, targets[-1]], start, 1)
    assert went.error > 0.1
    assert went.drift[0] < 1e-7


@pytest.mark.studies
def test_cycles_depend_on_their_seed_alone(subject: Subject) -> None:
    found = study_cycles([subject], cycles=2, rounds=2).rows(jobs=2)
    assert [(each.arm, each.target, each.seed) for each in found] == [
        ("small", target, seed) for target in ("configuration", "points") for seed in (0, 1)
    ]
    assert all(len(each.drift) == 2 and each.steps > 0 for each in found)
    counted: list[tuple[int, int]] = []
    study = study_cycles([subject], ["points"], cycles=1, rounds=2, first_seed=1)
    alone = study.rows(progress=lambda *counts: counted.append(counts))
    assert alone == found[3:]
    assert counted == [(1, 1)]


def test_wrong_input_is_named(arm: pp.Arm, subject: Subject) -> None:
    targets, start = postures()
    for arguments, message in (
        ((arm, [], start), "targets is"),
        ((arm, targets, start[:3]), "q0"),
        ((arm, targets, start, 0), "rounds is 0"),
    ):
        with pytest.raises(InvalidValue, match=message):
            cycle_drift(*arguments)
    for options, message in (
        ({"subjects": []}, "subjects is"),
        ({"knowledge": []}, "knowledge is"),
        ({"cycles": 0}, "cycles is 0"),
        ({"first_seed": -1}, "first_seed is -1"),
    ):
        with pytest.raises(InvalidValue, match=message):
            study_cycles(**{"subjects": [subject], **options})
    with pytest.raises(UnknownName, match="configuration, points"):
        study_cycles([subject], ["curve"])
