"""What a grid of chessboard corners must look like, and which way round it is numbered.

A grid is an array (rows, columns, 2) of pixel positions. Square (i, j) lies between corners (i, j) and (i+1,
j+1). Numbering: along a row of `columns` corners first; turning from the row direction to the column
direction is clockwise in the image (u right, v down), so that with x along the rows and y down the columns, z
= x cross y points INTO the board, away from the camera. A mirrored numbering would calibrate without
complaint and be wrong.
"""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from jaxmocap._errors import InputError

Floats: TypeAlias = NDArray[np.float64]
Grey: TypeAlias = NDArray[np.uint8]

_MAX_BEND = 0.5
"""Largest second difference along a line of corners, in spacings. A corner left out or taken for its
neighbour makes at least 1; perspective at most about 2 square / distance, which reaches 0.5 only nearer than
four squares to the board."""

_CONTINUES = 0.5
"""Contrast beyond the outer squares, relative to the board's, from which the pattern is said to go on: half
way between a blank margin (0) and further squares (1)."""

_COVERED = 0.5
"""Contrast close to a corner, relative to that of the middles of the squares around it, below which the
corner is hidden: half way between a covered corner (0) and a clear one (1). OpenCV's sector finder makes up
corners that it cannot see."""

_MIDDLE = np.array([0.3, 0.5, 0.7])  # across a square: clear of blurred edges
_NEAR_CORNERS = np.array([0.2, 0.8])  # nearer, blur of a few pixels would count as cover where squares are small
_OUTWARDS = (1.0, 1.6)
"""Lines extrapolated outwards, in squares: past the outer squares, and not too far beyond these, because
where a bigger board goes on, the squares seen there may be its outer ones, often printed or cut narrower."""

_RING = len(_OUTWARDS)


def check_board(columns_rows: tuple[int, int]) -> tuple[int, int]:
    """The board's inner corners as two checked integers.

    Args:
        columns_rows: Inner corners along and across, for instance (9, 6).

    Returns:
        The same pair.

    Raises:
        InputError: Not two whole numbers of at least 3 (OpenCV's finders need that many, and so does the
            check that neighbours are regularly spaced).
    """
    try:
        columns, rows = (int(n) for n in columns_rows)
        exact = (columns, rows) == tuple(columns_rows)
    except (TypeError, ValueError, OverflowError):
        columns, rows, exact = 0, 0, False
    if not exact or not 3 <= min(columns, rows) <= max(columns, rows) <= 200:
        raise InputError(
            f"board {columns_rows!r}: expected COLUMNSxROWS, two whole numbers from 3 to 200, counting INNER "
            "corners (where four squares meet): a board of 10 x 7 squares is 9x6."
        )
    return columns, rows


def as_grid(uv: NDArray, columns_rows: tuple[int, int]) -> Floats:
    """Corners (n, 2) as a grid (rows, columns, 2).

    Raises:
        InputError: The count is not columns x rows, or a position is not finite.
    """
    columns, rows = check_board(columns_rows)
    uv = np.asarray(uv, dtype=np.float64)
    if uv.shape != (columns * rows, 2) or not np.isfinite(uv).all():
        raise InputError(
            f"corners: expected {columns * rows} finite positions, shape ({columns * rows}, 2), for a "
            f"{columns}x{rows} board; got shape {uv.shape}. Give the corners of one whole board."
        )
    return uv.reshape(rows, columns, 2)


def orient_by_colour(grey: Grey, uv: NDArray, columns_rows: tuple[int, int]) -> Floats:
    """Number the corners in the one way that the board's colours and its handedness allow.

    Never mirrored; and the first square, between the first two corners of the first two rows, is dark
    wherever the board permits: when one of columns and rows is odd and the other even, a half turn swaps the
    colours and the numbering is absolute (corner 0 is the same printed corner in any photo, upside down or
    not). Other boards look the same after a half turn (square ones with even counts after a quarter turn
    too); of the numberings left, the one whose rows point most nearly to the right of the image is taken, and
    a stereo pair needs `consistent_order`.

    Args:
        grey: The photo, uint8 (h, w).
        uv: Corners in any of the numberings row by row, (columns * rows, 2), pixels.
        columns_rows: Inner corners along and across.

    Returns:
        The corners renumbered, (columns * rows, 2), pixels.

    Raises:
        InputError: The corners do not fit the board.
    """
    grid = as_grid(uv, columns_rows)
    if cell_turns(grid).mean() < 0:
        grid = grid[:, ::-1]
    dark_first = [g for g in _rotations(grid) if _first_square_is_dark(grey, g)]
    best = max(dark_first or _rotations(grid), key=lambda g: _row_direction(g)[0])
    return np.ascontiguousarray(best).reshape(-1, 2)


