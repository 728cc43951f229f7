"""Start values of a turntable: from the poses of a board on it, whose rotations share one axis, or nominal ones."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from jaxmocap._errors import SolveError
from jaxmocap._programs import program
from jaxmocap.calibration.boards import Lens
from jaxmocap.calibration.start import start_poses
from jaxmocap.calibration.turntable import BeadScene, BoardScene
from jaxmocap.cameras import Camera, Turntable, turntable_from_axis
from jaxmocap.geometry import Pose
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowVariables
from jaxmocap.reconstruction import fit_point_linear, rays

# Two poses of a board that was turned by less than this say nothing of the axis: the rotation between them is known
# to about (corner noise 0.1 px) / (board of 100 px) = 0.06 degrees at best.
_LEAST_TURN = np.radians(0.5)
# A rotation whose axis is off the common one by more does not belong: the mirrored pose of a flat board is off by
# twice its tilt, and a tilt below half of this is one that cannot be told from its mirror image.
_OFF_AXIS = np.radians(10.0)


class TurntableStart(NamedTuple):
    """A turntable as the board poses say."""

    point: Float[np.ndarray, "3"]
    """Point of the axis nearest the camera centre, camera frame [scene]."""
    direction: Float[np.ndarray, "3"]
    """Unit direction of the axis, up in the picture."""
    angles: Float[np.ndarray, "photos"]
    """Angle of each photo from the first one [rad], in (-pi, pi]; positive anticlockwise seen from above."""
    best: int
    """Photo whose board pose agrees best with all the others."""


def start_turntable(T_camera_board: Float[np.ndarray, "photos 4 4"]) -> TurntableStart:
    """Axis and angles from board poses.

    For two photos T_ij = T_i T_j^-1 is a turn about the axis: its rotation vector lies along the axis, and the axis
    is where it moves no point.

    Args:
        T_camera_board: poses of the board, at least two.

    Returns:
        TurntableStart.

    Raises:
        SolveError: if the board did not turn between any two photos, or its turns share no axis.
    Source: Strobl et al. and others on hand-eye calibration (A X = X B with one axis); Rodrigues' axis of a rotation.
    """
    i, j = np.triu_indices(len(T_camera_board), 1)
    T = T_camera_board[i] @ np.linalg.inv(T_camera_board[j])
    w = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    turn = np.linalg.norm(w, axis=1)
    use = turn > _LEAST_TURN
    if not use.any():
        raise SolveError(
            f"The turntable did not turn: between no two photos did the board turn by more than "
            f"{np.degrees(_LEAST_TURN):g} degrees (largest {np.degrees(turn.max(initial=0.0)):.2g}). Turn it by its "
            "steps between the photos; copies of one photo under several names do the same."
        )
    T, w = T[use], w[use]
    direction, own = _common_direction(w)
    R, t = T[own, :3, :3], T[own, :3, 3]
    A = np.concatenate([*(np.eye(3) - R), direction[None]])
    point = np.linalg.lstsq(A, np.append(t.ravel(), 0.0), rcond=None)[0]
    turns = np.stack([_turn_about(direction, T_camera_board[:, :3, :3], k) for k in range(len(T_camera_board))])
    best = int(np.argmin(turns[:, :, 1].sum(axis=1)))
    angles = turns[best, :, 0] - turns[best, 0, 0]
    return TurntableStart(point, direction, (angles + np.pi) % (2 * np.pi) - np.pi, best)


def _common_direction(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direction that most rotation vectors lie along, upwards in the picture (-y), and which of them do."""
    unit = w / np.linalg.norm(w, axis=1, keepdims=True)
    off = np.arccos(np.clip(np.abs(unit @ unit.T), 0, 1))
    votes = np.minimum(off, _OFF_AXIS) @ np.linalg.norm(w, axis=1)
    own = off[int(np.argmin(votes))] < _OFF_AXIS
    direction = np.linalg.svd(w[own])[2][0]
    return direction * (1.0 if direction[1] < 0 else -1.0), own


