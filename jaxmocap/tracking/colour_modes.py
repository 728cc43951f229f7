"""Naming beads of one photograph by colour alone: as the document prints it, and repaired."""

import numpy as np
from jaxtyping import Float, Int

from jaxmocap._errors import InputError
from jaxmocap.tracking.bead_colours import BeadColours
from jaxmocap.tracking.colour_space import hue_difference

MAX_DISTANCE = 0.2
"""Default of the document's largest colour distance, which it does not print: about three standard deviations of
one view (`colour_space.VIEW_SD`, hue divided by 2 pi s). `scripts/identification_rates.py --sweep` shows others."""


def colour_distances(
    hsb: Float[np.ndarray, "candidates 3"], colours: BeadColours, circular: bool
) -> Float[np.ndarray, "candidates markers"]:
    """Distance of every candidate's colour from every reference.

    Args:
        hsb: colours of the candidates, 0..1.
        colours: references.
        circular: hue around the circle; the document's own difference is plain.

    Returns:
        sqrt(dh^2 + ds^2 + db^2).
    Source: stop-motion document, eq. 3.7; circular hue: 3.2.
    """
    h, ref = hsb[:, None, 0], colours.hsb[None, :, 0]
    dh = hue_difference(h, ref) if circular else h - ref
    rest = hsb[:, None, 1:] - colours.hsb[None, :, 1:]
    return np.sqrt(dh**2 + (rest**2).sum(axis=-1))


def name_by_colour(
    hsb: Float[np.ndarray, "candidates 3"],
    colours: BeadColours,
    mode: str,
    max_distance: float = MAX_DISTANCE,
) -> Int[np.ndarray, "markers"]:
    """Candidate of each bead in one photograph, by colour alone.

    All distances are sorted from small to large; each in turn gives its marker its candidate if it is below
    `max_distance` and the marker is still free. "literal" is exactly that: the hue difference is plain and one
    candidate may get several names. "repaired" takes the hue around the circle and a candidate only once.

    Args:
        hsb: colours of the candidates, 0..1.
        colours: references.
        mode: "literal" or "repaired".
        max_distance: largest distance of eq. 3.7.

    Returns:
        Index of the candidate of every marker, -1 where none.

    Raises:
        InputError: for another mode, or a distance that is not positive.
    Source: stop-motion document, 3.3.3 and eq. 3.7.
    """
    if mode not in ("literal", "repaired"):
        raise InputError(f"mode: expected 'literal' or 'repaired', got {mode!r}.")
    if not max_distance > 0:
        raise InputError(f"max_distance: expected a positive number, got {max_distance}.")
    distances = colour_distances(hsb, colours, circular=mode == "repaired")
    index = np.full(len(colours.names), -1)
    taken = np.zeros(len(hsb), bool)
    for flat in np.argsort(distances, axis=None, kind="stable"):
        candidate, marker = np.unravel_index(flat, distances.shape)
        if distances[candidate, marker] >= max_distance:
            break
        if index[marker] < 0 and not (mode == "repaired" and taken[candidate]):
            index[marker], taken[candidate] = candidate, True
    return index
