"""Beads in a photo: where the visible ones are, how large, of which colour, and how sure that is.

In rounds: bright patches; in each the place farthest inside; from there the edge, ray by ray; through the edge a
circle; what it covers is explained and taken away, and what is left of the patch is looked at again (beads behind
beads). At last all circles are fitted once more, each knowing the others' pixels and the size of beads in this picture.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxmocap.vision.bead_circles import Circles, fit_circles, no_circles
from jaxmocap.vision.bead_edges import Seeds, select, trace_edges
from jaxmocap.vision.bead_seeds import RADIUS_SPREAD, Patches, empty_seeds, guess_radius, weighted_median
from jaxmocap.vision.colour import SQUARE, hsb_of_rgb, square_hsb
from jaxmocap.vision.hough import check_count, check_radius
from jaxmocap.vision.threshold import check_rgb

Floats = NDArray[np.float64]

_ROUNDS = 2  # at each level: beads behind beads
_CLEAR_ARC = 0.6  # of the outline: found first, so that they tell the usual radius, and those behind them are seen
_LEAST_ARC = 0.2  # of the outline; of less, half the points may belong to whatever hides the rest
_WORST_RMS = 0.5  # px, of the edge points from the circle: a pixel staircase has 0.3
_DIMMEST = 0.1
"""Light of the darkest part of a bead, relative to a usual bead: matt black reflects about 4 %, paint of
bright colour 30 to 90 %, so that what is darker is as likely the figure."""
_MARGIN = 3.0  # px that rays run past the farthest edge
_FLOOR, _FLOOR_OF_RADIUS = 0.02, 0.004
"""Error common to all edge points, px and of the radius: pixels are not points, and light and surroundings differ from
one side of a bead to the other. With it z^2 of clear beads is about 1 in `scripts/bead_detectors.py`."""
_HIDDEN = 1.5
"""How much more the centre scatters, in parts of its sigma, if nothing of the outline is seen: some of the points
taken for outline then belong to the edge of what hides the rest (same script)."""
_RADIUS_SD = 0.12  # of the median radius: beads at 340 to 460 mm of a camera at 400 mm


class BeadCandidates(NamedTuple):
    """What may be a bead, best first: one row each.

    Attributes:
        uv: Centre of the bead's outline, (n, 2), px.
        radius: Of the outline as it shows against its surroundings, (n,), px.
        sigma: Standard deviation of u and of v, (n,), px.
        hsb: Colour of the visible part, (n, 3), 0..1: mean of up to 5x5 pixels of its inside without highlights.
        score: From 0 to 1: how much of the outline is seen, times how well it is a circle, (n,).
        hsb_square: Mean of all 5x5 pixels around the centre, as the document measures colours, (n, 3), 0..1.
        arc: Fraction of the outline that is seen, (n,).
        merged: The visible part touches another candidate's in the picture, (n,).
    """

    uv: Floats
    radius: Floats
    sigma: Floats
    hsb: Floats
    score: Floats
    hsb_square: Floats
    arc: Floats
    merged: NDArray[np.bool_]


def find_beads(
    rgb: NDArray, *, radius: tuple[float | int, float | int] | None = None, count: int | None = None
) -> BeadCandidates:
    """Find coloured beads on a dark figure before a dark background.

    Args:
        rgb: Photo, uint8 (h, w, 3).
        radius: Least and greatest radius of a bead, px; by default found from the picture.
        count: At most so many candidates; by default all plausible ones, among which may be other small bright
            things.

    Returns:
        The candidates, best first; none when nothing in the picture looks like a bead.

    Raises:
        InputError: Not a colour picture, or a radius or count that makes no sense.
    """
    rgb = check_rgb(rgb)
    limits = None if radius is None else check_radius(radius)
    most = None if count is None else check_count(count)
    patches = Patches(rgb)
    limits = limits or _radius_range(patches)
    seeds, circles, limits, prior = _search(patches, limits, narrow=radius is None)
    if not len(seeds.uv):
        return _none()
    seeds = _recentred(seeds, circles, patches)
    edges = trace_edges(patches.linear, patches.owners, seeds, _usual(limits, prior), 2 * limits[1] + _MARGIN)
    return _best(_measure(rgb, patches, seeds, fit_circles(edges, limits, prior), prior), most)


def _radius_range(patches: Patches) -> tuple[float, float]:
    """Radii that beads of this picture may have: around that of most round patches, at whatever brightness."""
    patches_of = []
    for level in patches.levels()[::2]:
        patches.expose(level)
        _, inner, area = patches.peaks()
        small = inner < min(patches.value.shape) / 8  # the figure has to be in the picture too
        light = np.full(small.sum(), (level / 255.0) ** 2.2)
        patches_of.append((inner[small], area[small], light))
    guess = guess_radius(*map(np.concatenate, zip(*patches_of))) if patches_of else None
    return (0.5, 1.0) if guess is None else (guess / RADIUS_SPREAD, guess * RADIUS_SPREAD)


def _search(
    patches: Patches, limits: tuple[float, float], narrow: bool
) -> tuple[Seeds, Circles, tuple[float, float], tuple[float, float] | None]:
    """Seeds and circles, clear beads first; the radii, narrowed if allowed; the usual radius and its spread."""
    found = _sweep(patches, limits, None, _CLEAR_ARC, (empty_seeds(), no_circles()))
    prior = _size_of_beads(found[1], limits)
    if prior is not None and narrow:
        limits = _narrowed(limits, prior)
        usual = _of_usual_size(patches, found, limits)
        if len(usual[0].uv) < len(found[0].uv):
            found = _sweep(patches, limits, prior, _CLEAR_ARC, usual)
    found = _sweep(patches, limits, prior, _LEAST_ARC, found)
    return *found, limits, prior


def _sweep(
    patches: Patches,
    limits: tuple[float, float],
    prior: tuple[float, float] | None,
    least_arc: float,
    known: tuple[Seeds, Circles],
) -> tuple[Seeds, Circles]:
    """Seeds and circles from bright to dark: of patches, and of what is left of them behind what has been found.

    Args:
        patches: The picture; what is found is explained in it.
        limits: Least and greatest radius, px.
        prior: Usual radius and its spread, px, if known.
        least_arc: Fraction of the outline that must be seen.
        known: What earlier sweeps found; comes back with what this one finds.
    """
    found = known
    for level in patches.levels():
        if level < _dimmest(*found):
            break
        patches.expose(level)
        for _ in range(_ROUNDS):
            new = patches.seeds(1 + int(found[0].owner.max(initial=0)), (limits[0] / 3, limits[1]))
            if not len(new.uv):
                break
            edges = trace_edges(patches.linear, patches.owners, new, _usual(limits, prior), 2 * limits[1] + _MARGIN)
            circles = fit_circles(edges, limits, prior)
            good = _plausible(circles, least_arc)
            kept = select(new, good), Circles(*(field[good] for field in circles))
            patches.explain(kept[1].uv, kept[1].radius, kept[0])
            patches.pass_over(new.uv, new.inner)
            found = _joined(found, kept)
    return found


def _of_usual_size(
    patches: Patches, found: tuple[Seeds, Circles], limits: tuple[float, float]
) -> tuple[Seeds, Circles]:
    """Without circles that turn out too small, such as highlights, or too large; their places are looked at again."""
    seeds, circles = found
    fits = (circles.radius >= limits[0]) & (circles.radius <= limits[1])
    patches.forget(circles.uv[~fits], circles.radius[~fits], seeds.owner[~fits])
    return select(seeds, fits), Circles(*(field[fits] for field in circles))


def _joined(first: tuple[Seeds, Circles], second: tuple[Seeds, Circles]) -> tuple[Seeds, Circles]:
    """One table of two."""
    seeds, circles = zip(first, second)
    return Seeds(*map(np.concatenate, zip(*seeds))), Circles(*map(np.concatenate, zip(*circles)))  # pyright: ignore[reportArgumentType]


def _usual(limits: tuple[float, float], prior: tuple[float, float] | None) -> float:
    """Radius to expect, px."""
    return prior[0] if prior else float(np.sqrt(limits[0] * limits[1]))


def _narrowed(limits: tuple[float, float], prior: tuple[float, float]) -> tuple[float, float]:
    """Radii within three spreads of the usual one, px."""
    return max(limits[0], prior[0] - 3 * prior[1]), min(limits[1], prior[0] + 3 * prior[1])


def _dimmest(seeds: Seeds, circles: Circles) -> float:
    """Coded brightness, 0..255, below which nothing is a bead, given those that were found; 0 when none was."""
    light = seeds.colour[circles.arc > _CLEAR_ARC].max(axis=1, initial=0.0)
    return 255.0 * (_DIMMEST * float(np.median(light))) ** (1 / 2.2) if len(light) >= 3 else 0.0


def _plausible(circles: Circles, least_arc: float = _LEAST_ARC) -> NDArray[np.bool_]:
    """Whether enough of an outline is seen, and is a circle."""
    return (circles.arc >= least_arc) & (circles.rms <= _WORST_RMS) & (circles.outside <= 0.25)


def _size_of_beads(circles: Circles, limits: tuple[float, float]) -> tuple[float, float] | None:
    """Radius of the beads seen as a whole, and the spread of it, px; None if there are too few."""
    whole = (circles.arc > 0.8) & (circles.rms < 0.35)
    if whole.sum() < 3:
        return None
    radius = circles.radius[whole]
    middle = weighted_median(radius, radius**2)
    return middle, max(_RADIUS_SD * middle, 1.4826 * float(np.median(np.abs(radius - middle))))


def _recentred(seeds: Seeds, circles: Circles, patches: Patches) -> Seeds:
    """Seeds moved to the circle's centre where that is in the visible part: from there all rays meet the edge alike."""
    height, width = patches.owners.shape  # pyright: ignore[reportAssignmentType]
    column = np.clip(np.rint(circles.uv[:, 0]), 0, width - 1).astype(int)
    row = np.clip(np.rint(circles.uv[:, 1]), 0, height - 1).astype(int)
    seen = (patches.owners[row, column] == seeds.owner) & (circles.arc > 0.7)
    return seeds._replace(
        uv=np.where(seen[:, None], circles.uv, seeds.uv), inner=np.where(seen, 0.9 * circles.radius, seeds.inner)
    )


