"""Measures of the thesis's claims on runs, and the rules for verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from operator import lt
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Row
from benchmarks.reproduce.runs import ANY_STEP, Reading, label, median

# A claim is judged by comparing the shares of cases in which it is true with the thresholds of its rule.

Verdict = Literal[
    "holds", "holds by construction", "holds partly", "does not hold", "does not hold as stated", "not seen"
]


class Rule(NamedTuple):
    """The share of cases in which a claim must be true.

    Attributes:
        words: kind of claims to which the rule applies.
        holds: smallest share at which the claim holds.
        partly: smallest share at which it holds partly; None if a single counterexample refutes it.
    """

    words: str
    holds: float
    partly: float | None


RULES: Mapping[str, Rule] = {
    "always": Rule("guaranteed, or said of every case", 1.0, None),
    "usually": Rule("said of how the method works in general", 0.9, 0.5),
    "rather": Rule("a comparison or a tendency", 0.75, 0.5),
}
"""The rules by name, as used in `benchmarks.reproduce.claims`."""


class Share(NamedTuple):
    """The number of cases in which a claim is true, of all cases."""

    true: int
    cases: int

    @property
    def value(self) -> float:
        """The share; 0 if there are no cases."""
        return self.true / self.cases if self.cases else 0.0


def share(truths: Iterable[bool]) -> Share:
    """Return the share of true values."""
    listed = [bool(truth) for truth in truths]
    return Share(sum(listed), len(listed))


class NearnessBin(NamedTuple):
    """A quantity over the steps within one range of nearness to a singular posture.

    Attributes:
        quantity: name of the quantity, with its unit.
        group: the group of runs.
        low: lower bound of the nearness: smallest singular value of the tip's Jacobian per arm length.
        high: upper bound.
        steps: number of steps in it.
        median: median over the steps.
        largest: largest value.
    """

    quantity: str
    group: str
    low: float
    high: float
    steps: int
    median: float
    largest: float


class Finding(NamedTuple):
    """Measurements for a claim.

    Attributes:
        shares: number of cases in which it is true, by group of runs; these decide.
        figures: additional numbers, by name.
        instead: what was found, in words; shown if the claim does not hold throughout.
        by_nearness: dependence on the distance to the nearest singular posture, if measured.
    """

    shares: Mapping[str, Share]
    figures: Mapping[str, float] = {}
    instead: str = ""
    by_nearness: Sequence[NearnessBin] = ()


def judge(shares: Mapping[str, Share], rule: Rule) -> Verdict:
    """Return the verdict on a claim.

    It holds if it holds in all groups of runs, does not hold if it holds not even partly in any group, and
    otherwise holds partly. A claim about every case does not hold as stated if there is a counterexample, and
    does not hold if there are only counterexamples. Groups without cases are ignored; without any case at all
    the claim was not seen.
    """
    values = [each.value for each in shares.values() if each.cases]
    if not values:
        return "not seen"
    if min(values) >= rule.holds:
        return "holds"
    if rule.partly is None:
        return "does not hold as stated" if max(values) > 0.0 else "does not hold"
    return "does not hold" if max(values) < rule.partly else "holds partly"


THERE = 1e-2
"""Mean point error per arm length at which an arm visually has the target posture."""

CLOSE = 1e-3
"""Mean point error per arm length that is nearly zero."""

EXACT = 1e-6
"""Mean point error per arm length at which a run has converged and stops."""

ON_CURVE = 1e-5
"""Distance from a curve per arm length that is attributed to sampling."""

FEW = 50
"""Steps that count as a few, at 0.1 rad per step."""

NON_SINGULAR = ("helix", "random", "planar-random")
SINGULAR = ("line", "planar-near-line")
TARGETS = (*NON_SINGULAR, *SINGULAR)
FROM_STRAIGHT = ("from-straight", "planar-from-straight")
FROM_NEAR_STRAIGHT = ("near-straight", "planar-near-straight")
ACROSS = ("opposite", "planar-opposite")
BOTH = ("selection", "projection")


def final(run: Row) -> float:
    """Return the mean point error at the end, per arm length."""
    return float(run.mean_errors[-1])


def arrived(run: Row, within: float = THERE) -> bool:
    """Return whether a run ends with a mean point error of at most `within`, per arm length."""
    return final(run) <= within


def lower(run: Row, others: Sequence[Row]) -> bool:
    """Return whether a run ends with a lower error than others, or has converged like them."""
    return all(final(run) < final(other) or max(final(run), final(other)) <= EXACT for other in others)


Groups = Mapping[str, Sequence[Row]]
"""Runs by "arm, scenario, method" in words."""


def _errors(groups: Groups) -> dict[str, float]:
    return _prefixed("median final error per arm length", _medians(groups, final))


def _medians(groups: Groups, measure: Callable[[Row], float]) -> dict[str, float]:
    """Return the median of a measure over the runs of each group."""
    return {name: median([measure(run) for run in runs]) for name, runs in groups.items()}


def _prefixed(quantity: str, values: Mapping[str, float]) -> dict[str, float]:
    """Prefix the names of groups with a quantity."""
    return {f"{quantity}: {name}": value for name, value in values.items()}


def _values(shares: Mapping[str, Share]) -> dict[str, float]:
    return {name: each.value for name, each in shares.items()}


def _in_words(values: Mapping[str, float], form: str = ".0%") -> str:
    """Format the values of groups on one line."""
    return "; ".join(f"{name}: {value:{form}}" for name, value in values.items())


def _count_runs(groups: Groups, true: Callable[[Row], bool]) -> dict[str, Share]:
    return {name: share(true(run) for run in runs) for name, runs in groups.items()}


def _arrives(scenarios: Sequence[str], methods: Sequence[str], reading: Reading) -> Finding:
    groups = reading.each(scenarios, methods)
    close = _values(_count_runs(groups, lambda run: arrived(run, CLOSE)))
    halved = _values(_count_runs(groups, lambda run: run.outcome.ratio <= 0.5))
    figures = _errors(groups) | _prefixed("within 0.1 %", close)
    text = f"The posture error is at least halved in {_in_words(halved)}."
    return Finding(_count_runs(groups, arrived), figures, text)


def _similar(reading: Reading) -> Finding:
    def alike(one: Row, other: Row) -> bool:
        low, high = sorted((final(one), final(other)))
        return high <= max(2.0 * low, CLOSE)

    pairs = reading.pairs(NON_SINGULAR, *BOTH)
    factors = {
        name: median([np.log10(max(final(b), EXACT) / max(final(a), EXACT)) for a, b in runs])
        for name, runs in pairs.items()
    }
    ratios = _in_words({name: 10.0**value for name, value in factors.items()}, ".2g")
    return Finding(
        {name: share(alike(a, b) for a, b in runs) for name, runs in pairs.items()},
        _prefixed("median of log10(Projection / Selection)", factors),
        f"Final error of Projection relative to that of Selection, the median: {ratios}.",
    )


def _projection_lower(scenarios: Sequence[str], reading: Reading) -> Finding:
    pairs = reading.pairs(scenarios, *BOTH)
    shares = {name: share(lower(b, [a]) for a, b in runs) for name, runs in pairs.items()}
    figures = _errors(reading.each(scenarios, BOTH))
    parts = [
        f"{name}: {median([final(a) for a, _ in runs]):.2g} by Selection, "
        f"{median([final(b) for _, b in runs]):.2g} by Projection"
        for name, runs in pairs.items()
    ]
    return Finding(shares, figures, f"Median final errors per arm length: {'; '.join(parts)}.")


def _converges(reading: Reading) -> Finding:
    groups = reading.each(TARGETS, ("projection",))
    there = _values(_count_runs(groups, arrived))
    return Finding(
        _count_runs(groups, lambda run: arrived(run, CLOSE)),
        _errors(groups),
        f"A mean point error of at most 1 % of the arm length is reached in {_in_words(there)}.",
    )


def _few_steps(reading: Reading) -> Finding:
    groups = reading.each(("planar-random",), ("selection",))

    def steps(run: Row) -> float:
        below = np.flatnonzero(run.mean_errors <= THERE)
        return float(below[0]) if len(below) else np.inf

    needed = [steps(run) for runs in groups.values() for run in runs]
    reached = [count for count in needed if np.isfinite(count)]
    return Finding(
        _count_runs(groups, lambda run: steps(run) <= FEW and arrived(run)),
        {"median steps to 1 %, of runs that come there": median(reached)} | _errors(groups),
        f"{len(reached)} of {len(needed)} runs come within 1 %, in {median(reached):.0f} steps (median).",
    )


def _cannot_start(scenarios: Sequence[str], reading: Reading) -> Finding:
    groups = reading.each(scenarios, ("selection",))
    there = _values(_count_runs(groups, arrived))
    figures = _prefixed("end within 1 %", there)
    text = f"Of all runs, these end within 1 % of the arm length: {_in_words(there)}."
    return Finding(_count_runs(groups, lambda run: run.outcome.steps == 0), figures, text)


def _departs(reading: Reading) -> Finding:
    groups = reading.each(FROM_STRAIGHT, ("projection",))
    ratios = _medians(groups, lambda run: run.outcome.ratio)
    return Finding(
        _count_runs(groups, lambda run: run.outcome.ratio <= 0.5),
        _prefixed("median ratio of final to first posture error", ratios),
        f"Median ratio of the final posture error to the first: {_in_words(ratios, '.2g')}.",
    )


def _is_stranded(run: Row) -> bool:
    return bool(run.outcome.status == "no_control_points")


NEAR = 0.03
"""Smallest singular value of the tip's Jacobian, per arm length, up to which a posture is nearly singular."""

