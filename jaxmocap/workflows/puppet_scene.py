"""Camera and turntable of a puppet's photographs: read, converted to one unit, improved from beads. No formula."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap._errors import InputError
from jaxmocap._programs import program
from jaxmocap.calibration.boards import Lens
from jaxmocap.calibration.turntable import BeadScene, TurntableEstimate, bead_prior, solve_beads
from jaxmocap.calibration.turntable_checks import smallest_step, wrap_deg
from jaxmocap.cameras import Camera, Turntable
from jaxmocap.cameras.turntable import DOCUMENT_DISTANCE, DOCUMENT_HEIGHT
from jaxmocap.io import read_rig, read_turntable
from jaxmocap.io.length_units import unit_factor
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowVariables
from jaxmocap.reconstruction import fit_point_linear, rays
from jaxmocap.tracking.rounds import Refine
from jaxmocap.workflows.turntable import lens_of
from jaxmocap.workflows.units import parse_length

_PHOTOS = 12
"""Photos are padded to a multiple: one compiled program for a turn of up to 30-degree steps."""
_GATE_SIGMAS = 3.0  # 1 % of right places lie farther off, for errors that are normal in u and v


@dataclass(frozen=True)
class PuppetScene:
    """What is known before a photograph is looked at."""

    lens: Lens
    covariance_lens: np.ndarray
    """(10, 10), zeros where the camera file states none."""
    image_size: tuple[int, int]
    turntable: Turntable
    covariance_turntable: np.ndarray | None
    """(4, 4) of rotation vector and distance; None: the nominal build, from which the axis is sought."""
    unit: str
    notes: tuple[str, ...]

    @property
    def free(self) -> tuple[str, ...]:
        """What the beads leave free and the files do not say either, in words."""
        if self.covariance_turntable is None:
            return ("scale (held by the distance)", "height of the origin", "zero of the angles")
        return ("height of the origin", "zero of the angles")


class Angles(NamedTuple):
    """Stated angles of the photographs of one take."""

    stated: np.ndarray
    """(photos,) [rad]."""
    held: np.ndarray
    """(photos,) True for the one that keeps its stated angle: the one nearest 0."""
    sigma: float
    """How far a photograph may be off [rad]: half a step, where it would pass for its neighbour, is 3 sigma."""

    @classmethod
    def of(cls, stated_deg: np.ndarray) -> "Angles":
        """Angles in degrees as they are stated."""
        deg = np.asarray(stated_deg, float)
        held = np.arange(len(deg)) == int(np.argmin(np.abs(wrap_deg(deg))))
        return cls(np.radians(deg), held, np.radians(smallest_step(deg)) / 6.0)


def load_scene(
    camera: str | Path,
    turntable: str | Path | None = None,
    distance: str | float | None = None,
    height: str | float | None = None,
) -> PuppetScene:
    """Read the files; lengths are brought to the unit of the camera's file.

    Args:
        camera: rig file of one camera.
        turntable: as `calibrate turntable` writes it; None: the document's build is the start.
        distance: of the camera from the axis without a turntable file; None: 400 mm.
        height: of the camera above the origin; None: that of the turntable file, or 80 mm.

    Returns:
        PuppetScene.

    Raises:
        InputError: files or lengths are wrong.
    """
    rig = read_rig(camera)
    lens, covariance_lens, notes = lens_of(rig, str(camera))
    size = rig.cameras[0].camera.image_size
    if turntable is None:
        far, said = _length(distance, DOCUMENT_DISTANCE, "--distance", rig.unit)
        high, more = _length(height, DOCUMENT_HEIGHT, "--height", rig.unit)
        table = Turntable.nominal(far, high)
        return PuppetScene(lens, covariance_lens, size, table, None, rig.unit, (*notes, *said, *more))
    file = read_turntable(turntable)
    factor = unit_factor(file.unit, rig.unit, "--turntable")
    high = _length(height, 0.0, "--height", rig.unit)[0] if height is not None else file.height * factor
    table = Turntable(jnp.asarray(file.rotation), jnp.asarray(file.distance * factor), jnp.asarray(float(high)))
    covariance = file.covariance
    if covariance is None:
        notes = [*notes, f"{turntable} states no covariance: the axis is sought anew from the beads."]
    else:
        scale = np.array([1.0, 1.0, 1.0, factor])
        covariance = covariance * np.outer(scale, scale)
    return PuppetScene(lens, covariance_lens, size, table, covariance, rig.unit, tuple(notes))


def _length(given: str | float | None, default_mm: float, option: str, unit: str) -> tuple[float, list[str]]:
    """A length in a unit; the document's where none is given."""
    if given is not None:
        value, own = parse_length(given, option)
        return value * unit_factor(own, unit, option), []
    if unit == "1":
        return default_mm, [f"{option} was not given: the document's {default_mm:g} is taken as it is, without a unit."]
    return default_mm * unit_factor("mm", unit, option), []


