"""How accurate are the markers of the stop-motion system, and what does that depend on?

    python scripts/puppet_accuracy.py [--poses 10] [--seed 0]

The document asks for it in 8.2. Random poses of the drawn puppet (`jaxmocap.synthetic.puppet`: 704x576, the document's
camera and turntable, JPEG), beads found by `vision.find_beads`, points by `reconstruction`. Each candidate gets the
name of the bead whose true place is nearest (within half a radius or 2 px): naming is not what is measured here. The
build is perfect and known, so errors of the turntable are not in these numbers. Prints Markdown tables.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics
from jaxmocap.geometry import Pose
from jaxmocap.observations import PixelObservations
from jaxmocap.reconstruction.refinement import refine_point
from jaxmocap.reconstruction.triangulation import fit_point_linear, rays
from jaxmocap.synthetic.puppet import TWELVE, PuppetPhoto, Studio, puppet_take, view_truth
from jaxmocap.synthetic.puppet_camera import PuppetCamera
from jaxmocap.synthetic.puppet_figure import BEAD_RADIUS, Figure, Proportions, pose_figure, random_pose
from jaxmocap.synthetic.puppet_render import Look
from jaxmocap.vision.beads import find_beads

VIEWS = {
    "3 in front (-30, 0, 30 deg)": (0, 30, 330),
    "3 all round (0, 120, 240 deg)": (0, 120, 240),
    "5 in front (-60 ... 60 deg)": (0, 30, 60, 300, 330),
    "12": tuple(range(0, 360, 30)),
}
NOISE = (1.0, 2.0, 4.0, 8.0)
RADII_PX = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0)
MM_PER_PX = 400.0 / 859.6  # at the axis
LOOKS = {
    "lamp at the lens, blur 0.45 px": Look(),
    "lamp 50 mm aside, 50 mm above": Look(lamp=(50.0, -50.0, 0.0)),
    "lamp 200 mm aside, 150 mm above": Look(lamp=(200.0, -150.0, 0.0)),
    "blur 1 px": Look(blur=1.0),
    "strong highlights": Look(highlight=0.5),
    "JPEG quality 60": Look(jpeg_quality=60),
}
ORDERS = {
    "in the order of the turn (0, 30, 60, ...)": tuple(range(12)),
    "front first (0, 30, 330, 60, 300, ...)": (0, 1, 11, 2, 10, 3, 9, 4, 8, 5, 7, 6),
}


@dataclass(frozen=True)
class Take:
    """What was found of one pose, named by the truth; NaN where a bead was not found."""

    beads: np.ndarray
    """(16, 3) true centres [mm]."""
    T_camera_world: np.ndarray
    """(12, 4, 4)."""
    uv: np.ndarray
    """(12, 16, 2) found [px]."""
    sigma: np.ndarray
    """(12, 16) stated [px]."""
    error: np.ndarray
    """(12, 16, 2) found minus true centre of the outline [px]."""
    clear: np.ndarray
    """(12, 16) at least nine tenths seen, and inside the picture."""


def named_take(figure: Figure, photos: list[PuppetPhoto]) -> Take:
    """Find the beads and name them by the truth."""
    shape = (len(photos), len(MARKERS))
    uv, sigma, error = np.full((*shape, 2), np.nan), np.full(shape, np.nan), np.full((*shape, 2), np.nan)
    clear = np.zeros(shape, dtype=bool)
    for k, photo in enumerate(photos):
        found = find_beads(photo.rgb)
        truth = [photo.beads[name] for name in MARKERS]
        places = np.array([bead["outline_centroid_px"] for bead in truth])
        reach = np.array([max(2.0, bead["radius_px"] / 2.0) for bead in truth])
        clear[k] = [bead["visible_fraction"] >= 0.9 and bead["in_image"] for bead in truth]
        some = np.array([bead["visible_fraction"] > 0.0 for bead in truth])
        apart = np.linalg.norm(found.uv[:, None] - places[None], axis=2) + np.where(some, 0.0, np.inf)
        for j in np.argsort(apart.min(axis=1, initial=np.inf)):
            i = int(apart[j].argmin())
            if apart[j, i] < reach[i] and np.isnan(sigma[k, i]):
                uv[k, i], sigma[k, i], error[k, i] = found.uv[j], found.sigma[j], found.uv[j] - places[i]
    return Take(figure.beads, np.array([photo.T_camera_world for photo in photos]), uv, sigma, error, clear)


def takes(poses: int, seed: int, look: Look | None = None, bead_radius: float = BEAD_RADIUS) -> list[Take]:
    """The same random poses whatever look and radius."""
    done = []
    for k in range(poses):
        rng = np.random.default_rng([seed, k])
        figure = pose_figure(random_pose(rng), Proportions(bead_radius=bead_radius))
        done.append(named_take(figure, puppet_take(Studio(look=look or Look()), figure, rng=rng)))
    return done


def seen_in_truth(poses: int, seed: int) -> list[np.ndarray]:
    """(12, 16) per pose: at least half of the bead can be seen, and it is in the picture; no pictures are drawn."""
    done, studio = [], Studio()
    for k in range(poses):
        figure = pose_figure(random_pose(np.random.default_rng([seed, k])))
        views = [view_truth(studio, figure, angle) for angle in TWELVE]
        done.append(np.array([[v[name]["visible"] and v[name]["in_image"] for name in MARKERS] for v in views]))
    return done


def cameras_of(T: np.ndarray, lens: PuppetCamera) -> Camera:
    """The views as cameras of the library."""
    n = len(T)
    K = Intrinsics(*(jnp.full(n, float(x)) for x in (lens.fx, lens.fy, lens.cx, lens.cy, 0.0)))
    distortion = jax.vmap(BrownDistortion.from_vector)(jnp.asarray(np.tile(lens.distortions(), (n, 1))))
    rotvec = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    return Camera(K, distortion, Pose(jnp.asarray(rotvec), jnp.asarray(T[:, :3, 3])), (lens.width, lens.height))


@jax.jit
def linear_points(cameras: Camera, seen: PixelObservations):
    """Least squares of rays."""

    def one(seen: PixelObservations):
        return fit_point_linear(*rays(cameras, seen.uv, seen.visible))

    p, valid = jax.vmap(one)(seen)
    return p, valid, jnp.full((*p.shape, 3), jnp.nan)


@jax.jit
def refined_points(cameras: Camera, seen: PixelObservations):
    """Least reprojection error, robust."""
    point = jax.vmap(lambda seen: refine_point(cameras, seen, "cauchy"))(seen)
    return point.p_world, point.valid, point.covariance


@dataclass(frozen=True)
class Errors:
    """Marker errors of several takes."""

    xyz: np.ndarray
    """(n, 3) found minus true [mm]."""
    z: np.ndarray
    """(n, 3) in stated sigmas."""
    possible: int
    """Markers that there were."""

    def row(self) -> str:
        """Columns of a table: found, RMS of x, y, z, median, 95 % and maximum of all coordinates, RMS of z-scores."""
        if not len(self.xyz):
            return f"0 of {self.possible} | | | | | | |"
        size = np.abs(self.xyz).ravel()
        x, y, z = np.sqrt((self.xyz**2).mean(axis=0))
        score = f"{np.sqrt((self.z**2).mean()):.2f}" if np.isfinite(self.z).all() else ""
        return (
            f"{len(self.xyz)} of {self.possible} | {x:.3f} {y:.3f} {z:.3f} | {np.median(size):.3f} "
            f"| {np.percentile(size, 95):.3f} | {size.max():.2f} | {score} |"
        )


HEAD = "markers | RMS x y z [mm] | median | 95 % | max [mm] | RMS error / sigma |"
RULE = "---|---|---|---|---|---|"


def errors(
    some: Iterable[Take],
    angles: tuple[int, ...] = VIEWS["12"],
    method: Callable = refined_points,
    lens: PuppetCamera | None = None,
) -> Errors:
    """Markers from the views at these angles [deg]."""
    xyz, scores, possible = [], [], 0
    use = np.isin(np.arange(0, 360, 30), angles)
    for take in some:
        visible = np.isfinite(take.sigma) & use[:, None]
        uv = np.where(visible[..., None], take.uv, 0.0).transpose(1, 0, 2)
        seen = PixelObservations(
            jnp.asarray(uv), jnp.asarray(visible.T), jnp.asarray(np.where(visible, take.sigma, 1.0).T)
        )
        p, valid, covariance = (
            np.asarray(x) for x in method(cameras_of(take.T_camera_world, lens or PuppetCamera()), seen)
        )
        difference = (p - take.beads)[valid]
        possible += len(valid)
        xyz.append(difference)
        scores.append(difference / np.sqrt(np.diagonal(covariance[valid], axis1=1, axis2=2)))
    return Errors(np.concatenate(xyz), np.concatenate(scores), possible)


def noise_table(poses: int, seed: int) -> list[Take]:
    """Noise and method; gives back the takes with the ordinary noise."""
    print(f"\n**Noise** (12 views, {poses} poses; noise 1 is that of the rendered set, 1.4 grey levels)\n")
    print(f"| noise | points | {HEAD}\n|---|---|{RULE}")
    first = None
    for noise in NOISE:
        done = takes(poses, seed, Look(noise=noise))
        first = first or done
        print(f"| {noise:g} | rays, least squares (5.13) | {errors(done, method=linear_points).row()}")
        print(f"| {noise:g} | reprojection, robust | {errors(done).row()}", flush=True)
    return first


def views_table(done: list[Take]) -> None:
    """Number of views."""
    print(f"\n**Views** (the same pictures, noise 1; a marker needs two views)\n\n| views | {HEAD}\n|---|{RULE}")
    for name, angles in VIEWS.items():
        print(f"| {name} | {errors(done, angles).row()}")


def distortion_table(done: list[Take]) -> None:
    """With and without the lens."""
    flat = replace(PuppetCamera(), k1=0.0, k2=0.0)
    print("\n**Distortion** (12 views, noise 1, k1 = -0.12, k2 = 0.03)\n")
    print(f"| distortion | points | {HEAD}\n|---|---|{RULE}")
    for name, lens in (("corrected", PuppetCamera()), ("ignored", flat)):
        print(f"| {name} | rays, least squares (5.13) | {errors(done, method=linear_points, lens=lens).row()}")
        print(f"| {name} | reprojection, robust | {errors(done, lens=lens).row()}")


def radius_table(poses: int, seed: int) -> None:
    """How small beads may be."""
    print(f"\n**Bead radius** (12 views, {poses} poses, noise 1; clear: at least nine tenths of the bead are seen)\n")
    print(f"| radius [px] | clear beads found | their RMS error [px] | {HEAD}\n|---|---|---|{RULE}")
    for radius in RADII_PX:
        done = takes(poses, seed, bead_radius=radius * MM_PER_PX)
        share, rms = clear_beads(done)
        print(f"| {radius:g} | {100 * share:.1f} % | {rms:.3f} | {errors(done).row()}", flush=True)


def light_table(poses: int, seed: int) -> None:
    """A lamp that stands aside makes crescents of the beads; blur, gloss."""
    print(f"\n**Light and sharpness** (12 views, {poses} poses, noise 1; lamp to the right of the lens and above it)\n")
    print(f"| photos | RMS error of clear beads [px] | {HEAD}\n|---|---|{RULE}")
    for name, look in LOOKS.items():
        done = takes(poses, seed, look)
        print(f"| {name} | {clear_beads(done)[1]:.3f} | {errors(done).row()}", flush=True)


def clear_beads(done: list[Take]) -> tuple[float, float]:
    """Share of the clear beads that were found, and their RMS error per coordinate [px]."""
    error = np.concatenate([take.error for take in done])[np.concatenate([take.clear for take in done])]
    found = np.isfinite(error[:, 0])
    return float(found.mean()), float(np.sqrt((error[found] ** 2).mean())) if found.any() else np.nan


def pictures_table(poses: int, title: str, seen: list[np.ndarray]) -> None:
    """How many pictures until all beads have two views."""
    print(f"\n**How many pictures until all 16 beads have two views** ({poses} poses; {title})\n")
    print("| pictures taken | 2 | 3 | 4 | 5 | 6 | 8 | 12 | median needed |\n|---|" + "---|" * 8)
    for name, order in ORDERS.items():
        print(f"| {name} | {shares([pictures_needed(found[list(order)]) for found in seen])}")
    print(f"| the best choice for each pose | {shares([fewest(found) for found in seen])}", flush=True)


def pictures_needed(found: np.ndarray) -> float:
    """Pictures until every bead has been found twice; infinite if never."""
    enough = (np.cumsum(found, axis=0) >= 2).all(axis=1)
    return float(enough.argmax() + 1) if enough.any() else np.inf


def fewest(found: np.ndarray) -> float:
    """The same with the best pictures, by trying all choices."""
    choices = (np.arange(2 ** len(found))[:, None] >> np.arange(len(found))) & 1
    good = ((choices @ found.astype(int)) >= 2).all(axis=1)
    return float(choices[good].sum(axis=1).min()) if good.any() else np.inf


def shares(needed: list[float]) -> str:
    """Columns: share of poses that have enough after so many pictures."""
    needed_by = [f"{100 * np.mean([n <= m for n in needed]):.0f} %" for m in (2, 3, 4, 5, 6, 8, 12)]
    middle = np.sort(needed)[len(needed) // 2]
    return " | ".join([*needed_by, f"{middle:.0f}" if np.isfinite(middle) else "more than 12"]) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    done = noise_table(arguments.poses, arguments.seed)
    views_table(done)
    distortion_table(done)
    pictures_table(len(done), "found in the pictures", [np.isfinite(take.sigma) for take in done])
    pictures_table(200, "at least half of the bead in sight", seen_in_truth(200, arguments.seed))
    light_table(max(arguments.poses // 2, 2), arguments.seed)
    radius_table(max(arguments.poses // 2, 2), arguments.seed)


if __name__ == "__main__":
    main()
