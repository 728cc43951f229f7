"""What can be known exactly about a drawn view of the puppet: where each bead is seen, and how much of it."""

import numpy as np

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.synthetic.puppet_camera import PuppetCamera, pixels
from jaxmocap.synthetic.puppet_figure import Figure, Solids

Array = np.ndarray

_RAYS = 400  # per bead, as many as rendered_puppet's truth has
_OUTLINE = 256


def first_hits(solids: Solids, rays: Array) -> Array:
    """Depth z (solids, rays) at which rays (rays, 3) from the origin first enter each solid; inf where they miss.

    A solid is missed, too, where it is cut off, and behind the camera.
    """
    d = np.einsum("nij,rj->nri", solids.shape, rays)
    c = np.einsum("nij,nj->ni", solids.shape, solids.centre)[:, None]
    a, b = (d * d).sum(-1), (d * c).sum(-1)
    under = b * b - a * ((c * c).sum(-1) - 1.0)
    t = (b - np.sqrt(np.where(under > 0, under, 0.0))) / np.where(a > 0, a, 1.0)
    along = np.einsum("ni,nri->nr", solids.cut[:, :3], t[..., None] * rays - solids.centre[:, None])
    hit = (under > 0) & (a > 0) & (t > 0) & (along >= 0) & (along <= solids.cut[:, 3:])
    return np.where(hit, t * rays[:, 2], np.inf)


def may_cover(solids: Solids, centre: Array, radius: float) -> Array:
    """Indices of the solids of which some part may stand before a sphere, seen from the origin."""
    middle = solids.ends.mean(axis=1)
    far, away = np.linalg.norm(middle, axis=1), np.linalg.norm(centre)
    reach = solids.reach + np.linalg.norm(solids.ends[:, 1] - solids.ends[:, 0], axis=1) / 2.0
    apart = np.arccos(np.clip(middle @ centre / (far * away), -1.0, 1.0))
    wide = np.arcsin(np.minimum(reach / far, 1.0)) + np.arcsin(min(radius / away, 1.0))
    return np.flatnonzero((apart <= wide) & (far - reach <= away + radius))


def outline(centre: Array, radius: float, turns: Array, part: Array | float = 1.0) -> Array:
    """Rays (n, 3) over the disc that a sphere shows the camera.

    Args:
        centre: of the sphere, camera frame.
        radius: of the sphere.
        turns: (n,) angle about the line of sight [rad].
        part: 0 at the middle, 1 on the outline.

    Returns:
        Points of the plane of the circle where rays touch the sphere.
    """
    n = centre / np.linalg.norm(centre)
    e = np.cross(n, [0.0, 1.0, 0.0])
    e /= np.linalg.norm(e)
    shrink = 1.0 - radius**2 / (centre @ centre)
    ring = np.cos(turns)[:, None] * e + np.sin(turns)[:, None] * np.cross(n, e)
    return centre * shrink + radius * np.sqrt(shrink) * np.asarray(part)[..., None] * ring


def polygon_area_centroid(uv: Array) -> tuple[float, Array]:
    """Area and centre of area of a closed polygon (n, 2)."""
    origin = uv.mean(axis=0)
    p = uv - origin
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = cross.sum() / 2.0
    return abs(float(area)), origin + ((p + q) * cross[:, None]).sum(axis=0) / (6.0 * area)


def bead_truth(camera: PuppetCamera, T_camera_world: Array, figure: Figure, solids: Solids) -> dict[str, dict]:
    """Truth of one view by bead.

    Args:
        camera: lens.
        T_camera_world: (4, 4).
        figure: in the world.
        solids: everything drawn, in the CAMERA frame, the beads first and in their order.

    Returns:
        Per bead `centre_px` (projected centre), `outline_centroid_px` (centre of area of the outline), `radius_px`
        (of the circle of that area), `visible_fraction` (of rays over the disc), `visible` (at least half),
        `in_image` (whole disc).
    """
    centres = figure.beads @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    # Sunflower points: equal areas of the disc.
    k = np.arange(_RAYS) + 0.5
    turns, part = k * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(k / _RAYS)
    ring = np.linspace(0.0, 2.0 * np.pi, _OUTLINE, endpoint=False)
    truth = {}
    for i, (name, c) in enumerate(zip(MARKERS, centres)):
        rim = pixels(camera, outline(c, figure.bead_radius, ring))
        area, centroid = polygon_area_centroid(rim)
        low, high = rim.min(axis=0), rim.max(axis=0)
        size = np.array([camera.width, camera.height])
        near = may_cover(solids, c, figure.bead_radius)
        hits = first_hits(solids.chosen(near), outline(c, figure.bead_radius, turns, part))
        seen = float((near[hits.argmin(axis=0)] == i).mean())
        truth[name] = {
            "centre_px": _rounded(pixels(camera, c)),
            "outline_centroid_px": _rounded(centroid),
            "radius_px": round(float(np.sqrt(area / np.pi)), 6),
            "visible_fraction": seen,
            "visible": seen >= 0.5,
            "in_image": bool((low >= -0.5).all() and (high <= size - 0.5).all()),
        }
    return truth


def _rounded(values: Array) -> list[float]:
    return [round(float(v), 6) for v in values]
