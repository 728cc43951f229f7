"""From what a user types (files, folders, patterns) to a list of photos in natural order."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable
from pathlib import Path

from jaxmocap._errors import InputError

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".jpe", ".png", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm", ".pnm")
"""File name endings that make a file of a folder a photo."""


def expand_photos(patterns: Iterable[str | Path]) -> list[Path]:
    """List the photos that files, folders and glob patterns stand for.

    A file is taken as it is; a folder stands for the photos directly in it; anything else is a glob pattern
    (`**` allowed), of which the photos are taken. The result is in natural order (`view2` before `view10`)
    whatever the order given, and a file reached twice is listed once.

    Args:
        patterns: Files, folders or quoted patterns; a single string is also accepted.

    Returns:
        The photos' paths, at least one.

    Raises:
        InputError: Nothing was given, an entry stands for no photo, or a name is not UTF-8.
    """
    entries = [patterns] if isinstance(patterns, str | Path) else list(patterns)
    if not entries:
        raise InputError("no photos were given. Name files, a folder or a pattern such as 'photos/*.jpg'.")
    paths = sorted((path for entry in entries for path in _expand_one(str(entry))), key=natural_key)
    _refuse_unnameable(paths)
    unique = {path.resolve(): path for path in reversed(paths)}  # reversed: of two spellings the first in order stays
    return sorted(unique.values(), key=natural_key)


def _refuse_unnameable(paths: Iterable[Path]) -> None:
    """Refuse names that neither text nor files can hold."""
    for path in paths:
        try:
            str(path).encode("utf-8")
        except UnicodeEncodeError:  # half of a surrogate pair: how Python shows a byte that is not UTF-8
            raise InputError(
                f"photo {ascii(str(path))}: the name is not UTF-8, so that no result could name it. It probably comes "
                "from a system with another encoding: rename the file or folder."
            ) from None


def natural_key(path: str | Path) -> tuple[tuple[tuple[int, int | str], ...], str]:
    """Key that sorts digits as numbers: `a2 < a10`; the text itself breaks the tie of `a2` and `a02`."""
    text = Path(path).as_posix()
    pieces = re.split(r"([0-9]+)", text)
    return tuple((0, int(piece)) if piece.isdecimal() else (1, piece.casefold()) for piece in pieces), text


def _expand_one(entry: str) -> list[Path]:
    """The photos one entry stands for."""
    try:
        path = Path(entry).expanduser()
        if path.is_file():
            return [path]
        is_folder = path.is_dir()
        found = list(path.iterdir()) if is_folder else [Path(p) for p in glob.glob(str(path), recursive=True)]
        photos = [p for p in found if p.suffix.lower() in PHOTO_SUFFIXES and p.name[0] != "." and p.is_file()]
    except (OSError, ValueError, RuntimeError) as error:  # a NUL character in the path; ~ of an unknown user
        raise InputError(
            f"{entry!r}: cannot be listed ({error}). Check the path and its permissions; a folder must be allowed to "
            "be entered (x), not only read."
        ) from error
    if photos:
        return photos
    if is_folder:
        what = (
            f"folder {entry!r} holds no photo ({len(found)} other entries)" if found else f"folder {entry!r} is empty"
        )
    elif glob.has_magic(entry):
        what = f"no photo matches {entry!r}"
    else:
        what = f"{entry!r}: no such file or folder"
    raise InputError(f"{what}. Photos end in {', '.join(PHOTO_SUFFIXES)}; check the spelling and the folder.")
