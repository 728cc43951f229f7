"""Tracks: candidates of several photographs that can be one thing, alike in colour and meeting in one point.

Nothing here knows names. A track is found before it is named, so that one odd colour names nothing.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri, gammaln

from jaxmocap.tracking.candidates import CandidateTable
from jaxmocap.tracking.colour_space import VIEW_SD
from jaxmocap.tracking.views import PhotoViews, meet

_COLOUR_LIMIT = float(chdtri(3, 0.001))  # largest squared distance of two colours of one bead [VIEW_SD^2]
_MIN_ANGLE = np.radians(5.0)  # rays nearer to parallel leave the depth open
_POLISH = 4  # passes of point -> members -> point; more change nothing (members repeat)


@dataclass(frozen=True)
class Tracks:
    """Candidates that belong together, best supported first."""

    index: Int[np.ndarray, "tracks photos"]
    """Slot of the candidate in each photograph, -1 where none."""
    p_world: Float[np.ndarray, "tracks 3"]
    """Points [scene]."""
    cone: Float[np.ndarray, "tracks 3"]
    """Median colours of the members in the colour cone."""
    support: Float[np.ndarray, "tracks"]
    """Minus the logarithm of how many tracks of as many views chance would make (see `chance_support`)."""

    @property
    def views(self) -> np.ndarray:
        """Number of photographs of every track."""
        return (self.index >= 0).sum(axis=1)

    def take(self, which: np.ndarray) -> "Tracks":
        """Some of the tracks."""
        return Tracks(self.index[which], self.p_world[which], self.cone[which], self.support[which])


def find_tracks(table: CandidateTable, views: PhotoViews, gate: float) -> Tracks:
    """Group candidates of different photographs that can be one bead.

    Each pair of candidates that are alike in colour and whose rays pass each other within the gate is a hypothesis.
    A hypothesis is worth what it collects: in every photograph the one candidate that fits best in place and
    colour. The best one is taken, its point refined from all its members, its candidates removed; and so on. At
    the end all tracks compete for all candidates once more, so that what was taken early does not stay unjustly.

    Args:
        table: the candidates.
        views: the same through the cameras.
        gate: largest distance of a candidate from the place of its point [px].

    Returns:
        Tracks of at least two photographs.
    Source: stop-motion document, 3.3.3 and 5 (points from rays, eq. 5.9-5.13); the search is ours.
    """
    points, colours = _hypotheses(table, views, gate)
    found: list[np.ndarray] = []
    if len(points):
        gain = _gains(table, views, points, colours, gate, spread=1.5)
        while True:
            best_slot = gain.argmax(axis=2)
            best = np.take_along_axis(gain, best_slot[..., None], 2)[..., 0]
            lead = int(best.sum(axis=1).argmax())
            if (best[lead] > 0).sum() < 2:
                break
            free = (gain > 0).any(axis=0)
            index = _polish(table, views, np.where(best[lead] > 0, best_slot[lead], -1), free, gate)  # pyright: ignore[reportArgumentType]
            if (index >= 0).sum() < 2:
                gain[lead] = 0.0
                continue
            found.append(index)
            for k in np.flatnonzero(index >= 0):
                gain[:, k, index[k]] = 0.0
    index = np.array(found, int).reshape(len(found), len(table.uv))
    return _compete(table, views, index, gate)


def chance_support(table: CandidateTable, gate: float, count: Int[np.ndarray, "tracks"]) -> np.ndarray:
    r"""Minus the logarithm of the expected number of tracks of `count` views that unrelated candidates make.

    N candidates start one; its second member lies in a band along the epipolar line of another photograph, each
    further one in a disc of the gate; all must be alike in colour, which happens to a share q of the pairs.

    Source: expected number of accidental matches, as in a-contrario detection (Desolneux, Moisan, Morel 2008).
    """
    n, photos = table.counts, len(table.counts)
    if photos < 2 or n.sum() < 2:
        return np.zeros(len(count))
    q = _alike_share(table)
    per_photo = n.mean() * q / table.area
    disc = min(per_photo * np.pi * gate**2, 1.0)
    band = min(per_photo * 2.0 * gate * np.sqrt(table.area), 1.0)
    more = np.maximum(count - 2, 0)
    ways = gammaln(photos - 1) - gammaln(more + 1) - gammaln(np.maximum(photos - 1 - more, 1))
    return -(np.log(n.sum()) + np.log((photos - 1) * band / 2) + ways + more * np.log(disc))


def without_doubles(tracks: Tracks, table: CandidateTable, views: PhotoViews) -> Tracks:
    """Tracks less those that stand inside the bead of a better supported one.

    Two beads cannot be nearer than their diameter. A bead half hidden behind a limb is seen beside its true place,
    and two such sights make a track of their own.

    Source: two spheres do not overlap.
    """
    if not len(tracks.index):
        return tracks
    radius = float(np.median(table.radius[table.filled]))
    place = views.offsets(tracks.p_world) * views.focal
    keep: list[int] = []
    for i in range(len(tracks.index)):
        apart = np.linalg.norm(place[keep] - place[i], axis=-1)  # in space at least as far as in any photograph
        if not (apart.max(axis=1, initial=0.0) < 2.0 * radius).any():
            keep.append(i)
    return tracks.take(np.array(keep))


def _alike_share(table: CandidateTable) -> float:
    """Share of pairs of candidates of one photograph, thus of different things, that are alike in colour."""
    alike, pairs = 1.0, 1.0  # one more of each: never zero
    for k in range(len(table.uv)):
        cone = table.cone[k, table.filled[k]] / VIEW_SD
        d2 = ((cone[:, None] - cone[None]) ** 2).sum(axis=-1)
        i, j = np.triu_indices(len(cone), 1)
        alike, pairs = alike + (d2[i, j] < 2 * _COLOUR_LIMIT).sum(), pairs + len(i)
    return float(alike / pairs)


def _hypotheses(table: CandidateTable, views: PhotoViews, gate: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and colours of pairs that can be one bead."""
    photo, slot = np.nonzero(views.valid)
    cone = table.cone[photo, slot] / VIEW_SD
    squares = (cone**2).sum(axis=1)
    alike = squares[:, None] + squares[None] - 2.0 * cone @ cone.T < 2.0 * _COLOUR_LIMIT
    i, j = np.nonzero(np.triu(alike & (photo[:, None] != photo[None]), 1))
    v = views.v_world[photo, slot]
    cos = np.einsum("pi,pi->p", v[i], v[j])
    good = cos**2 < np.cos(_MIN_ANGLE) ** 2
    i, j, cos = i[good], j[good], cos[good]
    c = views.centre_world[photo]
    between = c[j] - c[i]
    a, b = np.einsum("pi,pi->p", between, v[i]), np.einsum("pi,pi->p", between, v[j])
    t_i, t_j = (a - b * cos) / (1 - cos**2), (a * cos - b) / (1 - cos**2)
    p_i, p_j = c[i] + t_i[:, None] * v[i], c[j] + t_j[:, None] * v[j]
    # Half the gap between the rays is what each of the two misses their middle by.
    half = 0.5 * np.linalg.norm(p_i - p_j, axis=1)
    focal = views.focal.max()
    near = (t_i > 0) & (t_j > 0) & (half * focal < gate * np.minimum(np.abs(t_i), np.abs(t_j)))
    middle = 0.5 * (p_i + p_j)[near]
    return middle, 0.5 * (table.cone[photo, slot][i] + table.cone[photo, slot][j])[near]