def consistent_order(uv_left: NDArray, uv_right: NDArray, columns_rows: tuple[int, int]) -> Floats:
    """Number the right photo's corners as the left's, for boards whose colours leave a choice.

    Boards with one odd and one even count have an absolute numbering (`orient_by_colour`) and come back
    unchanged. For the others, of the turns that keep the colours, the one that best overlays the left grid is
    taken: right as long as one camera is not rolled against the other by more than 90 degrees (45 for square
        boards with even counts).

    Args:
        uv_left: Corners in the left photo, (columns * rows, 2), pixels, from `find_corners`.
        uv_right: The same board at the same moment in the right photo, likewise.
        columns_rows: Inner corners along and across.

    Returns:
        The right corners renumbered, (columns * rows, 2), pixels.

    Raises:
        InputError: The corners do not fit the board.
    """
    left, right = as_grid(uv_left, columns_rows), as_grid(uv_right, columns_rows)
    columns, rows = columns_rows
    if (columns + rows) % 2:
        return right.reshape(-1, 2)
    quarter_turns = columns == rows and columns % 2 == 0
    candidates = _rotations(right) if quarter_turns else [right, np.rot90(right, 2)]
    centred_left = left - left.mean(axis=(0, 1))
    best = max(candidates, key=lambda g: float(np.sum(centred_left * (g - g.mean(axis=(0, 1))))))
    return np.ascontiguousarray(best).reshape(-1, 2)


def grid_fault(grey: Grey, grid: Floats, *, whole_board_in_view: bool = False) -> str | None:
    """Why a grid cannot be the whole board, or None if it can.

    Args:
        grey: The photo, uint8 (h, w).
        grid: Corners (rows, columns, 2), numbered without mirroring, pixels.
        whole_board_in_view: Also demand that the outer squares lie in the image, so that it can be seen that
            the board ends there.

    Returns:
        The reason in words.
    """
    height, width = grey.shape
    if (grid < 0).any() or (grid > (width - 1, height - 1)).any():
        return "a corner lies outside the image"
    if (cell_turns(grid) <= 0).any():
        return "the corners' quadrilaterals are crossed or mirrored"
    if _bend(grid) > _MAX_BEND:
        return "the corners are not regularly spaced"
    extended = _extended(grid)
    brightness = square_brightness(grey, extended)
    if not _alternates(brightness[_RING:-_RING, _RING:-_RING]):
        return "the squares between the corners do not alternate"
    if whole_board_in_view and np.isnan(brightness[1:-1, 1:-1]).any():
        return "the outer squares are not all in the image"
    if _is_covered(grey, extended, brightness):
        return "a corner is hidden"
    if _goes_on(brightness):
        return "the pattern goes on beyond the outer squares: the board is bigger"
    return None


def cell_turns(grid: Floats) -> Floats:
    """Turn from row to column direction at the four corners of each square, (4, rows-1, columns-1).

    All positive: the square is convex and not mirrored. In squared pixels.
    """
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    return np.stack([_cross(b - a, d - a), _cross(c - b, a - b), _cross(d - c, b - c), _cross(a - d, c - d)])


def square_brightness(grey: Grey, grid: Floats) -> Floats:
    """Mean brightness in each square's middle, (rows-1, columns-1); NaN where that is not in the image."""
    return _samples(grey, grid, _MIDDLE).mean(axis=(0, 1))


def corner_contrast(grey: Grey, grid: Floats) -> Floats:
    """Contrast of the squares close to each inner corner of the grid, (rows-2, columns-2).

    Half the difference of the two pairs of opposite squares a fifth of a square from the corner, positive
    where the first pair is brighter; about 0 where something covers the corner. NaN where that is not in the
    image.
    """
    near = _samples(grey, grid, _NEAR_CORNERS)  # (2, 2, rows-1, columns-1): down, across in each square
    first = near[1, 1, :-1, :-1] + near[0, 0, 1:, 1:]
    second = near[1, 0, :-1, 1:] + near[0, 1, 1:, :-1]
    return (first - second) / 4


def _samples(grey: Grey, grid: Floats, t: Floats) -> Floats:
    """Brightness at fractions t down and across each square, (t, t, rows-1, columns-1); NaN outside the image."""
    down, across = t[:, None, None, None, None], t[None, :, None, None, None]
    top = grid[:-1, :-1] * (1 - across) + grid[:-1, 1:] * across
    bottom = grid[1:, :-1] * (1 - across) + grid[1:, 1:] * across
    points = top * (1 - down) + bottom * down
    flat = points.reshape(-1, grid.shape[1] - 1, 2)  # cv2.remap wants two axes
    u, v = flat[..., 0].astype(np.float32), flat[..., 1].astype(np.float32)
    values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = grey.shape
    inside = ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=-1)
    return np.where(inside, values.reshape(inside.shape).astype(np.float64), np.nan)


def _cross(p: Floats, q: Floats) -> Floats:
    return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]


