"""Bright patches of a photo, and one place inside each from which a bead's edge can be looked for."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from jaxmocap.vision.bead_edges import Seeds
from jaxmocap.vision.threshold import linear_light

Floats = NDArray[np.float64]

_SMOOTH = 0.7  # px: noise of single pixels halves, and a bead of 1.5 px radius still keeps most of its height
_SHRINK = 4  # the surroundings' colour changes slowly
_GROUND_WINDOW = 15  # shrunk pixels: a bead of up to 20 px radius is less than half of what the median sees
_LEAST_AREA = 4  # px: of a bead of 1.5 px radius, seven pixels are bright
_EDGE = 1.0  # px: how far blur carries a bead's edge
_RIM = 0.2  # light of a bead's rim, of its middle: a sphere lit from the camera has less at its very edge only
_LEVEL_RATIO = 0.5 ** (1 / 2.2)  # half of the light, in coded brightness
_SAME_COLOUR = np.radians(12.0)
_MOST = 200  # patches that are looked at in one round, largest first
_ROUND_PATCH = 1.5
"""A patch of more than so many times the area of its largest inner circle is not one bead (a disc: 1)."""
_RAGGED = 0.7  # px by which the largest circle of whole pixels within a disc may fall short of it
RADIUS_SPREAD = 2.2
"""Of beads of one size in one picture, the nearest is not so many times as large as the median one: the camera
would be within the figure."""


_GRID = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), axis=-1).reshape(-1, 2) / 3.0
_WITHIN = _GRID[np.linalg.norm(_GRID, axis=1) <= 1.0]  # places spread over the unit disc


class Patches:
    """What is brighter than a level in a picture, and what of it has been explained so far.

    Attributes:
        smooth: The picture, slightly smoothed, uint8 (h, w, 3).
        linear: The picture in linear light, float32 (h, w, 3).
        value: Its brightest channel, uint8 (h, w).
        ground: The surroundings' colour, uint8, shrunk.
        owners: int32 (h, w): bead that explains a pixel, 0 for none.
        explained: uint8 (h, w): 0 where a bead has been found already, else 255.
        level: Brightness above which a pixel is bright.
        left: uint8 (h, w): not 0 where bright and not yet explained.
    """

    def __init__(self, rgb: NDArray[np.uint8]):
        self.linear = linear_light(rgb)
        self.smooth = cv2.GaussianBlur(rgb, (0, 0), _SMOOTH)
        self.value = brightest_channel(self.smooth)  # pyright: ignore[reportArgumentType]
        small = cv2.resize(rgb, self._shrunk(), interpolation=cv2.INTER_AREA)
        self.ground = cv2.medianBlur(small, _GROUND_WINDOW)
        self.owners = np.zeros(self.value.shape, np.int32)
        self.explained = np.full(self.value.shape, 255, np.uint8)
        self.left = np.zeros_like(self.value)
        self.level = 0.0

    def _shrunk(self) -> tuple[int, int]:
        """Width and height of the shrunk picture."""
        height, width = self.value.shape
        return max(1, width // _SHRINK), max(1, height // _SHRINK)

    def levels(self) -> Floats:
        """Brightnesses at which to look for patches, from high to low, 0..255.

        Each stands for half as much light as the one before: a bead that touches the figure in the picture, which
        is several times darker, is a patch of its own at one of them.
        """
        counts = np.bincount(self.value.ravel(), minlength=256)
        top = float(np.flatnonzero(counts)[-1])
        usual = float(np.searchsorted(np.cumsum(counts), counts.sum() / 2))
        levels = top * _LEVEL_RATIO ** np.arange(1, 16)
        return levels[levels > max(1.5 * usual, usual + 10.0)]

    def expose(self, level: float) -> None:
        """Look at what is brighter than a level."""
        self.level = level
        _, bright = cv2.threshold(self.value, int(level), 255, cv2.THRESH_BINARY)
        self.left = cv2.bitwise_and(bright, self.explained)

    def peaks(self) -> tuple[Floats, Floats, NDArray[np.int_]]:
        """Innermost pixel (n, 2), inner radius and area of each patch that is left, the largest first."""
        u, v, width, height = cv2.boundingRect(self.left)
        if not width:
            return np.zeros((0, 2)), np.zeros(0), np.zeros(0, int)
        left = cv2.copyMakeBorder(
            self.left[v : v + height, u : u + width], 1, 1, 1, 1, cv2.BORDER_CONSTANT
        )  # beyond the border is dark: a bead that leaves the picture has its edge there
        depth = cv2.distanceTransform(left, cv2.DIST_L2, 5)
        count, labels = cv2.connectedComponents(left, connectivity=8)
        at = np.flatnonzero(left)
        label, inner = labels.ravel()[at], depth.ravel()[at]
        order = np.lexsort((inner, label))
        innermost = order[np.searchsorted(label[order], np.arange(1, count), side="right") - 1]
        area = np.bincount(label, minlength=count)[1:]
        kept = np.argsort(-area, kind="stable")[:_MOST]
        kept = kept[area[kept] >= _LEAST_AREA]
        row, column = np.divmod(at[innermost[kept]], left.shape[1])
        uv = np.stack([column + u - 1, row + v - 1], axis=1).astype(np.float64)
        return uv, inner[innermost[kept]].astype(np.float64) - 0.5, area[kept]

    def seeds(self, first_owner: int, inner: tuple[float, float]) -> Seeds:
        """A seed in each patch that is left and whose inner radius lies between two, px."""
        uv, radius, _ = self.peaks()
        fits = (radius >= inner[0]) & (radius <= inner[1])
        uv, radius = uv[fits], radius[fits]
        owner = first_owner + np.arange(len(uv))
        return Seeds(uv, radius, self._colour_at(uv, radius), self.ground_at(uv), owner)

    def _colour_at(self, uv: Floats, radius: Floats) -> Floats:
        """Median colour within circles, in linear light (n, 3): a highlight covers less than half of one."""
        at = np.rint(uv[:, None] + np.maximum(radius - 0.5, 1.0)[:, None, None] * _WITHIN).astype(int)
        row = np.clip(at[..., 1], 0, self.value.shape[0] - 1)
        column = np.clip(at[..., 0], 0, self.value.shape[1] - 1)
        colour = np.sort(self.smooth[row, column], axis=1)[:, len(_WITHIN) // 2]
        return linear_light(colour).astype(np.float64)  # pyright: ignore[reportArgumentType]

    def ground_at(self, uv: Floats) -> Floats:
        """The surroundings' colour (n, 3) at positions (n, 2)."""
        height, width = self.ground.shape[:2]
        column = np.clip((uv[:, 0] + 0.5) * width / self.value.shape[1], 0, width - 1).astype(int)
        row = np.clip((uv[:, 1] + 0.5) * height / self.value.shape[0], 0, height - 1).astype(int)
        return linear_light(self.ground[row, column]).astype(np.float64)  # pyright: ignore[reportArgumentType]

    def explain(self, uv: Floats, radius: Floats, seeds: Seeds) -> None:
        """Give the pixels of these discs that have their bead's colour to it; what was owned before stays so."""
        dim = 255.0 * (_RIM * seeds.colour.max(axis=1, initial=0.0)) ** (1 / 2.2)
        for k, (part, disc) in enumerate(self._discs(uv, radius + _EDGE)):
            bright = self.value[part] > min(dim[k], self.level)
            own = disc & bright & _similar(self.linear[part], seeds.colour[k])
            self.owners[part][own & (self.owners[part] == 0)] = seeds.owner[k]
            rim = _grown(own, 1) | (_grown(own, 2) & ~(bright & ~own))
            self.explained[part][disc & rim] = 0
            self.left[part][disc & rim] = 0

    def forget(self, uv: Floats, radius: Floats, owner: NDArray[np.int_]) -> None:
        """Take these beads back: what they explained is open again."""
        for k, (part, disc) in enumerate(self._discs(uv, radius + _EDGE)):
            self.owners[part][self.owners[part] == owner[k]] = 0
            self.explained[part][disc & (self.owners[part] == 0)] = 255

    def pass_over(self, uv: Floats, radius: Floats) -> None:
        """Leave these discs out of what is looked at, at this level."""
        for part, disc in self._discs(uv, radius + _EDGE):
            self.left[part][disc] = 0

    def _discs(self, uv: Floats, radius: Floats) -> Iterator[tuple[tuple[slice, slice], NDArray[np.bool_]]]:
        """The part of the picture around each disc, and the disc in it."""
        for (u, v), r in zip(uv, radius):
            top, left = max(0, int(v - r)), max(0, int(u - r))
            part = np.s_[top : max(top, int(v + r) + 2), left : max(left, int(u + r) + 2)]
            rows, columns = np.indices(self.owners[part].shape, sparse=True)  # pyright: ignore[reportAssignmentType]
            yield part, (rows + top - v) ** 2 + (columns + left - u) ** 2 <= r**2


