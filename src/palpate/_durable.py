"""Files that are there whole or not at all, also after a crash or a power cut.

A file is written under a temporary name beside its place, flushed, renamed, and the
folder is flushed too, since a new name is durable only then. A reader sees the old file
or the new one, never a part. Temporary names begin with `PARTIAL`.
"""

import errno
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, BinaryIO

PARTIAL = ".partial-"


def check_folder_of(target: Path, kind: type[ValueError] = ValueError) -> None:
    """Refuse a place where nothing can be written, before the work for it is done.

    `kind` says that there is no such folder, an `OSError` what else the disk says.
    """
    if not target.parent.is_dir():
        raise kind(f"There is no folder {target.parent} to write to; make it.")
    try:
        with TemporaryFile(prefix=PARTIAL, dir=target.resolve().parent):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(target)) from error


@contextmanager
def replacing(target: Path) -> Iterator[BinaryIO]:
    """Open a file that takes the place of `target` once the block ends well.

    A file that is there is replaced in one step, for those who might read and write it;
    a link is followed. An `OSError` names `target`; nothing is left behind then, nor
    where the block itself raises.
    """
    place = target.resolve()
    partial = place.with_name(f"{PARTIAL}{secrets.token_hex(8)}")
    try:
        with partial.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        with suppress(OSError):  # there was none
            shutil.copymode(place, partial)
        partial.replace(place)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink()
        number = _disk_error(error, partial)
        if number is None:
            raise
        raise OSError(number, os.strerror(number), str(target)) from error
    flush_folder(place.parent)


def _disk_error(error: BaseException, partial: Path) -> int | None:
    """Return the number of what the disk said, to Python or to a library in Rust."""
    if isinstance(error, OSError):
        return error.errno if error.filename in (None, str(partial)) else None
    match = re.search(r"\(os error (\d+)\)", str(error))
    return int(match[1]) if match else None


def write_text(target: Path, content: str) -> None:
    """Put `content` into `target` as UTF-8, whole or not at all; see `replacing`."""
    with replacing(target) as file:
        file.write(content.encode())


def lock(file: IO[Any]) -> bool:
    """Take the lock of an open file, unless another program has it.

    The system gives it back when a program dies. Nothing keeps two programs apart where
    there are no locks: on Windows, and on some file systems.
    """
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        pass
    return True


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
