"""
What is taken for what
======================

One press of each part, and the name it gets. Rows are what was pressed, columns what it
was taken for. Shapes of one size are the hard part, more than sizes of one shape.
"""

import matplotlib.pyplot as plt
from sklearn.metrics import ConfusionMatrixDisplay

from palpate import ObjectRecogniser, simulate_presses

taught = simulate_presses(None, 12, load_kgf=(1, 5), random_state=2)
recogniser = ObjectRecogniser("liu2014").fit(taught)
test = simulate_presses(None, 12, load_kgf=(1, 5), random_state=3)
named = recogniser.predict(test)

figure, axes = plt.subplots(figsize=(6.4, 5.6))
ConfusionMatrixDisplay.from_predictions(
    test.object,
    named,
    normalize="true",
    values_format=".0%",
    xticks_rotation=60,
    cmap="cividis",
    text_kw={"size": 7},
    colorbar=False,
    ax=axes,
)
right = (named == test.object).mean()
axes.set(xlabel="taken for", ylabel="pressed", title=f"liu2014: {right:.0%} right")
