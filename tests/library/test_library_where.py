"""Filters: what they select, and that no text of one ever reaches SQL."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary
from palpate.library._where import COLUMNS, parse_where

OBJECTS = ["cup", "red mug", "7", "o'hara", "pen", "pen"]
FORCES = [0.1, 0.2, 0.3, 0.4, 0.5, np.nan]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    touches = Touches(
        np.arange(6 * 4, dtype=np.int16).reshape(6, 2, 2),
        object=OBJECTS,
        session=[1, 1, 2, 2, 3, 3],
        force_n=FORCES,
        order=np.arange(6),
        position_mm=np.arange(18).reshape(6, 3),
        wear=np.array([5, 4, 3, 2, 1, 0]),
    )
    folder = tmp_path_factory.mktemp("where")
    with TouchLibrary.open(folder, create=True) as opened:
        opened.add(touches)
        yield opened


@pytest.mark.parametrize(
    ("where", "found"),
    [
        ("object = cup", [0]),
        ("object = 'red mug'", [1]),
        ("object=7", [2]),
        ("object = '7'", [2]),
        ('object = "o\'hara"', [3]),
        ("object != pen", [0, 1, 2, 3]),
        ("object in (cup, pen, 7)", [0, 2, 4, 5]),
        ("object contains e", [1, 4, 5]),
        ("force_n > 0.25", [2, 3, 4]),
        ("force_n <= 2e-1", [0, 1]),
        ("force_n is null", [5]),
        ("force_n is not null and order >= 3", [3, 4]),
        ("session = 2", [2, 3]),
        ("session = '2'", []),
        ("object = cup or object = pen and force_n = 0.5", [0, 4]),
        ("(object = cup or object = pen) and force_n = 0.5", [4]),
        ("not object = pen", [0, 1, 2, 3]),
        ("not force_n > 0.25", [0, 1, 5]),
        ("x_mm = 3", [1]),
        ("z_mm >= 14 AND wear < 1", [5]),
        ("wear in (5, 4)", [0, 1]),
        ("geometry is null", [0, 1, 2, 3, 4, 5]),
        ("category is not null", []),
        ("category = nan", []),
        ("force_n = nan", []),
        ("object in (nan, cup)", [0]),
        ("order = 0_3", []),
        ("order < 9" + "9" * 400, [0, 1, 2, 3, 4, 5]),
        ("force_n < inf and order > -inf", [0, 1, 2, 3, 4]),
        ("order = +3.", [3]),
        ("object = 'o''hara'", [3]),
        ("order in (" + ",".join(map(str, range(1, 1200))) + ")", [1, 2, 3, 4, 5]),
        (" or ".join(["order=1"] * 800), [1]),
        (" and ".join(["order=1"] * 800), [1]),
        ("not " * 40 + "order = 1", [1]),
        ("not " * 41 + "order = 1", [0, 2, 3, 4, 5]),
        (
            "order=9 or not (order=1 and " * 5
            + " or ".join(["order=1"] * 600)
            + ")" * 5,
            [0, 2, 3, 4, 5],
        ),
        (" ", [0, 1, 2, 3, 4, 5]),
    ],
)
def test_filters_select(library, where, found):
    assert [int(row.order) for row in library.list(where)] == found
    assert library.count(where) == len(found)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("colour = red", "columns of the library.*got 'colour'"),
        ("object", "go on with a comparison.*got its end"),
        ("object = ", "a number, a word"),
        ("object = cup pen", "and, or, or its end, got 'pen'"),
        ("(object = cup", "go on with"),
        ("object = 'cup", "must be a filter"),
        ("object in cup", "go on with"),
        ("object is cup", "go on with null"),
        ("= cup", "the name of a column"),
        ("(" * 60 + "object = cup", "nest at most 50"),
        ("order=9 or not (order=1 and " * 12 + "order=1" + ")" * 12, "less deeply"),
        ("object = " + "x" * 10_000, "at most 10000 characters"),
        ("force_n > nan", "number or a text, got 'nan'.*is null"),
        ("object = \udcff", "that UTF-8 can hold"),
        ("object = cup; DROP TABLE touches", "and, or, or its end"),
    ],
)
def test_what_is_no_filter_is_refused(library, where, message):
    with pytest.raises(LibraryError, match=message):
        library.list(where)


@pytest.mark.parametrize("method", ["count", "list", "touches", "select"])
def test_a_filter_is_text(library, method):
    with pytest.raises(TypeError, match="where must be a filter or None, got int"):
        getattr(library, method)(5)


@given(text=st.text(max_size=60))
@settings(max_examples=150, deadline=None)
def test_any_text_is_a_filter_or_refused(text):
    """No character of a literal shows up in the SQL: only marks and known columns."""
    try:
        sql, values = parse_where(text)
    except LibraryError:
        return
    rest = sql
    for column in sorted(COLUMNS.values(), key=len, reverse=True):
        rest = rest.replace(column, "")
    words = ("IS NOT", "IS", "IN", "NULL", "AND", "OR", "NOT", "coalesce", "instr")
    for word in words:
        rest = rest.replace(word, "")
    assert set(rest) <= set("()?<>=, 0")
    assert sql.count("?") == len(values)


@given(name=st.text(min_size=1, max_size=30).filter(lambda t: "'" not in t))
@settings(max_examples=100, deadline=None)
def test_a_literal_is_only_ever_a_value(library, name):
    try:
        name.encode()
    except UnicodeEncodeError:
        return
    rows = library.list(f"object = '{name}'")
    assert {row.object for row in rows} <= {name}
    assert len(library) == 6