@program
def _cameras(lens: Lens, turntable: Turntable, angles: jax.Array, image_size: tuple[int, int]) -> Camera:
    one = lambda a: Camera(lens.intrinsics, lens.distortion, turntable.pose(a), image_size)  # noqa: E731
    return jax.vmap(one)(angles)


def cameras_at(scene: PuppetScene, turntable: Turntable, angles: np.ndarray) -> Camera:
    """The camera at every angle [rad], stacked."""
    n = len(angles)
    padded = np.concatenate([angles, np.zeros(-n % _PHOTOS)])
    cameras = _cameras(scene.lens, turntable, jnp.asarray(padded), scene.image_size)
    return jax.tree.map(lambda x: x[:n], cameras)


@program
def _start_points(cameras: Camera, uv: jax.Array, visible: jax.Array) -> jax.Array:
    """(beads, 3) of pixels (beads, photos, 2)."""

    def one(uv: jax.Array, visible: jax.Array) -> jax.Array:
        centre, v, inside = rays(cameras, uv, visible)
        return fit_point_linear(centre, v, inside & visible)[0]

    return jax.vmap(one)(uv, visible)


def improve(
    scene: PuppetScene,
    angles: Angles,
    at: tuple[Turntable, np.ndarray],
    uv: np.ndarray,
    visible: np.ndarray,
    sigma: np.ndarray,
) -> TurntableEstimate:
    """Turntable, angles and beads from where the beads were seen.

    Args:
        scene: what is known.
        angles: stated ones.
        at: turntable and angles (photos,) to start from.
        uv: (photos, beads, 2) [px].
        visible: (photos, beads).
        sigma: (photos, beads) [px].

    Returns:
        TurntableEstimate of these photos.
    """
    n = len(uv)
    more = -n % _PHOTOS
    turntable, start_angles = at

    def pad(x: np.ndarray, value: float | bool = 0.0) -> np.ndarray:
        return np.concatenate([x, np.full((more, *x.shape[1:]), value, x.dtype)])

    seen = PixelObservations(*(jnp.asarray(np.swapaxes(x, 0, 1)) for x in (pad(uv), pad(visible), pad(sigma, 1.0))))
    cameras = _cameras(scene.lens, turntable, jnp.asarray(pad(start_angles)), scene.image_size)
    points = _start_points(cameras, seen.uv, seen.visible)
    prior = bead_prior(
        scene.turntable,
        jnp.asarray(pad(angles.stated)),
        jnp.asarray(pad(angles.held, True)),
        covariance=scene.covariance_turntable,
        sigma_angle=angles.sigma,
    )
    start = ArrowVariables(BeadScene(turntable, jnp.asarray(pad(start_angles)), scene.lens), points)
    found = solve_beads(start, seen, prior, jnp.asarray(scene.covariance_lens), trust_sigma=True)
    keep = np.arange(4 + n)
    return found._replace(
        angles=found.angles[:n],
        covariance=found.covariance[np.ix_(keep, keep)],
        covariance_data=found.covariance_data[np.ix_(keep, keep)],
        residual=found.residual[:, :n],
    )


def refiner(scene: PuppetScene, angles: Angles) -> Refine:
    """The callable by which identification has the cameras improved between its rounds."""
    at = [(scene.turntable, angles.stated)]

    def refine(uv: np.ndarray, visible: np.ndarray, sigma: np.ndarray) -> tuple[Camera, np.ndarray, float]:
        found = improve(scene, angles, at[0], uv, visible, sigma)
        if found.estimate.success or bool(np.isfinite(np.asarray(found.angles)).all()):
            at[0] = (found.turntable, np.asarray(found.angles))
        length2 = np.sum(np.asarray(found.residual) ** 2, axis=-1)[visible.T]
        # The median of a squared length is 2 ln 2 variances; what was fitted makes residuals smaller than errors.
        fitted = 3 * int((visible.sum(axis=0) >= 2).sum()) + 4 + len(uv)
        shrunk = max(1.0 - fitted / max(2 * int(visible.sum()), 1), 0.2)
        spread = np.sqrt(np.median(length2) / (2.0 * np.log(2.0)) / shrunk) if length2.size else np.inf
        return cameras_at(scene, *at[0]), np.asarray(found.points), float(_GATE_SIGMAS * spread)

    return refine


def check_photo_size(name: str, size: tuple[int, int], scene: PuppetScene) -> None:
    """Refuse a photograph of another camera or resolution.

    Raises:
        InputError: naming both sizes.
    """
    if size != scene.image_size:
        raise InputError(
            f"{name}: {size[0]}x{size[1]} px, but the camera was calibrated at {scene.image_size[0]}x"
            f"{scene.image_size[1]} px. Take the photograph with that camera at that size, unrotated and uncropped."
        )
