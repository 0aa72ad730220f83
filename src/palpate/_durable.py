"""Files that are there whole or not at all, also after a crash or a power cut.

A file is written under a temporary name beside its place, flushed, renamed, and the
folder is flushed too, since a new name is durable only then. A reader sees the old file
or the new one, never a part. Temporary names begin with `PARTIAL`.
"""

import errno
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

PARTIAL = ".partial-"


@contextmanager
def replacing(target: Path, slot: Path | None = None) -> Iterator[BinaryIO]:
    """Open a file that takes the place of `target` once the block ends well.

    A file that is there is replaced in one step, and a link is followed. With a `slot`,
    one of `make_slots`, the content is written there and renamed; no link is followed,
    and the folder is not flushed. If a power cut undoes the renaming, the file stands
    whole in the slot. An `OSError` names `target`; nothing is left behind then, nor
    where the block itself raises.
    """
    place = target if slot else target.resolve()
    partial = slot or place.with_name(f"{PARTIAL}{secrets.token_hex(8)}")
    try:
        with partial.open("r+b" if slot else "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(place)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink()
        number = _disk_error(error, partial)
        if number is None:
            raise
        raise OSError(number, os.strerror(number), str(target)) from error
    if slot is None:
        flush_folder(place.parent)


def make_slots(folder: Path, n_slots: int) -> list[Path]:
    """Make empty files whose names are on the disk before they are needed."""
    folder.mkdir(exist_ok=True)
    slots = [folder / f"{PARTIAL}{secrets.token_hex(8)}" for _ in range(n_slots)]
    for slot in slots:
        slot.open("xb").close()
    flush_folder(folder)
    flush_folder(folder.parent)
    return slots


def _disk_error(error: BaseException, partial: Path) -> int | None:
    """Return the number of what the disk said, to Python or to a library in Rust."""
    if isinstance(error, OSError):
        return error.errno if error.filename in (None, str(partial)) else None
    said = re.search(r"\(os error (\d+)\)", str(error))
    return int(said[1]) if said else None


def write_bytes(target: Path, content: bytes, slot: Path | None = None) -> None:
    """Put `content` into `target`, whole or not at all; see `replacing`."""
    with replacing(target, slot) as file:
        file.write(content)


def write_text(target: Path, content: str) -> None:
    """Put `content` into `target` as UTF-8, whole or not at all; see `replacing`."""
    write_bytes(target, content.encode())


def flush_all(path: Path) -> None:
    """Flush a file, or everything in a folder, that others have written."""
    for part in [path, *path.rglob("*")] if path.is_dir() else [path]:
        if part.is_dir():
            flush_folder(part)
            continue
        with part.open("rb+") as file:
            os.fsync(file.fileno())


def flush_folder(folder: Path) -> None:
    """Make new names in `folder` durable, where folders can be opened and flushed."""
    with suppress(PermissionError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):
                raise
        finally:
            os.close(handle)
