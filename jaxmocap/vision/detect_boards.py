"""Chessboards in a set of photos of one camera: read, find, and keep what the calibration needs."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jaxmocap._errors import InputError
from jaxmocap.vision.board_advice import advise_board, near_duplicates
from jaxmocap.vision.board_grid import Floats, check_board
from jaxmocap.vision.chessboard import find_corners
from jaxmocap.vision.photo_list import expand_photos
from jaxmocap.vision.photos import check_same_size, read_photo

Progress = Callable[[int, int], None]
"""Called with the number of photos done and their total."""


@dataclass(frozen=True)
class BoardDetections:
    """Where the board was seen in each photo.

    Attributes:
        columns_rows: Inner corners along and across.
        image_size: Width and height in pixels, of all photos.
        names: File names of the photos read, natural order, copies of one file once.
        uv: Corners, float64 (views, columns * rows, 2), pixels, numbered as `orient_by_colour` says; zeros
            where the board was not found.
        found: Whether the board was found, bool (views,).
        sha256: Hashes of the files.
        warnings: Sentences for the user.
    """

    columns_rows: tuple[int, int]
    image_size: tuple[int, int]
    names: tuple[str, ...]
    uv: Floats
    found: NDArray[np.bool_]
    sha256: tuple[str, ...]
    warnings: tuple[str, ...]


def detect_boards(
    paths: Sequence[str | Path],
    columns_rows: tuple[int, int],
    *,
    progress: Progress | None = None,
    workers: int | None = None,
) -> BoardDetections:
    """Find one chessboard in each of one camera's photos.

    The result does not depend on the order in which the photos are given, nor on `workers`.

    Args:
        paths: Files, folders or glob patterns, as `expand_photos` takes them.
        columns_rows: INNER corners along and across, for instance (9, 6).
        progress: Called in the calling thread after each photo.
        workers: Photos read and searched at the same time; by default one per processor.

    Returns:
        The corners, with a photo that shows no whole board marked as not found and named in the warnings.

    Raises:
        InputError: A file cannot be read (leave it out or copy it again), sizes differ, or no photo shows the
            board; the last says which board would fit.
    """
    check_board(columns_rows)
    files = expand_photos(paths)
    searched = _search_all(files, columns_rows, progress, workers or os.cpu_count() or 1)
    views, warnings = _without_copies(searched)
    image_size = check_same_size(views)
    names = tuple(view.name for view in views)
    found = np.array([view.uv is not None for view in views])
    if not found.any():
        raise InputError(advise_board(lambda index: read_photo(views[index].path).grey, names, columns_rows) + ".")
    zeros = np.zeros((columns_rows[0] * columns_rows[1], 2))
    stacked = np.stack([zeros if view.uv is None else view.uv for view in views])
    warnings += [text for view in views for text in view.warnings]
    warnings += _name_clashes(views) + _missing(names, found, columns_rows)
    repeats = near_duplicates(stacked[found], [name for name, ok in zip(names, found) if ok], image_size)
    return BoardDetections(
        columns_rows=(int(columns_rows[0]), int(columns_rows[1])),
        image_size=image_size,
        names=names,
        uv=stacked,
        found=found,
        sha256=tuple(view.sha256 for view in views),
        warnings=tuple(warnings + [group.message for group in repeats]),
    )


@dataclass(frozen=True)
class _View:
    """What is kept of a photo once searched: not its pixels, a hundred photos would fill the memory."""

    name: str
    path: Path
    size: tuple[int, int]
    sha256: str
    warnings: tuple[str, ...]
    uv: Floats | None


def _search_one(path: Path, columns_rows: tuple[int, int]) -> _View:
    """Read one photo and look for the board."""
    photo = read_photo(path)
    result = find_corners(photo.grey, columns_rows)
    uv = None if result is None else result.uv
    return _View(photo.name, photo.path, photo.size, photo.sha256, photo.warnings, uv)


def _search_all(
    files: Sequence[Path], columns_rows: tuple[int, int], progress: Progress | None, workers: int
) -> list[_View]:
    """Search every photo, several at a time (threads: OpenCV and Pillow release the interpreter lock)."""
    pool = ThreadPoolExecutor(max_workers=workers)
    try:
        views = []
        for view in pool.map(lambda path: _search_one(path, columns_rows), files):
            views.append(view)
            if progress is not None:
                progress(len(views), len(files))
        return views
    finally:
        pool.shutdown(wait=True, cancel_futures=True)  # on an error or Ctrl-C the photos not yet begun are left


def _without_copies(views: Sequence[_View]) -> tuple[list[_View], list[str]]:
    """The views without copies of one file, and a warning for each copy dropped."""
    first: dict[str, _View] = {}
    warnings = []
    for view in views:
        if view.sha256 in first:
            original = first[view.sha256].name
            warnings.append(f"{view.name} is a copy of {original} (same bytes); the copy is left out.")
        else:
            first[view.sha256] = view
    return list(first.values()), warnings


def _name_clashes(views: Sequence[_View]) -> list[str]:
    """A warning where messages could not tell two photos apart."""
    clashes = [name for name, count in Counter(view.name for view in views).items() if count > 1]
    return [f"several different photos are called {name}; results name them alike. Rename them." for name in clashes]


def _missing(names: Sequence[str], found: NDArray[np.bool_], columns_rows: tuple[int, int]) -> list[str]:
    """A warning naming the photos without a board."""
    missing = [name for name, ok in zip(names, found) if not ok]
    if not missing:
        return []
    return [
        f"no whole {columns_rows[0]}x{columns_rows[1]} board in {len(missing)} of {len(names)} photos: "
        f"{', '.join(missing)}. They are not used."
    ]
