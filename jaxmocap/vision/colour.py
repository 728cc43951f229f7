"""Colours as the stop-motion document measures them: hue, saturation and brightness from 0 to 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxmocap._errors import InputError
from jaxmocap.vision.threshold import check_rgb

SQUARE = 5
"""Side in pixels of the square over which a bead's colour is averaged (document 000, section 3.2)."""


def hsb_of_rgb(rgb: ArrayLike) -> NDArray[np.float64]:
    """Hue, saturation, brightness of colours.

    Source: the hexcone model of A. R. Smith, 1978, which document 000 (section 3.2) uses through its programs.

    Args:
        rgb: (..., 3), 0..255.

    Returns:
        (..., 3), 0..1 each. Hue is periodic (1 is 0 again); of greys it is 0, and saturation of black is 0.
    """
    r, g, b = np.moveaxis(np.asarray(rgb, dtype=np.float64) / 255.0, -1, 0)
    top, low = np.maximum(np.maximum(r, g), b), np.minimum(np.minimum(r, g), b)
    span = top - low
    safe = np.where(span > 0, span, 1.0)
    sextant = np.where(top == r, (g - b) / safe, np.where(top == g, 2 + (b - r) / safe, 4 + (r - g) / safe))
    hue = np.where(span > 0, (sextant / 6.0) % 1.0, 0.0)
    return np.stack([hue, np.where(top > 0, span / np.where(top > 0, top, 1.0), 0.0), top], axis=-1)


def square_hsb(rgb: NDArray, uv: ArrayLike) -> NDArray[np.float64]:
    """Colour of the 5x5 pixels around positions. Source: document 000, sections 3.2 and 3.3.3.

    Channels are averaged before the conversion, so that hue needs no circular mean. Pixels beyond the border are left
    out of the mean.

    Args:
        rgb: uint8 (h, w, 3).
        uv: Positions (n, 2), pixels, u right, v down; a position outside counts as the nearest pixel.

    Returns:
        Hue, saturation, brightness (n, 3), 0..1.

    Raises:
        InputError: Not a colour picture, or positions that are not finite.
    """
    rgb, uv = check_rgb(rgb), np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(uv).all():
        raise InputError("uv: positions that are not finite have no colour. Leave them out.")
    height, width = rgb.shape[:2]
    column = np.clip(np.rint(uv[:, 0]), 0, width - 1).astype(int)
    row = np.clip(np.rint(uv[:, 1]), 0, height - 1).astype(int)
    reach = np.arange(SQUARE) - SQUARE // 2
    rows, columns = row[:, None, None] + reach[:, None], column[:, None, None] + reach[None, :]
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    pixels = rgb[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.float64)
    mean = (pixels * inside[..., None]).sum((1, 2)) / inside.sum((1, 2))[:, None]
    return hsb_of_rgb(mean)