def _turn_about(direction: np.ndarray, R: np.ndarray, k: int) -> np.ndarray:
    """(photos, 2): turn about a direction from photo k to each that explains its rotation best; what is left over."""
    D = R @ R[k].T
    sine = np.einsum("i,pi->p", direction, np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0],
                                                       D[:, 1, 0] - D[:, 0, 1]], axis=1))  # fmt: skip
    cosine = np.trace(D, axis1=1, axis2=2) - np.einsum("i,pij,j->p", direction, D, direction)
    angle = np.arctan2(sine, cosine)
    left = Rotation.from_rotvec(-angle[:, None] * direction[None]) * Rotation.from_matrix(D)
    return np.stack([angle, left.magnitude()], axis=1)


def _refuse_turning_camera(
    found: TurntableStart, points: Float[np.ndarray, "points 3"], T_camera_board: Float[np.ndarray, "photos 4 4"]
) -> None:
    """Refuse an axis so near the camera that the board, turning about it, would sweep past the camera."""
    T = T_camera_board[found.best]
    off = points @ T[:3, :3].T + T[:3, 3] - found.point
    radius = float(np.linalg.norm(off - np.outer(off @ found.direction, found.direction), axis=1).min())
    distance = float(np.linalg.norm(found.point))
    if distance <= radius:
        raise SolveError(
            f"The axis passes at {distance:.4g} from the camera, and at {radius:.4g} from the board: it was the camera "
            "that turned, or board and camera stand on the turntable together. Leave the camera where it is and turn "
            "the board."
        )


def start_board(
    lens: Lens,
    points: Float[np.ndarray, "points 3"],
    uv: Float[np.ndarray, "photos points 2"],
    stated: Float[np.ndarray, "photos"],
    held: int,
    height: float,
) -> tuple[ArrowVariables, np.ndarray]:
    """Start values for `calibration.turntable.solve_board`, from nothing but the photos.

    Args:
        lens: of the camera.
        points: of the board in its own frame [scene].
        uv: where they were seen [px].
        stated: angles [rad]; only that of the held photo is used.
        held: photo whose stated angle counts.
        height: of the point of the axis nearest the camera centre above the origin [scene].

    Returns:
        ArrowVariables(BoardScene, angles); RMS length of the residuals of each photo with a pose of its own [px].

    Raises:
        SolveError: as `start_turntable`, or boards without a pose.
    Source: as `start_turntable`.
    """
    seen = np.ones(uv.shape[:2], bool)
    T, rms, use = start_poses(lens, np.tile(points, (len(uv), 1, 1)), uv, seen)
    if not use.all():
        raise SolveError("In some photos the corners of the board lie on one line: it is seen edge-on. Leave them out.")
    found = start_turntable(T)
    _refuse_turning_camera(found, points, T)
    angles = stated[held] + found.angles - found.angles[held]
    table = turntable_from_axis(jnp.asarray(found.point), jnp.asarray(found.direction), jnp.asarray(height))
    world = np.asarray(table.pose(jnp.asarray(angles[found.best])).inverse().matrix()) @ T[found.best]
    board = Pose(jnp.asarray(Rotation.from_matrix(world[:3, :3]).as_rotvec()), jnp.asarray(world[:3, 3]))
    return ArrowVariables(BoardScene(table, board, lens), jnp.asarray(angles)), rms


def start_beads(
    turntable: Turntable, angles: Float[Array, "photos"], lens: Lens, seen: PixelObservations
) -> ArrowVariables:
    """Start values for `calibration.turntable.solve_beads`: beads where the assumed turntable puts them.

    Args:
        turntable: nominal, or of a calibration.
        angles: stated [rad].
        lens: of the camera.
        seen: (beads, photos).

    Returns:
        ArrowVariables(BeadScene, beads (beads, 3) [scene]); a bead of fewer than two photos starts on the axis.
    Source: stop-motion document, 5.2.
    """
    points, valid = _triangulated(turntable, angles, lens, seen)
    on_axis = jnp.stack([jnp.zeros(()), turntable.height, jnp.zeros(())])
    return ArrowVariables(BeadScene(turntable, angles, lens), jnp.where(valid[:, None], points, on_axis[None]))


@program
def _triangulated(
    turntable: Turntable, angles: Array, lens: Lens, seen: PixelObservations
) -> tuple[Float[Array, "beads 3"], Array]:
    many = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(angles), *x.shape)), lens)
    # Nothing here asks for the size of the picture.
    cameras = Camera(many.intrinsics, many.distortion, jax.vmap(turntable.pose)(angles), (0, 0))
    return jax.vmap(lambda uv, use: fit_point_linear(*rays(cameras, uv, use)))(seen.uv, seen.visible)
