"""Files, control cycles and command lines as functions of plain data, for `hostile_calls.py`.

Each function writes a file, or makes cycles, of the data that it is given; each argument of each has an
example in `examples`, named "function.argument".
"""

from __future__ import annotations

import io
import json
import re
import struct
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer

import pinposture as pp
from pinposture.cli import app
from pinposture.editor import Editor
from pinposture.sim import Simulation, simulate
from pinposture.storage import parse_toml
from pinposture.viz.simulation import plot_simulation

SHIPPED = Path(__file__).parents[1] / "examples"
BEND = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.05, 0.0], [0.3, 0.1, 0.0]]
"""Control points of a curve for short arms [m]."""
TETRAHEDRON = [[0.3, 0.3, 0.3], [0.4, 0.3, 0.3], [0.3, 0.4, 0.3], [0.3, 0.3, 0.4]]
CORNERS = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
QUANTITY = re.compile(r"([-+]?[\d.]+) ?([a-zA-Z][\w/^]*)")


class Quantity(NamedTuple):
    """A number with a unit, which is text in files."""

    number: Any
    unit: str


class Unset(float):
    """An option that is left out, unless a number takes its place."""


@cache
def an_arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=3)


@cache
def a_fed_arm() -> pp.Arm:
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.2, velocity=0.5)
    return pp.Arm.from_modules([pp.ModuleTemplate("Feed", (slide,), (0.05,)), *[pp.template("RyRz")] * 3])


def a_target() -> pp.Target:
    return pp.Target.from_configuration(an_arm(), np.full(6, 0.1))


@cache
def a_run() -> pp.Run:
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)}, margin=0.01)
    limits = pp.Limits(step=None, dt=0.05, velocity=1.0, acceleration=5.0)
    return pp.track(an_arm(), a_target(), np.zeros(6), limits=limits, scene=scene)


@cache
def a_motion() -> pp.Trajectory:
    keyframes = [pp.Keyframe(joints=(0.0,) * 6), pp.Keyframe(joints=(0.1,) * 6, duration=0.3)]
    return pp.move_through(an_arm(), keyframes, limits=pp.Limits(step=None, dt=0.05, velocity=1.0))


# Values as text.


def with_quantities(value: Any) -> Any:
    """Return data in which text such as "2 cm" is a quantity."""
    if isinstance(value, Mapping):
        return {key: with_quantities(each) for key, each in value.items()}
    if isinstance(value, list):
        return [with_quantities(each) for each in value]
    found = QUANTITY.fullmatch(value) if isinstance(value, str) else None
    return value if found is None else Quantity(float(found[1]), found[2])


def toml(value: Any) -> str:
    if isinstance(value, Quantity):
        return json.dumps(f"{value.number} {value.unit}")
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, bool | str) else str(value)


def write(name: str, text: str) -> Path:
    path = Path(name)
    path.write_text(text)
    return path


def write_toml(content: Any) -> Path:
    if not isinstance(content, Mapping):
        return write("content.toml", f"content = {toml(str(content))}\n")
    lines = (f"{json.dumps(key)} = {toml(value)}\n" for key, value in content.items())
    return write("content.toml", "".join(lines))


def rows_of(rows: Any, separator: str) -> str:
    listed = rows if isinstance(rows, list | np.ndarray) else [[rows]]
    return "".join(separator.join(map(str, row)) + "\n" for row in listed)


# Files.


def plan_task(content: Any) -> Any:
    task = pp.Task.load(write_toml(content))
    reference = task.reference()
    return reference.offsets, [each.clearance for each in task.feasibility(reference)]


def perform_task(content: Any) -> Any:
    motion = pp.Task.load(write_toml(content)).perform()
    return motion.q, motion.time, motion.mean_error


def track_in_scene(content: Any) -> Any:
    scene = pp.Scene.load(write_toml(content))
    run = pp.track(an_arm(), a_target(), np.zeros(6), scene=scene, max_steps=20)
    return run.q, run.point_errors


