"""Which candidate is which bead: three modes side by side, the best one using all photographs at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from jaxmocap._errors import InputError
from jaxmocap.cameras.camera import Camera
from jaxmocap.tracking.bead_colours import BeadColours
from jaxmocap.tracking.candidates import CandidateTable, stack_candidates
from jaxmocap.tracking.colour_modes import MAX_DISTANCE, name_by_colour
from jaxmocap.tracking.naming import MIN_MARGIN, MIN_MARGIN_ALONE, Names, look_alike, name_things
from jaxmocap.tracking.rounds import GATE, Refine, tighten
from jaxmocap.tracking.tracks import Tracks, point_of, trimmed, without_doubles
from jaxmocap.tracking.views import PhotoViews, look

Mode = Literal["best", "repaired", "literal"]
"""The three ways of naming."""

# Squared Mahalanobis distances of a place from its point are exponential with mean 2: beyond the gate, three
# standard deviations, lies 1 %.
_GATE_SIGMAS = 3.0


@dataclass(frozen=True)
class Identification:
    """Names of candidates; arrays are in the order of the photographs and of `names`."""

    names: tuple[str, ...]
    index: Int[np.ndarray, "photos markers"]
    """Candidate of each marker in each photograph, -1 where it has none or none is sure."""
    p_world: Float[np.ndarray, "markers 3"]
    """Points nearest to the rays of the candidates [scene]; zero where not `located`."""
    located: Bool[np.ndarray, "markers"]
    """True for markers named in two photographs or more."""
    distance: Float[np.ndarray, "photos markers"]
    """Distance of the candidate from the place of its point [px]; zero where there is none."""
    margin: Float[np.ndarray, "markers"]
    """Logarithm of the odds of the name; zero where there is no candidate, and in the other modes."""
    foreign: tuple[Int[np.ndarray, "_"], ...]
    """For each photograph the candidates that bear no name."""
    cameras: Camera | None
    """As improved on the way; the given ones without `refine`."""
    gate: float
    """Gate of the last round [px]."""
    gains: Float[np.ndarray, "3"]
    """Common change of red, green, blue between the references and these photographs."""
    problems: tuple[str, ...]
    """What is unsure or wrong and what to do, in sentences."""


def identify_beads(
    photos: Sequence[Any],
    cameras: Camera | None,
    colours: BeadColours,
    *,
    mode: Mode | str = "best",
    gate: float = GATE,
    refine: Refine | None = None,
    light: str = "adapt",
    max_distance: float = MAX_DISTANCE,
) -> Identification:
    """Names of the bead candidates of a set of photographs of one pose.

    "best": candidates of different photographs that are alike in colour and meet in one point become tracks
    (`tracks`), the cameras are improved from them and the gate tightened (`rounds`), the tracks get names by
    optimal assignment with the covariance of every colour (`naming`), and each photograph is assigned once more to
    the named points. A name that is not sure is not given; a candidate that meets no other is not named. With one
    photograph there is only colour. "repaired" and "literal" look at each photograph alone (`colour_modes`).

    Args:
        photos: candidates of every photograph, see `candidates.stack_candidates`.
        cameras: stacked over the photographs. "best" needs them for two photographs or more; for the other modes
            they serve `p_world` and `distance` and may be missing.
        colours: references.
        mode: which of the three.
        gate: first gate of "best" [px]: how far a candidate may be from the place of its point through `cameras`.
        refine: improves the cameras of "best" between its rounds, see `rounds.Refine`; None takes them as they are.
        light: "adapt" estimates a common change of the light in "best"; "fixed" takes the references as they are.
        max_distance: largest colour distance of "literal" and "repaired".

    Returns:
        The names and how they fit.

    Raises:
        InputError: if an argument is wrong (see those functions).
    Source: stop-motion document, 3.3.3 (literal); the others are ours.
    """
    table = stack_candidates(photos)
    if mode not in ("best", "repaired", "literal"):
        raise InputError(f"mode: expected 'best', 'repaired' or 'literal', got {mode!r}.")
    if mode != "best":
        index = [
            name_by_colour(table.hsb_square[k, :n], colours, mode, max_distance) for k, n in enumerate(table.counts)
        ]
        return _plain_result(table, cameras, colours, np.stack(index), gate)
    if len(photos) == 1:
        return _one_photo(table, cameras, colours, gate, light)
    if cameras is None:
        raise InputError("cameras: mode 'best' needs the camera of every photograph, got None.")
    rounds = tighten(table, cameras, gate, refine)
    tracks = without_doubles(rounds.tracks, table, rounds.views)
    names = name_things(tracks.cone, tracks.views, len(photos), tracks.support, colours, light)
    index = _guided(table, rounds.views, names, tracks, rounds.gate)
    problems = _problems(names, tracks, index)
    return _result(
        table, rounds.views, names.colours, index, rounds.cameras, rounds.gate, names.margin, names.gains, problems
    )


def _one_photo(
    table: CandidateTable, cameras: Camera | None, colours: BeadColours, gate: float, light: str
) -> Identification:
    """Colour alone, and only what is sure."""
    n = int(table.counts[0])
    names = name_things(table.cone[0, :n], np.ones(n, int), 1, np.zeros(n), colours, light, MIN_MARGIN_ALONE)
    problems = ("One photograph: names rest on colour alone. Add photographs at other angles to confirm them.",)
    views = None if cameras is None else look(cameras, table)
    index = names.index[None]
    return _result(table, views, names.colours, index, cameras, gate, names.margin, names.gains, problems)


def _guided(
    table: CandidateTable, views: PhotoViews, names: Names, tracks: Tracks, gate: float
) -> Int[np.ndarray, "photos markers"]:
    """Each photograph once more: the named points look for their candidates, also for those of odd colour.

    A candidate of the named track stays unless another fits better. One that no track has is taken if it is a
    thousand times more probably this bead than anything else; one of another track, named or not, is not taken.
    """
    index = np.full((len(table.uv), len(names.index)), -1)
    named = np.flatnonzero(names.index >= 0)
    if not len(named):
        return index
    own = tracks.index[names.index[named]]
    elsewhere = _taken(tracks, table.filled.shape[1])
    sigma = gate / _GATE_SIGMAS
    foreign = np.log(table.counts.mean() / table.area) - np.log(np.pi)
    for _ in range(2):
        r = views.distances(point_of(views, own))
        for k in range(len(table.uv)):
            place = -0.5 * (r[:, k] / sigma) ** 2 - np.log(2.0 * np.pi * sigma**2)
            colour = names.colours.density_of(1).log_density(table.cone[k])[:, named].T
            mine = own[:, k, None] == np.arange(r.shape[2])
            gain = place + colour - foreign - np.where(mine, 0.0, MIN_MARGIN)
            allowed = (r[:, k] < gate) & (mine | ~elsewhere[k])
            rows, slots = linear_sum_assignment(np.where(allowed, np.maximum(gain, 0.0), 0.0), maximize=True)
            own[:, k] = -1
            won = allowed[rows, slots] & (gain[rows, slots] > 0)
            own[rows[won], k] = slots[won]
        own = np.stack([trimmed(views, row, gate) for row in own])
    index[:, named] = own.T
    return index


def _taken(tracks: Tracks, slots: int) -> Bool[np.ndarray, "photos slots"]:
    """Candidates that are members of some track that chance would not make."""
    taken = np.zeros((tracks.index.shape[1], slots), bool)
    for row in tracks.index[tracks.support > 0]:
        k = np.flatnonzero(row >= 0)
        taken[k, row[k]] = True
    return taken


def _problems(names: Names, tracks: Tracks, index: np.ndarray) -> tuple[str, ...]:
    said = []
    for m in np.flatnonzero((names.rival >= 0) & (names.index < 0)):
        name, track = names.colours.names[m], names.rival[m]
        said.append(
            f"{name}: a bead of its colour was found in {tracks.views[track]} photographs, but something else may be "
            "it as well (odds under 1000 to 1); left unnamed. Learn the colours anew in this light, repaint the bead, "
            "or take away what looks like it."
        )
    missing = [n for m, n in enumerate(names.colours.names) if names.rival[m] < 0]
    if missing:
        said.append(f"Not found in two photographs: {', '.join(missing)}. Add photographs at other angles.")
    return (*said, *look_alike(names.colours))


def _plain_result(
    table: CandidateTable, cameras: Camera | None, colours: BeadColours, index: np.ndarray, gate: float
) -> Identification:
    views = None if cameras is None else look(cameras, table)
    return _result(table, views, colours, index, cameras, gate, np.zeros(len(colours.names)), np.ones(3), ())


def _result(
    table: CandidateTable,
    views: PhotoViews | None,
    colours: BeadColours,
    index: np.ndarray,
    cameras: Camera | None,
    gate: float,
    margin: np.ndarray,
    gains: np.ndarray,
    problems: tuple[str, ...],
) -> Identification:
    photos, markers = index.shape
    located = (index >= 0).sum(axis=0) >= 2
    p_world, distance = np.zeros((markers, 3)), np.zeros((photos, markers))
    if views is not None and located.any():
        p_world[located] = point_of(views, index.T[located])
        r = views.distances(p_world)[np.arange(markers)[None], np.arange(photos)[:, None], np.maximum(index, 0)]
        distance = np.where((index >= 0) & located & np.isfinite(r), r, 0.0)
    foreign = tuple(np.setdiff1d(np.arange(n), row) for n, row in zip(table.counts, index))
    return Identification(
        colours.names, index, p_world, located & (views is not None), distance, margin, foreign, cameras, gate, gains,
        problems,
    )  # fmt: skip
