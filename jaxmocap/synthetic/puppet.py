"""Drawn photos of the puppet on its turntable, with the exact truth beside.

`puppet_photo` draws one view, `puppet_take` a turn of one pose; `puppet_set.puppet_set` everything that a session
needs: chessboards, the chessboard on the turntable, T-pose and other poses, and their truth in one record.
Lengths in mm, angles in radians (degrees in that record, where the key says so), pixels as everywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxmocap.bodies.puppet import DOCUMENT_COLOURS, MARKERS
from jaxmocap.synthetic.puppet_camera import Build, PuppetCamera
from jaxmocap.synthetic.puppet_figure import Figure, Solids, sphere, stack_solids
from jaxmocap.synthetic.puppet_render import (
    Look,
    add_specks,
    colour_of_bead,
    decoded,
    develop,
    draw_solids,
    jpeg_bytes,
    stage,
)
from jaxmocap.synthetic.puppet_truth import bead_truth

Array = np.ndarray

DOCUMENT_HSB = np.array([DOCUMENT_COLOURS[name] for name in MARKERS])
TWELVE = tuple(float(a) for a in np.deg2rad(np.arange(0, 360, 30)))


@dataclass(frozen=True)
class PuppetPhoto:
    """One drawn photo."""

    rgb: Array
    """(height, width, 3) uint8, as read back from the file."""
    file: bytes
    """JPEG (PNG where the quality is 0)."""
    beads: dict[str, dict]
    """Truth by bead: see `puppet_truth.bead_truth`."""
    specks: list[dict]
    """`centre_px` and `radius_px` of the foreign spots (they may be hidden by the figure)."""
    T_camera_world: Array
    """(4, 4)."""


@dataclass(frozen=True)
class Studio:
    """What the photos of one set have in common."""

    camera: PuppetCamera = PuppetCamera()
    build: Build = Build()
    look: Look = Look()
    hsb: Array = field(default_factory=lambda: DOCUMENT_HSB)
    """(16, 3) colours of the beads' middles in white light."""


def puppet_photo(studio: Studio, figure: Figure, angle: float, rng: np.random.Generator | int = 0) -> PuppetPhoto:
    """The figure at one turntable angle.

    Args:
        studio: camera, turntable, look, colours.
        figure: from `puppet_figure.pose_figure`.
        angle: at which the turntable really stands [rad].
        rng: or a seed, for noise and specks.

    Returns:
        Photo and truth.
    """
    rng = np.random.default_rng(rng)
    T = studio.build.world_to_camera(angle)
    solids = scene(studio, figure).moved(T[:3, :3], T[:3, 3])
    light = np.repeat(stage(studio.camera, studio.look.lamp)[..., None], 3, axis=2)
    specks = add_specks(light, studio.look, rng)
    gloss = np.arange(len(solids.reach)) < len(MARKERS)
    draw_solids(light, studio.camera, solids, gloss, studio.look)
    file = jpeg_bytes(develop(light, studio.look, rng), studio.look.jpeg_quality)
    return PuppetPhoto(decoded(file), file, bead_truth(studio.camera, T, figure, solids), specks, T)


def view_truth(studio: Studio, figure: Figure, angle: float) -> dict[str, dict]:
    """`PuppetPhoto.beads` of a view that is not drawn."""
    T = studio.build.world_to_camera(angle)
    return bead_truth(studio.camera, T, figure, scene(studio, figure).moved(T[:3, :3], T[:3, 3]))


def scene(studio: Studio, figure: Figure) -> Solids:
    """Beads, in their order, then the body; world frame."""
    beads = [sphere(c, figure.bead_radius, colour_of_bead(h)) for c, h in zip(figure.beads, studio.hsb)]
    return stack_solids([*beads, figure.body])


def puppet_take(
    studio: Studio, figure: Figure, angles: Sequence[float] = TWELVE, rng: np.random.Generator | int = 0
) -> list[PuppetPhoto]:
    """One photo per angle."""
    rng = np.random.default_rng(rng)
    return [puppet_photo(studio, figure, angle, rng) for angle in angles]


def random_hsb(rng: np.random.Generator) -> Array:
    """(16, 3) colours that can be told apart: hues in sixteen equal steps, in any order, in three kinds of paint."""
    hue = (rng.permutation(16) + rng.uniform(-0.15, 0.15, 16)) / 16.0 % 1.0
    kind = np.round(hue * 16.0).astype(int) % 3
    saturation = np.array([0.30, 0.50, 0.70])[kind] + rng.uniform(-0.05, 0.05, 16)
    brightness = np.array([0.80, 0.65, 0.72])[kind] + rng.uniform(-0.05, 0.05, 16)
    return np.stack([hue, saturation, brightness], axis=1)
