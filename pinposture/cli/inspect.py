"""`pinposture inspect`: show how the library interprets a URDF."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pinposture.cli.inputs import (
    OUTPUT,
    TARGET,
    ArmOptions,
    ChangeOptions,
    JsonOption,
    ScaleOption,
    SceneOptions,
    UrdfArgument,
    read_curve,
    read_points,
)
from pinposture.cli.output import examples, print_facts, print_json, print_note, print_table
from pinposture.errors import InvalidValue, NoEquilibrium, PostureError, UnsupportedModule, enumerated
from pinposture.storage import write_figure
from pinposture.units import error_text, length_text, number_text

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.collision import Scene


@examples(
    "pinposture inspect arm.urdf",
    "pinposture inspect arm.urdf --plot arm.png",
    "pinposture inspect arm.urdf --plot arm.png --ellipsoids 5,10,20",
    "pinposture inspect arm.urdf --base m05_l2 --tip tip --split 2",
    "pinposture inspect arm.urdf --split m05_l2,m10_l2,m15_l2,tip",
    "pinposture inspect arm.urdf --scene scene.toml",
    "pinposture inspect arm.urdf --self-collision --json",
    "pinposture inspect arm.urdf --curve helix",
)
def run(
    *,
    urdf: UrdfArgument,
    arm_options: ArmOptions,
    curve_options: CurveOptions,
    scene_options: SceneOptions,
    change_options: ChangeOptions,
    output_options: InspectOutput,
) -> None:
    """Show how the library interprets a robot description.

    It takes one chain of links, from --base to --tip or the longest one, and divides it into modules with a
    control point at the end of each. Meshes are not needed. Limits are in rad and rad/s, or in metres and m/s
    for a prismatic joint; positions and axes are in the world frame, at zero joint positions. The reach is
    the distance from base to tip of the straight arm, with a base that slides without real limits (over more
    than 100 arm lengths) at zero. Zero joint positions are often a singular posture: there manipulability
    measure, minimum singular value and index are 0, and the condition number is inf.

    If masses and torque limits are known, it tells how far the arm can be held straight out with gravity from
    the worst direction, and which joint gives up first; joints in the picture are then coloured by the share
    of its torque limit that each needs.

    With --curve it also shows the distances of the control points and of the whole arm, including its links,
    from that curve, and where the curve exceeds what the modules can follow.

    With --scene it also shows the obstacles of the file, the bodies of the arm, and what is nearest to each;
    with --self-collision, distances of the arm from itself count. The help of track describes scene files.
    """
    plot = output_options.plot
    ellipsoids = output_options.ellipsoids
    curve = curve_options.curve
    scale = curve_options.scale
    if curve is None and scale != 1.0:
        raise InvalidValue("--scale", scale, "only with --curve")
    change_options.check("arm")
    arm = change_options.apply("arm", arm_options.read(urdf))
    unasked = scene_options.scene is None and scene_options.self_collision is None
    surroundings = None if unasked else scene_options.read(arm)
    points = () if ellipsoids is None else read_points("--ellipsoids", ellipsoids, arm)
    about = describe(arm, points or (-1,))
    followed = None if curve is None else _describe_following(arm, curve, scale)
    around = None if surroundings is None else describe_scene(surroundings, arm)
    if plot is not None:
        from pinposture.viz import plot_arm

        loaded = arm.torques_known and not points
        write_figure(plot, plot_arm(arm, ellipsoids=points, scene=surroundings, torques=loaded))
    if output_options.as_json:
        drawn = None if plot is None else str(plot)
        print_json({"file": urdf, **about, "curve": followed, "scene": around, "plot": drawn})
    else:
        _print_tables(about if followed is None else {**about, "curve": followed})
        if around is not None:
            print_scene(around)
    if plot is not None:
        print_note(f"wrote {plot}")


@dataclass(frozen=True)
class InspectOutput:
    """What is shown, and how."""

    plot: Annotated[
        Path | None, OUTPUT("Save a PNG picture of modules, joint axes and control points here.", "FILE")
    ] = None
    ellipsoids: Annotated[
        str | None,
        OUTPUT(
            "Show how near a singularity these control points are, counted from 1 at the base, instead "
            "of the tip; with --plot, draw their manipulability ellipsoids.",
            "N,...|all",
        ),
    ] = None
    as_json: JsonOption = False


@dataclass(frozen=True)
class CurveOptions:
    """A curve that the arm is to follow."""

    curve: Annotated[
        str | None,
        TARGET(
            "Show how well the arm can follow this curve, placed at its base: a file, or one of {curves}.",
            "CURVE",
        ),
    ] = None
    scale: ScaleOption = 1.0


def _print_tables(about: Mapping[str, Any]) -> None:
    coupled = sum("follows" in joint for joint in about["joints"])
    counts = Counter(about["kinematics"])
    listed = ", ".join(f"{name} ({count})" for name, count in counts.items())
    placing = "closed form for every module" if about["closed_form"] else f"module by module: {listed}"
    if not counts:
        placing = "least squares over the whole arm"
    facts = {
        "robot": about["name"],
        "chain": f"from link {about['base']} to link {about['tip']}",
        "kind": "planar" if about["dimension"] == 2 else "spatial",
        "modules": str(about["modules"]),
        "reason": about["modules_reason"],
        "DOF": str(about["dof"]),
        "length": length_text(about["length"]),
        "reach": length_text(about["reach"]),
        "kinematics": "; ".join(filter(None, (placing, about["closed_form_reason"]))),
        "locked": ", ".join(about["held"]) or "no joint",
        **({"coupled": f"{coupled} joints follow others"} if coupled else {}),
        **_soft_limits_in_words(about["soft_limited"]),
        **_weight_in_words(about["weight"], about["length"]),
        **_following_in_words(about),
    }
    notes = {"note" if k == 0 else " " * k: text for k, text in enumerate(about["warnings"])}
    print_facts({**facts, **notes})
    # Headings of tables, and the keys of the values below them.
    joints = {
        "module": "module",
        "joint": "name",
        "type": "type",
        "parent": "parent",
        "child": "child",
        "axis": "axis",
        "lower": "lower",
        "upper": "upper",
        "speed": "velocity",
        **({"follows": "follows", "ratio": "ratio", "offset": "offset"} if coupled else {}),
    }
    told = [
        {**joint, "axis": " ".join(f"{round(x, 4) + 0.0:g}" for x in joint["axis"])}
        for joint in about["joints"]
    ]
    print_table(tuple(joints), [[joint.get(key) for key in joints.values()] for joint in told])
    headings = ("module", "control point", "module length [m]", "x [m]", "y [m]", "z [m]")
    points = about["control_points"]
    print_table(
        headings, [(point["module"], point["name"], point["length"], *point["position"]) for point in points]
    )
    # As text, because a table shows infinite numbers as missing.
    told = [{**one, "condition": f"{one['condition']:.4g}"} for one in about["manipulability"]]
    measures = {
        "module": "module",
        "control point": "name",
        "measure": "measure",
        "condition": "condition",
        "min. singular value": "minimum_singular_value",
        "index": "index",
    }
    print_table(tuple(measures), [[one[key] for key in measures.values()] for one in told])
    if any(one["condition"] == float("inf") for one in about["manipulability"]):
        print_facts({"measures": "a straight arm is singular: that is usual"})


def describe(arm: Arm, measured: Sequence[int]) -> dict[str, Any]:
    """Describe an arm as JSON-compatible data.

    Args:
        arm: an arm loaded from a URDF.
        measured: indices of the control points to report manipulability for, 0-based or -1.

    Returns:
        Lengths in metres, angles in radians; positions (world) and measures at the neutral configuration.

    Raises:
        InvalidValue: an arm that was not loaded from a URDF.
    """
    import numpy as np

    from pinposture.arm.description import read_description

    if arm.report is None or arm.urdf is None:
        raise InvalidValue("arm", arm, "one that was loaded from a URDF")
    description = read_description(arm.urdf)
    moving = set(arm.chain.joints)
    unsolved = _without_closed_form(arm)
    return {
        "name": description.name,
        "base": arm.report.base,
        "tip": arm.report.tip,
        "dimension": arm.dimension,
        "modules": arm.n_modules,
        "modules_reason": arm.segmentation.reason,
        "dof": arm.nv,
        "nq": arm.nq,
        "length": arm.length,
        "reach": float(np.linalg.norm(arm.at(arm.straight()).points[-1] - arm.chain.base)),
        "closed_form": not unsolved,
        "closed_form_reason": unsolved,
        "kinematics": _kinematics(arm),
        "warnings": list(arm.warnings),
        "soft_limited": list(arm.report.soft_limited),
        "weight": describe_weight(arm),
        "held": [joint.name for joint in description.joints if joint.moves and joint.name not in moving],
        "joints": _joints(arm, {joint.name: joint for joint in description.joints}),
        "control_points": [
            {"name": name, "module": k, "length": float(length), "position": point.tolist()}
            for k, (name, length, point) in enumerate(
                zip(arm.control_points, arm.chain.module_lengths, arm.chain.points, strict=True), start=1
            )
        ],
        "manipulability": [
            {
                "name": arm.control_points[one.point],
                "module": one.point + 1,
                "measure": one.measure,
                "condition": one.condition,
                "minimum_singular_value": one.smallest,
                "index": one.index,
            }
            for one in arm.at(arm.neutral()).ellipsoids(measured)
        ],
    }


def _describe_following(arm: Arm, curve: str, scale: float) -> dict[str, Any]:
    """Describe how well an arm can follow a curve at its base, as JSON-compatible data; lengths in metres."""
    from pinposture.placement import resolve_targets

    target = resolve_targets(arm, read_curve(curve, arm, scale), incomplete="partial")
    if target.curve is None or target.residual is None:
        raise InvalidValue("--curve", curve, "one on which the control points can be placed")
    return {
        "name": curve,
        "placed_by": target.method,
        "fallback": target.fallback,
        "placed_points": int(target.has_target.sum()),
        "largest_residual": float(target.residual.max()),
        "distance_from_curve": target.distance_from_curve(arm),
        "too_much": [str(excess) for excess in arm.can_follow(target.curve).excesses],
        "incomplete": target.incomplete,
    }


def describe_weight(arm: Arm) -> dict[str, Any]:
    """Describe what an arm weighs, carries and holds, as JSON-compatible data [kg, m, N m or N]."""
    import numpy as np

    from pinposture.schema import as_plain

    problem = None
    try:
        arm.require_masses(warns=False)
    except PostureError as error:
        problem = str(error)
    unlimited = [arm.joint_names[u] for u in arm.columns if np.isinf(arm.effort[u])]
    held = arm.held_out()
    return {
        "mass": None if problem else sum(float(body.mass) for body in list(arm.model.inertias)[1:]),
        "unknown_masses": problem,
        "given": as_plain(arm.weight),
        "effort": [None if np.isinf(limit) else float(limit) for limit in arm.effort],
        "joints_without_effort": unlimited,
        "held_out": None
        if held is None
        else {
            "length": held.length,
            "gives_up": held.load.as_data(),
            "payload": held.payload if np.isfinite(held.payload) else None,
        },
        "sag": _describe_sag(arm),
    }


def _describe_sag(arm: Arm) -> dict[str, Any] | None:
    """Describe how far the tip of the straight arm sags [m], or why it does not stay; None if unknown."""
    import numpy as np

    if not arm.sag_known:
        return None
    straight = arm.straight()
    try:
        sagged = arm.sag(straight)
    except NoEquilibrium as error:
        return {"tip": None, "problem": str(error)}
    moved = arm.at(sagged).points[-1] - arm.at(straight).points[-1]
    return {"tip": float(np.linalg.norm(moved)), "problem": None}


def _weight_in_words(weight: Mapping[str, Any], length: float) -> dict[str, str]:
    stated = weight["given"]
    words = {"mass": weight["unknown_masses"] or f"{weight['mass']:.4g} kg that joints move"}
    if "masses" in stated:
        source = f" from a density of {stated['density']:.4g} kg/m³" if "density" in stated else ""
        words["mass"] += f", that of {len(stated['masses'])} links{source}"
    carried = [
        f"{load['mass']:.4g} kg at {load.get('frame', 'the tip')}" for load in stated.get("payloads", ())
    ]
    carried += [f"a cable of {load['mass_per_length']:.4g} kg/m" for load in stated.get("cables", ())]
    if carried:
        words["carries"] = enumerated(carried, 8)
    if weight["sag"] is not None:
        sag = weight["sag"]
        words["sag"] = sag["problem"] or f"{length_text(sag['tip'])} at the tip of the straight arm"
    lacking = weight["joints_without_effort"]
    if weight["unknown_masses"]:
        return words
    if lacking:
        words["held out"] = f"not known: no torque limits of {enumerated(lacking)}"
        return words
    held = weight["held_out"]
    load = held["gives_up"]
    needed = f"{number_text(load['needed'])} of {number_text(load['limit'])} {load['unit']}"
    if load["share"] > 1.0:
        reach = f"{length_text(held['length'])} of {length_text(length)} towards the tip"
        words["held out"] = f"{reach}, in the worst direction; {load['joint']} gives up first ({needed})"
        return words
    more = "" if held["payload"] is None else f", and {held['payload']:.3g} kg more at the tip"
    words["held out"] = f"wholly, in the worst direction{more}; most loaded is {load['joint']} ({needed})"
    return words


def _soft_limits_in_words(names: Sequence[str]) -> dict[str, str]:
    if not names:
        return {}
    shown = enumerated(names, 8)
    return {"soft limits": f"those of <safety_controller> limit {shown}; --hard-limits ignores them"}


def _following_in_words(about: Mapping[str, Any]) -> dict[str, str]:
    if about.get("curve") is None:
        return {}
    curve = about["curve"]
    off = error_text(curve["largest_residual"], about["length"])
    away = error_text(curve["distance_from_curve"], about["length"])
    words = {
        "curve": f"{curve['name']}: {curve['placed_by']} placement; "
        f"largest distance of a control point from the curve {off}",
        "whole arm": f"largest distance of a link from the curve {away}",
    }
    if curve["fallback"]:
        words["why not in turn"] = curve["fallback"]
    if curve["too_much"]:
        words["too much"] = "\n".join(curve["too_much"])
    if curve["incomplete"]:
        words["incomplete"] = curve["incomplete"]
    return words


def _joints(arm: Arm, described: Mapping[str, Any]) -> list[dict[str, Any]]:
    names = [(module, name) for module, names in enumerate(arm.module_joints, start=1) for name in names]
    coupled = {coupling.joint: coupling for coupling in arm.couplings}

    def limits(name: str, column: int) -> dict[str, Any]:
        """Return the limits of a joint and, if it is coupled, its leader, ratio and offset."""
        ratio = 1.0
        offset = 0.0
        more = {}
        if name in coupled:
            _, leader, ratio, offset = coupled[name]
            more = {"follows": leader, "ratio": ratio, "offset": offset}
        lower, upper = sorted(ratio * float(edge[column]) + offset for edge in arm.limits[:2])
        velocity = abs(ratio) * float(arm.limits.velocity[column])
        return {"lower": lower, "upper": upper, "velocity": velocity, **more}

    return [
        {
            "name": name,
            "module": module,
            "type": described[name].type,
            "parent": described[name].parent,
            "child": described[name].child,
            "axis": axis.tolist(),
            **limits(name, column),
            "unit": "m" if described[name].type == "prismatic" else "rad",
        }
        for (module, name), column, axis in zip(names, arm.chain.columns, arm.chain.axes, strict=True)
    ]


def _without_closed_form(arm: Arm) -> str:
    """Describe the first module without closed-form kinematics, with the reason; empty if there is none."""
    from pinposture.placement.module_kinematics import joint_groups

    try:
        groups = joint_groups(arm)
    except UnsupportedModule as error:
        return str(error)
    numeric = next((group for group in groups if group.reason), None)
    if numeric is None:
        return ""
    joints = arm.module_joints[numeric.module]
    return str(UnsupportedModule(numeric.module + 1, joints, f"{numeric.reason}; it is placed numerically"))


def _kinematics(arm: Arm) -> list[str]:
    """Return the kinematics of each module, by name; empty if only least squares over the whole arm work."""
    from pinposture.placement.module_kinematics import kinematics_names

    try:
        return list(kinematics_names(arm))
    except UnsupportedModule:
        return []


def describe_scene(scene: Scene, arm: Arm) -> dict[str, Any]:
    """Describe a scene around an arm at zero joint positions, as JSON-compatible data; lengths in metres."""
    import numpy as np

    from pinposture.collision import CollisionModel

    clearance = CollisionModel(arm, scene)
    near = clearance.nearest(arm.at(arm.neutral()), np.inf)
    nearest: dict[str, tuple[str, float]] = {}
    for pair, distance in zip(near.pairs, near.distances, strict=True):
        for one, other in (pair, pair[::-1]):
            nearest.setdefault(one, (other, float(distance)))

    def beside(name: str) -> dict[str, Any]:
        other, distance = nearest.get(name, (None, None))
        return {"nearest": other, "distance": distance}

    return {
        "margin": scene.margin,
        "self_collision": scene.self_collision,
        "pairs": len(clearance.pairs),
        "outliers": _suspects(scene),
        "excluded_pairs": [pair._asdict() for pair in clearance.excluded_pairs],
        "obstacles": [
            {"name": name, **obstacle.to_dict(embed=False), **beside(name)}
            for name, obstacle in scene.obstacles.items()
        ],
        "bodies": [{"name": name, **beside(name)} for name in dict.fromkeys(clearance.bodies)],
    }


def _suspects(scene: Scene) -> dict[str, dict[str, Any]]:
    """Count the points of each point cloud that look like outliers, if any; distances in metres."""
    from pinposture.collision import Scan
    from pinposture.collision.scan import find_outliers, suspect_distance

    suspects = {}
    for name, obstacle in scene.obstacles.items():
        if not isinstance(obstacle, Scan) or obstacle.faces is not None:
            continue
        distance = suspect_distance(obstacle.points)
        count = int(find_outliers(obstacle.points, distance).sum()) if distance > 0.0 else 0
        if count:
            suspects[name] = {"points": count, "of": len(obstacle.points), "distance": distance}
    return suspects


def print_scene(about: Mapping[str, Any]) -> None:
    """Print the result of `describe_scene`: obstacles, bodies of the arm, and what is nearest to each."""
    excluded = [f"{pair['first']} to {pair['second']}" for pair in about["excluded_pairs"]]
    facts = {
        "margin": length_text(about["margin"]),
        "to itself": "distances of the arm from itself count" if about["self_collision"] else "not looked at",
        "pairs": f"{about['pairs']}, nearest at zero joint positions below",
    }
    if excluded:
        facts["excluded pairs"] = ", ".join(excluded)
    for name, outliers in about["outliers"].items():
        near = length_text(outliers["distance"])
        what = f"{outliers['points']} of {outliers['of']} points have fewer than eight others within {near}"
        facts[f"outliers of {name}"] = f"{what}; outlier_distance = {outliers['distance']:.2g} removes them"
    print_facts(facts)
    for kind, headings in (("obstacles", ("obstacle", "type")), ("bodies", ("body",))):
        rows = [
            (one["name"], *([one["type"]] if "type" in one else []), one["nearest"] or "-", one["distance"])
            for one in about[kind]
        ]
        if rows:
            print_table((*headings, "nearest to it", "distance [m]"), rows)
