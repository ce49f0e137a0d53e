"""Watch a control loop in Foxglove: an arm that takes one shape after another, until Ctrl-C.

pip install 'pinposture[foxglove]'
python examples/foxglove_loop.py
"""

import itertools
import time

import pinposture as pp

DT = 0.01  # cycle time [s]

arm = pp.Arm.from_template("RyRz", modules=20)
scene = pp.Scene({"ball": pp.Sphere(center=(0.5, 0.6, 0.0), radius=0.1)})
curves = (pp.Curve.helix(radius=0.06, pitch=0.15, turns=4), pp.Curve.helix(radius=0.4, pitch=0.0, turns=0.5))
targets = [pp.resolve_targets(arm, curve, placement="align") for curve in curves]
tracker = pp.Tracker(arm, limits=pp.Limits(dt=DT, velocity=1.0, acceleration=4.0), scene=scene)
q = arm.straight()
with pp.view(arm, tracker, viewer="foxglove") as viewer:
    print(f"open {viewer.url}")
    for cycle in itertools.count():
        if cycle % 500 == 0:
            tracker.update(targets[cycle // 500 % 2])
        q = arm.integrate(q, tracker.step(q))  # a robot would measure q
        viewer.show(q)
        time.sleep(DT)
