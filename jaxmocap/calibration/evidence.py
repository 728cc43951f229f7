"""What checks and reports need to know of a calibrated camera and its photos, and how it is measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np

Severity = Literal["note", "warning", "serious"]


@dataclass(frozen=True)
class Weakness:
    """One thing that speaks against a calibration."""

    code: str
    """Stable name, for programs: "few-views", "fronto-parallel", ..."""
    severity: Severity
    """note: know it; warning: use with care; serious: do not use the result."""
    sentence: str
    """What was found, with its numbers."""
    next_step: str
    """What to do about it."""


@runtime_checkable
class SeenView(Protocol):
    """What the checks need to know of one photo of the board (`report.ViewReport` has it)."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def uv(self) -> np.ndarray: ...  # noqa: D102
    @property
    def rms_px(self) -> float: ...  # noqa: D102
    @property
    def tilt_deg(self) -> float: ...  # noqa: D102
    @property
    def tilt_direction_deg(self) -> float: ...  # noqa: D102
    @property
    def depth(self) -> float: ...  # noqa: D102


@dataclass(frozen=True)
class CameraEvidence:
    """One calibrated camera and the photos it was calibrated from."""

    image_size: tuple[int, int]
    """(width, height) [px]."""
    K: np.ndarray
    """(3, 3) [px]."""
    distortion: np.ndarray
    """(5,) k1 k2 p1 p2 k3 [1]."""
    views: Sequence[SeenView]
    rms_px: float
    """Root of the mean squared residual length per point [px]."""
    sigma: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of each FREE parameter, by name ("fx", "k1", ...)."""
    sigma_plain: Mapping[str, float] = field(default_factory=dict)
    """The same, if every corner had an error of its own; compared with `sigma` where both are given."""
    valid_radius_px: float | None = None
    """Radius in the raw image where the lens folds back (`real_radius_px`); None if nowhere."""
    square: float | None = None
    """Side of a board square, in `unit`; None for a target that is no board."""
    unit: str = "1"
    planar: bool = True
    """Whether the target is flat: a flat one must be seen tilted, a solid one need not."""
    label: str = ""
    """Put before each sentence where there are several cameras."""


def board_attitude(R_camera_board: np.ndarray, centre_camera: np.ndarray) -> tuple[float, float, float]:
    """How a board stands before a camera.

    The tilt is against the optical axis, not the line of sight: a board parallel to the image is seen as a
    similar figure wherever it is held, and says nothing about the focal length.

    Args:
        R_camera_board: (3, 3) board -> camera; the board is the plane z = 0 of its frame.
        centre_camera: (3,) centre of the board in camera coordinates [scene].

    Returns:
        tilt [deg], 0..90: angle between the board's normal and the optical axis.
        direction [deg]: image direction in which the board recedes, 0 right, 90 down.
        depth: z of the centre [scene].
    """
    normal = R_camera_board[:, 2] * (-1.0 if R_camera_board[2, 2] > 0 else 1.0)
    tilt = np.degrees(np.arctan2(np.hypot(normal[0], normal[1]), -normal[2]))
    return float(tilt), float(np.degrees(np.arctan2(normal[1], normal[0])) % 360.0), float(centre_camera[2])


def real_radius_px(K: np.ndarray, distortion: np.ndarray, ideal_radius: float | np.ndarray) -> float | np.ndarray:
    """Radius in the raw image at which an ideal normalised radius is seen (tangential part left out).

    Args:
        K: (3, 3) [px].
        distortion: (5,) k1 k2 p1 p2 k3 [1].
        ideal_radius: [1], any shape.

    Returns:
        [px] from the principal point, in pixels of the mean focal length sqrt(fx fy).

    Source: optical tracking document, eq. 4.16-4.17.
    """
    s = np.square(ideal_radius)
    k1, k2, _, _, k3 = distortion
    return np.sqrt(abs(K[0, 0] * K[1, 1])) * ideal_radius * (1.0 + s * (k1 + s * (k2 + s * k3)))


def radius_px(K: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Distance of raw pixels (n, 2) from the principal point, in pixels of the mean focal length."""
    xy = (uv - K[:2, 2]) / np.array([K[0, 0], K[1, 1]])
    return np.sqrt(abs(K[0, 0] * K[1, 1])) * np.linalg.norm(xy, axis=1)


def image_corners(image_size: tuple[int, int]) -> np.ndarray:
    """(4, 2) outer corners of the image [px], in order around it: pixel centres are whole numbers."""
    w, h = image_size
    return np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])


# Steps of 5 degrees round a convex outline by at most 1 - cos(2.5 deg) = 0.1 % of its size.
_ANGLES = np.radians(np.arange(0, 360, 5))
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def convex_outline(uv: np.ndarray) -> np.ndarray:
    """Points (m, 2) of the convex outline of uv (n, 2), in order around it: the farthest in each direction."""
    if len(uv) < 2:
        return uv
    farthest = np.argmax(uv @ _DIRECTIONS, axis=0)
    return uv[farthest[farthest != np.roll(farthest, 1)]]


def covered_fraction(image_size: tuple[int, int], uv_lists: Sequence[np.ndarray]) -> float:
    """Share of the image inside the convex outline of at least one view's corners, on a grid of 64 x 48."""
    cells = np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), axis=-1).reshape(-1, 2)
    grid = cells * (np.array(image_size) / (64, 48)) - 0.5
    # A point lies in a convex outline if it is beyond it in no direction.
    seen = np.zeros(len(grid), bool)
    for uv in uv_lists:
        if len(uv):
            seen |= np.all(grid @ _DIRECTIONS <= np.max(uv @ _DIRECTIONS, axis=0), axis=1)
    return float(seen.mean())


def tilt_worth(tilt_deg: np.ndarray) -> float:
    """How many views tilted by 30 degrees would fix the focal length as well as these views (n,).

    A board seen square-on fixes only the ratio of focal length and distance. Tilted by t, the convergence of
    its lines gives sin t w / f (w: half its width [px]), its foreshortening cos t gives t. With a relative
    error e of widths, df/f = e hypot(cos t / sin^2 t, f / (w sin t)). A board that spans 28 degrees has
    f / w = 4. The worth is the inverse square; a test compares it with simulated calibrations from 5 to 40
    degrees. Beyond 45 degrees corners are found less well, and a view is worth no more.
    """
    t = np.radians(np.append(np.minimum(tilt_deg, 45.0), 30.0))
    information = np.sin(t) ** 4 / (np.cos(t) ** 2 + (4.0 * np.sin(t)) ** 2)
    return float(np.sum(information[:-1]) / information[-1])


def board_shift(uv: np.ndarray, other: np.ndarray) -> float:
    """Root mean square shift between two views' corners as a share of the first's extent; inf if unlike."""
    if uv.shape != other.shape or not len(uv):
        return np.inf
    extent = float(np.linalg.norm(np.ptp(uv, axis=0)))
    return float(np.sqrt(np.mean(np.sum((uv - other) ** 2, axis=1)))) / extent if extent else np.inf