def _gains(
    table: CandidateTable, views: PhotoViews, points: np.ndarray, cone: np.ndarray, gate: float, spread: float
) -> np.ndarray:
    """What each candidate adds to each hypothesis (points, photos, slots): 1 for a perfect fit, 0 for none."""
    r2 = (views.distances(points) / gate) ** 2
    cone, seen = cone / VIEW_SD, table.cone / VIEW_SD
    d2 = (cone**2).sum(-1)[:, None, None] + (seen**2).sum(-1)[None] - 2.0 * np.einsum("pi,ksi->pks", cone, seen)
    d2 = d2 / (spread * _COLOUR_LIMIT)
    return np.where((r2 < 1) & (d2 < 1), 1.0 - 0.5 * (r2 + d2), 0.0)


def _members(cone_of: np.ndarray, index: np.ndarray) -> np.ndarray:
    k = np.flatnonzero(index >= 0)
    return cone_of[k, index[k]]


def point_of(views: PhotoViews, index: Int[np.ndarray, "tracks photos"]) -> Float[np.ndarray, "tracks 3"]:
    """Points nearest to the rays of the members of each track.

    Source: stop-motion document, eq. 5.11.
    """
    photos = np.arange(index.shape[1])
    v = views.v_world[photos, np.maximum(index, 0)]
    return meet(np.broadcast_to(views.centre_world, v.shape), v, (index >= 0).astype(float))


