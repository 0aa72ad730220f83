"""Draw a belief that moves: four episodes of simulated touches, as a moving picture.

Six household objects are learnt from ten touches in each of eight placements. Then
three of them, and a thing that was never learnt, are touched in placements of their
own until there is a decision. Writes docs/images/belief.gif; takes half a minute:

    python benchmarks/moving_belief.py
"""

import io
from pathlib import Path
from textwrap import wrap

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from palpate import ObjectRecogniser, Touches, simulate_touches
from palpate.recognition._sentences import NOTHING
from palpate.simulation import DomeCamera

OUTPUT = Path(__file__).parents[1] / "docs" / "images" / "belief.gif"
OBJECTS = ("ball", "mug", "pen", "stapler", "textbook", "toothbrush")
# Each touched object and its right answer.
ANSWERS = {"mug": "mug", "toothbrush": "toothbrush", "pen": "pen"}
ANSWERS["massage ball"] = "unknown"
N_PLACEMENTS, N_TOUCHES, LONGEST = 8, 10, 20
ERROR, STRANGERS = 0.05, 0.25
PAPER, INK, GREY, RIGHT = "#fffefb", "#1d2529", "#b9b3a6", "#0d5c63"
TOUCH_MS, DECISION_MS = 700, 2600
WIDEST = 46  # letters of a line of the title


def learnt(camera: DomeCamera) -> ObjectRecogniser:
    """Learn the objects, each put down eight times."""
    parts = [
        simulate_touches(OBJECTS, N_TOUCHES, camera, random_state=seed)
        for seed in range(N_PLACEMENTS)
    ]
    sessions = np.repeat(np.arange(N_PLACEMENTS), [len(part) for part in parts])
    touches = Touches.concatenate(parts).with_columns(session=sessions)
    return ObjectRecogniser().fit(touches)


def main() -> None:
    """Touch each thing until there is a decision, and draw every touch."""
    camera = DomeCamera(image_shape=(120, 120))
    recogniser = learnt(camera)
    frames, durations_ms = [], []
    for number, (name, answer) in enumerate(ANSWERS.items()):
        touches = simulate_touches(name, LONGEST, camera, random_state=100 + number)
        episode = recogniser.episode(error=ERROR, strangers=STRANGERS)
        for touch in touches:
            episode.add(recogniser.evidence(touch))
            frames.append(drawn(name, touch.images[0], episode))
            durations_ms.append(DECISION_MS if episode.decision else TOUCH_MS)
            if episode.decision:
                break
        print(f"{name}: {episode.sentence}")
        if episode.decision != answer:
            raise SystemExit(f"{name} must end as {answer}, got {episode.decision}.")
    palette = frames[-1].quantize(64)
    quantised = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    quantised[0].save(
        OUTPUT,
        save_all=True,
        append_images=quantised[1:],
        duration=durations_ms,
        loop=0,
        optimize=True,
    )
    print(OUTPUT)


def drawn(name: str, image, episode) -> Image.Image:
    """Return one frame: the touch, a bar for each answer, the sentence."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.6, 3.3), width_ratios=[1, 1.75], layout="constrained"
    )
    figure.set_facecolor(PAPER)
    left.imshow(image, cmap="gray", vmin=0, vmax=255)
    left.set_axis_off()
    count = len(episode.touches)
    left.set_title(f"a {name}: touch {count}", fontsize=12, color=INK)
    last = episode.touches[-1]
    shares = [last.posterior[object_name] for object_name in OBJECTS] + [last.unknown]
    answer = "unknown" if episode.decision == "unknown" else episode.decision
    names = [*OBJECTS, "unknown"]
    colours = [RIGHT if object_name == answer else GREY for object_name in names]
    places = np.r_[np.arange(len(OBJECTS)), len(OBJECTS) + 0.4]
    right.barh(places, 100 * np.array(shares), color=colours, height=0.72)
    right.set_yticks(places, [*OBJECTS, NOTHING], fontsize=11, color=INK)
    right.invert_yaxis()
    right.set_xlim(0, 100)
    right.set_xticks([0, 50, 100], ["0", "50", "100 %"], color=INK)
    right.spines[["top", "right"]].set_visible(False)
    right.set_facecolor(PAPER)
    weight = "bold" if episode.decision else "normal"
    words = "\n".join(wrap(episode.sentence, WIDEST))
    right.set_title(words, fontsize=12, color=INK, loc="left", weight=weight)
    stored = io.BytesIO()
    figure.savefig(stored, dpi=100, facecolor=PAPER)
    plt.close(figure)
    return Image.open(stored).convert("RGB")


if __name__ == "__main__":
    main()