def _measure(
    rgb: NDArray[np.uint8], patches: Patches, seeds: Seeds, circles: Circles, prior: tuple[float, float] | None
) -> BeadCandidates:
    """The record of all plausible circles, unsorted."""
    keep = _plausible(circles)
    if not keep.any():
        return _none()
    seeds, circles = select(seeds, keep), Circles(*(field[keep] for field in circles))
    return BeadCandidates(
        uv=circles.uv,
        radius=circles.radius,
        sigma=_sigma(circles, prior),
        hsb=_inside_hsb(rgb, patches.owners, seeds, circles),
        score=circles.arc * np.exp(-((circles.rms / _WORST_RMS) ** 2)) * (1 - circles.outside),
        hsb_square=square_hsb(rgb, circles.uv),
        arc=circles.arc,
        merged=_touched(circles),
    )


def _sigma(circles: Circles, prior: tuple[float, float] | None) -> Floats:
    """Standard deviation per coordinate, (n,), px.

    Scatter of the edge points, what is common to them, and what may be hidden unseen: of a bead of a few pixels that
    shows a part only, that part looks like a smaller bead, whose centre is off by about what its radius lacks.
    """
    variance = np.trace(circles.covariance[:, :2, :2], axis1=1, axis2=2) / 2
    scatter = (1.0 + _HIDDEN * (1.0 - circles.arc)) ** 2 * variance
    lacking = np.maximum(prior[0] - 1.5 * prior[1] - circles.radius, 0.0) if prior else 0.0
    return np.sqrt(scatter + _FLOOR**2 + (_FLOOR_OF_RADIUS * circles.radius) ** 2 + lacking**2)