def read_curve(content: Any) -> Any:
    curve = pp.Curve.load(write("curve.json", json.dumps(content, default=str)))
    target = pp.resolve_targets(an_arm(), curve, placement="align")
    return curve.length, target.points


def read_control_points(rows: Any) -> Any:
    curve = pp.Curve.load(write("curve.csv", rows_of(rows, ",")))
    return curve.length, curve.at(0.5 * curve.length)


def read_points(rows: Any, separator: str, suffix: str) -> Any:
    scan = pp.Scan.load(write(f"scan{suffix}", rows_of(rows, separator)))
    scene = pp.Scene({"scan": scan}, margin=0.01)
    return scan.points, pp.CollisionModel(an_arm(), scene).minimum(np.zeros(6)).distance


def read_array(points: Any) -> Any:
    np.save("scan.npy", np.asarray(points))
    scene = pp.Scene({"scan": pp.Scan.load("scan.npy")}, margin=0.01)
    return pp.CollisionModel(an_arm(), scene).minimum(np.zeros(6)).distance


def read_mesh(corners: Any) -> Any:
    rows = corners if isinstance(corners, list) else [[corners]]
    lines = ["v " + " ".join(map(str, each)) for each in rows]
    faces = ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    mesh = pp.Mesh.load(write("mesh.obj", "\n".join(lines + faces) + "\n"))
    return pp.CollisionModel(an_arm(), pp.Scene({"mesh": mesh})).minimum(np.zeros(6)).distance


def stored(values: Any, kind: str) -> bytes:
    """Numbers as a file of a type holds them: whole ones within its range, large ones as infinite."""
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (OverflowError, TypeError, ValueError) as error:
        raise pp.PostureError("no file holds this") from error
    with np.errstate(over="ignore"):
        if kind != "<f4":
            limits = np.iinfo(kind)
            numbers = np.nan_to_num(np.clip(numbers, limits.min, limits.max))
        return numbers.astype(kind).tobytes()


def read_ply(vertices: Any, faces: Any, counts: Any, form: str) -> Any:
    """A surface in a file that says how many vertices and faces there are."""
    vertex = "".join(f"property float {name}\n" for name in "xyz")
    given = counts if isinstance(counts, list) and counts else [counts]
    lines = [f"format {form} 1.0", f"element vertex {given[0]}", vertex.strip()]
    lines += [f"element face {given[-1]}", "property list uchar int vertex_indices"]
    header = "\n".join(["ply", *lines, "end_header", ""])
    listed = faces if isinstance(faces, list) else [faces]
    if form == "ascii":
        rows = [[3, *(each if isinstance(each, list) else [each])] for each in listed]
        content = (header + rows_of(vertices, " ") + rows_of(rows, " ")).encode()
    else:
        corners = b"".join(b"\3" + stored(each, "<i4") for each in listed)
        content = header.encode() + stored(vertices, "<f4") + corners
    return _clearances(content, ".ply")


def read_glb(content: Any, vertices: Any, faces: Any) -> Any:
    """A surface in a file of glTF, whose description is given."""
    data = stored(vertices, "<f4") + stored(faces, "<u2")
    text = json.dumps(content, default=str).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    size = struct.pack("<II", 2, 28 + len(text) + len(data))
    parts = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    )
    return _clearances(b"glTF" + size + parts, ".glb")


def _clearances(content: bytes, suffix: str) -> Any:
    """The points of a file as a scan, and the distances of an arm from it as a scan and as a mesh."""
    path = Path(f"surface{suffix}")
    path.write_bytes(content)
    scan = pp.Scan.load(path)
    told = [scan.points, pp.CollisionModel(an_arm(), pp.Scene({"s": scan})).minimum(np.zeros(6)).distance]
    if suffix == ".ply":
        mesh = pp.Mesh.load(path)
        told.append(pp.CollisionModel(an_arm(), pp.Scene({"s": mesh})).minimum(np.zeros(6)).distance)
    return told


