"""What to tell a user whose board was not found, or whose photos repeat one another."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from jaxmocap._errors import InputError
from jaxmocap.vision.board_grid import Grey, check_board
from jaxmocap.vision.chessboard import find_corners

_PHOTOS_TRIED = 4
_SECONDS = 6.0  # about what a user waits for an answer; the likeliest sizes are tried first

REPEATS_WITHIN = 0.01
"""Views whose corners differ by less than this fraction of the image diagonal (root mean square) repeat each
other. Across a field of view of about 60 degrees it is a turn or tilt of about half a degree: the second view
has nearly the first one's equations, and its corners fall into the same refinement windows, so that their
errors are the same too and do not average out, though the stated sigmas shrink as if they did."""


@dataclass(frozen=True)
class NearDuplicates:
    """Views that show the board in one place.

    Attributes:
        names: The photos, the one that the others repeat first.
        rms_px: Largest root mean square corner displacement from the first, pixels; 0 for copies of one file.
    """

    names: tuple[str, ...]
    rms_px: float

    @property
    def message(self) -> str:
        """One sentence that names the photos and says what is wrong with them."""
        first, *others = self.names
        return (
            f"{', '.join(others)}: the board is where it was in {first} (within {self.rms_px:.1f} px). "
            "Repeated views add no information but make the stated sigmas too small; keep one of them and "
            "move the board."
        )


def near_duplicates(
    uv: Sequence[NDArray] | NDArray,
    names: Sequence[str],
    image_size: tuple[int, int],
    sha256: Sequence[str] | None = None,
) -> tuple[NearDuplicates, ...]:
    """Group views that are copies of one file or show the board in nearly one place.

    Each view joins the first earlier group whose first member it repeats, so that a slow sweep is not one
    group.

    Args:
        uv: Corners of each view, (views, corners, 2), pixels; only of views where the board was found.
        names: Their photos' names.
        image_size: Width and height in pixels.
        sha256: Hashes of the photos' files, if known: equal ones repeat each other whatever the corners say.

    Returns:
        Groups of two views or more, in the order of their first members.

    Raises:
        InputError: The lengths differ.
    """
    if len(uv) != len(names) or (sha256 is not None and len(sha256) != len(names)):
        raise InputError(f"near_duplicates: {len(uv)} views but {len(names)} names; give one name (and hash) a view.")
    limit = REPEATS_WITHIN * float(np.hypot(*image_size))
    groups: list[list[int]] = []
    for view in range(len(names)):
        for group in groups:
            same_file = sha256 is not None and sha256[group[0]] == sha256[view]
            if same_file or _rms_distance(uv[group[0]], uv[view]) < limit:
                group.append(view)
                break
        else:
            groups.append([view])
    return tuple(
        NearDuplicates(
            names=tuple(names[view] for view in group),
            rms_px=max(_rms_distance(uv[group[0]], uv[view]) for view in group),
        )
        for group in groups
        if len(group) > 1
    )


def _rms_distance(first: NDArray, second: NDArray) -> float:
    """Root mean square distance between corresponding corners, pixels."""
    return float(np.sqrt(np.mean(np.sum((np.asarray(first) - np.asarray(second)) ** 2, axis=-1))))


def advise_board(
    load: Callable[[int], Grey],
    names: Sequence[str],
    columns_rows: tuple[int, int],
    seconds: float = _SECONDS,
) -> str:
    """Say why no photo shows the stated board, and which board would fit.

    A few photos are searched for any lattice of corners; its size, and the sizes that users confuse (squares
    given for inner corners, one line miscounted), are then looked for in earnest.

    Args:
        load: Gives the grey image of the photo with that index.
        names: The photos' names.
        columns_rows: The board that was not found.
        seconds: Time after which no further size is tried.

    Returns:
        A sentence or two for the error message.
    """
    columns, rows = check_board(columns_rows)
    tried = np.unique(np.linspace(0, len(names) - 1, min(_PHOTOS_TRIED, len(names))).round().astype(int))
    photos = [load(int(index)) for index in tried]
    what = f"no {columns}x{rows} board in {_photos(len(names))}"
    deadline = time.monotonic() + seconds
    for size in _candidates(photos, (columns, rows)):
        if time.monotonic() > deadline:
            break
        fits = sum(find_corners(photo, size, "quads") is not None for photo in photos)
        if fits:
            board = f"{size[0]}x{size[1]}"
            cause = _cause((columns, rows), size)
            return f"{what}; {board} fits {fits} of {len(photos)} tried: {cause} (--board {board})"
    return (
        f"{what}, nor a similar one in {len(photos)} tried. Count INNER corners (where "
        "four squares meet); the whole board must be in the picture, sharp, flat, evenly lit, with a light margin"
    )


def _photos(count: int) -> str:
    return "1 photo" if count == 1 else f"{count} photos"


def _candidates(photos: Sequence[Grey], board: tuple[int, int]) -> list[tuple[int, int]]:
    """Sizes worth looking for, likeliest first, without the one that failed."""
    columns, rows = board
    votes = Counter(size for photo in photos if (size := _any_lattice(photo, columns >= rows)) is not None)
    seen = [size for size, _ in votes.most_common()]
    confused = [(columns - 1, rows - 1), (columns + 1, rows + 1)]
    miscounted = [(columns + i, rows + j) for i, j in ((-1, 0), (0, -1), (1, 0), (0, 1))]
    wanted = [size for size in (*seen, *confused, *miscounted) if min(size) >= 3 and size != board]
    return list(dict.fromkeys(wanted))


def _any_lattice(photo: Grey, columns_first: bool) -> tuple[int, int] | None:
    """Size of the biggest lattice that OpenCV's sector finder sees, its longer side as the user's."""
    found, _, meta = cv2.findChessboardCornersSBWithMeta(photo, (3, 3), cv2.CALIB_CB_LARGER)
    if not found:
        return None
    short, long = sorted(meta.shape[:2])
    return (long, short) if columns_first else (short, long)


def _cause(asked: tuple[int, int], found: tuple[int, int]) -> str:
    """The likely slip behind a wrong size."""
    difference = found[0] - asked[0], found[1] - asked[1]
    if difference == (-1, -1):
        return "you may have given squares instead of inner corners"
    if difference == (1, 1):
        return "you may have left out the outermost inner corners"
    return "a line of corners may have been miscounted, or it is another board"
