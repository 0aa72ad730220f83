"""
Where to touch next
===================

A `TouchMap` learns what each thing feels like from every side. From it follows how much
another touch is expected to tell, for every place on the hemisphere. Before the first
touch nobody knows how a thing is turned, so all directions of a ring are worth the
same; one touch of the mug makes it the likeliest, and the directions differ. The next
touch is made where most is to be learnt, away from the first.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser
from palpate.exploration import (
    InformativeTouch,
    TouchMap,
    explore,
    explore_to_learn,
    put_down,
)
from palpate.simulation import find_object

things = [find_object(name) for name in ("mug", "ball", "box")]
touches = explore_to_learn(things, 16, n_sessions=2, random_state=0)
recogniser = ObjectRecogniser().fit(touches)
touch_map = TouchMap().fit(recogniser, touches)

stand = put_down(find_object("mug"), yaw_rad=1.0, random_state=1)
strategy = InformativeTouch(touch_map, stand.hemisphere)
gains = {"before the first touch": strategy.expected_gain(None, [])}
end = explore(
    stand.robot,
    stand.sensor,
    touch_map,
    strategy,
    max_attempts=1,
    clock=stand.robot.clock,
)
gains["after one touch"] = strategy.expected_gain(end.belief, end.history)
next_pose = strategy.next_pose(end.belief, end.history)
print({name: round(share, 3) for name, share in end.belief.posterior.items()})

figure, axes = plt.subplots(1, 2, figsize=(7.2, 3), sharey=True)
for axis, (when, gain) in zip(axes, gains.items(), strict=True):
    shown = axis.imshow(
        np.reshape(gain, (-1, 24)), aspect="auto", vmin=0, origin="lower"
    )
    axis.set(title=when, xlabel="direction, steps of 15 degrees", xticks=[0, 12, 23])
    figure.colorbar(shown, ax=axis, label="expected gain, nats")
axes[0].set_ylabel("ring, lowest first")
