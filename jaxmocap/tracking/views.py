"""Candidates as rays in the world, and points as places in the photographs: the geometry that naming needs.

NumPy: these are many small steps on few numbers. The lens is inverted once, by the camera model itself.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._errors import InputError
from jaxmocap.cameras.camera import Camera, ray_from_pixel
from jaxmocap.geometry import rotation
from jaxmocap.tracking.candidates import CandidateTable


@dataclass(frozen=True)
class PhotoViews:
    """Cameras and candidates of a set of photographs, the lens removed."""

    R_camera_world: Float[np.ndarray, "photos 3 3"]
    centre_world: Float[np.ndarray, "photos 3"]
    """Camera centres [scene]."""
    focal: Float[np.ndarray, "photos 2"]
    """fx, fy [px]."""
    xy: Float[np.ndarray, "photos slots 2"]
    """Candidates in normalised coordinates, lens removed."""
    v_world: Float[np.ndarray, "photos slots 3"]
    """Unit directions of the candidates' rays."""
    valid: Bool[np.ndarray, "photos slots"]
    """True where there is a candidate and its ray exists."""

    def offsets(self, p_world: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points photos 2"]:
        """Normalised coordinates of points in all photographs; infinite behind a camera.

        Source: stop-motion document, eq. 4.5-4.9.
        """
        p_camera = np.einsum("kij,pkj->pki", self.R_camera_world, p_world[:, None] - self.centre_world)
        depth = p_camera[..., 2:]
        front = depth > 0
        return np.where(front, p_camera[..., :2] / np.where(front, depth, 1.0), np.inf)

    def distances(self, p_world: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points photos slots"]:
        """Distance of every candidate from the place of every point [px], infinite where it cannot be one.

        Measured with the lens removed: within the gates used here that is the distance in the photograph up to the
        local magnification of the lens (some per cent).

        Source: stop-motion document, eq. 4.8-4.9.
        """
        place = self.offsets(np.asarray(p_world, float))
        place = np.where(np.isfinite(place), place, 1e6)
        delta = (self.xy[None] - place[:, :, None]) * self.focal[None, :, None]
        return np.where(self.valid[None], np.hypot(delta[..., 0], delta[..., 1]), np.inf)


def look(cameras: Camera, table: CandidateTable) -> PhotoViews:
    """Views of the candidates through cameras stacked over the photographs.

    Raises:
        InputError: if the number of cameras is not that of the photographs.
    Source: stop-motion document, eq. 5.1-5.8, the distortion removed first as its 8.2 asks for.
    """
    shape = cameras.T_camera_world.rotvec.shape
    if shape != (len(table.uv), 3):
        raise InputError(f"cameras: expected a stack of {len(table.uv)}, one for each photograph, got shape {shape}.")
    centre, v_world, exists, R, focal = (np.asarray(a) for a in _rays(cameras, jnp.asarray(table.uv)))
    v_camera = np.einsum("kij,ksj->ksi", R, v_world)
    front = v_camera[..., 2:] > 0
    xy = np.where(front, v_camera[..., :2] / np.where(front, v_camera[..., 2:], 1.0), 0.0)
    return PhotoViews(R, centre, focal, xy, v_world, table.filled & exists & front[..., 0])


@eqx.filter_jit
def _rays(cameras: Camera, uv: Float[Array, "photos slots 2"]) -> tuple[Array, Array, Array, Array, Array]:
    def one(camera: Camera, uv: Float[Array, "slots 2"]):
        centre, v_world, valid = jax.vmap(ray_from_pixel, (None, 0), (None, 0, 0))(camera, uv)
        focal = jnp.stack([camera.intrinsics.fx, camera.intrinsics.fy])
        return centre, v_world, valid, rotation.exp(camera.T_camera_world.rotvec), focal

    return jax.vmap(one)(cameras, uv)


def meet(
    centre: Float[np.ndarray, "*batch rays 3"],
    v_world: Float[np.ndarray, "*batch rays 3"],
    weight: Float[np.ndarray, "*batch rays"],
) -> Float[np.ndarray, "*batch 3"]:
    """Point nearest to rays in the sense of least squares; rays of weight zero do not count.

    sum_i w_i (I - v_i v_i^T) x = sum_i w_i (I - v_i v_i^T) c_i. Parallel rays give the point of least length among
    the solutions: finite, and refused later by its distances.

    Source: stop-motion document, eq. 5.9-5.13 (normal equations of 5.11).
    """
    across = np.eye(3) - v_world[..., :, None] * v_world[..., None, :]
    A = np.einsum("...r,...rij->...ij", weight, across)
    y = np.einsum("...r,...rij,...rj->...i", weight, across, centre)
    return np.einsum("...ij,...j->...i", np.linalg.pinv(A, hermitian=True), y)