def _rotations(grid: Floats) -> list[Floats]:
    """The numberings that turning the board allows: two, or four for a square board."""
    turns = (0, 1, 2, 3) if grid.shape[0] == grid.shape[1] else (0, 2)
    return [np.rot90(grid, k) for k in turns]


def _row_direction(grid: Floats) -> Floats:
    """Unit vector from the first to the last column, mean over the rows."""
    direction = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    return direction / np.linalg.norm(direction)


def _parity(shape: tuple[int, ...]) -> Floats:
    """+1 and -1 like the colours of a chessboard, +1 at (0, 0)."""
    return np.where(np.indices(shape).sum(axis=0) % 2 == 0, 1.0, -1.0)


def _first_square_is_dark(grey: Grey, grid: Floats) -> bool:
    """Whether the squares of the first one's colour are the darker ones."""
    brightness = square_brightness(grey, grid)
    return _contrast(brightness, _parity(brightness.shape)) < 0


def _contrast(brightness: Floats, parity: Floats) -> float:
    """Half the difference of the squares of parity +1 and -1; 0 unless at least two of each are seen."""
    seen = np.isfinite(brightness)
    bright, dark = brightness[seen & (parity > 0)], brightness[seen & (parity < 0)]
    return float(bright.mean() - dark.mean()) / 2 if min(bright.size, dark.size) >= 2 else 0.0


def _bend(grid: Floats) -> float:
    """Largest second difference along rows and columns, relative to the shorter of the two spacings."""
    worst = 0.0
    for lines in (grid, grid.swapaxes(0, 1)):
        steps = np.diff(lines, axis=0)
        change = np.linalg.norm(np.diff(steps, axis=0), axis=-1)
        length = np.linalg.norm(steps, axis=-1)
        worst = max(worst, float((change / np.minimum(length[1:], length[:-1])).max()))
    return worst


def _extended(grid: Floats) -> Floats:
    """The grid with `_RING` more corners on every side."""
    for _ in range(4):  # each time the last row's side, then the next side is turned there
        beyond = _continued(grid[-3:])
        grid = np.rot90(np.concatenate([grid, beyond]), 1)
    return grid


def _continued(last_rows: Floats) -> Floats:
    """`_RING` rows more, by the homography of the last three: few, so that the lens bends little."""
    depth, columns = last_rows.shape[:2]
    steps = np.append(np.arange(depth), depth - 1 + np.array(_OUTWARDS))
    lattice = np.stack(np.meshgrid(np.arange(columns, dtype=np.float64), steps), axis=-1)
    homography, _ = cv2.findHomography(lattice[:depth].reshape(-1, 2), last_rows.reshape(-1, 2), 0)
    if homography is None:
        return np.full((_RING, columns, 2), np.nan)
    beyond = cv2.perspectiveTransform(lattice[depth:].reshape(-1, 1, 2), homography)
    return np.asarray(beyond, dtype=np.float64).reshape(_RING, columns, 2)


def _alternates(inner: Floats) -> bool:
    """Whether every square is darker, or every one brighter, than the mean of its neighbours, in turn.

    Neighbours only, so that shading and vignetting across the board do not matter.
    """
    padded = np.pad(inner, 1, constant_values=np.nan)
    neighbours = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    contrast = _parity(inner.shape) * (inner - np.nanmean(neighbours, axis=0))
    return bool((contrast > 0).all() or (contrast < 0).all())


def _is_covered(grey: Grey, extended: Floats, brightness: Floats) -> bool:
    """Whether the pattern is missing close to some corner though the squares around it show it.

    The squares' contrast is local, because light may fall off across the board; and taken as half the board's
    at least, because the outer squares may themselves be hidden, say by the fingers that hold the board.
    """
    own = np.s_[1:-1, 1:-1]
    corner_sign = _parity(brightness.shape)[:-1, :-1]
    near = (corner_sign * corner_contrast(grey, extended))[own]
    around = brightness[:-1, :-1] + brightness[1:, 1:] - brightness[:-1, 1:] - brightness[1:, :-1]
    middles = (corner_sign * around / 4)[own]
    inner = np.s_[_RING:-_RING, _RING:-_RING]
    board = _contrast(brightness[inner], _parity(brightness.shape)[inner])
    expected = np.fmax(middles / board, 0.5)  # fmax: half the board's, too, where outer squares leave the image
    return bool((near / board < _COVERED * expected).any())  # a NaN, outside the image, cannot tell


def _goes_on(brightness: Floats) -> bool:
    """Whether a line of squares just outside the outer ones alternates as the board does."""
    parity = _parity(brightness.shape)
    inner = np.s_[_RING:-_RING, _RING:-_RING]
    board = _contrast(brightness[inner], parity[inner])
    beyond = (np.s_[0, 1:-1], np.s_[-1, 1:-1], np.s_[1:-1, 0], np.s_[1:-1, -1])
    return any(_contrast(brightness[line], parity[line]) / board > _CONTINUES for line in beyond)
