"""Random and deliberately singular inputs, drawn with numpy alone: nothing here calls jaxmocap."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import jax
import numpy as np
from scipy.spatial.transform import Rotation

ROTATION_KINDS = (
    "uniform",
    "1e-7 from identity",
    "1e-12 from identity",
    "identity",
    "just below pi",
    "pi",
    "just above pi",
    "beyond 2 pi",
)


def unit_vectors(rng: np.random.Generator, n: int) -> np.ndarray:
    """Directions, uniform on the sphere; the first three are the axes x, y, z."""
    v = rng.normal(size=(n, 3))
    v[: min(n, 3)] = np.eye(3)[: min(n, 3)]
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def rotation_vectors(kind: str, n: int = 8, seed: int = 0) -> np.ndarray:
    """n rotation vectors of one kind, shape (n, 3)."""
    rng = np.random.default_rng([seed, ROTATION_KINDS.index(kind)])
    if kind == "uniform":
        return Rotation.from_quat(rng.normal(size=(n, 4))).as_rotvec()
    angle = {
        "1e-7 from identity": np.full(n, 1e-7),
        "1e-12 from identity": np.full(n, 1e-12),
        "identity": np.zeros(n),
        "just below pi": np.full(n, np.pi - 1e-7),
        "pi": np.full(n, np.pi),
        "just above pi": np.full(n, np.pi + 1e-7),
        "beyond 2 pi": rng.uniform(2 * np.pi, 6 * np.pi, n),
    }[kind]
    return unit_vectors(rng, n) * angle[:, None]


def all_rotation_vectors(n: int = 8, seed: int = 0) -> np.ndarray:
    """n rotation vectors of every kind, one after another."""
    return np.concatenate([rotation_vectors(kind, n, seed) for kind in ROTATION_KINDS])


def growth_roots(k: np.ndarray) -> np.ndarray:
    """Positive real roots s = r^2 of 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3, ascending, by numpy; k = k1 k2 p1 p2 k3."""
    roots = np.roots(np.trim_zeros([7 * k[4], 5 * k[1], 3 * k[0], 1.0], "f"))
    real = roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)]
    return np.sort(real[real > 0])


def invertible_radius(k: np.ndarray) -> float:
    """Ideal radius up to which the radial part of a lens k1 k2 p1 p2 k3 grows; infinite if it always does."""
    roots = growth_roots(k)
    return float(np.sqrt(roots[0])) if len(roots) else float("inf")


@dataclass(frozen=True)
class CameraNumbers:
    """One camera as plain numbers."""

    K: np.ndarray
    k: np.ndarray
    """Distortion k1 k2 p1 p2 k3."""
    rotvec: np.ndarray
    translation: np.ndarray
    size: tuple[int, int]

    def radius_in_view(self) -> float:
        """Ideal radius that is safely inside both the picture and the invertible range."""
        width, height = self.size
        corner = np.hypot(width / self.K[0, 0], height / self.K[1, 1]) / 2
        return float(min(corner, 0.8 * invertible_radius(self.k)))


def cameras(n: int = 6, seed: int = 0, skew: bool = True, wide: bool = False) -> list[CameraNumbers]:
    """Cameras of focal length 300..3000 px with all five distortion numbers, invertible over their picture.

    With `wide` the lens may fold back inside the picture.
    """
    rng = np.random.default_rng([seed, 101])
    found: list[CameraNumbers] = []
    while len(found) < n:
        width, height = [(640, 480), (1280, 720), (1920, 1080)][len(found) % 3]
        f = np.exp(rng.uniform(np.log(300), np.log(3000)))
        K = np.array([[f, 0, width / 2], [0, f * rng.uniform(0.9, 1.1), height / 2], [0, 0, 1.0]])
        K[:2, 2] += rng.normal(0, 20, 2)
        K[0, 1] = rng.uniform(-5, 5) if skew else 0.0
        k = rng.normal(size=5) * np.array([0.2, 0.1, 0.002, 0.002, 0.03])
        numbers = CameraNumbers(
            K, k, Rotation.from_quat(rng.normal(size=4)).as_rotvec(), rng.normal(size=3), (width, height)
        )
        if wide or numbers.radius_in_view() < 0.7 * invertible_radius(k):
            found.append(numbers)
    return found


def points_in_view(camera: CameraNumbers, n: int = 20, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """World points in front of a camera, inside its invertible radius, and their camera coordinates: (n, 3) each."""
    rng = np.random.default_rng([seed, 202])
    radius = camera.radius_in_view() * np.sqrt(rng.uniform(0, 1, n))
    phi = rng.uniform(0, 2 * np.pi, n)
    depth = rng.uniform(0.5, 20, n)
    p_camera = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.ones(n)], axis=1) * depth[:, None]
    return Rotation.from_rotvec(camera.rotvec).inv().apply(p_camera - camera.translation), p_camera


@cache
def _compiled(fn: Callable) -> Callable:
    return jax.jit(jax.vmap(fn))


def over(fn: Callable, *samples):
    """fn applied to every sample (leading axis), as numpy. Compiled once per fn: hand it named functions."""
    return jax.tree.map(np.asarray, _compiled(fn)(*jax.tree.map(jax.numpy.asarray, samples)))


def central_difference(fn, x: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """d fn / d x of a function of one vector, with the axis of x last; error about h^2 plus 1e-16 / h."""
    columns = [
        (np.asarray(fn(jax.numpy.asarray(x + h * e))) - np.asarray(fn(jax.numpy.asarray(x - h * e)))) / (2 * h)
        for e in np.eye(x.size)
    ]
    return np.stack(columns, axis=-1)
