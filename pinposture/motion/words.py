"""What summaries of results say in words: the same on the command line, in notebooks and in reports."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

from pinposture.placement.target import Moved
from pinposture.units import CONVERGED, error_text, length_text, number_text


def in_words(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return what the `summary` of a result says, by topic; multiple lines for lists."""
    say: Mapping[str, Callable[[Mapping[str, Any]], dict[str, str]]] = {
        "run": _of_run,
        "motion": _of_trajectory,
        "joint trajectory": _of_joints,
        "simulation": _of_simulation,
        "identification": _of_identification,
    }
    return say[summary["kind"]](summary)


def headline(summary: Mapping[str, Any], name: str) -> tuple[str, str, str]:
    """Return the words with which a figure or page of a run, motion or simulation begins.

    Args:
        summary: what `summary` returns.
        name: who moved.

    Returns:
        Whether it reached its target, and the faults; why it ended; how long it was.
    """
    words = in_words(summary)
    reason = str(summary["reason"])
    extent = next(
        f"{topic}: {words[topic]}" for topic in ("steps", "duration", "simulated") if topic in words
    )
    return f"{name} {words['verdict'].removesuffix(f': {reason}')}", reason, extent


def title(summary: Mapping[str, Any], name: str) -> str:
    """Return the words of `headline` as one sentence."""
    ending, reason, extent = headline(summary, name)
    return f"{ending}: {reason}; {extent}"