AWAY = 2.0 * NEAR
"""Nearness, as `NEAR`, from which on a posture counts as clear of singular ones."""

SEEN = 0.1
"""Share of runs that must come near a singular posture for a verdict on passing it."""


def approach(run: Row) -> bool | None:
    """Return whether a run that came near a singular posture left it again; None if it did not come near.

    A run comes near if it gets from AWAY to NEAR, and leaves if it gets AWAY again. Runs to targets that are
    not AWAY from singular postures do not count.
    """
    if run.goal_nearness is None or run.goal_nearness < AWAY:
        return None
    clear, near = run.steps.nearness >= AWAY, run.steps.nearness <= NEAR
    if not clear.any():
        return None
    came = np.flatnonzero(near & (np.arange(len(near)) > int(np.argmax(clear))))
    return bool(clear[came[0] :].any()) if len(came) else None


def _passes(method: str, expected: bool, reading: Reading) -> Finding:
    groups = reading.each((*NON_SINGULAR, *ACROSS), (method,))
    left_again = {
        name: [left for run in runs if (left := approach(run)) is not None] for name, runs in groups.items()
    }
    came = {name: Share(len(left_again[name]), len(runs)) for name, runs in groups.items()}
    held = {name: share(each is expected for each in left_again[name]) for name in groups}
    shares = {name: each if came[name].value >= SEEN else Share(0, 0) for name, each in held.items()}
    summary = "; ".join(
        f"{name}: {sum(left_again[name])} of {each.true}" for name, each in came.items() if each.true
    )
    return Finding(
        shares,
        _prefixed("share of runs that come near", _values(came)),
        f"Of the runs that come near these leave again: {summary or 'none comes near'}.",
    )