GLTF = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [
        {"children": [1], "translation": [0.3, 0.3, 0.3], "rotation": [0.0, 0.0, 0.0, 1.0]},
        {"mesh": 0, "scale": [0.1, 0.1, 0.1]},
    ],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 4}]}],
    "buffers": [{"byteLength": 72}],
    "bufferViews": [
        {"buffer": 0, "byteOffset": 0, "byteLength": 48},
        {"buffer": 0, "byteOffset": 48, "byteLength": 24},
    ],
    "accessors": [
        {
            "bufferView": 0,
            "componentType": 5126,
            "count": 4,
            "type": "VEC3",
            "min": [0, 0, 0],
            "max": [1, 1, 1],
        },
        {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
    ],
}
"""The description of a tetrahedron."""


def read_mjcf(numbers: Any) -> Any:
    """An arm of two joints, one of which follows the other, whose numbers are given."""
    given = dict(numbers) if isinstance(numbers, Mapping) else {"pos": [numbers]}
    word = {key: " ".join(map(str, each)) for key, each in given.items()}
    of = lambda key: word.get(key, "0")  # noqa: E731
    joint = f'range="{of("range")}" damping="{of("damping")}" ref="{of("ref")}" armature="{of("armature")}"'
    text = (
        f'<mujoco model="m"><compiler angle="radian"/><option timestep="{of("timestep")}"/><worldbody>'
        f'<body name="a"><inertial pos="0 0 0" mass="{of("mass")}" diaginertia="{of("inertia")}"/>'
        f'<joint name="j1" axis="{of("axis")}" {joint}/><geom type="capsule" size="{of("size")}"/>'
        f'<body name="b" pos="{of("pos")}" quat="{of("quat")}"><joint name="j2" axis="0 1 0" range="-1 1"/>'
        f'<geom size="0.01" mass="1"/><body name="c" pos="0.1 0 0" euler="{of("euler")}"><joint name="j3"/>'
        f'<geom size="0.01" density="{of("density")}"/><site name="tip" pos="{of("pos")}"/></body></body>'
        "</body></worldbody><equality>"
        f'<joint joint1="j3" joint2="j2" polycoef="{of("polycoef")}"/></equality></mujoco>'
    )
    arm = pp.Arm.load(text)
    state = arm.at(arm.neutral())
    return state.points, state.jacobians, arm.length


def read_description(numbers: Any) -> Any:
    """An arm of two joints whose numbers are given."""
    given = dict(numbers) if isinstance(numbers, Mapping) else {"xyz": [numbers]}
    joined = {key: " ".join(map(str, each)) for key, each in given.items()}
    word = lambda key: joined.get(key, "0")  # noqa: E731
    limit = (
        f'<limit lower="{word("lower")}" upper="{word("upper")}" '
        f'effort="{word("effort")}" velocity="{word("velocity")}"/>'
    )
    inertia = f'<inertia ixx="{word("inertia")}" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    text = (
        '<robot name="r"><link name="b"/><link name="l1"><inertial><mass value="'
        f'{word("mass")}"/>{inertia}</inertial><collision><geometry><cylinder radius="{word("radius")}" '
        f'length="0.1"/></geometry></collision></link><link name="l2"/><link name="t"/>'
        f'<joint name="j1" type="revolute"><parent link="b"/><child link="l1"/><axis xyz="{word("axis")}"/>'
        f'{limit}</joint><joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/>'
        f'<origin xyz="{word("xyz")}" rpy="{word("rpy")}"/><axis xyz="0 1 0"/>{limit}'
        f'<mimic joint="j1" multiplier="{word("ratio")}" offset="{word("offset")}"/></joint>'
        f'<joint name="f" type="fixed"><parent link="l2"/><child link="t"/><origin xyz="{word("xyz")}"/>'
        "</joint></robot>"
    )
    arm = pp.Arm.load(text)
    state = arm.at(arm.neutral())
    return state.points, state.jacobians, arm.length


