"""The visible edge of a bead, point by point, and the circle through it.

From a pixel inside the bead, rays run outwards; along each, the picture's colour is compared with the bead's own
(1) and the background's (0), and the edge is where it falls to one half. A bead is a disc minus whatever hides a
part of it: edge points are those of the disc, or lie WITHIN the disc where something hides it, never outside. So
the circle is the one on which most edge points lie with hardly any outside; the centroid of the visible part would be
drawn away from a hidden side.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RAYS = 48
_STEP = 0.5  # px along a ray; the picture is sampled linearly between pixels
_INSIDE = (3, 4, 6)  # samples before the edge, 1.5 to 3 px, where the bead shows its own brightness
_OUTSIDE = (2, 3, 4, 5)  # samples after it, 1 to 2.5 px, the darkest of which is what lies around
_SAME_COLOUR, _OTHER_COLOUR = np.radians((6.0, 16.0))
_BRIGHT = 0.4
_SIZES, _EDGE_LEVELS = (1.5, 4.0), (0.5, 0.2)
_BEYOND = 1.0  # px past the edge that must still be background
_ANGLE = np.arange(RAYS) * (2 * np.pi / RAYS)
_DIRECTIONS = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], axis=1)  # (RAYS, 2)


class Seeds(NamedTuple):
    """Where beads are suspected: one row each.

    Attributes:
        uv: A pixel well inside the visible part, (n, 2).
        inner: Radius of the largest circle around it that stays in the visible part, (n,), px.
        colour: Typical colour of the visible part, (n, 3), linear light 0..1.
        ground: Colour of the surroundings, (n, 3), linear light 0..1.
        owner: Number by which the map of owners knows the bead, (n,).
    """

    uv: Floats
    inner: Floats
    colour: Floats
    ground: Floats
    owner: NDArray[np.int_]


class Edges(NamedTuple):
    """Edge points along the rays of each seed.

    Attributes:
        uv: (n, RAYS, 2), px.
        found: (n, RAYS): the ray crosses an edge, and it is one against the background.
    """

    uv: Floats
    found: NDArray[np.bool_]


def trace_edges(rgb: NDArray[np.float32], owners: NDArray[np.int32], seeds: Seeds, size: float, reach: float) -> Edges:
    """Edge points of each seed's bead.

    Args:
        rgb: Picture, linear light, float32 (h, w, 3), 0..1.
        owners: int32 (h, w): which bead a pixel is known to belong to, 0 for none. A ray ends at a pixel of
            another bead, and where it ends says nothing about this bead's disc.
        seeds: Where to look.
        size: Radius that beads of this picture usually have, px.
        reach: Length of the rays, px.

    Returns:
        The edge points.
    """
    distance = np.arange(0.0, reach, _STEP)
    points = seeds.uv[:, None, None, :] + distance[:, None] * _DIRECTIONS[None, :, None, :]
    own = _ownness(_sample(rgb, points), seeds)  # (n, RAYS, S)
    own = np.where(distance < 0.75 * seeds.inner[:, None, None], 1.0, own)  # a highlight there is no edge
    edge = _edge_level(size)
    first = _first_below(own, np.full(own.shape[:2], edge + 0.05), np.zeros(own.shape[:2], int))
    level = _half_way(own, first, edge)
    crossing, found = _crossing(own, level, first)
    uv = seeds.uv[:, None, :] + crossing[..., None] * _STEP * _DIRECTIONS[None]
    beyond = uv + _BEYOND * _DIRECTIONS[None]
    others = _first_other(owners, points, seeds.owner)
    found &= (others > crossing + _BEYOND / _STEP) & _inside(rgb.shape, beyond)
    return Edges(uv, found)


def _first_other(owners: NDArray[np.int32], points: Floats, owner: NDArray[np.int_]) -> NDArray[np.int_]:
    """Index of the first sample of each ray on another bead's pixel; past the end where there is none."""
    if not owners.any():
        return np.full(points.shape[:2], points.shape[2])
    column = np.clip(np.rint(points[..., 0]), 0, owners.shape[1] - 1).astype(int)
    row = np.clip(np.rint(points[..., 1]), 0, owners.shape[0] - 1).astype(int)
    whose = owners[row, column]
    other = (whose != 0) & (whose != owner[:, None, None])
    return np.where(other.any(-1), other.argmax(-1), points.shape[2])


