"""What the page shows, as plain arrays."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.geometry.upright import R_UPRIGHT_WORLD

Colour = tuple[float | int, float | int, float | int]
"""Red, green, blue, 0..1, as in a picture (sRGB)."""


@dataclass(frozen=True)
class Markers:
    """Points with names, over frames."""

    names: tuple[str, ...]
    p_world: np.ndarray
    """(frames, markers, 3); NaN where not seen."""
    sigma: np.ndarray | None = None
    """(frames, markers, 3) standard deviations along x, y, z; NaN where unknown."""
    colours: tuple[Colour, ...] | None = None
    """One per marker; None: told apart by hue."""


@dataclass(frozen=True)
class Skeleton:
    """Joints with names, over frames, and which hangs on which."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    """-1 for a root."""
    p_world: np.ndarray
    """(frames, joints, 3); NaN where missing."""


@dataclass(frozen=True)
class CameraView:
    """A camera as the pyramid that it sees."""

    name: str
    centre: np.ndarray
    """(3,) in the world."""
    corners: np.ndarray
    """(4, 3) from the centre to the corners of the picture at distance 1, in the world; the top left one first, then
    clockwise as the picture is seen."""


@dataclass(frozen=True)
class Axis:
    """A turning axis."""

    point: np.ndarray
    """(3,) on it, in the world."""
    direction: np.ndarray
    """(3,) upwards, in the world."""


@dataclass(frozen=True)
class ViewerScene:
    """Everything that one page shows; arrays over frames have one length. Checked when made."""

    title: str
    unit: str = "1"
    """Unit of every length; "1": no physical unit."""
    up: str = "y"
    """Axis of the world that is drawn upwards: "y", "-y", "z", ..."""
    markers: Markers | None = None
    skeleton: Skeleton | None = None
    cameras: tuple[CameraView, ...] = ()
    axis: Axis | None = None
    fps: float | int | None = None
    """Frames per second; None where nobody knows."""
    frame_numbers: np.ndarray | None = None
    """(frames,) what the source calls each frame; None: 0, 1, ..."""
    notes: Sequence[str] = ()
    """Sentences to show beside the picture."""

    def __post_init__(self):
        if self.up not in R_UPRIGHT_WORLD:
            raise InputError(f"up: expected one of {', '.join(R_UPRIGHT_WORLD)}, got {self.up!r}")
        lengths = set()
        if self.markers is not None:
            lengths.add(_frames("markers", self.markers.p_world, len(self.markers.names)))
            if self.markers.sigma is not None and self.markers.sigma.shape != self.markers.p_world.shape:
                raise InputError(f"sigma: expected {self.markers.p_world.shape}, got {self.markers.sigma.shape}")
            if self.markers.colours is not None and len(self.markers.colours) != len(self.markers.names):
                raise InputError(f"colours: expected {len(self.markers.names)}, got {len(self.markers.colours)}")
        if self.skeleton is not None:
            lengths.add(_frames("skeleton", self.skeleton.p_world, len(self.skeleton.names)))
            joints = len(self.skeleton.names)
            if len(self.skeleton.parents) != joints or not all(-1 <= p < joints for p in self.skeleton.parents):
                raise InputError(f"parents: expected {joints} numbers from -1 to {joints - 1}")
        if self.frame_numbers is not None:
            lengths.add(len(self.frame_numbers))
        if len(lengths) > 1:
            raise InputError(f"scene: expected one number of frames, got {sorted(lengths)}")

    @property
    def frames(self) -> int:
        """How many frames there are; 0 where nothing moves or stands but cameras and axis."""
        tracks = (self.markers, self.skeleton)
        return next((len(track.p_world) for track in tracks if track is not None), 0)

    def rotation(self) -> np.ndarray:
        """(3, 3) from the world to the picture, whose y points up."""
        return R_UPRIGHT_WORLD[self.up]


def _frames(what: str, p_world: np.ndarray, points: int) -> int:
    if p_world.ndim != 3 or p_world.shape[1:] != (points, 3):
        raise InputError(f"{what}: expected shape (frames, {points}, 3), got {p_world.shape}")
    return len(p_world)
