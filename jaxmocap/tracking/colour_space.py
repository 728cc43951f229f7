"""Colours as places in a cone, where grey colours of any hue are neighbours; hue as an angle."""

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

# Scatter of the colour of one bead between photographs: (saturation plane, saturation plane, brightness). A matte
# bead lit from the lens keeps hue and saturation while its brightness follows the slope of what is seen of it, so
# brightness scatters several times as much. `scripts/identification_rates.py --scatter` measures it on rendered
# beads: 0.005 to 0.03 and 0.01 to 0.13.
VIEW_SD = np.array([0.03, 0.03, 0.10])


def cone_from_hsb(hsb: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Place of a colour in the cone: (s cos 2 pi h, s sin 2 pi h, b).

    The plane of the first two holds hue and saturation, which the strength of the light does not change; where the
    saturation is small, any two hues are near each other.

    Source: stop-motion document, 3.2 (the hue is periodic); the plane is ours.
    """
    hsb = np.asarray(hsb, float)
    angle = 2.0 * np.pi * hsb[..., 0]
    return np.stack([hsb[..., 1] * np.cos(angle), hsb[..., 1] * np.sin(angle), hsb[..., 2]], axis=-1)


def hsb_from_cone(cone: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Hue, saturation, brightness of a place in the cone, cut to 0..1; the hue of grey is zero.

    Source: inverse of `cone_from_hsb`.
    """
    cone = np.asarray(cone, float)
    hue = np.mod(np.arctan2(cone[..., 1], cone[..., 0]) / (2.0 * np.pi), 1.0)
    hue = np.where(hue >= 1.0, 0.0, hue)  # mod of a tiny negative number rounds up to 1
    saturation = np.minimum(np.hypot(cone[..., 0], cone[..., 1]), 1.0)
    return np.stack([hue, saturation, np.clip(cone[..., 2], 0.0, 1.0)], axis=-1)


def rgb_from_hsb(hsb: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Red, green, blue in 0..1 of hue, saturation, brightness.

    Source: A. R. Smith, Color gamut transform pairs, 1978 (HSV).
    """
    hsb = np.asarray(hsb, float)
    phase = np.mod(hsb[..., :1] + np.array([1.0, 2.0 / 3.0, 1.0 / 3.0]), 1.0) * 6.0
    pure = np.clip(np.abs(phase - 3.0) - 1.0, 0.0, 1.0)
    return hsb[..., 2:] * (1.0 - hsb[..., 1:2] * (1.0 - pure))


def hsb_from_rgb(rgb: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Hue, saturation, brightness in 0..1 of red, green, blue; hue and saturation of black are zero.

    Source: A. R. Smith, Color gamut transform pairs, 1978 (HSV).
    """
    rgb = np.asarray(rgb, float)
    top, spread = rgb.max(axis=-1), np.ptp(rgb, axis=-1)
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    safe = np.where(spread > 0, spread, 1.0)
    sixths = np.where(top == r, (g - b) / safe, np.where(top == g, 2.0 + (b - r) / safe, 4.0 + (r - g) / safe))
    hue = np.where(spread > 0, np.mod(sixths / 6.0, 1.0), 0.0)
    saturation = np.where(top > 0, spread / np.where(top > 0, top, 1.0), 0.0)
    return np.stack([np.where(hue >= 1.0, 0.0, hue), saturation, top], axis=-1)


def hue_difference(a: ArrayLike | float, b: ArrayLike | float) -> np.ndarray:
    """Distance between two hues around the circle, 0 to 0.5.

    Source: stop-motion document, 3.2: on a scale from 0 to 1, hue 0.999 is right next to hue 0.001.
    """
    plain = np.mod(np.abs(np.subtract(a, b)), 1.0)
    return np.asarray(np.minimum(plain, 1.0 - plain))
