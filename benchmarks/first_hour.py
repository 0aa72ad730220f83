"""From nothing to a recognised touch of three recorded things, as the page does it.

`python benchmarks/first_hour.py FOLDER OUT.json [--draws 90] [--first 0] [--table]`,
with the folder of recorded touches (`bathtip/bathtip50.npz`); half an hour on one core,
and docs/explanation/page.md has the table that `--table` prints of OUT.json. Each draw
takes three of the 50 things. A simulated hand presses recorded touches on a live
sensor, and a `LiveSession` takes the baseline, teaches, learns and recognises, as
behind the page. Touches of the first three quarters of each recording are taught. Asked
are the twelve of its last quarter whose places are farthest from those taught, in their
order. Taught:

- "in a row": twelve touches after one another of each thing.
- "in a row, advice followed": the same, but "touch it elsewhere" is obeyed, with a
  touch from anywhere in the first three quarters, and so is "ten more touches of ...",
  until nothing more is said, three times at most.
- "all over": twelve touches from anywhere in the first three quarters.
- "all over, advice followed": the same, and then as above.
"""

import argparse
import json
import queue
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from palpate import Touches
from palpate._durable import write_text
from palpate.sensors import LiveSensor
from palpate.web import LiveSession
from tables import one_figure_a_cell

N_THINGS, N_TAUGHT, N_MORE, N_ROUNDS, N_ASKED = 3, 12, 10, 3, 12
AFTER = (1, 8)
TEACHINGS = ("in a row", "all over")
_MORE = re.compile(r"ten more touches of (?P<name>each|it|.*), elsewhere")
_ALIKE = re.compile(r"Of \d+ touches of (?P<name>.*) \d+ are like others")
_PAIR = re.compile(r"(?P<one>.*) and (?P<other>.*) are taken for each other")


class Hand(LiveSensor):
    """A sensor that rests, but for the pictures that are pressed on it."""

    queue_length = 1000

    def __init__(self, idle_frame: np.ndarray[Any, Any]) -> None:
        super().__init__(
            "recorded dome", "grey level", idle_frame.shape, idle_frame.dtype
        )
        self._idle_frame = idle_frame
        self._pressed: queue.Queue[Any] = queue.Queue()

    def press(self, image: np.ndarray[Any, Any]) -> None:
        """Press and let go."""
        for frame in (*[image] * 3, *[self._idle_frame] * 3):
            self._pressed.put(frame)

    def _open(self) -> None:
        pass

    def _grab(self) -> list[np.ndarray[Any, Any]]:
        try:
            return [self._pressed.get(timeout=0.01)]
        except queue.Empty:
            return [self._idle_frame]

    def _close(self) -> None:
        pass


class Desk:
    """A session whose things are touched by rows of one recording of each."""

    def __init__(self, things: Touches, folder: Path, rng: np.random.Generator) -> None:
        self.things, self.rng = things, rng
        self.hand = Hand(things.no_contact)
        self.session = LiveSession(self.hand, library=folder)
        self.names = np.unique(things.object).tolist()
        self.first, self.last = {}, {}
        for name in self.names:
            rows = np.flatnonzero(things.object == name)
            rows = rows[np.argsort(things.order[rows], kind="stable")]
            cut = len(rows) - len(rows) // 4
            self.first[name], self.last[name] = rows[:cut].tolist(), rows[cut:].tolist()
        self.taught: dict[str, list[int]] = {name: [] for name in self.names}

    def _touch(self, row: int, count: Callable[[], int]) -> bool:
        """Press one touch; return whether the session counted it."""
        before, end_s = count(), time.monotonic() + 2.0
        self.hand.press(self.things.images[row])
        while count() == before and time.monotonic() < end_s:
            time.sleep(0.002)
        return count() > before

    def _elsewhere(self, name: str) -> int:
        """Return a row of the first three quarters that was not taught."""
        left = sorted(set(self.first[name]) - set(self.taught[name]))
        return int(self.rng.choice(left))

    def teach(self, name: str, wanted: int, *, in_a_row: bool, obey: bool) -> None:
        """Teach `wanted` touches; with `obey` go elsewhere when the page says so."""
        self.session.teach(name, wanted)
        lesson = self.session.teacher.lesson
        rows = self.first[name]
        at = int(self.rng.integers(len(rows) - wanted + 1)) if in_a_row else 0
        while lesson.done < wanted:  # touches without contact do not count
            prompted = obey and lesson.prompt
            fresh = in_a_row and not prompted and rows[at % len(rows)]
            row = self._elsewhere(name) if fresh is False else fresh
            at = rows.index(row) + 1
            if row not in self.taught[name]:
                self.taught[name].append(row)
                self._touch(row, lambda: len(lesson.ids))
        while self.session.teacher.lesson is not None:
            time.sleep(0.002)

    def learn(self) -> None:
        """Learn, or say why not."""
        self.session.learn(wait=True)
        if self.session.learn_error:
            raise RuntimeError(self.session.learn_error)

    def follow_advice(self) -> int:
        """Follow the advice "Teach next" until there is none; return how often."""
        for number in range(N_ROUNDS):
            names = [n for n in advised(self.session.advice) if self._room(n)]
            if not names:
                return number
            for name in names:
                self.teach(name, N_MORE, in_a_row=False, obey=True)
            self.learn()
        return N_ROUNDS

    def _room(self, name: str) -> bool:
        return len(self.first[name]) - len(self.taught[name]) > N_MORE

    def _farthest(self, name: str) -> tuple[list[int], float]:
        """Return the rows of the last quarter farthest from taught touches, in order.

        Also return their median distance from the nearest taught touch, in steps: the
        median distance between touches that follow each other in the recording.
        """
        places = self.things.columns["position_raw"].astype(float)
        of_thing = places[[*self.first[name], *self.last[name]]]
        step = np.median(np.linalg.norm(np.diff(of_thing, axis=0), axis=1))
        taught, tested = places[self.taught[name]], places[self.last[name]]
        distances = np.linalg.norm(tested[:, None] - taught, axis=2).min(axis=1)
        chosen = np.sort(np.argsort(-distances, kind="stable")[:N_ASKED])
        rows = [self.last[name][place] for place in chosen.tolist()]
        return rows, float(np.median(distances[chosen]) / step)

    def ask(self) -> list[dict[str, Any]]:
        """Touch each thing where it was not taught; return the answers."""
        answers = []
        for name in self.names:
            self.session.begin_episode()
            right, first = "", None
            rows, steps = self._farthest(name)
            for row in rows:
                if self._touch(row, lambda: len(self.session.episode.touches)):
                    episode = self.session.episode
                    right += str(int(episode.belief.best == name))
                    first = first or episode.decision
            answer = {"right": right, "first": first, "steps": steps}
            answers.append({"object": name, **answer})
        return answers