def _on_curve(reading: Reading) -> Finding:
    groups = {
        label(scenario): reading.runs(scenario, "selection")
        for scenario in ("helix", "line", "planar-random", "planar-near-line")
    }
    off = {
        name: [run.off_curve for run in runs if run.off_curve is not None] for name, runs in groups.items()
    }
    farthest = {name: max(values, default=0.0) for name, values in off.items()}
    return Finding(
        {name: share(value <= ON_CURVE for value in values) for name, values in off.items()},
        _prefixed("farthest off, per arm length", farthest),
        f"The farthest that a target is off the curve, per arm length: {_in_words(farthest, '.2g')}.",
    )


BINS = (0.0, 0.003, 0.01, 0.03, 0.1, np.inf)
"""Bounds of the ranges of nearness for which figures are given."""

HALF_TURN = float(np.pi)
"""Largest acceptable joint motion in one step [rad]; beyond it the joint might turn the other way."""

ABRUPT = 0.5
"""Relative change of the joint displacement above which a motion is not smooth."""


def _near(runs: Sequence[Row], name: str, low: float = 0.0, high: float = NEAR) -> NDArray[np.float64]:
    """Return a quantity of the steps of runs within a range of nearness to a singular posture."""
    parts = [
        getattr(run.steps, name)[(run.steps.nearness >= low) & (run.steps.nearness < high)] for run in runs
    ]
    return np.concatenate([np.zeros(0), *parts])


