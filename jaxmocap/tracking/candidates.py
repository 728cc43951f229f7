"""Bead candidates of several photographs as one padded table: what every step of the naming reads."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxmocap._arrays import check_finite, check_shape
from jaxmocap._errors import InputError
from jaxmocap.tracking.colour_space import cone_from_hsb

_SLOTS = 32  # slots are padded to a multiple of it, so that one compiled function serves most sets


@dataclass(frozen=True)
class CandidateTable:
    """Candidates of all photographs; a photograph with fewer than the most has empty slots at its end."""

    uv: Float[np.ndarray, "photos slots 2"]
    """Centres [px], zero in empty slots."""
    sigma: Float[np.ndarray, "photos slots"]
    """Standard deviation per coordinate [px], one in empty slots."""
    radius: Float[np.ndarray, "photos slots"]
    """Radius [px], zero in empty slots."""
    hsb: Float[np.ndarray, "photos slots 3"]
    """Hue, saturation, brightness in 0..1."""
    cone: Float[np.ndarray, "photos slots 3"]
    """The same colours as places in the colour cone (see `cone_from_hsb`)."""
    filled: Bool[np.ndarray, "photos slots"]
    """True where a candidate is."""

    @property
    def counts(self) -> np.ndarray:
        """Candidates of each photograph."""
        return self.filled.sum(axis=1)

    @property
    def area(self) -> float:
        """Area of the box that holds all candidates [px^2], at least one pixel by one."""
        found = self.uv[self.filled]
        return float(np.prod(np.maximum(np.ptp(found, axis=0), 1.0))) if len(found) else 1.0


def stack_candidates(photos: Sequence[Any]) -> CandidateTable:
    """One table of the candidates that were found in each photograph.

    Args:
        photos: for each photograph an object with `uv` (n, 2), `sigma` (n,), `radius` (n,) [px] and `hsb` (n, 3)
            in 0..1, such as `jaxmocap.vision.beads.BeadCandidates`; n may be zero.

    Returns:
        The table; slot i of photograph k is candidate i of photos[k].

    Raises:
        InputError: if there is no photograph, a shape is wrong, a number is not finite, a colour is outside 0..1
            or a sigma or radius is not positive.
    """
    if not len(photos):
        raise InputError("photos: expected the candidates of at least one photograph, got none.")
    checked = [_checked(k, photo) for k, photo in enumerate(photos)]
    most = max(len(uv) for uv, *_ in checked)
    slots = max(-(-most // _SLOTS), 1) * _SLOTS
    uv, hsb = np.zeros((len(photos), slots, 2)), np.zeros((len(photos), slots, 3))
    sigma, radius = np.ones((len(photos), slots)), np.zeros((len(photos), slots))
    filled = np.zeros((len(photos), slots), bool)
    for k, (uv_k, sigma_k, radius_k, hsb_k) in enumerate(checked):
        n = len(uv_k)
        uv[k, :n], sigma[k, :n], radius[k, :n], hsb[k, :n], filled[k, :n] = uv_k, sigma_k, radius_k, hsb_k, True
    return CandidateTable(uv, sigma, radius, hsb, cone_from_hsb(hsb), filled)


def _checked(k: int, photo: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    where = f"candidates of photograph {k}"
    uv = check_shape(f"{where}, uv", photo.uv, (None, 2))
    sigma = check_shape(f"{where}, sigma", photo.sigma, (len(uv),))
    radius = check_shape(f"{where}, radius", photo.radius, (len(uv),))
    hsb = check_shape(f"{where}, hsb", photo.hsb, (len(uv), 3))
    for name, array in (("uv", uv), ("sigma", sigma), ("radius", radius), ("hsb", hsb)):
        check_finite(f"{where}, {name}", array, "Leave such candidates out.")
    if len(uv) and (hsb.min() < 0 or hsb.max() > 1):
        raise InputError(f"{where}, hsb: expected numbers in 0..1, got {hsb.min():.4g} to {hsb.max():.4g}.")
    for name, array in (("sigma", sigma), ("radius", radius)):
        if len(uv) and array.min() <= 0:
            raise InputError(f"{where}, {name}: expected positive pixels, got {array.min():.4g}.")
    return uv, sigma, radius, hsb
