"""A common change of the light between two turns: one gain each for red, green and blue."""

from itertools import product

import numpy as np
from jaxtyping import Float, Int

from jaxmocap.tracking.bead_colours import BeadColours
from jaxmocap.tracking.colour_space import hsb_from_cone, hsb_from_rgb, rgb_from_hsb

# A channel of a colour is measured to 0.05 (VIEW_SD). Lamps, exposure and white balance change a channel by some
# 30 %: daylight taken for tungsten light, the largest error of a white balance, changes red over blue by a factor
# of three in linear light, thus 3^(1/2.2) = 1.65 in the values of a photograph, half on either side.
_CHANNEL_SD, _LOG_SD = 0.05, 0.25

STARTS = tuple(np.array([red, 1.0, blue]) for red, blue in product((0.7, 0.85, 1.0, 1.18, 1.4), repeat=2))
"""Lights to begin from: steps of 18 %, which the first, blurred look at the colours bridges."""


def under_light(colours: BeadColours, gains: Float[np.ndarray, "3"]) -> BeadColours:
    """References as they look when red, green and blue are stronger by common factors; scatter unchanged.

    Source: J. von Kries 1902.
    """
    hsb = hsb_from_rgb(np.clip(rgb_from_hsb(colours.hsb) * gains, 0.0, 1.0))
    return BeadColours(colours.names, hsb, colours.sd, colours.covariance, colours.n)


def light_cost(gains: Float[np.ndarray, "3"]) -> float:
    """Minus the logarithm of how probable a light is against an unchanged one.

    Source: normal distribution of the logarithms of the gains.
    """
    return float(0.5 * (np.log(gains) ** 2).sum() / _LOG_SD**2)


def common_gains(
    cone: Float[np.ndarray, "things 3"], colours: BeadColours, thing: Int[np.ndarray, "markers"]
) -> Float[np.ndarray, "3"]:
    """Gains between references and what was named, drawn towards 1; what is far off counts less.

    Source: J. von Kries 1902; weights: Huber 1981.
    """
    m = np.flatnonzero(thing >= 0)
    seen, reference = rgb_from_hsb(hsb_from_cone(cone[thing[m]])), rgb_from_hsb(colours.hsb[m])
    weight, gains, prior = np.ones(len(m)), np.ones(3), (_CHANNEL_SD / _LOG_SD) ** 2
    for _ in range(5):
        w = weight[:, None]
        gains = ((w * seen * reference).sum(axis=0) + prior) / ((w * reference**2).sum(axis=0) + prior)
        off = np.linalg.norm(seen - gains * reference, axis=1)
        weight = 1.0 / np.maximum(off / _CHANNEL_SD, 1.0)
    return gains
