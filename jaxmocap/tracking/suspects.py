"""Names that cannot be right, told by where the beads are: for names of any origin, also an operator's."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap._errors import InputError
from jaxmocap.cameras.camera import Camera
from jaxmocap.tracking.candidates import stack_candidates
from jaxmocap.tracking.tracks import point_of
from jaxmocap.tracking.views import look


@dataclass(frozen=True)
class Suspects:
    """Which names contradict the others of the same marker."""

    wrong: Bool[np.ndarray, "photos markers"]
    """True where the candidate misses the point that most others of its marker meet in."""
    undecided: Bool[np.ndarray, "markers"]
    """True where the candidates contradict each other and no majority says which are wrong."""
    distance: Float[np.ndarray, "photos markers"]
    """Distance from the place of that point [px]; zero where there is no candidate or no majority."""
    problems: tuple[str, ...]
    """One sentence for each marker concerned."""


def suspect_names(
    photos: Sequence[Any],
    cameras: Camera,
    index: Int[np.ndarray, "photos markers"],
    names: Sequence[str],
    photo_names: Sequence[str],
    gate: float,
) -> Suspects:
    """Check by reprojection which candidates do not bear their name rightly.

    For each marker the point of every pair of its candidates is tried; the one that most candidates meet within the
    gate stands, and the others are suspect. Two candidates that miss each other, or two halves of equal number,
    decide nothing.

    Args:
        photos: candidates, see `candidates.stack_candidates`.
        cameras: stacked over the photographs.
        index: candidate of each marker in each photograph, -1 where none.
        names: markers, for the sentences.
        photo_names: photographs, for the sentences.
        gate: largest distance of a right candidate [px].

    Returns:
        Suspects.

    Raises:
        InputError: if a shape is wrong or an index points to no candidate.
    Source: stop-motion document, eq. 5.9-5.13 (the point); consensus: Fischler and Bolles 1981, all pairs.
    """
    table = stack_candidates(photos)
    views = look(cameras, table)
    index = np.asarray(index)
    if index.shape != (len(photos), len(names)) or len(photo_names) != len(photos):
        raise InputError(
            f"index: expected shape ({len(photos)}, {len(names)}) and as many photo_names, got {index.shape} and "
            f"{len(photo_names)}."
        )
    if (index >= table.counts[:, None]).any() or (index < -1).any():
        k, m = np.argwhere((index >= table.counts[:, None]) | (index < -1))[0]
        raise InputError(f"index: {names[m]} in {photo_names[k]} is candidate {index[k, m]} of {table.counts[k]}.")
    wrong, distance = np.zeros(index.shape, bool), np.zeros(index.shape)
    undecided, problems = np.zeros(len(names), bool), []
    for m, name in enumerate(names):
        k = np.flatnonzero(index[:, m] >= 0)
        if len(k) < 2:
            continue
        pairs = list(combinations(k, 2))
        rows = np.full((len(pairs), len(photos)), -1)
        for row, pair in zip(rows, pairs):
            row[list(pair)] = index[list(pair), m]
        r = views.distances(point_of(views, rows))[:, k, index[k, m]]
        inside = r < gate
        best = int(np.lexsort((np.where(inside, r, 0).sum(axis=1), -inside.sum(axis=1)))[0])
        if inside[best].all():
            distance[k, m] = r[best]
        elif inside[best].sum() * 2 <= len(k) or len(k) < 3:
            undecided[m] = True
            problems.append(
                f"{name}: its candidates in {', '.join(photo_names[i] for i in k)} do not meet in one point, and no "  # pyright: ignore[reportArgumentType, reportCallIssue]
                "majority says which is wrong. Check the names in these photographs and their angles."
            )
        else:
            wrong[k, m], distance[k, m] = ~inside[best], np.minimum(r[best], 1e6)
            far = ", ".join(f"{photo_names[i]} ({distance[i, m]:.0f} px off)" for i in k[~inside[best]])
            problems.append(f"{name} is probably another bead in {far}. Name it anew or remove it there.")
    return Suspects(wrong, undecided, distance, tuple(problems))