def _placement(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return how the control points were placed on the curve, if there is one."""
    if summary["largest_residual"] is None:
        return {}
    error = error_text(summary["largest_residual"], summary["arm_length"])
    placed = f"{summary['placed_by']} placement; largest distance of a control point from the curve {error}"
    return {"placed by": placed}


def _whole_arm(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return the final distance of the whole arm from the curve, if there is one."""
    away = summary["distance_from_curve"]
    if away is None:
        return {}
    error = error_text(away, summary["arm_length"])
    return {"whole arm": f"largest distance of a link from the curve {error}"}


def _of_run(summary: Mapping[str, Any]) -> dict[str, str]:
    length = summary["arm_length"]
    mean = summary["mean_error"]
    begun = summary.get("start_taken", "")
    taken = {"start": f"{begun}; the motion begins there"} if begun else {}
    words = {
        "verdict": str(summary["verdict"]),
        **taken,
        "steps": str(summary["steps"]) + (f", {summary['duration']:.4g} s" if "duration" in summary else ""),
        **_placement(summary),
        **_whole_arm(summary),
        "point errors": f"mean {length_text(summary['mean_start_error'], length)} at the start, "
        f"{error_text(mean, length)} at the end; largest {length_text(summary['largest_error'], length)}",
        **_shares(summary),
        "active points": f"{summary['first_active_points']} at the first step, "
        f"{summary['last_active_points']} at the last, of {summary['control_points']}",
        "paths": f"of control points {summary['path_length_ratio']:.3g} times as long as straight ones",
    }
    curve = []
    if summary["curve_length"] is not None and summary["covered_to"] is not None:
        whole = length_text(summary["curve_length"])
        covered = length_text(summary["covered_to"])
        curve.append(f"{whole} long, covered by the arm up to {covered}")
    if summary["moved"] is not None and Moved(**summary["moved"]):
        curve.append(f"{Moved(**summary['moved'])} to the base of the arm; placement as_is keeps it in place")
    if curve:
        words["curve"] = "; ".join(curve)
    if summary["escape_share"]:
        words["rising"] = f"{100 * summary['escape_share']:.3g} % of the steps may raise the posture error"
    if summary["switches"]:
        first_switch = summary["switches"][0]
        words["switches"] = (
            f"{len(summary['switches'])}; the first in step {first_switch['step'] + 1} to "
            f"{first_switch['method']}: {first_switch['reason']}"
        )
    if summary["clearance"] is not None:
        words["clearance"] = _closest(summary["clearance"])
        if summary["start_clearance"] < 0.0:
            begun = f"{words['start']}; " if "start" in words else ""
            words["start"] = f"{begun}in collision, choose another one"
    words |= _holding(summary)
    words |= _sagging(summary)
    if summary["violated_constraints"]:
        first_relaxed = summary["violated_constraints"][0]
        what = textwrap.shorten("; ".join(first_relaxed["what"]), 200, placeholder=" ...")
        counts = [f"{name} in {len(steps)}" for name, steps in summary["violated_steps"].items()]
        words["violated"] = f"{', '.join(counts)} steps; first in step {first_relaxed['step'] + 1}: {what}"
    if summary.get("tip") is not None:
        turn = summary["tip"]["turn"]
        turned = "" if turn is None else f", turned by {turn:.4g} rad"
        words["tip"] = f"{length_text(summary['tip']['distance'], length)} off{turned}"
    if summary["incomplete"]:
        words["incomplete"] = str(summary["incomplete"])
    return words


def _of_trajectory(summary: Mapping[str, Any]) -> dict[str, str]:
    words = {
        "verdict": str(summary["verdict"]),
        "duration": _duration(summary),
        **_shares(summary),
    }
    if summary["keyframes"]:
        words["keyframes"] = _keyframes(summary["keyframes"], summary["arm_length"])
    worst = summary["worst_mean_error"]
    length = summary["arm_length"]
    words["point errors"] = (
        f"largest mean {error_text(worst, length)}, at {summary['worst_mean_at']:.4g} s; "
        f"{length_text(summary['mean_error'], length)} on average, "
        f"{length_text(summary['mean_final_error'], length)} at the end; "
        f"largest {length_text(summary['largest_error'], length)}"
    )
    if summary["clearance"] is not None:
        words["clearance"] = _closest(summary["clearance"], summary["dt"])
    words |= _holding(summary, summary["dt"])
    words |= _sagging(summary)
    if summary["deviations"]:
        words["not as planned"] = "\n".join(summary["deviations"])
    return words


def _duration(summary: Mapping[str, Any]) -> str:
    """Describe the actual and planned durations."""
    planned = summary["planned"]
    text = f"{summary['duration']:.4g} s"
    if summary["done"] < planned:
        text += f", for {summary['done']:.4g} of the {planned:.4g} s of the plan"
    else:
        text += f", {summary['slowdown'] or 'as planned'}"
    if summary["start_index"]:
        text += f"; before that {summary['start_index']:.4g} s to come to the first posture"
    return text


def _keyframes(waypoints: list[dict[str, Any]], arm_length: float) -> str:
    """Describe the named waypoints, one per line, in columns."""
    width = max(len(waypoint["name"]) for waypoint in waypoints)
    lines = []
    for waypoint in waypoints:
        line = f"{waypoint['name']:{width}}  planned {waypoint['planned']:8.4g} s, "
        if waypoint["reached"] is None:
            line += "not reached"
        else:
            passed = "missed" if waypoint["missed"] else "passed"
            error = length_text(waypoint["mean_error"], arm_length)
            line += f"{passed} {waypoint['reached']:8.4g} s, mean error {error}"
        if waypoint["off_curve"] is not None:
            line += f", largest distance from its curve {length_text(waypoint['off_curve'], arm_length)}"
        if waypoint["tip_off"] is not None:
            line += f", tip error {length_text(waypoint['tip_off'], arm_length)}"
        if waypoint["moved"] is not None and Moved(**waypoint["moved"]):
            line += f", curve {Moved(**waypoint['moved'])}"
        if waypoint["too_heavy"] is not None:
            line += f", {waypoint['too_heavy']}"
        lines.append(line)
    return "\n".join(lines)


def _of_joints(summary: Mapping[str, Any]) -> dict[str, str]:
    speeds = ", ".join(f"{value:.4g} {unit}" for unit, value in summary["largest_speed"].items())
    rates = ", ".join(f"{value:.4g} {unit}" for unit, value in summary["largest_acceleration"].items())
    rates = rates.replace("^2", "²")
    return {
        "motion": f"{len(summary['joints'])} joints, {summary['points']} points, {summary['duration']:.4g} s",
        "speed": f"at most {speeds}",
        "acceleration": f"at most {rates}",
    }


def _of_simulation(summary: Mapping[str, Any]) -> dict[str, str]:
    length = summary["arm_length"]
    strength = math.hypot(*summary["gravity"])
    gravity = f"gravity {strength:.4g} m/s²" if strength else "no gravity"
    words = {
        "verdict": str(summary["verdict"]),
        "simulated": f"{summary['loop']} loop, {gravity}, "
        f"{summary['cycles']} cycles of {summary['dt']:.4g} s, physics steps of {summary['timestep']:.3g} s",
    }
    for kind in ("turning", "sliding"):
        errors = summary[f"{kind}_joints"]
        if errors is not None:
            unit = errors["unit"]
            words[f"{kind} joints"] = (
                f"{errors['rms']:.3g} {unit} off (rms), at most {errors['largest']:.3g} {unit} "
                f"({errors['joint']} at {errors['time']:.4g} s), {errors['end']:.3g} {unit} at the end"
            )
    mean = summary["mean_point_error"]
    most = summary["largest_point_error"]
    words["posture"] = (
        f"error of the points: rms {length_text(mean['rms'], length)}, largest "
        f"{error_text(most['value'], length)} ({most['point']} at {most['time']:.4g} s), "
        f"mean at the end {length_text(mean['end'], length)}"
    )
    if summary["target_error"] is not None:
        words["target"] = f"mean error at the end {length_text(summary['target_error']['end'], length)}"
    if summary["clearance"] is not None:
        words["clearance"] = _closest(summary["clearance"], summary["dt"])
    if summary["contact"] is not None:
        words["first touch"] = _first_touch(summary["contact"])
    for kind in ("torque", "force"):
        most = summary[f"largest_{kind}"]
        if most is not None:
            limit = "no limit" if most["limit"] is None else f"limit {most['limit']:.4g} {most['unit']}"
            words[kind] = (
                f"at most {abs(most['value']):.4g} {most['unit']} ({most['joint']} at "
                f"{most['time']:.4g} s, {limit})"
            )
    nearest = summary["largest_share_of_limit"]
    if nearest is not None:
        words["of its limit"] = (
            f"at most {100.0 * nearest['share']:.3g} % ({nearest['joint']} at {nearest['time']:.4g} s, "
            f"{abs(nearest['value']):.4g} of {nearest['limit']:.4g} {nearest['unit']})"
        )
    return words


def _first_touch(contact: Mapping[str, Any]) -> str:
    """Return what the arm touched first, and how hard, as `ContactHistory.summary` tells it."""
    first = contact["first_touch"]
    if first is None:
        return "none"
    pairs = sum(entry["of_arm"] for entry in contact["all"])
    others = f"; {pairs} pairs touched in all" if pairs > 1 else ""
    slid = f", slid {length_text(first['slip'])}" if first["slip"] > 0.0 else ""
    how = f"at {first['speed']:.3g} m/s, up to {first['force']:.3g} N{slid}"
    return f"{' to '.join(first['pair'])} at {first['time']:.4g} s, {how}{others}"


def _closest(clearance: Mapping[str, Any], dt: float | None = None) -> str:
    """Describe the smallest distance.

    Args:
        clearance: what `closest` returns.
        dt: duration of a step [s]; None: count steps.
    """
    if clearance["pair"] is None:
        return "nothing to keep clear of"
    steps = clearance["after_steps"]
    after = "at the start"
    if steps:
        after = f"after {steps} steps" if dt is None else f"after {steps * dt:.4g} s"
    words = (
        f"{length_text(clearance['smallest'])} where it is smallest, {' to '.join(clearance['pair'])}, "
        f"{after}; {length_text(clearance['final'])} at the end; "
    )
    kinds = {"obstacles": clearance["to_obstacles"], "itself": clearance["to_itself"]}
    for name, least in kinds.items():
        if None not in kinds.values() and least["pair"] not in (None, clearance["pair"]):
            words += f"{length_text(least['smallest'])} from {name}, {' to '.join(least['pair'])}; "
    return f"{words}the margin is {length_text(clearance['margin'])}"


def _holding(summary: Mapping[str, Any], dt: float | None = None) -> dict[str, str]:
    """Describe the largest torque at rest in relation to its limit; nothing if it is not known.

    Args:
        summary: what `summary` returns.
        dt: duration of a step [s]; None: count steps.
    """
    most = summary["holding_torque"]
    if most is None:
        return {}
    steps = most["after_steps"]
    after = "at the start"
    if steps:
        after = f"after {steps} steps" if dt is None else f"after {steps * dt:.4g} s"
    needed = f"{number_text(most['needed'])} of {number_text(most['limit'])} {most['unit']}"
    return {"torque at rest": f"at most {100.0 * most['share']:.3g} % ({most['joint']} {after}, {needed})"}


def _sagging(summary: Mapping[str, Any]) -> dict[str, str]:
    """Describe how far the loaded arm ends beside the motion; nothing if that is not known."""
    sag = summary["sag"]
    if sag is None:
        return {}
    if sag["mean_error"] is None:
        return {"sag": f"the arm has no stable rest, first after {sag['after_steps']} steps"}
    clear = "" if sag["clearance"] is None else f", and it is {length_text(sag['clearance'])} clear"
    return {
        "sag": f"under load the arm ends {length_text(sag['mean_error'])} off (mean of its points){clear}"
    }


def _shares(summary: Mapping[str, Any]) -> dict[str, str]:
    """Describe the largest speed, acceleration and jerk of a summary relative to limits, if there are any."""
    words = {}
    for kind in ("speed", "acceleration", "jerk"):
        share = summary.get(f"largest_{kind}")
        if share is not None:
            reached = ", which is reached" if abs(share - 1.0) <= CONVERGED else ""
            words[kind] = f"at most {100.0 * share:.4g} % of the limit{reached}"
    return words


def _of_identification(summary: Mapping[str, Any]) -> dict[str, str]:
    words = {}
    for name in ("measurements", "commands"):
        timing = summary[name]
        period = 1e3 * timing["period"]
        said = f"{timing['rows']} rows every {period:.4g} ms, jitter {1e3 * timing['jitter']:.2g} ms"
        shares = {word: timing[word] for word in ("stale", "bursts", "missing") if timing[word]}
        words[name] = ", ".join([said, *(f"{share:.1%} {word}" for word, share in shares.items())])
    noise = list(summary["noise"].values())
    if noise:
        words["noise"] = f"{min(noise):.2g} to {max(noise):.2g} {summary['unit']}"
    drives = summary["drives"]
    for name, unit in summary["units"].items():
        estimate = summary["payload"] if name == "payload" else drives[name.replace(" ", "_")]
        told = "not identified"
        if estimate is not None:
            told = f"{estimate['value']:.4g} {unit} ({estimate['lower']:.4g} to {estimate['upper']:.4g})"
        words[name] = told
    if drives["explained"] is not None:
        words["explained"] = (
            f"{drives['explained']:.1%} of the variance in segments left out; the rest is "
            f"{drives['rest']:.2g} {summary['unit']} (rms)"
        )
    return words
