"""From nothing taught to touches recognised in places that were never taught."""

import numpy as np
import pytest

from first_hour import N_ASKED, N_TAUGHT, Desk, advised, table
from palpate import Touches
from palpate.recognition import teaching_advice


def of(name, after_one, after_eight, other):
    figures = {"after_one": after_one, "after_eight": after_eight}
    return {"name": name, "taken_for": other, **figures}


def test_advised_objects_are_read_from_the_advice():
    pair = teaching_advice(
        [of("a mug", 0.3, 0.5, "a cup"), of("a cup", 0.3, 0.5, "a mug")]
    )
    assert sorted(advised(pair)) == ["a cup", "a mug"]
    assert advised(teaching_advice([of("pen", 0.3, 0.5, "a cup, blue")])) == ["pen"]
    assert advised(teaching_advice([of("pen", 0.3, 0.5, None)])) == ["pen"]
    assert advised(teaching_advice([of("pen", 0.3, None, "cup")])) == []
    alike = (
        "Of 12 touches of a mug 9 are like others: ten more touches of it, elsewhere"
    )
    assert advised([f"{alike}, unless it is the same all over."]) == ["a mug"]


def test_the_table_gives_shares_of_episodes():
    right = {"object": "pen", "right": "0" + "1" * 11, "first": "pen"}
    wrong = {"object": "cup", "right": "1" + "0" * 11, "first": "pen"}
    none = {"object": "mug", "right": "1" * 12, "first": None}
    stranger = {"object": "box", "right": "1" * 12, "first": "unknown"}
    outcome = {
        "asked": [right, wrong, none, stranger],
        "taught": {"pen": 12, "cup": 22},
    }
    line = table([{"in a row": outcome}] * 2).splitlines()[2]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells == ["in a row", "17", *["25"] * 4, "75", "0", "75", "0", "75"]


@pytest.mark.realdata
@pytest.mark.slow
def test_three_recorded_things_are_recognised_where_they_were_not_taught(
    data_folder, tmp_path
):
    touches = Touches.load(data_folder / "bathtip" / "bathtip50.npz")
    names = ["ball_greenfootball", "can_largeyellow", "stapler_greyred"]
    things = touches[np.isin(touches.object, names)]
    desk = Desk(things, tmp_path / "desk", np.random.default_rng(0))
    with desk.session as session:
        session.take_baseline()
        for name in names:
            desk.teach(name, N_TAUGHT, in_a_row=False, obey=True)
        state = session.to_dict()
        stored = [entry["n_touches"] for entry in state["library"]["objects"]]
        assert min(stored) == N_TAUGHT  # touches without contact are stored beside
        assert sum(stored) - len(state["no_contact"]) == 3 * N_TAUGHT
        desk.learn()
        assert desk.follow_advice() <= 3
        records = desk.ask()
    tested_rows = {name: set(desk.last[name]) for name in names}
    assert all(not tested_rows[name] & set(desk.taught[name]) for name in names)
    # Chance is a third of the touches, and one thing of three after eight.
    marks = [record["right"] for record in records]
    assert np.mean([episode[7] == "1" for episode in marks]) >= 2 / 3
    assert np.mean([mark == "1" for episode in marks for mark in episode]) > 0.6
    assert all(len(episode) == N_ASKED for episode in marks)
    assert [record["first"] for record in records].count("unknown") <= 1