def _by_nearness(groups: Groups, name: str, quantity: str) -> list[NearnessBin]:
    """Return medians and largest values of a quantity of the steps, by nearness."""
    bins = []
    for group, runs in groups.items():
        for low, high in pairwise(BINS):
            values = _near(runs, name, low, high)
            if len(values):
                largest = float(values.max())
                bins.append(NearnessBin(quantity, group, low, high, len(values), median(values), largest))
    return bins


def _bounded_steps(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, BOTH)
    largest = {name: float(_near(runs, "asked").max(initial=0.0)) for name, runs in groups.items()}
    in_words = "; ".join(f"{name}: {value:.3g} rad" for name, value in largest.items())
    return Finding(
        {name: share(_near(runs, "asked") <= HALF_TURN) for name, runs in groups.items()},
        _prefixed("largest |dq| asked for near a singular posture [rad]", largest),
        f"The most that was asked of a joint in one step near a singular posture: {in_words}. "
        "A step limit takes care of it.",
        _by_nearness(groups, "asked", "largest motion of a joint asked for [rad]"),
    )


def _no_blow_up(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, BOTH) | reading.each(SINGULAR, BOTH, ANY_STEP)
    growth = {
        name: [value for run in runs if (value := _growth(run)) is not None] for name, runs in groups.items()
    }
    near = {name: float(len(values)) for name, values in growth.items()}
    return Finding(
        {name: share(value <= 2.0 for value in values) for name, values in growth.items()},
        _prefixed("largest growth", {name: max(values, default=1.0) for name, values in growth.items()})
        | _prefixed("runs that come near", near),
        "With a step limit the error hardly ever grows again; without one it may. Runs that come near a "
        f"singular posture at all: {_in_words(near, '.0f')}.",
    )


def _growth(run: Row) -> float | None:
    """Return the largest error after a run came near a singular posture, relative to that there, or None."""
    near = np.flatnonzero(run.steps.nearness <= NEAR)
    if not len(near):
        return None
    after = run.mean_errors[near[0] :]
    return float(after.max() / max(float(after[0]), 1e-300))


def _smooth(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, BOTH)
    far = {name: median(_near(runs, "turn", NEAR, np.inf)) for name, runs in groups.items()}
    near = {name: median(_near(runs, "turn")) for name, runs in groups.items()}
    summary = "; ".join(f"{name}: {near[name]:.2f} near, {far[name]:.2f} elsewhere" for name in groups)
    return Finding(
        {name: share(_near(runs, "turn") <= ABRUPT) for name, runs in groups.items()},
        _prefixed("median change of dq per size, near", near),
        f"Median change of the joint displacement from step to step, per size: {summary}.",
        _by_nearness(groups, "turn", "change of dq from step to step, per size")
        + _by_nearness(groups, "change", "share of the active set exchanged from step to step"),
    )


def _any_step(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, BOTH, ANY_STEP)
    shares = _count_runs(groups, arrived)
    text = f"Of runs without a step limit these arrive: {_in_words(_values(shares))}."
    return Finding(shares, _errors(groups), text)


DIRECT = 1.5
"""Path length of the control points relative to straight lines up to which a motion counts as direct."""

CALM = 1e-3
"""Separation after a nudge of 1e-6 rad, per arm length, up to which a motion counts as predictable."""

VISIBLE = 0.01
"""Rise of the posture error, relative to the initial one, that is visible in a picture."""

