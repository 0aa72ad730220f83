"""Filters select rows, and no text of a filter ever reaches SQL."""

import re
import sqlite3
from functools import partial
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary

OBJECTS = ["cup", "red mug", "7", "o'hara", "pen", "pen"]
FORCES = [0.1, 0.2, 0.3, 0.4, 0.5, np.nan]


class _Recording(sqlite3.Connection):
    """Keeps each statement of SQL, and the number of its values."""

    statements: ClassVar = []

    def execute(self, sql, values=()):
        self.statements.append((sql, len(values)))
        return super().execute(sql, values)


def _statements(library, where):
    """Return each statement that a filter leads to, and the number of its values."""
    _Recording.statements.clear()
    library.count(where)
    return list(_Recording.statements)


def _words(sql):
    """Return the words and operators of SQL."""
    return set(re.findall(r"[^\s(),?]+", sql))


@pytest.fixture(scope="module")
def known_words(library):
    """All words of SQL to which the columns and operators of filters lead."""
    with pytest.raises(LibraryError) as refusal:
        library.count("nothing = 1")
    listed = re.search(r"columns of the library \((.*)\), got", str(refusal.value))[1]
    names = listed.split(", ")
    assert {"object", "x_mm", "geometry", "wear"} < set(names)
    forms = ("{} is null", "{} is not null", "not {} = 1", "{} != 1", "{} contains 1")
    filters = [form.format(name) for form in forms for name in names]
    filters += [
        f"order {sign} {than} and order = 1 or order = 2"
        for sign in ("<", "<=", ">", ">=")
        for than in ("1", "a")
    ]
    return {
        w for f in filters for sql, _ in _statements(library, f) for w in _words(sql)
    }


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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=_Recording))
        opened = TouchLibrary.open(folder, create=True)
    with opened:
        opened.add(touches)
        yield opened


@pytest.mark.parametrize(
    ("where", "orders"),
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
        ("object > 6", [2]),
        ("object <= 6 or object < 7.5", [2]),
        ("not object >= 7", [0, 1, 3, 4, 5]),
        ("object >= pen", [1, 4, 5]),
        ("force_n < 0.25N or session <= monday or wear < three", []),
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
def test_filters_select(library, where, orders):
    assert [int(row.order) for row in library.list(where)] == orders
    assert library.count(where) == len(orders)


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
        ("object = \udcff", "such as UTF-8 can hold"),
        ("object = cup; DROP TABLE touches", "and, or, or its end"),
    ],
)
def test_what_is_no_filter_is_refused(library, where, message):
    with pytest.raises(LibraryError, match=message):
        library.list(where)


def test_texts_that_spell_numbers_are_ordered_as_these(tmp_path):
    """As `library add --session 2` writes them; a day is no number."""
    sessions = ["1", "02", "10", "-3", "2.5", "2024-05-01", "monday", ".", ""]
    sessions += ["1.2.3", "--5"]
    touches = Touches(np.arange(44).reshape(11, 2, 2), session=sessions)
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(touches)
        for sign, expected in (("<", ["1", "-3"]), (">=", ["02", "10", "2.5"])):
            rows = library.list(f"session {sign} 2")
            assert [row.session for row in rows] == expected
        assert library.count("session > 2024-04-30") == 2  # the day, and Monday
        assert library.count("session < 3.5") == 4


@pytest.mark.parametrize(
    ("where", "n_touches"),
    [("wet = true", 2), ("wet = False", 1), ("wet != true", 1), ("wet = 'true'", 0)],
)
def test_truths_are_compared_by_name(tmp_path, where, n_touches):
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        about = {"object": ["0", "1", "1"], "wet": [True, False, True]}
        library.add(Touches(np.ones((3, 2, 2)), order=range(3), **about))
        assert library.count(where) == n_touches
        assert library.count("object = true") == 0


@pytest.mark.parametrize("limit", [2**63 - 1, 2**63, 2**64, -(2**63), -(2**64)])
def test_integers_of_any_size_are_compared(library, limit):
    assert library.count(f"force_n < {limit}") == 5 * (limit > 0)


@pytest.mark.parametrize("method", ["count", "list", "touches", "select"])
def test_a_filter_is_text(library, method):
    with pytest.raises(TypeError, match="where must be a filter or None, got int"):
        getattr(library, method)(5)


_SIGNS, _QUOTES = st.sampled_from(["=", "!=", "<", "contains"]), st.sampled_from("' ")
_PIECES = [*"=<(),1", "object", "order", "wear", "in", "and", "not", "'a b'", "DROP"]


@given(
    text=st.one_of(
        st.text(max_size=60),
        st.builds("object {0} {1}{2}{1}".format, _SIGNS, _QUOTES, st.text(max_size=9)),
        st.lists(st.sampled_from(_PIECES), max_size=9).map(" ".join),
    )
)
@settings(max_examples=300, deadline=None)
def test_any_text_is_a_filter_or_refused(library, known_words, text):
    """No literal shows up in the SQL: only question marks and known words."""
    try:
        statements = _statements(library, text)
    except LibraryError:
        return
    for sql, n_values in statements:
        assert _words(sql) <= known_words
        assert sql.count("?") == n_values


@pytest.mark.parametrize(
    "name", ["h\u00f6he", "\u65e5\u672c", 'a"b', "a\\b", "a\tb", "a.b", "a[0]", "$x"]
)
def test_columns_of_any_name_are_found(tmp_path, name):
    """JSON escapes letters beyond ASCII, quotes and backslashes."""
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        touches = Touches(np.ones((2, 2, 2)), object=["a", "b"], **{name: [1, 2]})
        library.add(touches)
        library.add(Touches(np.zeros((1, 2, 2)), object=["c"]))
        quoted_name = '"' + name.replace('"', '""') + '"'
        for sign, n in (("= 2", 1), ("> 0", 2), ("is null", 1), ("!= 1", 2)):
            assert library.count(f"{quoted_name} {sign}") == n
