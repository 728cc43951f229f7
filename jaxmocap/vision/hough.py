"""Circles in an edge map by the Hough transform: the document's accumulator, and OpenCV's for comparison.

`python scripts/compare_hough.py DATA` measures both beside `find_beads`.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from jaxmocap._errors import InputError

COUNT = 16
"""Circles that are looked for by default, one a marker (document 000, section 3.3.2)."""
RADIUS = (5.0, 7.0)
"""Radii that are looked for by default, pixels (document 000, section 3.3.2)."""

_CANNY_HIGH = 100.0  # OpenCV's default; its centres' threshold is what has to be chosen per picture
_VOTES = 8.0  # of OpenCV's centres: lower than any bead's, so that `count` decides


def check_radius(radius: tuple[float | int, float | int]) -> tuple[float, float]:
    """The two radii as floats.

    Raises:
        InputError: Not two finite numbers with 0 < r_min <= r_max.
    """
    try:
        low, high = (float(r) for r in radius)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not 0.0 < low <= high < np.inf:
        raise InputError(f"radius: expected two radii in pixels, 0 < r_min <= r_max, got {radius!r}.")
    return low, high


def check_count(count: int) -> int:
    """The number of circles as an integer.

    Raises:
        InputError: Not a whole number of at least 1.
    """
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise InputError(f"count: expected a whole number of circles, at least 1, got {count!r}.")
    return int(count)


def hough_circles(
    edges: NDArray, radius: tuple[float | int, float | int] = RADIUS, count: int = COUNT
) -> NDArray[np.float64]:
    """The circles on whose paths most edge pixels lie. Source: document 000, section 3.3.2.

    Each edge pixel votes, in the space (x, y, r), for the centres of all circles of radius r through it, r in whole
    pixels from r_min to r_max. The fullest cell is a circle; cells nearer to it than r are struck out; and so on.

    Args:
        edges: Edge map, bool (h, w).
        radius: Least and greatest radius, pixels.
        count: At most so many circles.

    Returns:
        Circles (n, 3): u, v, r, whole pixels, fullest first; cells without a vote are no circles.

    Raises:
        InputError: Radii or count that make no sense, or an edge map of another shape.
    """
    edges = np.asarray(edges, dtype=bool)
    if edges.ndim != 2:
        raise InputError(f"edges: expected an edge map (height, width), got shape {edges.shape}.")
    low, high = check_radius(radius)
    radii = np.arange(max(1, int(np.ceil(low))), int(np.floor(high)) + 1)
    if radii.size == 0:
        raise InputError(f"radius: no whole number of pixels between {low:g} and {high:g}; widen the range.")
    votes = np.stack([_votes(edges, int(r)) for r in radii])
    return _fullest(votes, radii, check_count(count))


def _votes(edges: NDArray[np.bool_], r: int) -> NDArray[np.int32]:
    """Accumulator of one radius: each cell counts the edge pixels on the circle around it."""
    height, width = edges.shape
    ring = _circle_offsets(r)
    v, u = np.nonzero(edges)
    cells = (v[:, None] + r + ring[None, :, 0]) * (width + 2 * r) + u[:, None] + r + ring[None, :, 1]
    padded = np.bincount(cells.ravel(), minlength=(height + 2 * r) * (width + 2 * r))
    return padded.reshape(height + 2 * r, width + 2 * r)[r : r + height, r : r + width].astype(np.int32)


def _circle_offsets(r: int) -> NDArray[np.int64]:
    """The different pixels (row, column) of a circle of radius r around 0."""
    angle = np.linspace(0.0, 2 * np.pi, 8 * r, endpoint=False)
    return np.unique(np.rint(r * np.stack([np.sin(angle), np.cos(angle)], axis=1)).astype(np.int64), axis=0)


def _fullest(votes: NDArray[np.int32], radii: NDArray, count: int) -> NDArray[np.float64]:
    """The `count` fullest cells of (r, v, u), none within another's radius."""
    best, which = votes.max(axis=0), votes.argmax(axis=0)  # over the radii
    best = best.copy()
    rows, columns = np.indices(best.shape, sparse=True)
    circles = []
    while len(circles) < count:
        v, u = np.unravel_index(int(best.argmax()), best.shape)
        if best[v, u] == 0:
            break
        r = int(radii[which[v, u]])
        circles.append((float(u), float(v), float(r)))
        part = np.s_[max(0, v - r) : v + r + 1, max(0, u - r) : u + r + 1]
        best[part][(rows[part[0]] - v) ** 2 + (columns[:, part[1]] - u) ** 2 <= r * r] = 0
    return np.array(circles, dtype=np.float64).reshape(-1, 3)


def opencv_circles(
    grey: NDArray, radius: tuple[float | int, float | int] = RADIUS, count: int = COUNT
) -> NDArray[np.float64]:
    """Circles by OpenCV's gradient method, which votes along the gradient in the plane (x, y) and takes r afterwards.

    Args:
        grey: uint8 (h, w).
        radius: Least and greatest radius, pixels.
        count: At most so many circles.

    Returns:
        Circles (n, 3): u, v, r, pixels, strongest first.

    Raises:
        InputError: Radii or count that make no sense, or a picture of another kind.
    """
    grey = np.asarray(grey)
    if grey.dtype != np.uint8 or grey.ndim != 2:
        raise InputError(f"grey: expected uint8 (height, width), got {grey.dtype} {grey.shape}.")
    low, high = check_radius(radius)
    found = cv2.HoughCircles(
        grey,
        cv2.HOUGH_GRADIENT,
        dp=1,
        minDist=low,
        param1=_CANNY_HIGH,
        param2=_VOTES,
        minRadius=int(np.floor(low)),
        maxRadius=int(np.ceil(high)),
    )
    circles = np.zeros((0, 3)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 3)
    return circles[: check_count(count)]