def _polish(table: CandidateTable, views: PhotoViews, index: np.ndarray, free: np.ndarray, gate: float) -> np.ndarray:
    """Members again and again from the point of the last ones; at the end none is outside the gate."""
    for _ in range(_POLISH):
        before = index
        cone = np.median(_members(table.cone, index), axis=0)
        gain = _gains(table, views, point_of(views, index[None]), cone[None], gate, spread=1.25)[0] * free
        index = np.where(gain.max(axis=1) > 0, gain.argmax(axis=1), -1)
        if (index >= 0).sum() < 2:
            return before if _fits(views, before, gate) else np.full_like(index, -1)
        if (index == before).all():
            break
    return trimmed(views, index, gate)


def _fits(views: PhotoViews, index: np.ndarray, gate: float) -> bool:
    return bool((trimmed(views, index, gate) == index).all())


def trimmed(views: PhotoViews, index: Int[np.ndarray, "photos"], gate: float) -> Int[np.ndarray, "photos"]:
    """A track without the members that do not meet the others: the worst leaves until all are inside the gate.

    Source: leave-one-out of the residuals of eq. 5.11 of the stop-motion document.
    """
    index = index.copy()
    while (index >= 0).sum() >= 2:
        k = np.flatnonzero(index >= 0)
        distance = views.distances(point_of(views, index[None]))[0, k, index[k]]
        worst = int(distance.argmax())
        if distance[worst] < gate:
            return index
        index[k[worst]] = -1
    return np.full_like(index, -1)


def _compete(table: CandidateTable, views: PhotoViews, index: np.ndarray, gate: float) -> Tracks:
    """All tracks over all candidates: in each photograph the assignment of the largest total gain."""
    for _ in range(2):
        if not len(index):
            break
        cone = np.stack([np.median(_members(table.cone, row), axis=0) for row in index])
        gain = _gains(table, views, point_of(views, index), cone, gate, spread=1.25)
        index = np.full_like(index, -1)
        for k in range(index.shape[1]):
            rows, slots = linear_sum_assignment(gain[:, k], maximize=True)
            won = gain[rows, k, slots] > 0
            index[rows[won], k] = slots[won]
        index = np.stack([trimmed(views, row, gate) for row in index])
        index = index[(index >= 0).sum(axis=1) >= 2]
    return _as_tracks(table, views, index, gate)


def _as_tracks(table: CandidateTable, views: PhotoViews, index: np.ndarray, gate: float) -> Tracks:
    cone = [np.median(_members(table.cone, row), axis=0) for row in index]
    support = chance_support(table, gate, (index >= 0).sum(axis=1))
    order = np.argsort(-support, kind="stable")
    cone = np.array(cone).reshape(len(index), 3)
    return Tracks(index, point_of(views, index) if len(index) else np.zeros((0, 3)), cone, support).take(order)
