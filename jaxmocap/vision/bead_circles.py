"""The circle on which most edge points of a bead lie, with hardly any outside, and how well they determine it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxmocap.vision.bead_edges import RAYS, Edges

Floats = NDArray[np.float64]

_NEAR, _NEAR_OF_RADIUS, _LEAST_NEAR = 0.5, 0.08, 0.15
"""Distance from the circle within which an edge point is on it: half a pixel, beyond which neighbouring pixels decide;
of small circles a part of the radius, because half a pixel would pass the chord of a half hidden bead for its outline;
px, of the radius, px."""
_CORRELATED = 1.5
"""Length along the edge, px, over which errors of edge points are common: the linear interpolation spreads a pixel's
noise over its neighbours, and JPEG and demosaicing over a little more."""
_TURNED = 0.6
_LEAST_RMS = 0.05
"""Scatter of edge points, px, that is assumed even when they happen to lie on the circle more exactly."""
_ITERATIONS = 6


class Circles(NamedTuple):
    """Circles fitted to edges, one row per seed.

    Attributes:
        uv: Centre (n, 2), px.
        radius: (n,), px.
        arc: Fraction of the circumference with edge points on it, (n,).
        rms: Root mean square distance of these from the circle, (n,), px.
        outside: Fraction of the rays whose edge point lies outside the circle, (n,).
        covariance: Of u, v and r, (n, 3, 3), px^2.
    """

    uv: Floats
    radius: Floats
    arc: Floats
    rms: Floats
    outside: Floats
    covariance: Floats


def fit_circles(edges: Edges, radius: tuple[float, float], prior: tuple[float, float] | None = None) -> Circles:
    """Fit a circle to the edge points of each seed.

    Args:
        edges: From `trace_edges`.
        radius: Least and greatest radius, px.
        prior: Radius and its standard deviation that the other beads of the picture suggest, px.

    Returns:
        The circles; `arc` is 0 where there is none.
    """
    start = _consensus(edges, radius, prior)
    uvr, weight = _refine(edges, start, radius, prior)
    return _describe(edges, uvr, weight, prior)


def _triples() -> NDArray[np.int_]:
    """Triples of rays (k, 3), spread over arcs from a sixth to two thirds of a turn."""
    spans = [(4, 8), (6, 12), (8, 16), (8, 20), (12, 24), (16, 32)]
    return np.array([((i + 0) % RAYS, (i + a) % RAYS, (i + b) % RAYS) for a, b in spans for i in range(0, RAYS, 3)])


_TRIPLES = _triples()


def _consensus(edges: Edges, radius: tuple[float, float], prior: tuple[float, float] | None) -> Floats:
    """Of the circles through three edge points, the one that explains most: (n, 3) u, v, r."""
    points = edges.uv[:, _TRIPLES]  # (n, k, 3, 2)
    centre, r = _circles_through(points)
    fits = edges.found[:, _TRIPLES].all(-1) & (r >= radius[0]) & (r <= radius[1])
    distance = np.linalg.norm(edges.uv[:, None] - centre[:, :, None], axis=-1) - r[..., None]  # (n, k, RAYS)
    length = _ray_weights(edges)[:, None]
    near = _near(r)[..., None]
    gain = np.maximum(1.0 - (distance / (2 * near)) ** 2, 0.0) - (distance > 2 * near)
    score = np.where(fits, (gain * length).sum(-1), -np.inf)
    if prior is not None:
        score = score - 0.05 * length.sum(-1) * np.minimum(((r - prior[0]) / prior[1]) ** 2, 9.0)
    best = score.argmax(axis=1)
    rows = np.arange(len(best))
    chosen = np.concatenate([centre[rows, best], r[rows, best, None]], axis=1)
    fallback = np.concatenate([edges.uv.mean(1), np.full((len(best), 1), radius[0])], axis=1)
    return np.where(np.isfinite(score[rows, best])[:, None], chosen, fallback)


def _circles_through(points: Floats) -> tuple[Floats, Floats]:
    """Centre (..., 2) and radius of the circle through three points (..., 3, 2); huge where they are on a line."""
    a, b = points[..., 1, :] - points[..., 0, :], points[..., 2, :] - points[..., 0, :]
    cross = 2 * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    cross = np.where(np.abs(cross) < 1e-6, 1e-6, cross)
    aa, bb = (a**2).sum(-1), (b**2).sum(-1)
    x = (b[..., 1] * aa - a[..., 1] * bb) / cross
    y = (a[..., 0] * bb - b[..., 0] * aa) / cross
    return points[..., 0, :] + np.stack([x, y], axis=-1), np.hypot(x, y)


def _ray_weights(edges: Edges) -> Floats:
    """Length of edge that each ray stands for, (n, RAYS), px: rays from a seed near an edge crowd there."""
    step = np.linalg.norm(np.diff(edges.uv, axis=1, append=edges.uv[:, :1]), axis=-1)
    return np.minimum((step + np.roll(step, 1, axis=1)) / 2, 2.0) * edges.found


def _refine(
    edges: Edges, uvr: Floats, radius: tuple[float, float], prior: tuple[float, float] | None
) -> tuple[Floats, Floats]:
    """Reweighted least squares of the distances from the circle (Tukey's weights): u, v, r and the weights."""
    length = _ray_weights(edges)
    weight = length
    for k in range(_ITERATIONS):
        residual, jacobian = _residuals(edges, uvr)
        near = _near(uvr[:, 2:])
        width = 3.0 * near if k < 2 else np.clip(4.0 * _scatter(residual, length, near), 0.6 * near, 2 * near)
        along = _along_circle(edges, jacobian)
        kept = np.maximum(1.0 - (residual / width) ** 2, 0.0) ** 2 * along
        kept = np.minimum(kept, np.minimum(kept[:, _further(1)], kept[:, _further(-1)]))
        weight = length * kept
        normal, right = _normal_equations(residual, jacobian, weight, uvr, prior)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        uvr = uvr - np.clip(step, -2.0, 2.0)
        uvr[:, 2] = np.clip(uvr[:, 2], *radius)
    return uvr, weight


def _near(radius: Floats) -> Floats:
    """Distance from circles within which edge points are on them, px."""
    return np.clip(_NEAR_OF_RADIUS * radius, _LEAST_NEAR, _NEAR)


def _scatter(residual: Floats, length: Floats, near: Floats) -> Floats:
    """Robust standard deviation of the edge points that lie near the circle, (n, 1), px."""
    distance = np.abs(residual)
    on = (distance < near) & (length > 0)
    ordered = np.sort(np.where(on, distance, np.inf), axis=1)
    middle = np.maximum(on.sum(axis=1, keepdims=True) - 1, 0) // 2
    return 1.4826 * np.minimum(np.take_along_axis(ordered, middle, axis=1), near)


def _further(by: int) -> NDArray[np.int_]:
    """Indices of the rays so many further round."""
    return (np.arange(RAYS) + by) % RAYS


def _along_circle(edges: Edges, jacobian: Floats) -> Floats:
    """1 where the edge runs along the circle, falling to 0 where it turns off by `_TURNED`: (n, RAYS).

    Where something hides a part of the bead, the edge leaves the circle at a corner, which blur makes round.
    """
    chord = edges.uv[:, _further(2)] - edges.uv[:, _further(-2)]
    sine = np.abs((chord * jacobian[..., :2]).sum(-1)) / np.maximum(np.linalg.norm(chord, axis=-1), 1e-6)
    return np.maximum(1.0 - (sine / _TURNED) ** 2, 0.0)


def _residuals(edges: Edges, uvr: Floats) -> tuple[Floats, Floats]:
    """Distance of each edge point from the circle (n, RAYS), and its derivative by u, v, r (n, RAYS, 3)."""
    offset = edges.uv - uvr[:, None, :2]
    distance = np.maximum(np.linalg.norm(offset, axis=-1), 1e-6)
    jacobian = np.concatenate([-offset / distance[..., None], -np.ones((*distance.shape, 1))], axis=-1)
    return distance - uvr[:, 2:], jacobian


def _normal_equations(
    residual: Floats, jacobian: Floats, weight: Floats, uvr: Floats, prior: tuple[float, float] | None
) -> tuple[Floats, Floats]:
    """J'WJ and J'Wr per circle; a weak pull towards the prior radius, and a hint of stiffness against singularity."""
    normal = np.einsum("nki,nk,nkj->nij", jacobian, weight, jacobian) + 1e-6 * np.eye(3)
    right = np.einsum("nki,nk,nk->ni", jacobian, weight, residual)
    if prior is not None:
        stiff = (0.15 / prior[1]) ** 2 * _CORRELATED  # edge points scatter by about 0.15 px
        normal[:, 2, 2] += stiff
        right[:, 2] += stiff * (uvr[:, 2] - prior[0])
    return normal, right


def _describe(edges: Edges, uvr: Floats, weight: Floats, prior: tuple[float, float] | None) -> Circles:
    """How well the edge points lie on the circles, and what covariance that leaves."""
    residual, jacobian = _residuals(edges, uvr)
    total = np.maximum(weight.sum(1), 1e-9)
    rms = np.sqrt((weight * residual**2).sum(1) / total)
    normal, _ = _normal_equations(residual, jacobian, weight / _CORRELATED, uvr, prior)
    scale = np.maximum(rms, _LEAST_RMS) ** 2
    return Circles(
        uv=uvr[:, :2],
        radius=uvr[:, 2],
        arc=_arc(edges, uvr, np.abs(residual) < _near(uvr[:, 2:])),
        rms=rms,
        outside=(edges.found & (residual > 2 * _near(uvr[:, 2:]))).mean(1),
        covariance=np.linalg.inv(normal) * scale[:, None, None],
    )


def _arc(edges: Edges, uvr: Floats, on: NDArray[np.bool_]) -> Floats:
    """Fraction of the circumference, in sectors of a 24th turn, that holds an edge point on the circle."""
    offset = edges.uv - uvr[:, None, :2]
    sector = ((np.arctan2(offset[..., 1], offset[..., 0]) / (2 * np.pi) % 1.0) * 24).astype(int) % 24
    held = np.zeros((len(uvr), 24), bool)
    np.logical_or.at(held, (np.arange(len(uvr))[:, None], sector), on & edges.found)
    return held.mean(1)


def no_circles() -> Circles:
    """No circle."""
    none = np.zeros((0, 3))
    return Circles(none[:, :2], none[:, 0], none[:, 0], none[:, 0], none[:, 0], np.zeros((0, 3, 3)))