def _grown(mask: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """The mask and what is at most so many pixels away, diagonally too."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * by + 1, 2 * by + 1), np.uint8)) > 0


def _similar(colours: NDArray[np.float32], colour: Floats) -> NDArray[np.bool_]:
    """Whether linear colours (..., 3) differ from one in brightness only, nearly."""
    length = np.linalg.norm(colours, axis=-1) * np.linalg.norm(colour)
    return colours @ colour.astype(np.float32) > np.cos(_SAME_COLOUR) * length


def brightest_channel(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The largest of the three channels, (h, w): saturated colours count as bright, whatever their hue."""
    r, g, b = cv2.split(rgb)
    return cv2.max(cv2.max(r, g), b)  # pyright: ignore[reportReturnType]


def empty_seeds() -> Seeds:
    """No seed."""
    none = np.zeros((0, 3))
    return Seeds(none[:, :2], none[:, 0], none, none, np.zeros(0, int))


def guess_radius(inner: Floats, area: NDArray[np.int_], light: Floats) -> float | None:
    """Radius that bright round patches usually have, px; None if no patch is round.

    Args:
        inner: Radius of the largest circle within each patch, px.
        area: Of each patch, px^2.
        light: Linear light of the level at which it is a patch: beads are brighter than the figure's patches.
    """
    roundness = np.pi * (inner + _RAGGED) ** 2 / area
    round_ones = roundness > 1 / _ROUND_PATCH
    if not round_ones.any():  # partly hidden beads only: the half of a disc has 0.5
        round_ones = roundness > 0.5 / _ROUND_PATCH
    if not round_ones.any():
        return None
    radius = np.sqrt(area[round_ones] / np.pi)
    return weighted_median(radius, light[round_ones] * radius**2)  # by the light that they send


def weighted_median(values: Floats, weights: Floats) -> float:
    """The value at which half of the weight is reached."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, reached[-1] / 2)])
