"""The table of comparisons: what autodiff gives beside what a document derives by hand."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, project
from jaxmocap.closed_forms import camera, distortion
from jaxmocap.closed_forms import rotation as by_hand
from jaxmocap.geometry import Pose, rotation


@dataclass(frozen=True)
class Pair:
    """One function, its derivative by its FIRST argument in closed form, and where to compare the two."""

    name: str
    document: str
    equation: str
    function: Callable[..., Any]
    """x, *rest -> array; autodiff differentiates it by x, one flat vector."""
    closed_form: Callable[..., Any]
    """x, *rest -> derivative, the axis of x last."""
    sampler: Callable[[np.random.Generator], tuple[Any, ...]]
    """The arguments, stacked on a leading axis; the singular places come first, random ones after."""
    tolerance: float = 1e-9
    """Largest difference, relative to the largest entry of the derivative or 1."""


def _rotvecs(rng: np.random.Generator) -> np.ndarray:
    """0, tiny, around pi, around 2 pi, then random up to two turns: 16 rotation vectors."""
    angles = [0.0, 1e-12, 1e-7, 1e-3, 1.0, np.pi - 1e-7, np.pi, np.pi + 1e-7, 2 * np.pi]
    angle = np.concatenate([angles, rng.uniform(0, 4 * np.pi, 16 - len(angles))])
    axis = rng.normal(size=(16, 3))
    return angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True)


def _rotation_and_point(rng: np.random.Generator) -> tuple[jax.Array, jax.Array]:
    return jnp.asarray(_rotvecs(rng)), jnp.asarray(rng.normal(size=(16, 3)))


def _rotation_only(rng: np.random.Generator) -> tuple[jax.Array]:
    return (jnp.asarray(_rotvecs(rng)),)


def _lens_numbers(rng: np.random.Generator) -> np.ndarray:
    """The ideal lens first, then random ones."""
    return rng.normal(size=(16, 5)) * [0.2, 0.1, 0.01, 0.01, 0.03] * (np.arange(16) > 0)[:, None]


def _point_and_lens(rng: np.random.Generator) -> tuple[jax.Array, jax.Array]:
    """Image points, the first four at the principal point."""
    return jnp.asarray(0.4 * rng.normal(size=(16, 2)) * (np.arange(16) > 3)[:, None]), jnp.asarray(_lens_numbers(rng))


def _lens_and_point(rng: np.random.Generator) -> tuple[jax.Array, jax.Array]:
    xy, lens = _point_and_lens(rng)
    return lens, xy


def _cameras(rng: np.random.Generator) -> tuple[Camera, np.ndarray]:
    """Cameras of every rotation of `_rotvecs` with a point in front of each."""
    ones = np.ones(16)
    numbers = (800 * ones, 810 * ones, 320 * ones, 240 * ones, rng.normal(size=16))
    p_camera = np.concatenate([rng.uniform(-1, 1, (16, 2)), rng.uniform(2, 5, (16, 1))], axis=1)
    p_camera[0, :2] = 0.0  # on the optical axis
    rotvec, t = jnp.asarray(_rotvecs(rng)), jnp.asarray(rng.normal(size=(16, 3)))
    lens = BrownDistortion(*jnp.asarray(_lens_numbers(rng).T))
    cameras = Camera(Intrinsics(*(jnp.asarray(n) for n in numbers)), lens, Pose(rotvec, t), (640, 480))
    return cameras, np.asarray(jax.vmap(rotation.rotate)(-rotvec, jnp.asarray(p_camera) - t))


def _point_and_camera(rng: np.random.Generator) -> tuple[jax.Array, Camera]:
    cameras, p_world = _cameras(rng)
    return jnp.asarray(p_world), cameras


def _rotvec_and_camera(rng: np.random.Generator) -> tuple[jax.Array, Camera, jax.Array]:
    cameras, p_world = _cameras(rng)
    return cameras.T_camera_world.rotvec, cameras, jnp.asarray(p_world)


def _turned(view: Camera, rotvec: jax.Array) -> Camera:
    pose = Pose(rotvec, view.T_camera_world.translation)
    return Camera(view.intrinsics, view.distortion, pose, view.image_size)


PAIRS: tuple[Pair, ...] = (
    Pair("matrix by rotation vector", "004", "3.11", rotation.exp, by_hand.J_matrix_rotvec, _rotation_only),
    Pair("W P by rotation vector", "004", "5.42", rotation.rotate, by_hand.J_rotated_rotvec, _rotation_and_point),
    Pair(
        "real point by ideal point",
        "004",
        "4.16",
        lambda xy, k: BrownDistortion.from_vector(k).distort(xy),
        lambda xy, k: distortion.J_distorted_ideal(BrownDistortion.from_vector(k), xy),
        _point_and_lens,
    ),
    Pair(
        "real point by lens numbers",
        "004",
        "4.17",
        lambda k, xy: BrownDistortion.from_vector(k).distort(xy),
        lambda k, xy: distortion.J_distorted_numbers(xy),
        _lens_and_point,
    ),
    Pair(
        "pixel by point",
        "004",
        "4.18",
        lambda p, view: project(view, p)[0],
        lambda p, view: camera.J_uv_point(view, p),
        _point_and_camera,
    ),
    Pair(
        "pixel by rotation vector",
        "004",
        "4.18",
        lambda w, view, p: project(_turned(view, w), p)[0],
        lambda w, view, p: camera.J_uv_rotvec(_turned(view, w), p),
        _rotvec_and_camera,
    ),
)
"""Every row is checked by tests/jacobians at singular and random samples. Equations as headed in the documents."""
