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
    hsb_square: Float[np.ndarray, "photos slots 3"]
    """The same as the document measures it, over 5x5 pixels whatever they show; `hsb` where it was not measured."""
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
    uv = np.zeros((len(photos), slots, 2))
    hsb, square = np.zeros((2, len(photos), slots, 3))
    sigma, radius = np.ones((len(photos), slots)), np.zeros((len(photos), slots))
    filled = np.zeros((len(photos), slots), bool)
    for k, (uv_k, sigma_k, radius_k, hsb_k, square_k) in enumerate(checked):
        n = len(uv_k)
        uv[k, :n], sigma[k, :n], radius[k, :n], filled[k, :n] = uv_k, sigma_k, radius_k, True
        hsb[k, :n], square[k, :n] = hsb_k, square_k
    return CandidateTable(uv, sigma, radius, hsb, square, cone_from_hsb(hsb), filled)


def _checked(k: int, photo: Any) -> tuple[np.ndarray, ...]:
    where = f"candidates of photograph {k}"
    uv = check_shape(f"{where}, uv", photo.uv, (None, 2))
    values = {"uv": uv}
    for name, shape in (("sigma", (len(uv),)), ("radius", (len(uv),)), ("hsb", (len(uv), 3))):
        values[name] = check_shape(f"{where}, {name}", getattr(photo, name), shape)
    square = getattr(photo, "hsb_square", photo.hsb)
    values["hsb_square"] = check_shape(f"{where}, hsb_square", square, (len(uv), 3))
    for name, array in values.items():
        check_finite(f"{where}, {name}", array, "Leave such candidates out.")
        if not len(uv):
            continue
        if name.startswith("hsb") and (array.min() < 0 or array.max() > 1):
            raise InputError(f"{where}, {name}: expected numbers in 0..1, got {array.min():.4g} to {array.max():.4g}.")
        if name in ("sigma", "radius") and array.min() <= 0:
            raise InputError(f"{where}, {name}: expected positive pixels, got {array.min():.4g}.")
    return tuple(values.values())