def _touched(circles: Circles) -> NDArray[np.bool_]:
    """Whether a circle meets another one."""
    apart = np.linalg.norm(circles.uv[:, None] - circles.uv[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    return (apart < circles.radius[:, None] + circles.radius[None] + 1.0).any(axis=1)


def _inside_hsb(rgb: NDArray[np.uint8], owners: NDArray[np.int32], seeds: Seeds, circles: Circles) -> Floats:
    """Mean colour of the pixels of a 5x5 square that are the bead's, clear of its edge and of highlights.

    The square is around the centre if that is visible, else around the innermost visible pixel. A highlight is
    brighter than the square's median colour by more than half, in its darkest channel.
    """
    height, width = owners.shape
    reach = np.arange(SQUARE) - SQUARE // 2
    at = np.rint(seeds.uv).astype(int)
    columns = np.clip(at[:, 0, None, None] + reach[None, :], 0, width - 1) + 0 * reach[:, None]
    rows = np.clip(at[:, 1, None, None] + reach[:, None], 0, height - 1) + 0 * reach[None, :]
    pixels = rgb[rows, columns].astype(np.float64).reshape(len(at), SQUARE**2, 3)
    offset = np.stack([columns, rows], axis=-1) - circles.uv[:, None, None]
    clear = np.linalg.norm(offset, axis=-1) <= np.maximum(circles.radius[:, None, None] - 1.0, 0.7)
    own = (clear & (owners[rows, columns] == seeds.owner[:, None, None])).reshape(len(at), -1)
    own[:, SQUARE**2 // 2] = True
    masked = np.where(own[..., None], pixels, np.nan)
    middle = np.nanmedian(masked, axis=1)
    highlight = (pixels.min(-1) > 1.5 * middle.min(-1)[:, None] + 10) & (pixels.max(-1) > middle.max(-1)[:, None])
    good = own & ~highlight
    good = np.where(good.any(1)[:, None], good, own)
    return hsb_of_rgb((pixels * good[..., None]).sum(1) / np.maximum(good.sum(1), 1)[:, None])


def _best(beads: BeadCandidates, most: int | None) -> BeadCandidates:
    """The candidates in order of their score, at most so many."""
    order = np.argsort(-beads.score, kind="stable")[:most]
    return BeadCandidates(*(field[order] for field in beads))  # pyright: ignore[reportArgumentType]


def _none() -> BeadCandidates:
    """No candidate."""
    none = np.zeros((0, 3))
    return BeadCandidates(
        none[:, :2], none[:, 0], none[:, 0], none, none[:, 0], none, none[:, 0], np.zeros(0, dtype=bool)
    )
