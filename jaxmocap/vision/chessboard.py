"""Inner corners of a chessboard in one photo: find the grid, refuse a wrong one, refine to sub-pixels.

Two finders of OpenCV are used. The finder of *quads* joins closed dark squares corner to corner; the finder
of *sectors* matches the four-fold pattern around a corner and takes any lattice of such points. The default
is quads, then sectors where quads find nothing, BOTH refined by the gradient method below:
`scripts/corner_sigmas.py` shows which combination's stated standard deviations hold, which is not the one
with the lowest residuals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from jaxmocap._errors import InputError
from jaxmocap.vision.board_grid import Floats, Grey, as_grid, check_board, grid_fault, orient_by_colour
from jaxmocap.vision.sheared import find_stretched, refine_one, smallest_angle, surroundings

Detector = Literal["default", "quads", "sectors"]

_QUAD_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
# pixels: far below any corner's noise
_SUBPIX_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)

WINDOW_FRACTION = 0.2
"""Half window over the smallest distance from a corner to a grid line beside it. Wider windows lower the
residuals, but on pictures of an independent renderer their stated sigmas stop holding
(`scripts/corner_sigmas.py`)."""

MIN_HALF_WINDOW = 5
"""Pixels wanted even where squares are small: blur spreads an edge over 3 or 4 pixels, and the finder's first
guess may be 2 or 3 pixels off."""

MAX_WINDOW_FRACTION = 0.35
"""But never more than this fraction: the half diagonal of the window is then 0.5 spacings, which stays clear
of the far edge even of outer squares that are printed or cut half as wide."""

_SMOOTHING = 0.5
"""Standard deviation, pixels, of a blur before refining. Differences between pixels misjudge an edge thinner
than a pixel by an amount that depends on where between two pixels it lies; half a pixel of blur is what
sampling asks for. More would lower the residuals further but, like wide windows, leaves errors that the
stated sigmas do not cover."""

SHEARED = np.deg2rad(50.0)
"""Grid lines that meet at less are refined where the squares look square (`vision.sheared`). A square board tilted
about a diagonal by t shows the angle 2 arctan(cos t): 50 degrees is a tilt of 62. Above, both ways are equally
accurate; below, the square window loses (`scripts/corner_sigmas.py`, kind "sheared")."""

_LEAST_HALF_WINDOW = 2  # below, fewer edge pixels than unknowns: such corners cannot be refined


@dataclass(frozen=True)
class CornerResult:
    """The corners of one board in one photo.

    Attributes:
        uv: Corners row by row, float64 (columns * rows, 2), pixels, (0, 0) the centre of the top-left pixel.
            Numbered as `orient_by_colour` says.
        finder: Which finder saw the grid, "quads", "sectors" or (sectors in a stretched photo) "stretched".
        half_window: Half size of the refinement window of each corner, (columns * rows,), pixels; 0: not
            refined. Of a sheared board: pixels of a picture in which its squares are square.
    """

    uv: Floats
    finder: str
    half_window: NDArray[np.int64]


def find_corners(
    photo_grey: NDArray, columns_rows: tuple[int, int], detector: Detector = "default"
) -> CornerResult | None:
    """Find all inner corners of a chessboard.

    All or nothing: a board that is partly hidden, cut off, bigger than stated or irregular gives None, never
    a grid with guessed or shifted corners.

    Args:
        photo_grey: The photo, uint8 (h, w).
        columns_rows: INNER corners along and across, at least 3 each; (6, 9) finds a 9x6 board too, numbered
            its way.
        detector: "default"; or "quads" or "sectors" alone, the latter with that finder's own refinement.

    Returns:
        The corners, or None if no whole board was found.

    Raises:
        InputError: The board is smaller than 3x3, or the photo is not 8-bit grey.
    """
    check_board(columns_rows)
    if not isinstance(photo_grey, np.ndarray) or photo_grey.ndim != 2 or photo_grey.dtype != np.uint8:
        raise InputError("photo: expected a uint8 array (height, width), as `read_photo(path).grey` gives it.")
    if min(photo_grey.shape) < 16:
        return None  # no room for 4 x 4 squares, and OpenCV's finders fail on such sizes
    if detector != "sectors":
        found = find_quads(photo_grey, columns_rows)
        if found is not None:
            return _refined(photo_grey, found, columns_rows, "quads")
    if detector == "quads":
        return None
    found = find_sectors(photo_grey, columns_rows)
    if found is None and detector == "default":
        # Sectors, because without a board in view that finder needs a tenth of the time.
        found = find_stretched(photo_grey, lambda grey: find_sectors(grey, columns_rows))
        if found is not None:
            found = _validated(photo_grey, found, columns_rows, whole_board_in_view=True)
        return None if found is None else _refined(photo_grey, found, columns_rows, "stretched")
    if found is None:
        return None
    if detector == "sectors":
        return CornerResult(found, "sectors", np.zeros(len(found), dtype=np.int64))
    return _refined(photo_grey, found, columns_rows, "sectors")


def half_windows(uv: NDArray, columns_rows: tuple[int, int], image_size: tuple[int, int]) -> NDArray[np.int64]:
    """Half size of the square window in which each corner is refined.

    One size for the whole view, so that all its corners are about equally uncertain, as least squares without
    weights assumes; smaller only for corners nearer than that to the border.

    Args:
        uv: Corners row by row, (columns * rows, 2), pixels.
        columns_rows: Inner corners along and across.
        image_size: Width and height in pixels.

    Returns:
        Whole pixels, (columns * rows,).

    Raises:
        InputError: The corners do not fit the board.
    """
    grid = as_grid(uv, columns_rows)
    free = distance_to_next_line(grid)
    wanted = max(WINDOW_FRACTION * free, min(MIN_HALF_WINDOW, MAX_WINDOW_FRACTION * free))
    border = np.minimum(grid, np.subtract(image_size, 1) - grid).min(axis=-1).ravel()
    return np.floor(np.minimum(wanted, border)).astype(np.int64)


def refine_corners(grey: Grey, uv: NDArray, half_window: NDArray[np.int64]) -> Floats:
    """Move each corner to where all brightness gradients around it are perpendicular to the line to it.

    Args:
        grey: The photo, uint8 (h, w).
        uv: Starting points, (n, 2), pixels.
        half_window: Half size of each corner's window, (n,), whole pixels; below 1 leaves the corner where it
            is.

    Returns:
        Refined corners, (n, 2), pixels.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING)
    refined = np.array(uv, dtype=np.float32)
    for half in np.unique(half_window[half_window >= 1]):
        here = half_window == half
        start = np.ascontiguousarray(refined[here]).reshape(-1, 1, 2)
        refined[here] = cv2.cornerSubPix(smooth, start, (int(half),) * 2, (-1, -1), _SUBPIX_STOP).reshape(-1, 2)
    return refined.astype(np.float64)


