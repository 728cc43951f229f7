"""Boards seen so obliquely that their grid lines meet at a small angle: found and refined where they look square.

Two steps fail on such photos. OpenCV's finder cuts the tips off narrow diamonds and then cannot join them: the photo
is stretched across them before searching. And a square window that reaches no other grid line holds few pixels of
the edges: corners are refined in a picture of their surroundings that makes the squares square.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from jaxmocap.vision.board_grid import Floats, Grey

_STRETCH = 2.2
"""A diamond of angle a, stretched across by s, gets an angle of 2 arctan(s tan(a / 2)): 2.2 makes 50 degrees, which
OpenCV joins reliably, of 24, and 90 of 49, where it needs no help."""

_DIRECTIONS = 4
"""Directions tried, 45 degrees apart: then one is at most 22.5 degrees off, and does 85 % of its work."""

_MOST_PIXELS = 1_500_000
"""A search in a larger picture takes seconds and finds the same boards; the corners are refined in the photo."""


def find_stretched(grey: Grey, find: Callable[[Grey], Floats | None]) -> Floats | None:
    """Search stretched copies of a photo.

    Args:
        grey: The photo, uint8 (h, w).
        find: Corners (n, 2) in a picture, or None.

    Returns:
        The corners of the first copy in which they were found, in pixels of the photo; or None.
    """
    for k in range(_DIRECTIONS):
        M, size = _stretching(grey.shape[::-1], np.pi * k / _DIRECTIONS)
        # Brightness beyond the border is repeated: black there would make new edges.
        copy = cv2.warpAffine(grey, M, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        found = find(copy)  # pyright: ignore[reportArgumentType]
        if found is not None:
            return (found - M[:, 2]) @ np.linalg.inv(M[:, :2]).T
    return None


def _stretching(size: tuple[int, ...], angle: float) -> tuple[Floats, tuple[int, int]]:
    """Affine map that stretches along a direction and shortens across it, and the size that holds the whole photo."""
    width, height = size
    root = np.sqrt(_STRETCH)
    direction = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-direction[1], direction[0]])
    # No turn: the picture keeps to its axes where it can, and so wastes no border.
    A = root * np.outer(direction, direction) + np.outer(across, across) / root
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) @ A.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = min(1.0, np.sqrt(_MOST_PIXELS / (width * height)))
    wanted = np.ceil(scale * (high - low)).astype(int)
    return np.column_stack([scale * A, -scale * low]), (int(wanted[0]), int(wanted[1]))


def smallest_angle(grid: Floats) -> float:
    """Smallest angle at which the lines of a grid (rows, columns, 2) meet, radians, at most pi / 2."""
    along, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    turn = np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
    return float(np.arctan2(turn, np.abs(np.sum(along * down, axis=-1))).min())


def surroundings(grid: Floats) -> tuple[Floats, float]:
    """Affine map of each corner's surroundings: photo <- picture in which squares are square.

    Args:
        grid: Corners (rows, columns, 2), pixels.

    Returns:
        (rows * columns, 2, 2); the width of a square in the picture, pixels: that of the longest in the photo.
    Source: derivative of the homography of the whole grid, less noisy than differences of neighbours.
    """
    rows, columns = grid.shape[:2]
    lattice = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(np.float64)
    H, _ = cv2.findHomography(lattice, grid.reshape(-1, 2), 0)
    h = np.column_stack([lattice, np.ones(len(lattice))]) @ H.T
    image = h[:, :2] / h[:, 2:]
    J = (H[None, :2, :2] - image[:, :, None] * H[None, 2:, :2]) / h[:, 2, None, None]
    square = float(np.linalg.norm(J, axis=1).max())
    return J / square, square


def refine_one(smooth: Grey, uv: Floats, A: Floats, half: int, stop: tuple[int, int, float]) -> Floats:
    """One corner refined by `cv2.cornerSubPix` in the picture that A makes of its surroundings.

    Args:
        smooth: The photo, uint8 (h, w).
        uv: Start, (2,), pixels.
        A: Photo <- picture, (2, 2).
        half: Half size of the window in the picture, pixels of the picture.
        stop: When cornerSubPix ends.

    Returns:
        The refined corner, (2,), pixels of the photo.
    """
    middle = half + 3  # the gradient filter, and the steps of the refinement, look beyond the window
    M = np.column_stack([A, uv - A @ [middle, middle]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    picture = cv2.warpAffine(smooth, M, (2 * middle + 1,) * 2, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    start = np.full((1, 1, 2), middle, np.float32)
    moved = cv2.cornerSubPix(picture, start, (half, half), (-1, -1), stop).reshape(2) - middle
    return uv + A @ moved.astype(np.float64)