# Results.


def packed(result: Any) -> dict[str, Any]:
    """The arrays and the description of a saved result; without those of the arm's model."""
    with np.load(pp.save(result, "result.npz"), allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    return {"about": json.loads(str(arrays.pop("about"))), "arrays": arrays}


def load_result(content: Any) -> Any:
    """What a file of this content tells, or the refusal."""
    given = dict(content) if isinstance(content, Mapping) else {"about": content, "arrays": {}}
    about = given["about"]
    if isinstance(about, Mapping) and isinstance(about.get("arm"), str):
        given["about"] = {**about, "arm": json.loads(about["arm"])}
    np.savez("changed.npz", about=np.array(json.dumps(given["about"], default=str)), **given["arrays"])
    result = pp.load("changed.npz")
    if isinstance(result, pp.JointTrajectory):
        pp.save(result, "again.csv")
        return vars(result), result.sampled(0.02).positions
    if isinstance(result, Simulation):
        told = result.summary()
        plot_simulation(result)
        return told, result.points, result.time, str(result), result.faults
    if isinstance(result, pp.Batch):
        return result.final_error, str(result), [run.q for run in result]
    run = result.run if isinstance(result, pp.Trajectory) else result
    if result.faults:
        return run.q, run.point_errors
    trajectory = result.joint_trajectory()
    return run.q, run.point_errors, trajectory.positions, trajectory.velocities


def read_table(header: str, rows: Any) -> Any:
    trajectory = pp.load(write("joints.csv", header + "\n" + rows_of(rows, ",")), pp.JointTrajectory)
    return vars(trajectory), trajectory.sampled(0.05).positions


def read_message(content: Any) -> Any:
    trajectory = pp.load(write("joints.json", json.dumps(content, default=str)), pp.JointTrajectory)
    return vars(trajectory), trajectory.sampled(0.05).positions


# Cycles.


def make_cycles(
    measured: Any, velocity: Any, points: Any, weights: Any, ball: Any, movement: Any, dt: Any
) -> Any:
    """Three cycles of usual values, and three of those given."""
    arm = an_arm()
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=5.0)
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)}, margin=0.01)
    tracker = pp.Tracker(arm, limits=limits, scene=scene)
    tracker.update(a_target())
    told = [tracker.step(np.zeros(6)) for _ in range(3)]
    refused = None
    for change in (
        lambda: tracker.update(pp.Target.from_points(arm, points, weights)),
        lambda: tracker.update(a_target(), velocity=velocity),
        lambda: tracker.step(measured),
        lambda: tracker.step(np.zeros(6), dt),
        lambda: tracker.step(np.zeros(6), scene=scene.moved({"ball": ball}, {"ball": movement})),
    ):
        try:
            change()
        except pp.PostureError as error:
            refused = error
        for _ in range(2):
            told.append(tracker.step(tracker.command))
        told += [tracker.command, tracker.positions]
        assert np.abs(told[-3]).max() <= 0.02 + 1e-9, "faster than the limit"
    if refused is not None and not np.isfinite(np.concatenate(told)).all():
        raise AssertionError("not finite after a refusal")
    return told


def restart(measured: Any, dq: Any) -> Any:
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=5.0)
    tracker = pp.Tracker(an_arm(), limits=limits)
    tracker.update(a_target())
    tracker.restart(measured, dq)
    return [tracker.step(np.zeros(6)), tracker.command]


def follow_path(points: Any, speed: Any, interval: Any, depth: Any) -> Any:
    path = pp.Curve.spline(points)
    reference = pp.follow_leader(a_fed_arm(), path, interval, speed, depth=depth)
    rows = np.array([a_fed_arm().integrate(reference.start, each) for each in reference.offsets])
    return reference.offsets, pp.path_deviation(a_fed_arm(), rows, path).largest


