"""What a calibration report shows: plain records of numbers and names, filled by the workflow."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from jaxmocap.calibration.evidence import Weakness

RMS_DEFINITION = "root of the mean squared residual length per point"


@dataclass(frozen=True)
class ParameterRow:
    """One number of the result."""

    name: str
    """"fx", "k1", "tx", ..."""
    value: float
    sigma: float | None
    """Standard deviation, in `unit`; None if it was not estimated."""
    unit: str
    """"px", "1", "rad", "mm", ..."""
    frozen: bool = False
    """Held at its value instead of being estimated."""
    sigma_plain: float | None = None
    """The same if every corner had an error of its own; `sigma` then allows for errors shared by a photo."""
    truth: float | None = None
    """True value, where the data are simulated."""


@dataclass(frozen=True)
class CameraReport:
    """One calibrated camera."""

    name: str
    image_size: tuple[int, int]
    """(width, height) [px]."""
    parameters: tuple[ParameterRow, ...]
    K: np.ndarray
    """(3, 3) [px]."""
    distortion: np.ndarray
    """(5,) k1 k2 p1 p2 k3 [1]."""
    rms_px: float
    correlation: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    """(p, p) over the free parameters of the camera [1]."""
    correlation_names: tuple[str, ...] = ()
    valid_radius_px: float | None = None
    """Radius in the raw image where the lens folds back (`evidence.real_radius_px`); None if nowhere."""


@dataclass(frozen=True)
class ViewReport:
    """One photo of the target by one camera."""

    name: str
    """File name of the photo."""
    camera: int
    """Index into `CalibrationReport.cameras`."""
    uv: np.ndarray
    """(n, 2) measured [px]."""
    residual: np.ndarray
    """(n, 2) measured - predicted [px]."""
    rms_px: float
    tilt_deg: float
    """Angle between the board's normal and the optical axis (`evidence.board_attitude`)."""
    tilt_direction_deg: float
    """Image direction in which the board recedes, 0 right, 90 down."""
    depth: float
    """z of the board's centre [unit of the report]."""
    grey: np.ndarray | None = None
    """(h, w) uint8 photo, for the pictures of the worst views."""


@dataclass(frozen=True)
class CalibrationReport:
    """Everything a page or a summary of one calibration shows."""

    title: str
    command: str
    """The command line that was run."""
    rms_px: float
    cameras: tuple[CameraReport, ...]
    views: tuple[ViewReport, ...]
    observations: int
    """Corners used."""
    unit: str = "1"
    """Unit of every length; "1" if none was given."""
    board: str | None = None
    """The target in words: "9x6 inner corners, squares of 30 mm"."""
    rms_definition: str = RMS_DEFINITION
    rejected: int = 0
    """Corners left out by the robust fit."""
    stereo: tuple[ParameterRow, ...] = ()
    """Pose of the second camera relative to the first."""
    skipped: tuple[tuple[str, str], ...] = ()
    """(photo, reason) of the photos that were not used."""
    warnings: tuple[Weakness, ...] = ()
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Version, seed, hashes of the inputs."""
    iterations: tuple[float, ...] = ()
    """Cost after each step of the solver."""