TWINS = ("helix", "planar-random")
"""Scenarios whose runs have twins."""


def predictable(run: Row) -> bool:
    """Return whether a run was direct and insensitive to a nudge of its start."""
    return run.path_length_ratio <= DIRECT and run.separation is not None and run.separation <= CALM


def _largest_rise(run: Row) -> float:
    """Return the largest rise of the posture error in one step, relative to the initial error."""
    return max(float(np.diff(run.mean_errors).max(initial=0.0)) / max(float(run.mean_errors[0]), 1e-300), 0.0)


def _monotone(method: str, expected: bool, reading: Reading) -> Finding:
    groups = reading.each(TARGETS, (method,))
    rising = _medians(groups, lambda run: run.descent.rose / max(run.descent.steps, 1))
    smooth = _values(_count_runs(groups, lambda run: _largest_rise(run) <= VISIBLE))
    summary = "; ".join(f"{name}: {rising[name]:.0%}, {smooth[name]:.0%}" for name in groups)
    return Finding(
        _count_runs(groups, lambda run: (run.descent.rose == 0) is expected),
        _prefixed("median share of rising steps", rising) | _prefixed("runs without a visible rise", smooth),
        "Median share of the steps of a run on which the posture error rises, and share of the runs in "
        f"which it never rises by more than 1 % of what it was at first: {summary}.",
    )


def _null_space(reading: Reading) -> Finding:
    groups = reading.each(TARGETS, BOTH)
    shares, uphill = {}, {}
    for name, runs in groups.items():
        steps = sum(run.descent.steps for run in runs)
        shares[name] = Share(steps - sum(run.descent.rose for run in runs), steps)
        uphill[name] = sum(run.descent.uphill for run in runs) / max(steps, 1)
    return Finding(
        shares,
        _prefixed("steps uphill however short", uphill),
        "The sum runs over all control points and its sign is that of descent, without which it would not "
        f"lower the posture error at all. Steps that would raise it however short they were made: "
        f"{_in_words(uphill, '.1%')}.",
    )


def _active_points(reading: Reading) -> Finding:
    groups = reading.each(TARGETS, ("selection",))
    counted = {
        name: tuple(
            sum(getattr(run.descent, field) for run in runs)
            for field in ("active", "active_rose", "active_free", "active_uphill", "steps", "clipped")
        )
        for name, runs in groups.items()
    }
    free = sum(count[2] for count in counted.values())
    uphill = sum(count[3] for count in counted.values())
    return Finding(
        {name: Share(count[0] - count[1], count[0]) for name, count in counted.items()},
        {f"steps with a joint at its limit: {k}": c[5] / max(c[4], 1) for k, c in counted.items()},
        f"Where no joint is stopped at its limit, {uphill} of {free} active control points would move "
        "away from their targets if the step were short: errors rise because steps are long and joints have "
        "limits.",
    )


def _points_rise(reading: Reading) -> Finding:
    groups = reading.each(TARGETS, ("selection",))
    return Finding(_count_runs(groups, lambda run: run.descent.points_rose > 0))


def _predictability(groups: Groups) -> dict[str, float]:
    figures = {}
    for name, runs in groups.items():
        figures[f"median path per direct distance: {name}"] = median([run.path_length_ratio for run in runs])
        apart = [run.separation for run in runs if run.separation is not None]
        figures[f"median separation of twins, per arm length: {name}"] = median(apart)
    return figures


def _predictable(method: str, expected: bool, reading: Reading) -> Finding:
    groups = {
        name: [run for run in runs if run.separation is not None]
        for name, runs in reading.each(TWINS, (method,)).items()
    }
    summary = "; ".join(
        f"{name}: direct in {share(run.path_length_ratio <= DIRECT for run in runs).value:.0%}, "
        f"insensitive to the nudge in {share((run.separation or 0.0) <= CALM for run in runs).value:.0%}"
        for name, runs in groups.items()
    )
    shares = _count_runs(groups, lambda run: predictable(run) is expected)
    return Finding(shares, _predictability(groups), f"{summary[:1].upper()}{summary[1:]}.")