# The command.


@cache
def _files() -> dict[str, str]:
    """Files for the command to work on."""
    folder = Path.cwd()
    write("arm.urdf", an_arm().urdf or "")
    pp.save(a_run(), "run.npz")
    write_toml(small_task()).rename("small.toml")
    Path("curve.csv").write_text("0,0,0\n0.1,0,0\n0.2,0.05,0\n0.3,0.1,0\n")
    return {name: str(folder / name) for name in ("arm.urdf", "run.npz", "small.toml", "curve.csv")}


VERBS: dict[str, tuple[str, ...]] = {
    "generate": ("RyRz", "--modules=3", "--output=made.urdf"),
    "inspect": ("arm.urdf",),
    "track": ("arm.urdf", "--curve=line", "--partial", "--steps=20", "--json"),
    "reach": ("arm.urdf", "--to=0.1,0.03,0.03", "--budget=10", "--json"),
    "batch": ("arm.urdf", "--curve=line", "--partial", "--count=2", "--steps=10", "--jobs=1", "--json"),
    "run": ("small.toml", "--json"),
    "export": ("run.npz", "--output=out.csv"),
    "view": ("run.npz", "--output=view.html"),
    "simulate": ("run.npz", "--hold=0.1", "--json"),
    "edit": ("arm.urdf", "--no-browser"),
}


PATTERNS = {
    "--to 1": "0.1,{},0.03",
    "--direction 1": "1,{},0",
    "--tip-position 1": "0.1,{},0.03",
    "--tip-pose 3": "0.1,0.03,0.03,{},0,0",
    "--tip-pose 0": "{},0.03,0.03,0,0,0",
    "--link-lengths 1": "0.02,{}",
    "--split 1": "2,{},2",
    "--velocity 1": "1,1,1,1,1,{}",
    "--acceleration 1": "5,5,5,5,5,{}",
    "--jerk 1": "50,50,50,50,50,{}",
    "--locked 1": "m02_j1_y={}",
    "--locked deg": "m02_j1_y={}deg",
    "--couple 1": "m02_j1_y=m01_j1_y,{}",
    "--couple 2": "m02_j1_y=m01_j1_y,0.5,{}",
    "--region 1": "1-{}",
    "--ellipsoids 1": "1,{}",
    "--start 1": "0,0,0,0,0,{}",
}
"""Options of several numbers, with a word that tells them apart, and the place of a number."""


def run_command(verb: str, options: Any) -> Any:
    """Run a verb; it ends with 0 or 1, or with 2 and one line of error."""
    given = dict(options) if isinstance(options, Mapping) else {}
    files = _files()
    words = [verb, *(files.get(word, word) for word in VERBS[verb])]
    for name, value in given.items():
        option = name.split(" ")[0]
        if not isinstance(value, Unset):
            words.append(f"{option}={PATTERNS.get(name, '{}').format(value)}")
    out = io.StringIO()
    err = io.StringIO()
    Editor.wait = _end_at_once  # type: ignore[method-assign]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            app(words, prog_name="pinposture")
        code: object = 0
    except SystemExit as end:
        code = end.code
    lines = [line for line in err.getvalue().splitlines() if line.startswith("error")]
    if code not in (0, 1, 2) or "Traceback" in err.getvalue():
        raise AssertionError(f"code {code}: {err.getvalue()[-200:]}")
    if code == 2 and len(words) == 1 + len(VERBS[verb]):
        raise AssertionError(f"the example is refused: {err.getvalue()[-200:]}")
    if code == 2 and len(lines) != 1:
        raise AssertionError(f"code 2 and {len(lines)} lines of error: {err.getvalue()[-200:]}")
    if "NaN" in out.getvalue():
        raise AssertionError(f"NaN in what is printed: {out.getvalue()[:200]}")
    return None


