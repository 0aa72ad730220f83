"""
One day or two
==============

The same number of touches, taught in one mounting of the sensor or in several. Asked is
always a mounting that was not taught: spread over more days, they are worth more.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, simulate_touches

names = ["mug", "ball", "pen", "box", "stapler"]
touches = simulate_touches(names, 24, n_sessions=4, mountings=True, random_state=0)
days = list(dict.fromkeys(touches.session))
test = touches[touches.session == days[3]]

right = {}
for n_days in (1, 2, 3):
    each = 24 // n_days
    taught = np.isin(touches.session, days[:n_days])
    place = np.zeros(len(touches), int)
    for episode in touches.episodes():
        place[episode.rows] = np.arange(len(episode.rows))
    recogniser = ObjectRecogniser("corradi2015").fit(touches[taught & (place < each)])
    right[f"{n_days} x {each}"] = 100 * recogniser.score(test.images, test.object)

figure, axes = plt.subplots()
bars = axes.bar([*right], [*right.values()])
axes.bar_label(bars, fmt="%.0f %%")
axes.axhline(100 / len(names), color="C4", lw=1, ls=":")
axes.set(xlabel="days x touches of each thing", ylim=(0, 105))
axes.set(ylabel="right after one touch, another day, %")
