"""Candidates as rays in the world, and points as places in the photographs: the geometry that naming needs.

NumPy: these are many small steps on few numbers. The lens is inverted once, by the camera model itself.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial.transform import Rotation

from jaxmocap._errors import InputError
from jaxmocap._programs import program
from jaxmocap.cameras.camera import Camera
from jaxmocap.cameras.distortion import BrownDistortion, undistort
from jaxmocap.cameras.intrinsics import Intrinsics
from jaxmocap.tracking.candidates import CandidateTable

_PIECE = 512  # candidates for which the lens is inverted at once
_MOST_SLACK = 3.0  # a candidate that may be anywhere confirms nothing


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
    slack: Float[np.ndarray, "photos slots"]
    """How many times less exact a candidate is than most, 1 to 3: its distances count so many times less."""

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

        Divided by the candidate's slack: a bead half hidden behind another may miss its place by more.
        Measured with the lens removed: within the gates used here that is the distance in the photograph up to the
        local magnification of the lens (some per cent).

        Source: stop-motion document, eq. 4.8-4.9.
        """
        place = self.offsets(np.asarray(p_world, float))
        place = np.where(np.isfinite(place), place, 1e6)
        delta = (self.xy[None] - place[:, :, None]) * self.focal[None, :, None]
        return np.where(self.valid[None], np.hypot(delta[..., 0], delta[..., 1]) / self.slack[None], np.inf)


def look(cameras: Camera, table: CandidateTable) -> PhotoViews:
    """Views of the candidates through cameras stacked over the photographs.

    Raises:
        InputError: if the number of cameras is not that of the photographs.
    Source: stop-motion document, eq. 5.1-5.8, the distortion removed first as its 8.2 asks for.
    """
    shape = cameras.T_camera_world.rotvec.shape
    if shape != (len(table.uv), 3):
        raise InputError(f"cameras: expected a stack of {len(table.uv)}, one for each photograph, got shape {shape}.")
    K, pose = cameras.intrinsics, cameras.T_camera_world
    R = Rotation.from_rotvec(np.array(pose.rotvec, float)).as_matrix()
    centre = -np.einsum("kji,kj->ki", R, np.asarray(pose.translation, float))
    xy, exists = _without_lens(cameras, table.uv)
    v_camera = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
    v_world = np.einsum("kji,ksj->ksi", R, v_camera / np.linalg.norm(v_camera, axis=-1, keepdims=True))
    focal = np.stack([np.asarray(K.fx, float), np.asarray(K.fy, float)], axis=-1)
    typical = np.median(table.sigma[table.filled]) if table.filled.any() else 1.0
    slack = np.clip(table.sigma / typical, 1.0, _MOST_SLACK)
    return PhotoViews(R, centre, focal, xy, v_world, table.filled & exists, slack)


def _without_lens(cameras: Camera, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normalised coordinates of all candidates, and whether the lens can be inverted there.

    In pieces of one size, so that one compiled function serves every number of photographs and candidates.
    """
    photos, slots = uv.shape[:2]
    flat = uv.reshape(-1, 2)
    owner = np.repeat(np.arange(photos), slots)
    xy, exists = np.zeros_like(flat), np.zeros(len(flat), bool)
    lens = jax.tree.map(np.asarray, (cameras.intrinsics, cameras.distortion))
    for start in range(0, len(flat), _PIECE):
        piece = np.arange(start, min(start + _PIECE, len(flat)))
        padded = np.resize(piece, _PIECE)
        intrinsics, distortion = jax.tree.map(lambda leaf, rows=owner[padded]: jnp.asarray(leaf[rows]), lens)
        found = _undistort_all(intrinsics, distortion, jnp.asarray(flat[padded]))
        xy[piece], exists[piece] = (np.asarray(part)[: len(piece)] for part in found)
    return xy.reshape(photos, slots, 2), exists.reshape(photos, slots)


@program
def _undistort_all(
    intrinsics: Intrinsics, lens: BrownDistortion, uv: Float[Array, "points 2"]
) -> tuple[Float[Array, "points 2"], Bool[Array, "points"]]:
    return jax.vmap(lambda K, lens, uv: undistort(lens, K.normalised_from_pixel(uv)))(intrinsics, lens, uv)


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
