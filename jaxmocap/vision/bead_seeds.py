"""Bright patches of a photo, and one place inside each from which a bead's edge can be looked for."""

from __future__ import annotations

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
_MOST = 200  # patches that are looked at in one round, largest first
_ROUND_PATCH = 2.5
"""A patch of more than so many times the area of its largest inner circle is not one bead (a disc: 1)."""
RADIUS_SPREAD = 2.0
"""Of beads of one size in one picture, the nearest is not so many times as large as the median one: the camera
would be within the figure."""


class Patches:
    """What is bright in a picture, and what of it has been explained so far.

    Attributes:
        smooth: The picture, slightly smoothed, uint8 (h, w, 3).
        ground: The surroundings' colour, uint8, shrunk.
        left: bool (h, w): bright pixels not explained yet.
        owners: int32 (h, w): bead that explains a pixel, 0 for none.
    """

    def __init__(self, rgb: NDArray[np.uint8]):
        self.smooth = cv2.GaussianBlur(rgb, (0, 0), _SMOOTH)
        value = brightest_channel(self.smooth)
        self.left = (value > class_mean_threshold(value)).astype(np.uint8)
        small = cv2.resize(rgb, None, fx=1 / _SHRINK, fy=1 / _SHRINK, interpolation=cv2.INTER_AREA)
        self.ground = cv2.medianBlur(small, _GROUND_WINDOW)
        self.owners = np.zeros(value.shape, np.int32)

    def seeds(self, first_owner: int) -> tuple[Seeds, NDArray[np.int_]]:
        """A seed in each patch that is left, at its innermost pixel, and the patches' areas; largest patches first.

        Args:
            first_owner: Number of the first of these beads.
        """
        u, v, width, height = cv2.boundingRect(self.left)
        if not width:
            return empty_seeds(), np.zeros(0, int)
        part = np.s_[v : v + height, u : u + width]
        left = cv2.copyMakeBorder(self.left[part], 1, 1, 1, 1, cv2.BORDER_CONSTANT)
        inner = cv2.distanceTransform(left, cv2.DIST_L2, 5)[1:-1, 1:-1]
        _, labels, stats, _ = cv2.connectedComponentsWithStats(self.left[part], connectivity=8)
        area = stats[:, cv2.CC_STAT_AREA]
        order = [k for k in 1 + np.argsort(-area[1:], kind="stable")[:_MOST] if area[k] >= _LEAST_AREA]
        if not order:
            return empty_seeds(), np.zeros(0, int)
        rows = [_seed(k, labels, stats[k], inner, self.smooth[part]) for k in order]
        uv, colour, radius = (np.array(column, dtype=np.float64) for column in zip(*rows))
        uv += (u, v)
        return Seeds(
            uv,
            radius,
            linear_light(np.rint(colour).astype(np.uint8)).astype(np.float64),
            self.ground_at(uv),
            first_owner + np.arange(len(rows)),
        ), area[order]

    def ground_at(self, uv: Floats) -> Floats:
        """The surroundings' colour (n, 3) at positions (n, 2)."""
        height, width = self.ground.shape[:2]
        column = np.clip(uv[:, 0] / _SHRINK, 0, width - 1).astype(int)
        row = np.clip(uv[:, 1] / _SHRINK, 0, height - 1).astype(int)
        return linear_light(self.ground[row, column]).astype(np.float64)

    def explain(self, uv: Floats, radius: Floats, owner: NDArray[np.int_]) -> None:
        """Give the pixels of these discs to their owners; what was owned before stays so."""
        margin = 1.0  # px: the blurred edge
        for (u, v), r, who in zip(uv, radius + margin, owner):
            top, left = max(0, int(v - r)), max(0, int(u - r))
            part = np.s_[top : max(top, int(v + r) + 2), left : max(left, int(u + r) + 2)]
            rows, columns = np.indices(self.owners[part].shape)
            disc = (rows + top - v) ** 2 + (columns + left - u) ** 2 <= r**2
            own = disc & (self.left[part] > 0) & (self.owners[part] == 0)
            self.owners[part][own] = who
            self.left[part][disc] = 0


def _seed(
    label: int, labels: NDArray[np.int32], stats: NDArray[np.int32], inner: NDArray[np.float32], rgb: NDArray[np.uint8]
) -> tuple[tuple[int, int], Floats, float]:
    """Innermost pixel of one patch, colour around it, and inner radius."""
    u, v, width, height = stats[:4]
    part = np.s_[v : v + height, u : u + width]
    own = labels[part] == label
    row, column = np.unravel_index(int(np.where(own, inner[part], 0).argmax()), own.shape)
    radius = float(inner[part][row, column]) - 0.5
    rows, columns = np.nonzero(own)
    near = (rows - row) ** 2 + (columns - column) ** 2 <= max(radius - 0.5, 1.0) ** 2
    colour = np.median(rgb[part][rows[near], columns[near]], axis=0)
    return (u + column, v + row), colour, radius


def brightest_channel(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The largest of the three channels, (h, w): saturated colours count as bright, whatever their hue."""
    r, g, b = cv2.split(rgb)
    return cv2.max(cv2.max(r, g), b)


def empty_seeds() -> Seeds:
    """No seed."""
    none = np.zeros((0, 3))
    return Seeds(none[:, :2], none[:, 0], none, none, np.zeros(0, int))


def class_mean_threshold(grey: NDArray[np.uint8]) -> float:
    """The threshold half way between the mean of what is below and that of what is above it, seen from the middle.

    Several thresholds satisfy this; `mean_threshold` finds the lowest, which may lie among the brightnesses of the
    figure when beads are few. Started at the middle of the range, the iteration ends at one that sets off what is
    brightest.

    Args:
        grey: uint8.

    Returns:
        The threshold, 0..255; white is what lies above it.
    """
    counts = np.bincount(grey.ravel(), minlength=256).astype(np.float64)
    levels = np.arange(256.0)
    present = np.flatnonzero(counts)
    threshold = (present[0] + present[-1]) / 2
    for _ in range(256):
        above = levels > threshold
        if not counts[above].any() or not counts[~above].any():
            break
        means = [np.average(levels[part], weights=counts[part]) for part in (above, ~above)]
        if abs(threshold - sum(means) / 2) < 0.01:
            break
        threshold = sum(means) / 2
    return threshold


def guess_radius(inner: Floats, area: NDArray[np.int_]) -> float | None:
    """Radius that most of the round patches have, by their area, px; None without patches."""
    disc = np.pi * np.maximum(inner, 0.5) ** 2
    roundish = (area < _ROUND_PATCH * disc) & (inner >= 1.0)
    if not roundish.any():
        roundish = inner > 0
    return weighted_median(inner[roundish], disc[roundish]) if roundish.any() else None


def weighted_median(values: Floats, weights: Floats) -> float:
    """The value at which half of the weight is reached."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, reached[-1] / 2)])