def _end_at_once(editor: Editor) -> None:
    raise KeyboardInterrupt


def options_of(verb: str) -> dict[str, Any]:
    """The options of a verb that take a value."""
    parameters = typer.main.get_command(app).commands[verb].params  # type: ignore[attr-defined]
    names = [each.opts[0] for each in parameters if not getattr(each, "is_flag", False)]
    names = [name for name in names if name.startswith("--") and name not in ("--jobs", "--output")]
    listed = [pattern for pattern in PATTERNS if pattern.split(" ")[0] in names]
    return {name: Unset() for name in [*names, *listed]}


# What is called, and with what.


def small_task() -> dict[str, Any]:
    line = {"type": "line", "a": [0, 0, 0], "b": [0.15, 0, 0]}
    coil = {"type": "helix", "radius": Quantity(10.0, "cm"), "pitch": Quantity(3.0, "cm"), "turns": 2.0}
    return {
        "version": 1,
        "kind": "keyframes",
        "arm": {"template": "RyRz", "modules": 3},
        "limits": {
            "cycle": Quantity(50.0, "ms"),
            "velocity": Quantity(90.0, "deg/s"),
            "acceleration": Quantity(360.0, "deg/s^2"),
        },
        "scene": {
            "margin": 0.01,
            "obstacles": {"ball": {"type": "sphere", "center": [0.1, 0.3, 0.2], "radius": 0.05}},
        },
        "keyframes": [
            {"name": "straight", "curve": line},
            {
                "name": "coil",
                "duration": Quantity(0.5, "s"),
                "curve": coil,
                "trim": True,
                "placement": "align",
            },
        ],
    }


def shipped(name: str) -> Any:
    return with_quantities(parse_toml((SHIPPED / name).read_text()))


def message() -> dict[str, Any]:
    points = [
        {
            "positions": [0.1 * k, 0.2 * k],
            "velocities": [0.1, 0.2],
            "time_from_start": {"sec": k, "nanosec": 0},
        }
        for k in range(3)
    ]
    return {"joint_names": ["a", "b"], "points": points}


CALLS: dict[str, Callable[..., Any]] = {
    **{f"plan_task.{name}": plan_task for name in ("around", "inspection", "keyframes", "pipe")},
    **{f"load_result.{name}": load_result for name in ("run", "motion", "batch", "joints", "simulation")},
    **{f"read_points.{name}": read_points for name in ("xyz", "csv")},
    **{f"run_command.{verb}": run_command for verb in VERBS},
    "perform_task": perform_task,
    "track_in_scene": track_in_scene,
    "read_curve": read_curve,
    "read_control_points": read_control_points,
    "read_array": read_array,
    "read_mesh": read_mesh,
    "read_description": read_description,
    "read_mjcf": read_mjcf,
    **{f"read_ply.{form}": read_ply for form in ("ascii", "binary_little_endian")},
    "read_glb": read_glb,
    "read_table": read_table,
    "read_message": read_message,
    "make_cycles": make_cycles,
    "restart": restart,
    "follow_path": follow_path,
}
"""What is called beside the public functions; a word after a dot tells cases of one function apart."""


