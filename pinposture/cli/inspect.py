"""`pinposture inspect`: show what the library makes of a URDF."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pinposture.cli.inputs import BaseOption, JsonOption, ModulesOption, TipOption, UrdfArgument, read_arm
from pinposture.cli.output import print_facts, print_json, print_table

if TYPE_CHECKING:
    from pinposture.arm import Arm

EXAMPLES = (
    "pinposture inspect arm.urdf",
    "pinposture inspect arm.urdf --base m05_l2 --tip tip --modules 2",
    "pinposture inspect arm.urdf --json",
)


def run(
    *,
    urdf: UrdfArgument,
    base: BaseOption = None,
    tip: TipOption = None,
    modules: ModulesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show what the library makes of a robot description.

    Of all the links it takes one chain, from --base to --tip or the longest one there is, and cuts it into
    modules with a control point at the end of each. Meshes are not needed. Limits are in rad and rad/s, or in
    metres and m/s for a prismatic joint; positions are those at zero joint positions, in the world.
    """
    arm = read_arm(urdf, base, tip, modules)
    about = describe(arm, base, tip)
    if as_json:
        print_json({"file": urdf, **about})
        return
    print_facts(
        {
            "robot": about["name"],
            "chain": f"from link {about['base']} to link {about['tip']}",
            "kind": "planar" if arm.dimension == 2 else "spatial",
            "modules": str(arm.n_modules),
            "DOF": str(arm.nv),
            "length": f"{arm.length:.4g} m",
            "held still": ", ".join(about["held"]) or "no joint",
        }
    )
    joints = [tuple(joint[key] for key in _JOINT_KEYS) for joint in about["joints"]]
    print_table(_JOINT_HEADINGS, joints)
    points = [
        (point["module"], point["name"], point["length"], *point["position"])
        for point in about["control_points"]
    ]
    print_table(_POINT_HEADINGS, points)


_JOINT_KEYS = ("module", "name", "type", "parent", "child", "lower", "upper", "velocity")
_JOINT_HEADINGS = ("module", "joint", "type", "parent", "child", "lower", "upper", "speed")
_POINT_HEADINGS = ("module", "control point", "module length [m]", "x [m]", "y [m]", "z [m]")


def describe(arm: Arm, base: str | None, tip: str | None) -> dict[str, Any]:
    """What there is to know about an arm, as data that JSON can hold.

    Args:
        arm: an arm loaded from a URDF.
        base: link at which it was asked to begin, if any.
        tip: link at which it was asked to end, if any.

    Returns:
        Lengths in metres, angles in radians; positions at the neutral configuration, in the world.
    """
    from pinposture.arm.description import read_description

    description = read_description(arm.urdf or "")
    first, last = (base or description.root, tip) if tip else description.longest_chain()
    described = {joint.name: joint for joint in description.joints}
    joints: list[dict[str, Any]] = []
    for module, names in enumerate(arm.module_joints, start=1):
        for name in names:
            joint = described[name]
            column = arm.columns[len(joints)]
            joints.append(
                {
                    "name": name,
                    "module": module,
                    "type": joint.type,
                    "parent": joint.parent,
                    "child": joint.child,
                    "lower": float(arm.limits.lower[column]),
                    "upper": float(arm.limits.upper[column]),
                    "velocity": float(arm.limits.velocity[column]),
                    "unit": "m" if joint.type == "prismatic" else "rad",
                }
            )
    lengths = arm.chain.module_lengths
    points = [
        {"name": name, "module": k + 1, "length": float(lengths[k]), "position": arm.chain.points[k].tolist()}
        for k, name in enumerate(arm.control_points)
    ]
    return {
        "name": description.name,
        "base": first,
        "tip": last,
        "dimension": arm.dimension,
        "modules": arm.n_modules,
        "dof": arm.nv,
        "nq": arm.nq,
        "length": arm.length,
        "held": [
            joint.name for joint in described.values() if joint.moves and joint.name not in arm.chain.joints
        ],
        "joints": joints,
        "control_points": points,
    }