def find_quads(grey: Grey, columns_rows: tuple[int, int]) -> Floats | None:
    """Grid of the finder that joins dark squares, validated, or None."""
    found, corners = cv2.findChessboardCorners(grey, columns_rows, flags=_QUAD_FLAGS)
    if not found:
        return None
    return _validated(grey, corners, columns_rows, whole_board_in_view=False)


def find_sectors(grey: Grey, columns_rows: tuple[int, int]) -> Floats | None:
    """Grid of the finder that matches sectors, validated, or None.

    That finder needs no squares, only corners, and so cannot tell a board from a part of a bigger one whose
    rest is out of the picture: the outer squares must be in view.
    """
    found, corners = cv2.findChessboardCornersSB(grey, columns_rows)
    if not found:
        return None
    return _validated(grey, corners, columns_rows, whole_board_in_view=True)


def _validated(
    grey: Grey, corners: NDArray, columns_rows: tuple[int, int], *, whole_board_in_view: bool
) -> Floats | None:
    """The numbered corners if they can be the whole board."""
    uv = np.asarray(corners, dtype=np.float64).reshape(-1, 2)  # shapes differ between OpenCV 4 and 5
    if not np.isfinite(uv).all():
        return None
    uv = orient_by_colour(grey, uv, columns_rows)
    fault = grid_fault(grey, as_grid(uv, columns_rows), whole_board_in_view=whole_board_in_view)
    return uv if fault is None else None


def _refined(grey: Grey, uv: Floats, columns_rows: tuple[int, int], finder: str) -> CornerResult | None:
    """Refined corners; None if refinement moved one out of its window, for then it was not a corner."""
    if smallest_angle(as_grid(uv, columns_rows)) < SHEARED:
        return _refined_sheared(grey, uv, columns_rows, finder)
    height, width = grey.shape
    half = half_windows(uv, columns_rows, (width, height))
    refined = refine_corners(grey, uv, half)
    if (half < _LEAST_HALF_WINDOW).any() or (np.abs(refined - uv).max(axis=1) > half).any():
        return None
    return CornerResult(refined, finder, half)


def _refined_sheared(grey: Grey, uv: Floats, columns_rows: tuple[int, int], finder: str) -> CornerResult | None:
    """The same with a window that is a parallelogram in the photo; its reach follows the rules of `half_windows`."""
    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING)
    border_of = np.subtract(grey.shape[::-1], 1)
    for _ in range(2):  # the window's shape follows from the corners, and the finder's are rough
        grid = as_grid(uv, columns_rows)
        free = distance_to_next_line(grid)
        fraction = max(WINDOW_FRACTION, min(MIN_HALF_WINDOW / free, MAX_WINDOW_FRACTION))
        A, square = surroundings(grid)
        reach = np.abs(A).sum(axis=2)  # of a window of half size 1, along u and v
        border = (np.minimum(uv, border_of - uv) / reach).min(axis=1)
        half = np.floor(np.minimum(fraction * square, border)).astype(np.int64)
        if (half * free / square < _LEAST_HALF_WINDOW).any():
            return None
        refined = np.array([refine_one(smooth, *one, _SUBPIX_STOP) for one in zip(uv, A, half.tolist())])  # pyright: ignore[reportArgumentType]
        move = np.abs(np.linalg.solve(A, (refined - uv)[..., None])[..., 0])
        if (move.max(axis=1) > half).any():
            return None
        uv = refined
    return CornerResult(uv, finder, half)


def distance_to_next_line(grid: Floats) -> float:
    """Smallest distance in the view from a corner to a grid line beside it, pixels.

    Less than the spacing where foreshortening makes squares into narrow diamonds.
    """
    shortest = np.inf
    for lines in (grid, grid.swapaxes(0, 1)):
        along = np.gradient(lines, axis=1)  # direction of each line at its corners
        step = np.diff(lines, axis=0)
        for direction in (along[:-1], along[1:]):
            turn = step[..., 0] * direction[..., 1] - step[..., 1] * direction[..., 0]
            shortest = min(shortest, float((np.abs(turn) / np.linalg.norm(direction, axis=-1)).min()))
    return shortest
