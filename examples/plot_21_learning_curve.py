"""
How many touches are enough?
============================

More training touches help, first much, then little. Draw the curve for your own sensor
before you teach a hundred things.
"""

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, simulate_presses

test = simulate_presses(None, 30, load_kgf=(2, 5), random_state=99)
taught = simulate_presses(None, 24, load_kgf=(2, 5), random_state=0)
numbers = [2, 5, 12, 24]
curves = {}
figure, axes = plt.subplots()
for preset in ("default", "corradi2015", "liu2014"):
    right = []
    for number in numbers:
        rows = np.concatenate([rows[:number] for _, _, rows in taught.episodes()])
        recogniser = ObjectRecogniser(preset).fit(taught[rows])
        right.append(100 * recogniser.score(test.images, test.object))
    axes.plot(numbers, right, marker="o", label=preset)
    print(preset, np.round(right))
    curves[preset] = right
axes.set(xlabel="training presses of each part", ylabel="right after one press, %")
axes.set(ylim=(0, 102), title="Twelve parts on a 10 x 10 array, 2 to 5 kgf")
axes.legend()
