"""Write and execute the notebook of the documentation.

python docs/notebook.py
"""

from __future__ import annotations

from pathlib import Path

import nbformat
from nbclient import NotebookClient

CELLS = (
    """# pinposture in a notebook

Arms, targets, runs, motions and joint trajectories show themselves: make one the last value of a cell.""",
    """import pinposture as pp

arm = pp.Arm.from_template("RyRz", modules=12)  # or pp.Arm.load("arm.urdf")
arm""",
    "A curve becomes a target: a point for each module, and the configuration that puts it there.",
    """curve = pp.Curve.helix(radius=0.08, pitch=0.25, turns=1.5)
target = pp.resolve_targets(arm, curve, placement="align")
target""",
    "The default controller plans the most direct path and follows it within the limits.",
    """limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0)
run = pp.track(arm, target, arm.straight(), limits=limits)
run""",
    """`pp.animate(arm, run)` shows an animation; `pp.view(arm, run)` opens meshcat inside the notebook.
For the robot, a run becomes a joint trajectory:""",
    """joints = run.joint_trajectory()
pp.save(joints, "motion.json")  # trajectory_msgs/msg/JointTrajectory
joints""",
    "Arms have weight. Where masses and torque limits are known, a run tells which joint lacks torque:",
    """heavy = arm.with_payload("0.2 kg").with_effort(1.0)  # at the tip; N m of each motor
pp.track(heavy, target, heavy.straight(), limits=limits)""",
)
"""Text and code in turn."""

PATH = Path(__file__).with_name("notebook.ipynb")


def make() -> nbformat.NotebookNode:
    """Return the notebook without outputs."""
    kinds = (nbformat.v4.new_markdown_cell, nbformat.v4.new_code_cell)
    cells = [kinds[number % 2](source, id=f"cell-{number}") for number, source in enumerate(CELLS)]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def execute(folder: Path) -> nbformat.NotebookNode:
    """Return the notebook with its outputs; files that it writes are left in a folder."""
    notebook = make()
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # when each cell ran
    return notebook


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as scratch:
        nbformat.write(execute(Path(scratch)), PATH)
