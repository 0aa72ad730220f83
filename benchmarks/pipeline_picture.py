"""Draw how a touch becomes a belief, with the values of one simulated touch.

Writes docs/images/pipeline.png; takes half a minute:

    python benchmarks/pipeline_picture.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from palpate import ObjectRecogniser, Touches, simulate_touches
from palpate.simulation import DomeCamera

OUTPUT = Path(__file__).parents[1] / "docs" / "images" / "pipeline.png"
OBJECTS = ("ball", "box", "mug", "pen", "stapler")
TRUTH = "mug"
N_TOUCHES = 6
PLACEMENTS = range(8)
BLUE, GREY, ORANGE = "#4c78a8", "#b8b8b8", "#f58518"


def main() -> None:
    """Learn five simulated objects, touch one of them, and draw each step."""
    camera = DomeCamera(image_shape=(120, 120), n_nodes=32)
    # Each object is put down several times, and once more to be asked about.
    train = Touches.concatenate(
        simulate_touches(OBJECTS, 10, camera, random_state=seed) for seed in PLACEMENTS
    )
    test = simulate_touches((TRUTH,), N_TOUCHES, camera, random_state=100)
    recogniser = ObjectRecogniser().fit(train)
    figure, columns = plt.subplots(
        1, 9, figsize=(14, 3.2), layout="constrained", width_ratios=[8, 1] * 4 + [8]
    )
    axes = columns[::2]
    for axis in columns[1::2]:
        axis.axis("off")
        axis.annotate("", (1, 0.5), (0, 0.5), arrowprops={"arrowstyle": "-|>"})
    draw_images(axes[:2], recogniser, test)
    evidence = recogniser.evidence(test[0])
    draw_features(axes[2], evidence.features[0])
    draw_evidence(axes[3], evidence.log_likelihood[0])
    draw_belief(axes[4], recogniser, test)
    OUTPUT.parent.mkdir(exist_ok=True)
    figure.savefig(OUTPUT, dpi=110)
    print(OUTPUT)


def draw_images(axes, recogniser, touches) -> None:
    """Draw a touch as the camera saw it, and after the clean-up."""
    axes[0].imshow(touches.images[0], cmap="gray")
    axes[0].set_title("Touches\n(images, labels, poses)", fontsize=10)
    axes[1].imshow(recogniser.encoder_.clean(touches[:1])[0], cmap="gray")
    axes[1].set_title("clean-up\n(rim found, disc standardised)", fontsize=10)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])


def draw_features(axis, features) -> None:
    """Draw the feature vector."""
    axis.bar(np.arange(len(features)), features, color=BLUE, width=1)
    axis.set_title(f"encoding\n({len(features)} features)", fontsize=10)
    axis.set_xticks([])
    axis.set_xlabel("feature", fontsize=9)


def draw_evidence(axis, log_likelihood) -> None:
    """Draw the log-likelihood of the touch under each object."""
    colours = [ORANGE if name == TRUTH else GREY for name in OBJECTS]
    axis.barh(OBJECTS, log_likelihood - log_likelihood.min() + 0.05, color=colours)
    axis.invert_yaxis()
    axis.set_title("Evidence\n(each encoding's\nlog-likelihood, flags)", fontsize=10)
    axis.set_xlabel("nats above the least", fontsize=9)


def draw_belief(axis, recogniser, touches) -> None:
    """Draw the posterior of each object, touch by touch."""
    belief = recogniser.start()
    shares = [list(belief.posterior.values())]
    for touch in touches:
        shares.append(list(belief.update(touch).posterior.values()))
    for name, line in zip(recogniser.classes_, 100 * np.array(shares).T, strict=True):
        truth = name == TRUTH
        axis.plot(line, "o-", color=ORANGE if truth else GREY, label=name, ms=4)
        if truth:
            axis.annotate(name, (len(line) - 1, line[-1]), (-30, -12), fontsize=9,
                          textcoords="offset points", color=ORANGE)  # fmt: skip
    axis.set_title("Belief\n(posterior of each object)", fontsize=10)
    axis.set_xlabel("touches", fontsize=9)
    axis.set_ylabel("per cent", fontsize=9)
    axis.set_ylim(0, 102)


if __name__ == "__main__":
    main()
