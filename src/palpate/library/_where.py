"""Filters such as `object = mug and force_n > 0.5`: parsed, never pasted.

A filter is comparisons of one column with one literal, joined by `and`, `or`, `not`
and brackets. Comparisons: `= != < <= > >=`, `in (a, b)`, `is null`, `is not null`
and `contains`. A literal is a number, a quoted text or a bare word; a quote within
quotes of its own kind is written twice. What a filter says reaches the database as
parameters alone; column names are looked up in a table.
"""

import re
from collections.abc import Callable, Collection
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple
from unicodedata import normalize

from ._content import CELLS
from ._store import LibraryError, placeholders

_SIZES = ("n_rows", "n_cols", "n_channels")
_RECORDED = ("kind", "unit", "pitch_mm", "geometry", *_SIZES)
COLUMNS = {
    **{name: f't."{name}"' for name in CELLS},
    "object": "o.name",
    "sensor": "coalesce(t.sensor, r.sensor)",
    "id": "lower(hex(t.id))",
    "added_s": "t.added_s",
    **{name: f"r.{name}" for name in _RECORDED},
    "x_mm": "json_extract(t.extra, '$.position_mm[0]')",
    "y_mm": "json_extract(t.extra, '$.position_mm[1]')",
    "z_mm": "json_extract(t.extra, '$.position_mm[2]')",
}
_TOKENS = re.compile(
    r"""\s*(?:(?P<op><=|>=|!=|==|<>|[=<>(),])
    |'(?P<single>(?:[^']|'')*)'|"(?P<double>(?:[^"]|"")*)"
    |(?P<word>[^\s=<>!(),'"]+))""",
    re.VERBOSE,
)
_ID = re.compile("[0-9a-f]{32}")
_TRUTHS = {"true": 1, "false": 0}  # as SQLite keeps them
_INTEGER = re.compile("[+-]?[0-9]+")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|[+-]?inf", re.I)
_PLAIN_NAME = re.compile(r"[ !#-\[\]-~]+")  # ASCII but for a quote and a backslash
_EQUAL, _UNEQUAL, _ORDERED = ("=", "=="), ("!=", "<>"), ("<", "<=", ">", ">=")
_NAMED = [("object", sign) for sign in _EQUAL]
_LONGEST = 10_000  # letters; a filter is written by hand
_DEEPEST = 50  # brackets; Python's own stack holds them
_DEEPEST_SQL = 30  # SQLite's parser holds 100 symbols, up to three for each bracket


class Condition(NamedTuple):
    """A piece of SQL with question marks, and the values that stand for them."""

    sql: str
    values: list[Any]


class _Token(NamedTuple):
    text: str
    quoted: bool
    operator: bool


def parse_where(text: str, extra: Collection[str] = ()) -> Condition:
    """Return a filter as SQL; `extra` names further columns that some touches have."""
    if len(text) > _LONGEST:
        raise LibraryError(
            f"where must have at most {_LONGEST} characters, got {len(text)}."
        )
    parser = _Parser(normalize("NFC", text), extra)  # as names of objects are spelt
    condition = parser.either(0)
    parser.end()
    steps = ((letter == "(") - (letter == ")") for letter in condition.sql)
    if max(accumulate(steps)) > _DEEPEST_SQL:
        raise LibraryError(
            f"where must nest less deeply, got {text[:80]!r}. Join comparisons by "
            "`in (...)`, or leave out brackets."
        )
    return condition


def objects_named(text: str) -> list[str]:
    """Return the names that a filter wants objects to have (`object = NAME`)."""
    tokens = [token.text for token in _tokens(text)]
    threes = zip(tokens, tokens[1:], tokens[2:], strict=False)
    return [name for column, sign, name in threes if (column, sign) in _NAMED]


