"""From the plain numbers of a file to a camera: every check that does not depend on the file format."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics
from jaxmocap.geometry import Pose, rotation
from jaxmocap.io.text_file import short


@dataclass(frozen=True)
class NamedCamera:
    """A camera with the name by which tables and photos refer to it."""

    name: str
    """Any text but the empty one."""
    camera: Camera
    """One camera, without a leading camera axis."""
    foreign: dict[str, Any] = field(default_factory=dict)
    """Keys of its table in a file that are not ours: kept and written back."""
    warnings: tuple[str, ...] = ()
    """What is odd about it, said when it was read."""


_MAX_PIXELS = 1_000_000
# A matrix printed with six digits is this far from a rotation; one that was scaled or sheared is further.
_ROUNDED, _NOT_A_ROTATION = 1e-6, 1e-3
_LENSES = {2: "k1 k2", 4: "k1 k2 p1 p2", 5: "k1 k2 p1 p2 k3"}


def numbers(where: str, value: object, depth: int = 2) -> np.ndarray:
    """Nested lists of numbers as a float64 array.

    Args:
        where: file, table and key, for the message.
        value: a number, or lists of equal length.
        depth: how deep lists may be nested.

    Raises:
        InputError: if something is not a number, rows differ in length, or a number is NaN or infinite.
    """
    if isinstance(value, list):
        parts = [numbers(where, entry, depth - 1) for entry in value] if depth and len(value) <= 100 else None
        if parts is None or len({part.shape for part in parts}) > 1:
            raise InputError(f"{where}: expected numbers, or rows of equally many numbers, got {short(value)}.")
        return np.stack(parts) if parts else np.zeros(0)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: expected numbers, got {short(value)}. Is the camera calibrated?")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{where}: holds {short(value)}, not a usable number. Calibrate the camera again.")
    return np.asarray(number)


def intrinsics_from_matrix(where: str, value: object) -> Intrinsics:
    """Intrinsics of a 3x3 calibration matrix.

    Raises:
        InputError: if it is not one: shape, lower triangle, K[2][2], focal lengths.
    """
    K = numbers(where, value)
    if K.shape != (3, 3):
        raise InputError(f"{where}: expected 3 rows of 3 numbers, got shape {K.shape}.")
    if K[2, 0] != 0 or K[2, 1] != 0 or K[1, 0] != 0:
        hint = " It looks transposed." if K[0, 2] == 0 and K[1, 2] == 0 else ""
        raise InputError(f"{where}: expected zeros below the diagonal of K, got {K.tolist()}.{hint}")
    if K[2, 2] != 1:
        raise InputError(f"{where}: expected K[2][2] = 1, got {K[2, 2]}. Divide the matrix by it.")
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise InputError(
            f"{where}: expected positive focal lengths, got fx = {K[0, 0]}, fy = {K[1, 1]}. "
            "A mirrored image must be flipped back before calibrating."
        )
    return Intrinsics.from_matrix(jnp.asarray(K))


def lens_from_numbers(where: str, value: object, say: Callable[[str], None]) -> BrownDistortion:
    """Lens of 2 (k1 k2), 4 (k1 k2 p1 p2) or 5 (k1 k2 p1 p2 k3) numbers in OpenCV's order.

    Raises:
        InputError: for another number of them; more than 5 are read if the rest is zero.
    """
    k = numbers(where, value).ravel()
    if k.size > 5 and not k[5:].any():
        k = k[:5]
    if k.size not in _LENSES:
        more = " The rational, thin-prism and tilted models are not supported: calibrate with k1 k2 p1 p2 k3."
        raise InputError(
            f"{where}: expected 5 numbers (k1 k2 p1 p2 k3) or 4, got {k.size}.{more if k.size > 5 else ''}"
        )
    if k.size == 2:
        say(f"{where}: two numbers are taken as {_LENSES[2]}.")
    return BrownDistortion.from_vector(jnp.asarray(np.concatenate([k, np.zeros(5 - k.size)])))


def rotvec_from_numbers(where: str, value: object, say: Callable[[str], None]) -> np.ndarray:
    """Rotation vector [rad] of 3 numbers or a 3x3 matrix.

    Raises:
        InputError: for another shape, or a matrix that is no rotation.
    """
    R = numbers(where, value)
    if R.shape == (3, 3):
        return _rotvec_from_matrix(where, R, say)
    if R.size != 3:
        hint = " A quaternion must be converted first." if R.size == 4 else ""
        raise InputError(f"{where}: expected a rotation vector of 3 numbers or a 3x3 matrix, got {R.shape}.{hint}")
    angle = math.hypot(*R.ravel())
    if angle > 2 * math.pi:
        say(
            f"{where}: the rotation vector is {angle:.4g} long, more than a full turn. "
            "Is it in degrees instead of radians?"
        )
    return R.ravel()


def _rotvec_from_matrix(where: str, R: np.ndarray, say: Callable[[str], None]) -> np.ndarray:
    # Entries of a rotation are at most 1; larger ones would overflow the products below.
    off = float(np.abs(R @ R.T - np.eye(3)).max()) if np.abs(R).max() < 2 else math.inf
    if off > _NOT_A_ROTATION:
        raise InputError(
            f"{where}: no rotation matrix (its rows are not unit vectors at right angles, off by {off:.2g}). "
            "Was it scaled, rounded or mixed up?"
        )
    if np.linalg.det(R) < 0:
        raise InputError(
            f"{where}: the matrix mirrors (determinant -1), so its world is left-handed. "
            "Flip one axis of the world in the program that wrote it."
        )
    if off > _ROUNDED:
        say(f"{where}: the matrix is rounded (off by {off:.2g}); the nearest rotation is taken.")
    return np.asarray(rotation.log(rotation.nearest_rotation(jnp.asarray(R))))


def translation_from_numbers(where: str, value: object) -> np.ndarray:
    """Translation of 3 numbers.

    Raises:
        InputError: for another number of them.
    """
    t = numbers(where, value)
    if t.size != 3:
        raise InputError(f"{where}: expected 3 numbers, got shape {t.shape}.")
    return t.ravel()


def size_from_numbers(where: str, value: object) -> tuple[int, int]:
    """(width, height) [px].

    Raises:
        InputError: if these are not two positive whole numbers.
    """
    size = numbers(where, value)
    if size.shape != (2,) or (size != np.round(size)).any() or not ((size > 0) & (size <= _MAX_PIXELS)).all():
        raise InputError(f"{where}: expected [width, height] in whole pixels, got {short(value)}.")
    return int(size[0]), int(size[1])


def assemble(
    where: str,
    size: tuple[int, int],
    intrinsics: Intrinsics,
    lens: BrownDistortion,
    pose: tuple[np.ndarray, np.ndarray],
    say: Callable[[str], None],
) -> Camera:
    """The camera of checked parts; says so if the principal point is off the sensor.

    Args:
        where: file and table, for what is said.
        size: (width, height) [px].
        intrinsics: K [px].
        lens: distortion [1].
        pose: rotation vector [rad] and translation [scene], world -> camera.
        say: takes a sentence.
    """
    cx, cy = float(intrinsics.cx), float(intrinsics.cy)
    if not (0 <= cx <= size[0] and 0 <= cy <= size[1]):
        say(
            f"{where}: the principal point ({cx:.6g}, {cy:.6g}) is off the {size[0]}x{size[1]} sensor. "
            "Was the camera calibrated at another image size?"
        )
    T_camera_world = Pose(jnp.asarray(pose[0]), jnp.asarray(pose[1]))
    return Camera(intrinsics=intrinsics, distortion=lens, T_camera_world=T_camera_world, image_size=size)


def plain_camera(named: NamedCamera) -> dict[str, Any]:
    """The numbers of one camera as Python lists: size, matrix, distortions, rotation, translation.

    Raises:
        InputError: if it has a leading camera axis, or a number is NaN or infinite.
    """
    camera = named.camera
    pose = camera.T_camera_world
    where = f"camera {named.name!r}"
    if np.shape(camera.intrinsics.fx) != () or np.shape(pose.rotvec) != (3,):
        raise InputError(f"{where}: expected one camera, got a stacked rig. Take its cameras with camera_of.")
    arrays = {
        "matrix": camera.intrinsics.matrix(),
        "distortions": camera.distortion.vector(),
        "rotation": pose.rotvec,
        "translation": pose.translation,
    }
    plain = {key: np.asarray(value, dtype=np.float64).tolist() for key, value in arrays.items()}
    for key, value in plain.items():
        numbers(f"{where}, {key}", value)
    width, height = camera.image_size
    return {"size": [int(width), int(height)], **plain}


def check_names(names: list[str]) -> None:
    """Refuse an empty list, empty names and names given twice.

    Raises:
        InputError: naming the one at fault.
    """
    if not names:
        raise InputError("cameras: expected at least one, got none.")
    for name in names:
        if not name:
            raise InputError("cameras: one has an empty name. Name it as its photos or table rows do.")
        if names.count(name) > 1:
            raise InputError(f"cameras: {names.count(name)} are called {name!r}. Give each its own name.")