def _compare(
    pairs: Mapping[str, Sequence[tuple[Row, Row]]],
    way: Callable[[float, float], bool],
    nudge: Callable[[float, float], bool],
) -> dict[str, Share]:
    """Count the seeds on which the path length ratios, and the separations of twins, compare as given."""
    ways = {
        f"{name}: way": share(way(a.path_length_ratio, b.path_length_ratio) for a, b in runs)
        for name, runs in pairs.items()
    }
    separations = {name: [(a.separation, b.separation) for a, b in runs] for name, runs in pairs.items()}
    return ways | {
        f"{name}: nudge": share(nudge(a, b) for a, b in both if a is not None and b is not None)
        for name, both in separations.items()
    }


def _more_predictable(reading: Reading) -> Finding:
    shares = _compare(reading.pairs(TWINS, *BOTH), lt, lt)
    text = f"Seeds on which Selection is the better: {_in_words(_values(shares))}."
    return Finding(shares, _predictability(reading.each(TWINS, BOTH)), text)


MANY = 0.25
"""Share of all control points that counts as a lot."""

SWITCHED = ("planar-near-line", "line", "planar-random", "helix", "random")
"""Scenarios for comparing switching with its parts; the thesis shows the first."""


def _steps_with(runs: Sequence[Row], part: float) -> Share:
    """Return the share of steps in which at least a fraction of all control points is active."""
    counts = np.concatenate([np.zeros(0), *(run.points / run.modules for run in runs)])
    return share(counts >= part)


def _mean_points(groups: Groups) -> dict[str, float]:
    moved = {name: [run for run in runs if len(run.points)] for name, runs in groups.items()}
    return _prefixed(
        "median of the mean number of active points", _medians(moved, lambda run: float(run.points.mean()))
    )


def _many(reading: Reading) -> Finding:
    groups = reading.each(("planar-random",), BOTH)
    fewest = {
        name: min((int(run.points.min()) for run in runs if len(run.points)), default=0)
        for name, runs in groups.items()
    }
    return Finding(
        {name: _steps_with(runs, MANY) for name, runs in groups.items()},
        _mean_points(groups),
        f"The fewest points in any step: {_in_words(fewest, 'd')}.",
    )


def _runs_out(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, ("selection",))
    figures = {}
    for name, runs in groups.items():
        figures[f"median points at first: {name}"] = median([run.outcome.first_points for run in runs])
        figures[f"median points at last: {name}"] = median([run.outcome.last_points for run in runs])
    summary = _in_words(figures, "g")
    return Finding(
        _count_runs(
            groups,
            lambda run: _is_stranded(run) or run.outcome.last_points <= run.outcome.first_points / 2,
        ),
        figures,
        f"{summary[:1].upper()}{summary[1:]}.",
    )


def _stranded(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, ("selection",))
    return Finding(_count_runs(groups, _is_stranded), _errors(groups), _final_errors(groups))


def _final_errors(groups: Groups) -> str:
    return f"Median final errors per arm length: {_in_words(_medians(groups, final), '.2g')}."


def _keeps(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, ("projection",))
    shares = _count_runs(groups, lambda run: bool(run.points.min(initial=run.modules) >= 0.5 * run.modules))
    return Finding(shares, _mean_points(groups))


def _all(reading: Reading) -> Finding:
    groups = reading.each((*TARGETS, *FROM_STRAIGHT), ("projection",))
    return Finding({name: _steps_with(runs, 1.0) for name, runs in groups.items()}, _mean_points(groups))


def _more(reading: Reading) -> Finding:
    pairs = reading.pairs(TARGETS, *BOTH)
    shares = {
        name: share(b.points.mean() > a.points.mean() for a, b in runs if len(a.points) and len(b.points))
        for name, runs in pairs.items()
    }
    return Finding(shares, _mean_points(reading.each(TARGETS, BOTH)))


