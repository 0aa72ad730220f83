"""What bytes on a serial line are, as far as they tell: for people, and for `auto`."""

import re
from collections import Counter
from dataclasses import dataclass
from math import isqrt

from ._framing import _HEAD, _TYPES, SYNC, BinaryFraming, LineFraming

_CODES = {code: name for name, (code, _) in _TYPES.items()}
_TEXT = re.compile(rb"[\t\r -~]*")
_LINES = 2


@dataclass(frozen=True)
class BytesTold:
    """How an array writes: `framing` "line" or "binary", or "" where bytes are neither.

    Of lines `n_values` and whether they have a `checksum`, of binary frames `dtype`;
    `shape` (n_rows, n_cols) is None where a line may be of several.
    """

    framing: str
    n_values: int = 0
    checksum: bool = False
    dtype: str = "uint16"
    shape: tuple[int, int] | None = None

    @property
    def shapes(self) -> str:
        """Return what to write for the shape: the squarest that fits, and its turn."""
        if self.shape is not None:
            return f"--shape {self.shape[0]}x{self.shape[1]}"
        n = self.n_values
        short = next(s for s in range(isqrt(n), 0, -1) if n % s == 0)
        both = dict.fromkeys((f"{short}x{n // short}", f"{n // short}x{short}"))
        return " or ".join(f"--shape {one}" for one in both)


def told_by(data: bytes) -> BytesTold | None:
    """Return what bytes tell, None while there are too few."""
    return _binary(data) or _lines(data)


def why_no_frame(
    data: bytes, framing: str, shape: tuple[int, int], dtype: str, checksum: bool | None
) -> str:
    """Return why bytes are no frames as they are read, and the fix; or nothing."""
    told = told_by(data)
    if told is None:
        return ""
    if not told.framing:
        return (
            "The bytes look neither like lines nor like frames: check --baud, or say "
            "--framing binary."
        )
    if told.framing != framing:
        looks = "binary" if told.framing == "binary" else "lines"
        return f"The bytes look like {looks}: --framing {told.framing}."
    expected = shape[0] * shape[1]
    if told.n_values != expected or told.shape not in (None, shape):
        return f"{told.n_values} values, expected {expected}: {told.shapes}."
    if framing == "binary":
        return f"Taxels are {told.dtype}, expected {dtype}: dtype={told.dtype}."
    if not told.checksum and checksum is not False:
        return "The lines have no checksum: --no-checksum."
    return ""


def _binary(data: bytes) -> BytesTold | None:
    """Return what the first frame in bytes says whose checksum is right."""
    start = data.find(SYNC)
    while 0 <= start <= len(data) - len(SYNC) - _HEAD.size:
        code, n_rows, n_cols, _ = _HEAD.unpack_from(data, start + len(SYNC))
        if code in _CODES and n_rows and n_cols:
            shape = n_rows, n_cols
            if BinaryFraming(shape, _CODES[code]).feed(data[start:]):
                n_values = n_rows * n_cols
                return BytesTold("binary", n_values, True, _CODES[code], shape)
        start = data.find(SYNC, start + 1)
    return None


def _lines(data: bytes) -> BytesTold | None:
    """Return what whole lines say: the first and the last piece may be cut."""
    if len(data) > 64 and not _TEXT.fullmatch(data.replace(b"\n", b"")[-64:]):
        return BytesTold("")
    lines = [line.strip() for line in data.split(b"\n")[1:-1] if line.strip()]
    if len(lines) < _LINES:
        return None
    counts = Counter(map(_values, lines))
    (n_values, checksum), _ = counts.most_common(1)[0]
    if not n_values:
        return BytesTold("")
    side = isqrt(n_values)
    shape = (side, side) if side**2 == n_values else None
    return BytesTold("line", n_values, checksum, shape=shape)


def _values(line: bytes) -> tuple[int, bool]:
    """Return how many numbers a line holds, 0 for none, and whether it is checked."""
    text = line.rpartition(b"$")[2].partition(b"*")[0]
    n_values = len(text.replace(b",", b" ").split())
    checked = LineFraming((1, max(1, n_values)), checksum=True)
    if checked.feed(line + b"\n"):
        return n_values, True
    plain = LineFraming((1, max(1, n_values)), checksum=False)
    return (n_values if plain.feed(line + b"\n") else 0), False