@cache
def examples() -> dict[str, Any]:
    """An example of each argument, by the name in `CALLS` and its own."""
    points = np.random.default_rng(0).uniform(0.3, 0.4, (30, 3)).round(3)
    batch = pp.track_many(an_arm(), [a_target()], [np.zeros(6), np.full(6, 0.2)], max_steps=5, keep="motions")
    results = {"run": a_run(), "motion": a_motion(), "batch": batch, "joints": a_run().joint_trajectory()}
    results["simulation"] = simulate(an_arm(), a_run(), hold=0.0, scene=a_run().scene)
    contents = {name: packed(result) for name, result in results.items()}
    for name in ("motion", "batch", "simulation"):  # the arm is that of the run
        contents[name]["about"]["arm"] = json.dumps(contents[name]["about"]["arm"])
    return {
        "plan_task.around.content": shipped("tasks/around.toml"),
        "plan_task.inspection.content": shipped("tasks/inspection.toml"),
        "plan_task.keyframes.content": shipped("tasks/keyframes.toml"),
        "plan_task.pipe.content": shipped("tasks/pipe.toml"),
        "perform_task.content": small_task(),
        "track_in_scene.content": shipped("scene.toml"),
        **{f"load_result.{name}.content": content for name, content in contents.items()},
        "read_curve.content": pp.Curve.spline(BEND).to_dict(),
        "read_control_points.rows": BEND,
        "read_points.xyz.rows": points.tolist(),
        "read_points.xyz.separator": " ",
        "read_points.xyz.suffix": ".xyz",
        "read_points.csv.rows": points.tolist(),
        "read_points.csv.separator": ",",
        "read_points.csv.suffix": ".csv",
        "read_array.points": points,
        "read_mesh.corners": TETRAHEDRON,
        "read_description.numbers": {
            **{"lower": [-1.0], "upper": [1.0], "effort": [1.0], "velocity": [1.0], "mass": [1.0]},
            **{"inertia": [1.0], "radius": [0.01], "ratio": [0.5], "offset": [0.1]},
            **{"xyz": [0.1, 0.0, 0.0], "rpy": [0.0, 0.1, 0.0], "axis": [0.0, 0.0, 1.0]},
        },
        "read_mjcf.numbers": {
            **{"range": [-1.0, 1.0], "damping": [0.1], "ref": [0.1], "armature": [0.01], "mass": [1.0]},
            **{"inertia": [0.1, 0.1, 0.1], "axis": [0.0, 0.0, 1.0], "size": [0.01, 0.05], "density": [100.0]},
            **{"pos": [0.1, 0.0, 0.0], "quat": [1.0, 0.0, 0.1, 0.0], "euler": [0.1, 0.0, 0.2]},
            **{"polycoef": [0.1, 0.5, 0.0, 0.0, 0.0], "timestep": [0.002]},
        },
        **{f"read_ply.{form}.vertices": TETRAHEDRON for form in ("ascii", "binary_little_endian")},
        **{f"read_ply.{form}.faces": CORNERS for form in ("ascii", "binary_little_endian")},
        **{f"read_ply.{form}.counts": [4, 4] for form in ("ascii", "binary_little_endian")},
        **{f"read_ply.{form}.form": form for form in ("ascii", "binary_little_endian")},
        "read_glb.content": GLTF,
        "read_glb.vertices": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "read_glb.faces": CORNERS,
        "read_table.header": "time [s],a position [rad],b position [rad]",
        "read_table.rows": [[0.0, 0.0, 0.0], [0.5, 0.1, 0.2], [1.0, 0.2, 0.4]],
        "read_message.content": message(),
        "make_cycles.measured": np.zeros(6),
        "make_cycles.velocity": np.full(6, 0.1),
        "make_cycles.points": an_arm().at(np.full(6, 0.1)).points,
        "make_cycles.weights": np.ones(3),
        "make_cycles.ball": (0.0, 0.01, 0.0),
        "make_cycles.movement": (0.1, 0.0, 0.0),
        "make_cycles.dt": 0.02,
        "restart.measured": np.zeros(6),
        "restart.dq": np.full(6, 0.001),
        "follow_path.points": [(0.2, 0, 0), (0.25, 0, 0), (0.3, 0, 0), (0.35, 0.01, 0), (0.4, 0.02, 0)],
        "follow_path.speed": 0.05,
        "follow_path.interval": 0.05,
        "follow_path.depth": 0.02,
        **{f"run_command.{verb}.verb": verb for verb in VERBS},
        **{f"run_command.{verb}.options": options_of(verb) for verb in VERBS},
    }


if __name__ == "__main__":
    sys.stdout.write("\n".join(CALLS) + "\n")
