"""A film of recorded gel frames, into touches by the detector, on a contact sheet.

`film_sheet.py SHEET.png [BEGIN]`: one day of `sessions/gelsight_wedge.npz`,
in the folder that PALPATE_DATA names, become a film without loss: of each squeeze its
frame without contact, the way in (25, 50, 75 % and the peak, held) and the way out.
What `TouchDetector.touches_in` finds is drawn below the peak of the squeeze in which it
began. BEGIN is the detector's limit; by default it finds its own.
"""

import os
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from palpate.sensors import TouchDetector

RATE_HZ, REST, HELD = 30, 12, 4
STAGES = ("rise25", "rise50", "rise75", "peak")


def main() -> None:
    """Write the film, find its touches, draw both; print the number of touches."""
    sheet, *limit = sys.argv[1:]
    path = Path(os.environ["PALPATE_DATA"]) / "sessions/gelsight_wedge.npz"
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    first_day = arrays["session"] == arrays["session"][0]
    frames, squeezes = [], []
    for idle in np.unique(arrays["idle_of"][first_day]):
        idle_frame = arrays["set_idle"][idle]
        of_stage = {
            s: (arrays["idle_of"] == idle) & (arrays["stage"] == s) for s in STAGES
        }
        rise = [arrays["images"][of_stage[s]][0] for s in STAGES]
        squeezes.append((len(frames) / RATE_HZ, rise[-1]))
        frames += [idle_frame] * REST + rise + rise[-1:] * HELD + rise[::-1]
    detector = TouchDetector(begin=float(limit[0])) if limit else TouchDetector()
    with tempfile.TemporaryDirectory() as folder:
        touches = detector.touches_in(
            write(Path(folder) / "day.mkv", frames), colour=True
        )
    starts = np.array([start for start, _ in squeezes])
    squeeze_of = np.searchsorted(starts, touches.columns["time_s"], side="right") - 1
    counts = np.bincount(squeeze_of, minlength=len(squeezes))
    differences = [
        np.abs(image.astype(int) - squeezes[n][1]).mean()
        for n, image in zip(squeeze_of, touches.images, strict=True)
    ]
    print(
        f"{len(squeezes)} squeezes, {len(touches)} touches; of one touch each: "
        f"{(counts == 1).sum()}, of none: {(counts == 0).sum()}. From the peak of "
        f"their squeeze they differ by {np.median(differences):.2f} levels (median), "
        f"at most {max(differences):.2f}. A touch begins at a change of "
        f"{detector.begin:.1f}."
    )
    blank = np.zeros_like(frames[0])
    first_touches = [
        next(iter(touches.images[squeeze_of == n]), blank) for n in range(len(squeezes))
    ]
    rows = [np.hstack([peak for _, peak in squeezes]), np.hstack(first_touches)]
    cv2.imwrite(sheet, np.vstack(rows)[::2, ::2, ::-1])


def write(path: Path, frames: list[np.ndarray]) -> Path:
    """Write red, green and blue frames as FFV1."""
    size = frames[0].shape[1], frames[0].shape[0]
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), RATE_HZ, size)
    for frame in frames:
        film.write(frame[..., ::-1])
    film.release()
    return path


if __name__ == "__main__":
    main()
