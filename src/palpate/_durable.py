"""Files that are there whole or not at all, also after a crash or a power cut.

A file is written under a temporary name beside its place, flushed, renamed, and the
folder is flushed too, since a new name is durable only then. A reader sees the old file
or the new one, never a part. Temporary names begin with `PARTIAL`.
"""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

PARTIAL = ".partial-"


@contextmanager
def replacing(target: Path) -> Iterator[BinaryIO]:
    """Open a file that takes the place of `target` once the block ends well.

    Parameters
    ----------
    target : Path
        Where the file goes; one that is there is replaced in one step, and a link is
        followed. Its folder must exist.

    Raises
    ------
    OSError
        The folder is missing, read-only or full. Nothing is left behind then, nor
        where the block itself raises.
    """
    place = target.resolve()
    partial = place.with_name(f"{PARTIAL}{secrets.token_hex(8)}")
    try:
        with partial.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(place)
    finally:
        with suppress(OSError):
            partial.unlink()
    flush_folder(place.parent)


def write_bytes(target: Path, content: bytes) -> None:
    """Put `content` into `target`, whole or not at all; see `replacing`."""
    with replacing(target) as file:
        file.write(content)


def write_text(target: Path, content: str) -> None:
    """Put `content` into `target` as UTF-8, whole or not at all; see `replacing`."""
    write_bytes(target, content.encode())


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
