"""What is known of the colour of every bead: mean, scatter, and how probable a measured colour is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaln

from jaxmocap._arrays import check_finite, check_shape
from jaxmocap._errors import InputError
from jaxmocap.tracking.colour_space import VIEW_SD, cone_from_hsb, hsb_from_cone

# The scatter that is expected of any bead (VIEW_SD) counts as much as this many photographs of it: with fewer, a
# covariance of three numbers is not determined (it needs four) and would be too small by chance.
PRIOR_VIEWS = 5

# Change of a bead's colour between two turns that no common change of the light explains: paint, lamps warming up.
# A third of what one turn shows between its photographs.
TURN_SD = VIEW_SD / 3.0


@dataclass(frozen=True)
class BeadColours:
    """Reference colours by bead."""

    names: tuple[str, ...]
    hsb: Float[np.ndarray, "markers 3"]
    """Mean hue (around the circle), saturation, brightness in 0..1."""
    sd: Float[np.ndarray, "markers 3"]
    """Standard deviation of one measured view of h, s, b."""
    covariance: Float[np.ndarray, "markers 3 3"]
    """Covariance of one measured view in the colour cone (see `cone_from_hsb`)."""
    n: Int[np.ndarray, "markers"]
    """Photographs it was learnt from; 0: taken from a table."""

    @classmethod
    def of(cls, table: Mapping[str, Sequence[float]]) -> "BeadColours":
        """Colours of a table of (h, s, b), with the scatter that is expected of any bead.

        Raises:
            InputError: if the table is empty or a colour is not three numbers in 0..1.
        """
        if not table:
            raise InputError("colours: expected at least one bead, got an empty table.")
        hsb = np.array([_checked_colour(name, colour) for name, colour in table.items()])
        sd = np.stack([sd_of_covariance(colour, np.diag(VIEW_SD**2)) for colour in hsb])
        return cls(tuple(table), hsb, sd, np.tile(np.diag(VIEW_SD**2), (len(hsb), 1, 1)), np.zeros(len(hsb), int))

    @property
    def cone(self) -> Float[np.ndarray, "markers 3"]:
        """The means as places in the colour cone."""
        return cone_from_hsb(self.hsb)

    def density_of(self, views: int) -> "ColourDensity":
        """How probable the mean colour of `views` photographs of one bead is, for every bead."""
        # A colour from a table is taken for the mean of as many views as the expected scatter stands for.
        seen = np.where(self.n > 0, self.n, PRIOR_VIEWS)[:, None, None]
        covariance = self.covariance * (1.0 / views + 1.0 / seen) + np.diag(TURN_SD**2)
        return ColourDensity(self.cone, covariance, PRIOR_VIEWS + self.n)


@dataclass(frozen=True)
class ColourDensity:
    """A Student density in the colour cone for every bead: what is left when a covariance was itself estimated."""

    mean: Float[np.ndarray, "markers 3"]
    covariance: Float[np.ndarray, "markers 3 3"]
    freedom: Int[np.ndarray, "markers"]

    def log_density(self, cone: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points markers"]:
        """Logarithm of the density at measured colours.

        Source: A. Gelman et al., Bayesian Data Analysis, 3rd ed., 3.6 (posterior predictive density).
        """
        nu = self.freedom.astype(float)
        offset = cone[:, None, :] - self.mean[None]
        precision = np.linalg.inv(self.covariance)
        d2 = np.einsum("pmi,mij,pmj->pm", offset, precision, offset)
        logdet = np.linalg.slogdet(self.covariance)[1]
        scale = gammaln((nu + 3) / 2) - gammaln(nu / 2) - 1.5 * np.log(nu * np.pi) - 0.5 * logdet
        return scale - (nu + 3) / 2 * np.log1p(d2 / nu)


def learn_colours(names: Sequence[str], samples: Sequence[Float[np.ndarray, "_ 3"]]) -> BeadColours:
    """Reference colours from the colours of each bead in the photographs of a calibration turn.

    Args:
        names: beads.
        samples: for each bead the measured h, s, b (views, 3) in 0..1; at least one view.

    Returns:
        Means (of the place in the cone, so around the circle in hue), standard deviations, covariances. The
        covariance is drawn towards the scatter expected of any bead, which counts as `PRIOR_VIEWS` photographs.

    Raises:
        InputError: if a bead has no view, or a number is no colour.
    Source: stop-motion document, 3.2; the covariance: Gelman et al., 3.6 (inverse Wishart prior).
    """
    if len(names) != len(samples):
        raise InputError(f"samples: expected one array for each of {len(names)} beads, got {len(samples)}.")
    hsb, sd, covariance, n = [], [], [], []
    for name, sample in zip(names, samples):
        views = check_shape(f"samples of {name}", sample, (None, 3))
        if not len(views):
            raise InputError(f"samples of {name}: no view. Leave the bead out or photograph it.")
        cone = cone_from_hsb(np.stack([_checked_colour(name, view) for view in views]))
        mean = cone.mean(axis=0)
        spread = (cone - mean).T @ (cone - mean)
        hsb.append(hsb_from_cone(mean))
        covariance.append((spread + PRIOR_VIEWS * np.diag(VIEW_SD**2)) / (len(views) - 1 + PRIOR_VIEWS))
        sd.append(sd_of_covariance(hsb[-1], covariance[-1]))
        n.append(len(views))
    return BeadColours(tuple(names), np.array(hsb), np.array(sd), np.array(covariance), np.array(n, int))


def sd_of_covariance(hsb: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Standard deviations of h, s, b where the covariance in the cone is known; that of hue at most an even spread.

    Source: first-order propagation through `cone_from_hsb`.
    """
    along, across = _directions(hsb[0])
    plane = covariance[:2, :2]
    s_sd, turn_sd = np.sqrt(along @ plane @ along), np.sqrt(across @ plane @ across)
    h_sd = turn_sd / (2.0 * np.pi * max(hsb[1], 1e-9))
    return np.array([min(h_sd, 1.0 / np.sqrt(12.0)), s_sd, np.sqrt(covariance[2, 2])])


def covariance_of_sd(hsb: Float[np.ndarray, "3"], sd: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Covariance in the cone of independent scatters of h, s, b; never under a tenth of what any bead shows.

    Source: first-order propagation through `cone_from_hsb`.
    """
    along, across = _directions(hsb[0])
    s_sd, turn_sd = max(sd[1], VIEW_SD[0] / 10), max(2.0 * np.pi * hsb[1] * sd[0], VIEW_SD[0] / 10)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = s_sd**2 * np.outer(along, along) + turn_sd**2 * np.outer(across, across)
    covariance[2, 2] = max(sd[2], VIEW_SD[2] / 10) ** 2
    return covariance


def _directions(hue: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions of growing saturation and of growing hue in the plane of the cone."""
    angle = 2.0 * np.pi * hue
    return np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])


def _checked_colour(name: str, colour: object) -> np.ndarray:
    hsb = check_shape(f"colour of {name}", colour, (3,))
    check_finite(f"colour of {name}", hsb, "Measure it again.")
    if hsb.min() < 0 or hsb.max() > 1:
        raise InputError(f"colour of {name}: expected h, s, b in 0..1, got {hsb.tolist()}.")
    return hsb
