"""A bar with two markers waved before two cameras: the arrow problem that speed is measured on.

The setting is the optical tracking document's: two 640x480 cameras 3 m apart whose axes meet at 90 degrees, barrel
distortion, and a bar of 1022 mm waved through 2.5 x 1.8 x 2.5 m. Everything is unknown but the bar's length, so the
18 numbers of the cameras are shared by all blocks, and each block has its own six: where the two markers were.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._arrays import Scalar, Vector2, Vector3
from jaxmocap._errors import InputError
from jaxmocap.geometry import Pose
from jaxmocap.optim import ArrowProblem, ArrowVariables

IMAGE_SIZE = (640, 480)
BAR_LENGTH = 1.022
"""Distance of the markers [m]."""
VOLUME = (2.5, 1.8, 2.5)
"""Sides of the box the bar's middle stays in [m]."""
_BASELINE = 3.0
_NEAREST = 0.3  # markers closer to a camera than this are not recorded [m]


class BarCamera(eqx.Module):
    """Six numbers of one camera.

    `Intrinsics` and `BrownDistortion` with skew, k3, p1 and p2 frozen give the same pixels; products with frozen
    zeros remain in the compiled program, which the peers' programs do not have.
    """

    fx: Scalar
    fy: Scalar
    cx: Scalar
    cy: Scalar
    k1: Scalar
    k2: Scalar

    def project(self, p_camera: Vector3) -> Vector2:
        """Pixel of a point in camera coordinates. Source: optical tracking document, eq. 4.16-4.18."""
        x, y = p_camera[0] / p_camera[2], p_camera[1] / p_camera[2]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * self.k2)
        return jnp.stack([self.fx * x * radial + self.cx, self.fy * y * radial + self.cy])


class BarCameras(eqx.Module):
    """Shared unknowns: both cameras and the second one's pose; the first one is the frame."""

    first: BarCamera
    second: BarCamera
    T_second_first: Pose


class BarMarkers(eqx.Module):
    """Local unknowns: both markers in the first camera's frame [m]."""

    a: Float[Array, "*blocks 3"]
    b: Float[Array, "*blocks 3"]


class BarImages(eqx.Module):
    """Where the cameras saw the markers [px]; markers along the second last axis."""

    first: Float[Array, "*blocks 2 2"]
    second: Float[Array, "*blocks 2 2"]


class BarSigmas(eqx.Module):
    """Common to all blocks: the bar's length and what residuals are measured in."""

    length: Scalar
    """[m]."""
    sigma_px: Scalar
    """Standard deviation of a pixel coordinate [px]."""
    sigma_length: Scalar
    """Standard deviation of the length [m]."""


class BarWorld(eqx.Module):
    """A drawn problem with its truth and a start a few percent away from it."""

    truth: ArrowVariables
    start: ArrowVariables
    images: BarImages
    common: BarSigmas


def bar_residuals(cameras: BarCameras, markers: BarMarkers, images: BarImages, common: BarSigmas) -> Array:
    """Nine residuals of one bar: four images and the length, in units of sigma.

    Source: optical tracking document, 4.5 (its sum over the views of the bar).
    """
    out = []
    for k, p in enumerate((markers.a, markers.b)):
        out.append((cameras.first.project(p) - images.first[k]) / common.sigma_px)
        p_second = cameras.T_second_first.act(p)
        out.append((cameras.second.project(p_second) - images.second[k]) / common.sigma_px)
    d = markers.a - markers.b
    length = jnp.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return jnp.concatenate([*out, ((length - common.length) / common.sigma_length)[None]])


BAR_PROBLEM = ArrowProblem(bar_residuals)


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def _images(cameras: BarCameras, markers: BarMarkers) -> BarImages:
    """Images of the markers of every block."""
    pair = (markers.a, markers.b)
    second = [cameras.second.project(cameras.T_second_first.act(p)) for p in pair]
    return BarImages(jnp.stack([cameras.first.project(p) for p in pair]), jnp.stack(second))


def true_cameras() -> BarCameras:
    """Two slightly different cameras at 90 degrees, the second one to the right."""
    first = BarCamera(*map(jnp.array, (520.0, 524.0, 322.0, 237.0, -0.20, 0.05)))
    second = BarCamera(*map(jnp.array, (512.0, 515.0, 316.0, 242.0, -0.18, 0.04)))
    # Both are 3 m / sqrt(2) away from the middle of the volume, which lies on the first one's axis.
    reach = _BASELINE / np.sqrt(2.0)
    turned = Pose(jnp.array([0.0, 0.5 * np.pi, 0.0]), jnp.array([-reach, 0.0, reach]))
    return BarCameras(first, second, Pose(jnp.array([0.01, 0.02, -0.015]), jnp.zeros(3)).compose(turned))