def _full_rank(method: str, reading: Reading) -> Finding:
    groups = reading.each((*TARGETS, *FROM_STRAIGHT), (method,))
    shares, dropping = {}, {}
    for name, runs in groups.items():
        steps = sum(run.descent.steps for run in runs)
        shares[name] = Share(steps - sum(run.deficient for run in runs), steps)
        dropping[name] = sum(run.dropping for run in runs) / max(steps, 1)
    text = f"Steps in which points were dropped for conditioning: {_in_words(dropping, '.1%')}."
    return Finding(shares, _prefixed("steps in which points were dropped", dropping), text)


def _switching_lower(reading: Reading) -> Finding:
    shares = {}
    for scenario in SWITCHED:
        runs = [reading.runs(scenario, method) for method in ("switching", *BOTH)]
        if all(runs):
            shares[label(scenario)] = share(lower(ours, parts) for ours, *parts in zip(*runs, strict=True))
    groups = reading.each(SWITCHED, (*BOTH, "switching"))
    return Finding(shares, _errors(groups), _final_errors(groups))


def _switching_predictable(reading: Reading) -> Finding:
    pairs = reading.pairs(TWINS, "switching", "selection")
    shares = _compare(pairs, lambda a, b: a <= 1.2 * b, lambda a, b: a <= max(10.0 * b, CALM))
    summary = "; ".join(
        f"{name}: {median([a.path_length_ratio for a, _ in runs]):.2f} against "
        f"{median([b.path_length_ratio for _, b in runs]):.2f}"
        for name, runs in pairs.items()
    )
    return Finding(
        shares, {}, f"Path per direct distance by switching against Selection, the medians: {summary}."
    )


def _mostly_selection(reading: Reading) -> Finding:
    groups = reading.each(SWITCHED, ("switching",))
    parts = _medians(groups, lambda run: run.by_projection)
    return Finding(
        _count_runs(groups, lambda run: run.by_projection <= 0.5),
        _prefixed("median share of steps by Projection", parts),
        f"Steps that Projection makes, the median: {_in_words(parts)}.",
    )


MEASURES: Mapping[str, Callable[[Reading], Finding]] = {
    "tracks-arbitrary": partial(_arrives, NON_SINGULAR, BOTH),
    "tracks-singular": partial(_arrives, SINGULAR, BOTH),
    "similar-performance": _similar,
    "projection-lower-non-singular": partial(_projection_lower, NON_SINGULAR),
    "projection-lower-singular": partial(_projection_lower, SINGULAR),
    "projection-converges": _converges,
    "selection-few-steps": _few_steps,
    "selection-cannot-start": partial(_cannot_start, FROM_STRAIGHT),
    "selection-cannot-start-near": partial(_cannot_start, FROM_NEAR_STRAIGHT),
    "projection-departs": _departs,
    "projection-converges-from-singular": partial(_arrives, FROM_STRAIGHT, ("projection",)),
    "selection-cannot-pass": partial(_passes, "selection", False),
    "projection-passes": partial(_passes, "projection", True),
    "targets-on-curve": _on_curve,
    "stable-near-singular": _bounded_steps,
    "no-blow-up": _no_blow_up,
    "smooth-near-singular": _smooth,
    "stable-without-step-limit": _any_step,
    "selection-monotone": partial(_monotone, "selection", True),
    "null-space-descends": _null_space,
    "active-points-descend": _active_points,
    "point-errors-not-monotone": _points_rise,
    "projection-not-monotone": partial(_monotone, "projection", False),
    "selection-predictable": partial(_predictable, "selection", True),
    "projection-unpredictable": partial(_predictable, "projection", False),
    "selection-more-predictable": _more_predictable,
    "many-points": _many,
    "selection-runs-out": _runs_out,
    "selection-stranded": _stranded,
    "projection-keeps-points": _keeps,
    "projection-uses-all": _all,
    "projection-more-points": _more,
    "selection-full-rank": partial(_full_rank, "selection"),
    "projection-full-rank": partial(_full_rank, "projection"),
    "switching-lower": _switching_lower,
    "switching-predictable": _switching_predictable,
    "switching-mostly-selection": _mostly_selection,
}
"""Measures of the claims about runs, by id of the claim."""
