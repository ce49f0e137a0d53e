"""A short tour for whoever is here for the first time; each browser remembers that it had it."""

from __future__ import annotations

from typing import Any

import viser

SEEN = "pinposture-tour"

STEPS = (
    (
        "Draw a curve, and the arm takes its shape",
        "The arm follows the curve of the selected keyframe, within its limits.\n\n"
        "Turn the picture with the left mouse button, move it with the right one, zoom with the wheel.",
    ),
    (
        "Drag the blue balls",
        "They control the curve. Drag one with the mouse, or click on it and use its axes, the numbers in "
        "*Shape*, or Shift and the arrow keys. `I` inserts a point, `Delete` deletes one.\n\n"
        "A curve that the arm cannot take turns red and says why; let go, and it is as it was.",
    ),
    (
        "What the colours say",
        "Dots on the arm are posture control points: green is where it belongs, red is far off. An orange "
        "ring marks those that the controller moves at the moment. Red bodies have a joint at a limit.\n\n"
        "The arm leaves the grey part of the curve: there the curve is longer than the arm.",
    ),
    (
        "Keyframes make a motion",
        "*Keyframes* lists postures and their times. Add some, then press *Play* under the picture: limits "
        "of speed and acceleration are kept, and the plots show how near they are.",
    ),
    (
        "Nothing is lost",
        "`Ctrl+Z` takes back, `Ctrl+S` saves the task file, which `pinposture run` performs. Changes are "
        "kept beside it all the time. The tour is in *File* if you want it again.",
    ),
)


def offer_tour(server: viser.ViserServer) -> None:
    """Show the tour to every browser that comes for the first time."""

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:  # called in a thread of its own, so it may wait
        try:
            if client.local_storage.get_item(SEEN, timeout=5.0) is None:
                show_tour(client)
        except (TimeoutError, RuntimeError):  # it left, or does not answer
            return


def show_tour(client: viser.ClientHandle, step: int = 0) -> None:
    """Show a step of the tour in one browser, with ways to go on and to end it."""
    title, text = STEPS[step]
    modal = client.gui.add_modal(title)
    with modal:
        client.gui.add_markdown(text)
        ways = ("Skip", "Next") if step == 0 else ("Back", "Done" if step == len(STEPS) - 1 else "Next")
        buttons = client.gui.add_button_group(f"{step + 1} of {len(STEPS)}", ways)

    async def turn(event: Any) -> None:
        modal.close()
        way = event.target.value
        if way in ("Skip", "Done"):
            client.local_storage.set_item(SEEN, "yes")
        else:
            show_tour(client, step + (1 if way == "Next" else -1))

    buttons.on_click(turn)