class _Parser:
    """Recursive descent: either > both > one."""

    def __init__(self, text: str, extra: Collection[str]) -> None:
        self._text, self._extra = text, extra
        self._tokens = _tokens(text)
        self._next = 0

    def either(self, depth: int) -> Condition:
        return self._joined("or", partial(self._joined, "and", self._operand), depth)

    def end(self) -> None:
        if self._next < len(self._tokens):
            raise self._error("and, or, or its end")

    def _joined(
        self, word: str, part: Callable[[int], Condition], depth: int
    ) -> Condition:
        parts = [part(depth)]
        while self._take(word):
            parts.append(part(depth))
        sql = _balanced(word.upper(), [p.sql for p in parts])
        return Condition(sql, [v for p in parts for v in p.values])

    def _operand(self, depth: int) -> Condition:
        if depth > _DEEPEST:
            raise LibraryError(f"where must nest at most {_DEEPEST} brackets deep.")
        negated = False
        while self._take("not"):
            negated = not negated
        if self._take("("):
            inner = self.either(depth + 1)
            self._expect(")")
        else:
            inner = self._comparison()
        return _negated(inner) if negated else inner

    def _comparison(self) -> Condition:
        column, bound = self._column()
        if self._take("is"):
            no = "NOT " if self._take("not") else ""
            if not self._take("null"):
                raise self._error("null")
            return Condition(f"({column} IS {no}NULL)", bound)
        if self._take("in"):
            self._expect("(")
            tokens = [self._literal()]
            while self._take(","):
                tokens.append(self._literal())
            self._expect(")")
            return _within(column, bound, tokens)
        if self._take("contains"):
            forms = _spellings(self._literal().text)
            sql = " OR ".join(f"instr({column}, ?) > 0" for _ in forms)
            return Condition(f"({sql})", [v for form in forms for v in (*bound, form)])
        if self._take(*_EQUAL):
            return _within(column, bound, [self._literal()])
        if self._take(*_UNEQUAL):
            return _negated(_within(column, bound, [self._literal()]))
        operator = self._take(*_ORDERED)
        if operator is None:
            raise self._error("a comparison such as = or <")
        token = self._literal()
        if token.text.lower() == "nan" and not token.quoted:
            raise LibraryError(
                f"where must compare with a number or a text, got {token.text!r} "
                'after a column. Write "is null" for values that are not known.'
            )
        return _in_order(column, bound, operator, _value(token))

    def _column(self) -> tuple[str, list[Any]]:
        token = self._literal("the name of a column")
        if token.text in COLUMNS:
            return COLUMNS[token.text], []
        if token.text in self._extra and _PLAIN_NAME.fullmatch(token.text):
            return "json_extract(t.extra, ?)", [f'$."{token.text}"']
        if token.text in self._extra:  # JSON escapes it, which paths do not
            return "(SELECT value FROM json_each(t.extra) WHERE key = ?)", [token.text]
        names = ", ".join([*COLUMNS, *sorted(self._extra)])
        raise LibraryError(
            f"where must name columns of the library ({names}), got {token.text!r}."
        )

    def _literal(self, wanted: str = "a number, a word or a quoted text") -> _Token:
        token = self._current()
        if token is None or token.operator:
            raise self._error(wanted)
        self._next += 1
        return token

    def _current(self) -> _Token | None:
        return self._tokens[self._next] if self._next < len(self._tokens) else None

    def _take(self, *wanted: str) -> str | None:
        """Go past one of some operators or words, and return it."""
        token = self._current()
        if token is None or token.quoted or token.text.lower() not in wanted:
            return None
        self._next += 1
        return token.text

    def _expect(self, operator: str) -> None:
        if not self._take(operator):
            raise self._error(repr(operator))

    def _error(self, wanted: str) -> LibraryError:
        token = self._current()
        got = "its end" if token is None else repr(token.text)
        return LibraryError(
            f"where must go on with {wanted}, got {got} in {self._text!r}. Write "
            'for example "object = mug and force_n > 0.5".'
        )


def _tokens(text: str) -> list[_Token]:
    tokens, place = [], 0
    text = text.rstrip()
    while place < len(text):
        match = _TOKENS.match(text, place)
        if match is None:
            raise LibraryError(
                f"where must be a filter, got {text[place:][:20]!r} in {text!r}. "
                "Put texts with odd characters between quotes."
            )
        kind = str(match.lastgroup)
        quoted = kind in ("single", "double")
        literal = match[kind]
        if quoted:
            quote = "'" if kind == "single" else '"'
            literal = literal.replace(2 * quote, quote)
        tokens.append(_Token(literal, quoted, kind == "op"))
        place = match.end()
    return tokens


def _within(column: str, bound: list[Any], tokens: list[_Token]) -> Condition:
    """Compare with the texts and with the numbers that literals may mean."""
    if column == COLUMNS["id"]:  # found by its index, not by going through all touches
        ids = [bytes.fromhex(t.text) for t in tokens if _ID.fullmatch(t.text)]
        return Condition(f"(t.id IN {placeholders(len(ids))})", [*ids])
    values = [v for t in tokens for v in (*_spellings(t.text), _value(t))]
    if column not in COLUMNS.values():
        bare = [t.text.lower() for t in tokens if not t.quoted]
        values += [_TRUTHS[word] for word in bare if word in _TRUTHS]
    different = list(dict.fromkeys((type(v), v) for v in values))
    sql = f"({column} IN {placeholders(len(different))})"
    return Condition(sql, [*bound, *(v for _, v in different)])


def _spellings(text: str) -> list[str]:
    """Return a text as it is typed and, where it differs, as names of files have it.

    Sessions and paths are kept as they came: those of a Mac's folders in letters and
    accents.
    """
    return list(dict.fromkeys((text, normalize("NFD", text))))


def _in_order(column: str, bound: list[Any], operator: str, value: Any) -> Condition:
    """Compare with a text or a number; to SQLite every number is below every text.

    A text that spells a number, such as the session "02", is compared as that number.
    """
    if isinstance(value, str):
        sql = f"(typeof({column}) = 'text' AND {column} {operator} ?)"
    else:
        sql = (
            f"(CASE WHEN typeof({column}) != 'text' THEN {column} "
            f"WHEN {column} GLOB '*[0-9]*' AND ltrim({column}, '-') NOT GLOB "
            f"'*[^0-9.]*' AND {column} NOT GLOB '*.*.*' AND {column} NOT GLOB '--*' "
            f"THEN CAST({column} AS NUMERIC) END {operator} ?)"
        )
    return Condition(sql, [*bound * sql.count(column), value])


def _negated(condition: Condition) -> Condition:
    return Condition(f"(NOT coalesce({condition.sql}, 0))", condition.values)


def _balanced(word: str, parts: list[str]) -> str:
    """Join conditions as a tree as flat as can be: SQLite refuses deep ones."""
    if len(parts) == 1:
        return parts[0]
    half = len(parts) // 2
    left, right = _balanced(word, parts[:half]), _balanced(word, parts[half:])
    return f"({left} {word} {right})"


def _value(token: _Token) -> Any:
    """Return the number that an unquoted literal spells, or its text."""
    if token.quoted or not _NUMBER.fullmatch(token.text):
        return token.text
    number = float(token.text)
    if _INTEGER.fullmatch(token.text) and abs(number) < 2**63:
        return int(token.text)
    return number


def quoted(text: str) -> str:
    """Return `text` as a literal of a filter, whatever stands in it."""
    return "'" + text.replace("'", "''") + "'"