def _sample(rgb: NDArray[np.float32], points: Floats) -> NDArray[np.float32]:
    """Colours at sub-pixel positions (..., 2), linear between pixels, border repeated: (..., 3)."""
    flat = points.astype(np.float32).reshape(points.shape[0] * points.shape[1], -1, 2)
    # cv2.remap refuses more than 32766 rows: a photo with hundreds of bright spots has more rays.
    sampled = [
        cv2.remap(rgb, part[..., 0], part[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.array_split(flat, len(flat) // 32766 + 1)
    ]
    return np.concatenate(sampled).reshape(*points.shape[:-1], 3)  # pyright: ignore[reportReturnType]


def _ownness(colours: NDArray[np.float32], seeds: Seeds) -> Floats:
    """Brightness as a fraction of the bead's own, 0 where a bright pixel is of another colour.

    In linear light shading and a blurred edge move a colour along the line from the background's to the bead's; a
    neighbouring bead of another colour lies off that line.
    """
    line = (seeds.colour - seeds.ground).astype(np.float32)
    length2 = np.maximum((line**2).sum(-1), 1e-6)
    offset = (colours - seeds.ground[:, None, None, :].astype(np.float32)).reshape(len(line), -1, 3)
    along = (offset @ (line / length2[:, None])[..., None])[..., 0]
    total = np.sqrt(np.einsum("nkc,nkc->nk", offset, offset) / length2[:, None])
    turned = np.arccos(np.clip(along / np.maximum(total, 1e-6), -1.0, 1.0))
    foreign = np.clip((turned - _SAME_COLOUR) / (_OTHER_COLOUR - _SAME_COLOUR), 0.0, 1.0) * (total > _BRIGHT)
    return (np.minimum(along, 1.0) * (1.0 - foreign)).reshape(colours.shape[:3])


def _first_below(own: Floats, level: Floats, start: NDArray[np.int_]) -> NDArray[np.int_]:
    """Index of the first sample below the level at or after `start`; the last index where there is none."""
    index = np.arange(own.shape[-1])
    below = (own < level[..., None]) & (index >= start[..., None])
    return np.where(below.any(-1), below.argmax(-1), own.shape[-1] - 1)


def _edge_level(size: float) -> float:
    """Half of a bead's light at its edge, relative to its inside.

    A matt sphere lit from the camera has about 0.4 of its light where a pixel still lies wholly within a large outline.
    Of a small one blur leaves no rim that is darker than the rest, and the edge is at half of the whole.
    """
    return float(np.interp(size, _SIZES, _EDGE_LEVELS))


def _half_way(own: Floats, first: NDArray[np.int_], edge: float) -> Floats:
    """Half way between what is inside and what is outside of a first guess of the edge, on each ray."""
    last = own.shape[-1] - 1
    inside = [np.take_along_axis(own, np.clip(first - k, 0, last)[..., None], -1)[..., 0] for k in _INSIDE]
    outside = [np.take_along_axis(own, np.clip(first + k, 0, last)[..., None], -1)[..., 0] for k in _OUTSIDE]
    return edge * np.max(inside, axis=0) + 0.5 * np.min(outside, axis=0)


def _crossing(own: Floats, level: Floats, first: NDArray[np.int_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Where the ray falls below its level near the first guess, in samples with a fraction, and whether it does."""
    last = own.shape[-1] - 1
    after = _first_below(own, level, np.maximum(first - 3, 0))
    after = np.maximum(after, 1)
    high = np.take_along_axis(own, (after - 1)[..., None], -1)[..., 0]
    low = np.take_along_axis(own, after[..., None], -1)[..., 0]
    fraction = np.clip((high - level) / np.maximum(high - low, 1e-9), 0.0, 1.0)
    return after - 1 + fraction, (after < last) & (np.abs(after - first) <= 4) & (low < level)


def _inside(shape: tuple[int, ...], uv: Floats) -> NDArray[np.bool_]:
    return (uv[..., 0] >= 0) & (uv[..., 0] <= shape[1] - 1) & (uv[..., 1] >= 0) & (uv[..., 1] <= shape[0] - 1)


def select(seeds: Seeds, keep: NDArray) -> Seeds:
    """The seeds that are kept, or in the order of the indices."""
    return Seeds(*(field[keep] for field in seeds))  # pyright: ignore[reportArgumentType]
