"""
Is it the touch, or the recording?
==================================

Each thing was recorded by itself, so the place of the camera or the brightness may name
it. `evaluate` always asks such nuisance values alone. Touch counts only as far as it is
above them: here it is below all three, and the recording proves nothing.
"""

import matplotlib.pyplot as plt

from palpate import evaluate, simulate_touches
from palpate.evaluation import Plan

touches = simulate_touches(["mug", "ball", "pen", "box"], 24, random_state=0)
plan = Plan(preset="corradi2015", touches=(1, 3, 5), orders=10)
figures, _ = evaluate(touches, split="last", plan=plan)

curves = {"touch": figures["accuracy"]} | figures["controls"]
figure, axes = plt.subplots()
for name, curve in curves.items():
    if curve:
        style = {"lw": 3} if name == "touch" else {"ls": "--", "alpha": 0.7}
        after = [int(k) for k in curve]
        axes.plot(
            after, [100 * v for v in curve.values()], marker="o", label=name, **style
        )
        print(name, {k: round(100 * v) for k, v in curve.items()})
axes.axhline(100 * figures["chance"], color="C4", lw=1, label="chance")
axes.set(xlabel="touches", ylabel="right, %", ylim=(0, 103), xticks=[1, 3, 5])
axes.legend()
