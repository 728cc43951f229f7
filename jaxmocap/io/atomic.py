"""Writing files whole or not at all: into a temporary file beside the target, then renamed over it."""

import errno
import os
import stat
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

from jaxmocap._errors import InputError

# Files that a shell has opened for us (`> log`): renamed over, what the shell holds would be lost.
_OPEN_ALREADY = ("/dev/std", "/dev/fd/", "/proc/")


def write_text(path: str | Path, text: str) -> None:
    """Write text as UTF-8 with the line ends it has; see `write_bytes`.

    Raises:
        InputError: as `write_bytes`, or if the text holds characters that UTF-8 cannot store.
    """
    write_bytes(path, utf8(path, text))


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file so that at every moment, whatever fails, it holds either all of the old or all of the new.

    Args:
        path: the file; a link is followed, devices and pipes (/dev/stdout) are written to directly.
        data: its content.

    Raises:
        InputError: if it cannot be written (folder missing or read-only, disk full); the old file is intact.
    """
    write_many({path: data})


def write_many(files: Mapping[Any, bytes]) -> None:
    """Write several files, none of which is touched before all of them lie complete beside their targets.

    What remains are the renames, which fail only if a folder is changed in that instant.

    Args:
        files: content by path (str or Path).

    Raises:
        InputError: if one of them cannot be written, or two paths are the same file.
    """
    targets = [(Path(path), data) for path, data in files.items()]
    _refuse_same_file([path for path, _ in targets])
    staged: list[tuple[Path, Path, Path]] = []  # temporary file, target, path as given
    try:
        for path, data in targets:
            if not _is_stream(path):
                target = Path(_real(path))
                staged.append((_stage(path, target, data), target, path))
        # Devices first: one that is full must not leave the files replaced.
        for path, data in targets:
            if _is_stream(path):
                _write_stream(path, data)
        while staged:
            temporary, target, path = staged[0]
            _replace(temporary, target, path)
            staged.pop(0)
    finally:  # also on Ctrl-C
        for temporary, _, _ in staged:
            temporary.unlink(missing_ok=True)


def utf8(path: str | Path, text: str) -> bytes:
    """Text as UTF-8 bytes.

    Raises:
        InputError: if it holds half of a surrogate pair, as file names that are not UTF-8 do in Python.
    """
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise InputError(
            f"{path}: the text to write holds {text[error.start]!r}, which UTF-8 cannot store. "
            "It probably comes from a file name in another encoding: rename that file."
        ) from None


def _refuse_same_file(paths: list[Path]) -> None:
    seen: dict[str, Path] = {}
    for path in paths:
        real = _real(path)
        if real in seen and not _is_stream(path):
            raise InputError(f"{path}: would be written twice (also as {seen[real]}). Give each output its own name.")
        seen[real] = path


def _real(path: Path) -> str:
    """The file that a path leads to through links; replacing the link itself would lose the file's place."""
    try:
        return os.path.realpath(path)
    except ValueError as error:  # a zero byte in the path
        raise cannot_write(path, error) from error


def _is_stream(path: Path) -> bool:
    """Whether path is a device or pipe: renaming a file over it would destroy it (as root even /dev/null)."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)) or str(path).startswith(_OPEN_ALREADY)


def _write_stream(path: Path, data: bytes) -> None:
    try:
        with open(path, "wb") as stream:
            stream.write(data)
    except OSError as error:
        raise cannot_write(path, error) from error


def _stage(path: Path, target: Path, data: bytes) -> Path:
    """A temporary file in the folder of the target that holds data safely on the disk."""
    temporary = None
    try:
        _refuse_protected(path, target)
        temporary, handle = _open_temporary(target)
        _fill(handle, target, data)
    except BaseException as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise cannot_write(path, error) from error
        raise
    return temporary


def _refuse_protected(path: Path, target: Path) -> None:
    """Refuse what open() would refuse, but a rename would not: a file that is write-protected."""
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if target.exists() and not os.access(target, os.W_OK):
        raise InputError(f"{path}: is write-protected. Choose another name, or allow writing to it first.")


def _fill(handle: int, target: Path, data: bytes) -> None:
    try:
        if hasattr(os, "fchmod") and target.exists():
            os.fchmod(handle, stat.S_IMODE(target.stat().st_mode))  # open() too keeps the permissions
        left = memoryview(data)
        while left:  # the system may take less than it is given
            left = left[os.write(handle, left) :]
        os.fsync(handle)
    finally:
        os.close(handle)


def _open_temporary(target: Path) -> tuple[Path, int]:
    """A new file with a name no one else has and the permissions of open(); tempfile would give 0600."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    for attempt in count():
        # 40 characters leave room for the rest within the 255 bytes that a name may have, also in UTF-8.
        temporary = target.parent / f".{target.name[:40]}.{os.getpid()}-{attempt}.tmp"
        try:
            return temporary, os.open(temporary, flags, 0o666)
        except FileExistsError:
            continue  # left by a process that was killed, or written by another thread now
    raise AssertionError("count() ended")


def _replace(temporary: Path, target: Path, path: Path) -> None:
    try:
        os.replace(temporary, target)
    except OSError as error:
        raise cannot_write(path, error) from error


def cannot_write(path: Path, error: OSError | ValueError) -> InputError:
    """Why a file cannot be written, in words of the user, and what to do."""
    code = error.errno if isinstance(error, OSError) else None
    folder = path.parent
    reasons = {
        errno.ENOENT: f"the folder {str(folder)!r} does not exist. Create it first or choose another",
        errno.ENOTDIR: f"{str(folder)!r} is not a folder. Choose another",
        errno.EISDIR: "this is a folder. Give the name of a file in it",
        errno.EACCES: f"no permission to write in the folder {str(folder)!r}. Change that or choose another",
        errno.EPERM: f"the system does not permit writing in the folder {str(folder)!r}. Choose another",
        errno.EROFS: f"the folder {str(folder)!r} is on a read-only file system. Choose another",
        errno.ENOSPC: "the disk is full. Free some space or choose another folder",
        errno.EDQUOT: "the disk quota is used up. Free some space or choose another folder",
        errno.EFBIG: "the file is larger than the system allows. Choose another folder or raise the limit",
        errno.ENAMETOOLONG: "the name is too long. Choose a shorter one",
    }
    reason = reasons.get(code, f"{error}. Choose another name or folder") if code else f"{error}. Choose another name"
    return InputError(f"{path}: cannot be written: {reason}. What was there before is untouched.")