def advised(sentences: list[str]) -> list[str]:
    """Return the things that need ten more touches, without advice of another day."""
    names: list[str] = []
    for sentence in sentences:
        more = _MORE.search(sentence)
        if more is None or sentence.startswith("All was taught"):
            continue
        if more["name"] == "each" and (pair := _PAIR.search(sentence)):
            names += pair["one"], pair["other"]
        elif more["name"] == "it" and (alike := _ALIKE.search(sentence)):
            names.append(alike["name"])
        else:
            names.append(more["name"])
    return list(dict.fromkeys(names))


def one_draw(touches: Touches, seed: int) -> dict[str, Any]:
    """Teach three things in each of the teachings, and test them."""
    rng = np.random.default_rng([seed, N_THINGS])
    names = rng.choice(np.unique(touches.object), N_THINGS, replace=False)
    things = touches[np.isin(touches.object, names)]
    result: dict[str, Any] = {"things": sorted(names.tolist())}
    for teaching in TEACHINGS:
        for obey in (False, True):
            with tempfile.TemporaryDirectory() as place:
                desk = Desk(things, Path(place) / "desk", np.random.default_rng(seed))
                with desk.session as session:
                    session.take_baseline()
                    for name in desk.names:
                        in_a_row = teaching == "in a row"
                        desk.teach(name, N_TAUGHT, in_a_row=in_a_row, obey=obey)
                    desk.learn()
                    n_rounds = desk.follow_advice() if obey else 0
                    n_taught = {n: len(rows) for n, rows in desk.taught.items()}
                    title = teaching + ", advice followed" * obey
                    advice = {"advice": session.advice, "rounds": n_rounds}
                    answers = {"asked": desk.ask(), "taught": n_taught}
                    result[title] = {**answers, **advice}
    return result


def table(draws: list[dict[str, Any]]) -> str:
    """Return the answers as a table of docs/explanation/page.md, in per cent."""
    head = "| taught | touches each | first decision: right | wrong | unknown | none "
    head += "in 12 touches | right after 1 touch | right after 8 | worst draw after 8 |"
    lines = [head, "|---" * 9 + "|"]
    for teaching in (name for name in draws[0] if name != "things"):
        episodes_of_draws = [draw[teaching]["asked"] for draw in draws]
        flat = [episode for episodes in episodes_of_draws for episode in episodes]
        firsts = [
            np.mean([e["first"] == e["object"] for e in flat]),
            np.mean([e["first"] not in (None, "unknown", e["object"]) for e in flat]),
            np.mean([e["first"] == "unknown" for e in flat]),
            np.mean([e["first"] is None for e in flat]),
        ]
        right = [
            [
                np.mean([e["right"][k - 1] == "1" for e in episodes])
                for episodes in episodes_of_draws
            ]
            for k in AFTER
        ]
        each = np.mean([list(draw[teaching]["taught"].values()) for draw in draws])
        worst = f"{min(right[1]):.0%}"
        spread = [f"{np.mean(r):.0%} ± {np.std(r, ddof=1):.0%}" for r in right]
        cells = [
            teaching,
            f"{each:.0f}",
            *(f"{share:.0%}" for share in firsts),
            *spread,
        ]
        lines.append("| " + " | ".join([*cells, worst]) + " |")
    text = "".join(f"{line}\n" for line in lines).replace("%", "")
    return one_figure_a_cell(text)


def main() -> None:
    """Measure draws; those that are in the file already are kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--draws", type=int, default=90)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    draws = json.loads(options.out.read_text()) if options.out.exists() else {}
    if not options.table:
        touches = Touches.load(options.folder / "bathtip" / "bathtip50.npz")
        for seed in range(options.first, options.first + options.draws):
            if str(seed) not in draws:
                draws[str(seed)] = one_draw(touches, seed)
                lines = (f'"{k}": {json.dumps(draw)}' for k, draw in draws.items())
                write_text(options.out, "{" + ",\n".join(lines) + "}\n")
                print(seed, flush=True)
    print(table(list(draws.values())))


if __name__ == "__main__":
    main()
