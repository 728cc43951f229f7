"""One process at a time in a folder. The system gives the lock back when its process ends, however it ends."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from jaxmocap._errors import InputError

LOCK = ".lock"
_LOCKED_BYTE = 1 << 20  # Windows keeps a locked byte from being read: one beyond the number of the process


@contextmanager
def locked(path: str | Path) -> Iterator[None]:
    """Keep other processes from changing a folder meanwhile.

    A lock file that was left by a process that died does not count: what is locked is the open file, not its name.

    Raises:
        InputError: another process holds it, or the folder cannot be written.
    """
    file = Path(path) / LOCK
    try:
        handle = os.open(file, os.O_CREAT | os.O_RDWR, 0o666)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}. Check the folder's rights.") from None
    try:
        if not _take(handle):
            raise InputError(
                f"{path}: another process{_named(file)} is working in this folder. Wait until it is done, and try "
                "again."
            )
        os.truncate(handle, 0)
        os.write(handle, str(os.getpid()).encode())
        yield
    finally:
        os.close(handle)


def _take(handle: int) -> bool:
    """Lock an open file; False if another one has it."""
    try:
        if os.name == "nt":
            import msvcrt

            os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            os.lseek(handle, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system that has no locks: better unprotected than unusable
        return True
    return True


def _named(file: Path) -> str:
    """Number of the process that holds a lock, as far as it can be read."""
    with suppress(OSError, ValueError):
        return f" ({int(file.read_text())})"
    return ""
