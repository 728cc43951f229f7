"""Reading a text file of unknown quality: size limit, encoding, and what to say when it is something else."""

import difflib
import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

from jaxmocap._errors import InputError

NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
"""A finite decimal number; float() would also take 1_0, nan and the digits of other scripts."""

_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


def read_text(path: str | Path, max_bytes: int) -> str:
    """Content of a UTF-8 text file (a byte order mark is dropped, line ends are kept).

    Args:
        path: the file.
        max_bytes: largest size that such a file can sensibly have.

    Returns:
        The text, not empty.

    Raises:
        InputError: if it is missing, not readable, empty, too large, binary or in another encoding.
    """
    data = read_bytes(path, max_bytes)
    if not data.strip():
        raise InputError(f"{path}: the file is empty. Check that the program that wrote it finished.")
    if data.startswith(_UTF16_MARKS):
        raise InputError(f"{path}: the file is in UTF-16. Save it as UTF-8.")
    if b"\0" in data:
        raise InputError(f"{path}: not a text file (it holds zero bytes). Check the name.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}, line {line}: byte 0x{data[error.start]:02x} is not UTF-8. "
            "Save the file as UTF-8, or check that it is a text file."
        ) from None


def hash_files(paths: Iterable[str | Path]) -> dict[str, str]:
    """SHA-256 of files by file name; where two folders hold the same name, by the path as given.

    Raises:
        InputError: if a file cannot be read.
    """
    files = [Path(path) for path in paths]
    names = [file.name for file in files]
    keys = [file.as_posix() if names.count(file.name) > 1 else file.name for file in files]
    return {key: _sha256(file) for key, file in zip(keys, files)}


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that a misspelt one was probably meant to be, or None."""
    by_lower = {name.lower(): name for name in known}
    close = difflib.get_close_matches(word.lower(), by_lower, n=1, cutoff=0.75)
    return by_lower[close[0]] if close else None


def short(value: object) -> str:
    """A value in a message, cut before it fills the screen."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers of more digits than Python prints; deep nesting
        return f"a very large {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


def _sha256(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def read_bytes(path: str | Path, max_bytes: int) -> bytes:
    """Content of a file.

    Raises:
        InputError: if it is missing, not readable or larger than `max_bytes`.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            data = file.read(max_bytes + 1)  # bounded whatever the size says: it may be a pipe or grow
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if len(data) > max_bytes:
        raise InputError(f"{path}: larger than {max_bytes >> 20} MiB, which no such file is. Check the name.")
    return data


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, IsADirectoryError):
        return InputError(f"{path}: this is a folder. Give the name of a file in it.")
    if isinstance(error, PermissionError):
        return InputError(f"{path}: no permission to read it. Change its permissions or copy it.")
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return InputError(f"{path}: no such file. {_instead(path)}")
    return InputError(f"{path}: cannot be read ({error}). Check the path.")


def _instead(path: Path) -> str:
    try:
        if not path.parent.is_dir():
            return f"Its folder {str(path.parent)!r} does not exist either; check the path."
        close = nearest(path.name, sorted(p.name for p in path.parent.iterdir()))
    except OSError:  # a folder that may not be listed
        close = None
    return f"Did you mean {close!r}?" if close else "Check the spelling."
