"""Edit a task: a program uses the editor as a person does in the browser.

python examples/11_edit_a_task.py

With --stay the editor runs until Ctrl-C: open the address in a browser, and drag.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.files import first_task

# An arm whose joints bend by half a radian, and a first task: straight, then bent three seconds later.
module = pp.template("RyRz").with_limits(-0.5, 0.5)
arm = pp.Arm.from_modules([module] * 20)
file = Path("out/edited/task.toml")
editor = Editor(first_task(arm, "edited"), file)
editor.start()


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait for a condition; the editor runs in threads of its own."""
    while not condition():
        time.sleep(0.02)


# The editor's loop performs requests in turn with those from the browser.
end = editor.session.shape.points[-1] + [0.1, 0.3, 0]
editor.post(lambda session: session.reshape(lambda arm, shape: shape.moved(arm, 5, end), "end moved aside"))
wait_for(lambda: editor.session.history.undoable == "end moved aside")

# The arm follows within its limits, in real time.
wait_for(lambda: editor.live.number == editor.session.number and editor.live.status == "converged")
print(f"converged, mean error {1e3 * editor.live.mean_error:.1f} mm")

# A refused shape changes nothing, and the notice says why: this curve would turn back at its base.
back = editor.session.shape.points[0] + [-0.3, 0, 0.05]
editor.post(lambda session: session.reshape(lambda arm, shape: shape.moved(arm, 1, back), "first point back"))
wait_for(lambda: editor.session.notice.kind == "error")
print(editor.session.notice.text)

# `pinposture run` performs the saved task file.
editor.post(editor.files.save)
wait_for(file.exists)
print(f"saved; next: pinposture run {file}, or pinposture edit {file}")

if "--stay" in sys.argv:
    print(f"open {editor.url} in a browser, and drag; Ctrl-C ends")
    editor.wait()
editor.close()
