"""From a colour photo to the outlines of what is bright in it, as the stop-motion document does it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from jaxmocap._errors import InputError

_LEVELS = np.arange(256, dtype=np.float64)
_CODED = _LEVELS / 255.0
_LINEAR = np.where(_CODED <= 0.04045, _CODED / 12.92, ((_CODED + 0.055) / 1.055) ** 2.4).astype(np.float32)


def check_rgb(rgb: NDArray) -> NDArray[np.uint8]:
    """The same picture, if it is one: uint8 (h, w, 3).

    Raises:
        InputError: Another type or shape.
    """
    rgb = np.asarray(rgb)
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or 0 in rgb.shape:
        raise InputError(
            f"rgb: expected a colour picture, uint8 (height, width, 3), got {rgb.dtype} {rgb.shape}. Beads are told "
            "apart by colour; read photos with jaxmocap.vision.read_colour_photo."
        )
    return rgb


def grey_of(rgb: NDArray) -> NDArray[np.uint8]:
    """8-bit grey of a 24-bit colour picture (weights of ITU-R BT.601). Source: document 000, section 3.3.1.

    Args:
        rgb: uint8 (h, w, 3).

    Returns:
        uint8 (h, w).

    Raises:
        InputError: Not a colour picture.
    """
    return cv2.cvtColor(check_rgb(rgb), cv2.COLOR_RGB2GRAY)  # pyright: ignore[reportReturnType]


def mean_threshold(grey: NDArray) -> int:
    """Iterative mean threshold of a grey picture. Source: document 000, section 3.3.1.

    A test threshold rises from 0 until it exceeds the average of the mean of the pixels at or below it and the mean
    of those above.

    Args:
        grey: uint8, any shape, at least one pixel.

    Returns:
        The first threshold that exceeds that average; white is what lies above it. For a picture of one brightness,
        which has nothing above, that brightness (nothing is white).

    Raises:
        InputError: Not uint8, or empty.
    """
    grey = np.asarray(grey)
    if grey.dtype != np.uint8 or grey.size == 0:
        raise InputError(f"grey: expected uint8 pixels, got {grey.dtype} {grey.shape}.")
    counts = np.bincount(grey.ravel(), minlength=256)
    below, sum_below = np.cumsum(counts), np.cumsum(counts * _LEVELS)
    above, sum_above = grey.size - below, sum_below[-1] - sum_below
    both = (below > 0) & (above > 0)
    composite = np.full(256, np.inf)
    composite[both] = (sum_below[both] / below[both] + sum_above[both] / above[both]) / 2
    exceeds = composite < _LEVELS
    return int(np.argmax(exceeds)) if exceeds.any() else int(grey.max())


def outline(white: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Edge map: black stays black, white turns black if all eight neighbours are white.

    Source: document 000, section 3.3.1, figure 10. What lies beyond the border counts as black.

    Args:
        white: bool (h, w).

    Returns:
        bool (h, w).
    """
    mask = np.asarray(white, dtype=np.uint8)
    inner = cv2.erode(mask, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return (mask - inner).astype(bool)


def edge_map(rgb: NDArray) -> NDArray[np.bool_]:
    """Grey, threshold, outline: the three steps of section 3.3.1 of document 000.

    Args:
        rgb: uint8 (h, w, 3).

    Returns:
        bool (h, w), true on outlines.

    Raises:
        InputError: Not a colour picture.
    """
    grey = grey_of(rgb)
    return outline(grey > mean_threshold(grey))


def linear_light(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Amount of light, 0..1, that 8-bit sRGB values stand for. Source: IEC 61966-2-1.

    Mixtures within a pixel, shading and blur add up in it, not in the coded values.

    Args:
        rgb: uint8, any shape.

    Returns:
        float32 of the same shape.
    """
    return _LINEAR[rgb]