def _candidates(rng: np.random.Generator, count: int) -> BarMarkers:
    """Bars anywhere in the volume, in any direction; the volume stands symmetrically between the cameras."""
    middle = rng.uniform(-0.5, 0.5, (count, 3)) * np.array(VOLUME)
    direction = rng.normal(size=(count, 3))
    half = 0.5 * BAR_LENGTH * direction / np.linalg.norm(direction, axis=1)[:, None]
    c = np.sqrt(0.5)
    turn = np.array([[c, 0.0, c], [0.0, 1.0, 0.0], [-c, 0.0, c]])
    ahead = np.array([0.0, 0.0, _BASELINE * c])
    return BarMarkers(jnp.asarray((middle + half) @ turn.T + ahead), jnp.asarray((middle - half) @ turn.T + ahead))


def _in_view(cameras: BarCameras, markers: BarMarkers) -> np.ndarray:
    """True for bars with all four images inside the pictures."""
    limit = np.array(IMAGE_SIZE) - 1.0
    images = _images(cameras, markers)
    seen = np.ones(markers.a.shape[0], bool)
    for uv in (np.asarray(images.first), np.asarray(images.second)):
        seen &= ((uv >= 0) & (uv <= limit)).all(axis=(1, 2))
    for p in (markers.a, markers.b):
        p_second = jax.vmap(cameras.T_second_first.act)(p)
        seen &= np.asarray((p[:, 2] > _NEAREST) & (p_second[:, 2] > _NEAREST))
    return seen


def _draw_markers(rng: np.random.Generator, cameras: BarCameras, blocks: int) -> BarMarkers:
    """The first bars that both cameras see whole."""
    found: list[BarMarkers] = []
    while sum(m.a.shape[0] for m in found) < blocks:
        drawn = _candidates(rng, 4 * blocks + 64)
        keep = np.flatnonzero(_in_view(cameras, drawn))
        found.append(BarMarkers(drawn.a[keep], drawn.b[keep]))
    return jax.tree.map(lambda *parts: jnp.concatenate(parts)[:blocks], *found)


def _off(rng: np.random.Generator, x: Array, fraction: float) -> Array:
    """Every number off by a few percent of itself."""
    return x * (1.0 + fraction * rng.standard_normal(x.shape))


def _start_camera(rng: np.random.Generator, camera: BarCamera, error: float) -> BarCamera:
    """Focal lengths a little wrong, principal point in the middle, no distortion."""
    zero = jnp.zeros(())
    cx, cy = (jnp.array(0.5 * (n - 1)) for n in IMAGE_SIZE)
    return BarCamera(_off(rng, camera.fx, error), _off(rng, camera.fy, error), cx, cy, zero, zero)


def _start(rng: np.random.Generator, truth: ArrowVariables, error: float) -> ArrowVariables:
    """Start values off by about `error` of each quantity."""
    cameras, T = truth.shared, truth.shared.T_second_first
    pose = Pose(T.rotvec + error * jnp.asarray(rng.standard_normal(3)), _off(rng, T.translation, error))
    shared = BarCameras(_start_camera(rng, cameras.first, error), _start_camera(rng, cameras.second, error), pose)
    return ArrowVariables(shared, jax.tree.map(lambda p: _off(rng, p, error), truth.local))


def make_bar(
    blocks: int,
    seed: int = 0,
    *,
    sigma_px: float = 0.2,
    sigma_length: float = 1e-4,
    noise: float = 1.0,
    start_error: float = 0.02,
) -> BarWorld:
    """Draw a bar problem.

    Args:
        blocks: number of places the bar is seen at.
        seed: the same number gives the same problem.
        sigma_px: what pixel residuals are divided by [px].
        sigma_length: what the length residual is divided by [m].
        noise: standard deviation of the pixel noise in units of sigma_px; 0 gives perfect images.
        start_error: how far the start is off, as a fraction of each number.
    Returns:
        BarWorld; solve it by `least_squares(BAR_PROBLEM, world.start, world.images, world.common)`.
    Raises:
        InputError: fewer than one block.
    Source: optical tracking document, 4.5, the setting of its reference numbers.
    """
    if blocks < 1:
        raise InputError(f"blocks: expected at least 1, got {blocks}")
    rng = np.random.default_rng(seed)
    cameras = true_cameras()
    markers = _draw_markers(rng, cameras, blocks)
    truth = ArrowVariables(cameras, markers)
    shift = lambda uv: uv + noise * sigma_px * jnp.asarray(rng.standard_normal(uv.shape))  # noqa: E731
    images = jax.tree.map(shift, _images(cameras, markers))
    common = BarSigmas(jnp.array(BAR_LENGTH), jnp.array(sigma_px), jnp.array(sigma_length))
    return BarWorld(truth, _start(rng, truth, start_error), images, common)
