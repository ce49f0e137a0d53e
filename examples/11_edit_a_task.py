"""The editor from Python: what hands do in the browser a program can do, too, and both see the same.

python examples/11_edit_a_task.py

With --stay it goes on until Ctrl-C: open the address in a browser, and drag.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.first_task import first_task

# An arm whose joints bend by half a radian, and a task to begin with: straight, and three seconds later bent.
module = pp.template("RyRz").with_limits(-0.5, 0.5)
arm = pp.Arm.from_modules([module] * 20)
file = Path("out/edited/task.toml")
editor = Editor(first_task(arm, "edited"), file)
editor.start()


def wait_for(what: Callable[[], bool]) -> None:
    """Wait until something is so; the editor works in threads of its own."""
    while not what():
        time.sleep(0.02)


# What is posted is done by the editor's own loop, in turn with what hands do in the browser.
end = editor.session.shape.points[-1] + [0.1, 0.3, 0]
editor.post(lambda session: session.reshape(lambda arm, shape: shape.moved(arm, 5, end), "end moved aside"))
wait_for(lambda: editor.session.history.undoable == "end moved aside")

# The arm follows within its limits, in real time.
wait_for(lambda: editor.live.number == editor.session.number and editor.live.status == "converged")
print(f"taken, mean error {1e3 * editor.live.mean_error:.1f} mm")

# What the arm cannot take changes nothing, and says why: here the curve would turn back at its base.
back = editor.session.shape.points[0] + [-0.3, 0, 0.05]
editor.post(lambda session: session.reshape(lambda arm, shape: shape.moved(arm, 1, back), "first point back"))
wait_for(lambda: editor.session.notice.kind == "error")
print(editor.session.notice.text)

# The task file is the one that `pinposture run` performs.
editor.post(editor.files.save)
wait_for(file.exists)
print(f"saved; perform it: pinposture run {file}, edit it: pinposture edit {file}")

if "--stay" in sys.argv:
    print(f"open {editor.url} in a browser, and drag; Ctrl-C ends")
    editor.wait()
editor.close()
