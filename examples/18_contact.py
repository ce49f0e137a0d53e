"""Contact: an arm pushes a crate in a simulation, and stops where it feels a post that nobody told it of.

python examples/18_contact.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.sim import ContactModel, Sensing, simulate, simulate_closed

# An arm of eight modules bends to the left. A crate of 200 g stands on a table in its way.
arm = pp.Arm.from_template("RyRz", modules=8)
posture = arm.configuration([0.0, 0.12] * 8)
target = pp.Target.from_configuration(arm, posture)
limits = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=4.0)
run = pp.track(arm, target, arm.straight(), limits=limits)
crate = pp.Box(center=(0.3, 0.07, -0.02), size=(0.06, 0.06, 0.06))
table = pp.HalfSpace((0, 0, -0.05), (0, 0, 1))
scene = pp.Scene({"crate": crate, "table": table}, touchable=["crate"])

contact = ContactModel(friction=0.4, masses={"crate": 0.2})
pushed = simulate(arm, run, scene=scene, contact=contact)
for event in pushed.contacts.of_arm:
    print(event)
ended = pushed.scene_in(-1, scene).obstacles["crate"].center
print(f"the crate was pushed by {1e3 * np.linalg.norm(np.subtract(ended, crate.center)):.0f} mm")
print(pushed.verdict)

# A contact that was not allowed is a fault.
untouchable = pp.Scene({"crate": crate, "table": table})
refused = simulate(arm, run, scene=untouchable, contact=contact)
print(refused.verdict)

# A post that the tracker does not know of: it stops where a torque is not that of weight and motion.
post = pp.Scene({"post": pp.Cylinder((0.3, 0.07, -0.5), (0.3, 0.07, 0.5), 0.02)})
gravity = np.abs(arm.at(arm.straight()).gravity_torques).max()
for touch in (None, pp.Touch(), pp.Touch(reaction="yield")):
    tracker = pp.Tracker(arm, limits=limits, touch=touch)
    felt = simulate_closed(
        arm,
        tracker,
        target,
        arm.straight(),
        duration=2.0,
        dt=0.01,
        sensing=Sensing(noise=1e-4, torque_noise=0.01 * gravity),
        scene=post,
        contact=ContactModel(),
    )
    events = felt.contacts.of_arm
    most = max(event.force for event in events)
    last = np.linalg.norm(felt.contacts.forces[-1].sum(axis=0))
    name = "without" if touch is None else touch.reaction
    print(f"{name:8} touched at {events[0].time:.3f} s, at most {most:.0f} N, in the end {last:.1f} N")
print(tracker.report.reason)

out = Path("out/contact")
out.mkdir(parents=True, exist_ok=True)
pp.plot_arm(arm, pushed.q[-1], scene=pushed.scene_in(-1, scene)).savefig(out / "pushed.png")
print(f"look at {out / 'pushed.png'}")
