"""The real turntable and the angle of every photo, from a chessboard that stands on it or from the beads themselves.

One arrow problem each. Board: shared are turntable and board, local is the angle of each photo. Beads: shared are
turntable and angles, local is the place of each bead. The lens is held as its file has it; what its uncertainty does
to the result is carried along (`calibration.held_numbers`).

What the data leave free is held: the zero of the angles (one photo keeps its stated angle) and the height of the
origin on the axis; with beads alone also the distance, which is the scale.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Scalar, require_x64
from jaxmocap._programs import program
from jaxmocap.calibration.boards import Lens, robust_covariance
from jaxmocap.calibration.held_numbers import joint_covariance
from jaxmocap.cameras import Turntable, pixel_of_point
from jaxmocap.geometry import Pose
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowProblem, ArrowVariables, least_squares, robust
from jaxmocap.optim.robust import TUNING, scale_from_data
from jaxmocap.results import Estimate

_LOSS: robust.Loss = "cauchy"


class BoardScene(eqx.Module):
    """Shared unknowns of a board on a turntable."""

    turntable: Turntable
    T_world_board: Pose
    lens: Lens
    """Held."""


class BoardPhotos(eqx.Module):
    """What each photo shows of the board."""

    seen: PixelObservations
    """Arrays (photos, points) [px]."""
    stated: Float[Array, "photos"]
    """Stated angle [rad]."""
    held: Bool[Array, "photos"]
    """True for the photo whose stated angle is the zero of all others."""


class BeadScene(eqx.Module):
    """Shared unknowns of beads on a turntable."""

    turntable: Turntable
    angles: Float[Array, "photos"]
    """[rad]."""
    lens: Lens
    """Held."""


class BeadPrior(eqx.Module):
    """What is known of turntable and angles before the beads are looked at.

    Residuals are root @ ((rotvec, distance, angles) - mean). A row of zeros says nothing.
    """

    mean: Float[Array, "n"]
    root: Float[Array, "n n"]


class TurntableEstimate(NamedTuple):
    """A turntable, the angles, and how well they are known."""

    turntable: Turntable
    angles: Float[Array, "photos"]
    """[rad]."""
    covariance: Float[np.ndarray, "n n"]
    """Of (rotvec [rad], distance [scene], angles [rad]), 4 + photos numbers; zero where held. The lens's share is
    in it."""
    covariance_data: Float[np.ndarray, "n n"]
    """The same for an exact lens."""
    residual: Float[Array, "..."]
    """Measured minus predicted [px], zero where nothing was seen: (photos, points, 2) or (beads, photos, 2)."""
    points: Float[Array, "points 3"]
    """Beads, or the corners of the board, in the world at angle 0 [scene]."""
    covariance_points: Float[np.ndarray, "points 3 3"]
    """Of the beads, turntable, angles and lens included [scene^2]; zeros for a board."""
    estimate: Estimate


def board_residuals(scene: BoardScene, angle: Scalar, photo: BoardPhotos, points: Float[Array, "points 3"]) -> Array:
    """Residuals of one photo [sigma], (points + 1, 2): the corners, and one row that keeps a held angle.

    Source: stop-motion document, eq. 4.17-4.18, with the lens of the optical tracking document, eq. 4.16-4.18.
    """
    at = jnp.where(photo.held, photo.stated, angle)

    def see(p_board: Array) -> Array:
        p_camera = scene.turntable.act(at, scene.T_world_board.act(p_board))
        return pixel_of_point(scene.lens.intrinsics, scene.lens.distortion, p_camera)

    r = (jax.vmap(see)(points) - photo.seen.uv) / photo.seen.sigma[:, None]
    keep = jnp.where(photo.held, angle - photo.stated, 0.0)
    return jnp.concatenate(
        [jnp.where(photo.seen.visible[:, None], r, 0.0), jnp.stack([keep, jnp.zeros_like(keep)])[None]]
    )


def bead_residuals(scene: BeadScene, p_world: Array, seen: PixelObservations, prior: BeadPrior) -> Array:
    """Residuals of one bead in all photos [sigma], (photos, 2).

    Source: stop-motion document, eq. 4.17-4.18 and 5.7-5.13, in the image instead of in space.
    """
    del prior

    def see(angle: Scalar) -> Array:
        p_camera = scene.turntable.act(angle, p_world)
        return pixel_of_point(scene.lens.intrinsics, scene.lens.distortion, p_camera)

    r = (jax.vmap(see)(scene.angles) - seen.uv) / seen.sigma[:, None]
    return jnp.where(seen.visible[:, None], r, 0.0)


def _known(scene: BeadScene) -> Array:
    t = scene.turntable
    return jnp.concatenate([t.rotvec, t.distance[None], scene.angles])


def _prior_residuals(scene: BeadScene, common: tuple[Array, BeadPrior]) -> Array:
    return common[1].root @ (_known(scene) - common[1].mean)


def robust_bead_residuals(
    scene: BeadScene, p_world: Array, seen: PixelObservations, common: tuple[Array, BeadPrior]
) -> Array:
    """`bead_residuals` with a Cauchy loss of width common[0] [sigma].

    Source: as `bead_residuals`; loss: Holland and Welsch 1977.
    """
    return robust.apply(_LOSS, bead_residuals(scene, p_world, seen, common[1]), common[0])


BOARD_PROBLEM = ArrowProblem(board_residuals)
BEAD_PROBLEM = ArrowProblem(robust_bead_residuals, _prior_residuals)


def _flags(scene: BoardScene | BeadScene) -> tuple[ArrowVariables, ArrowVariables]:
    """What is free (all but the height, where the origin is put, and the lens), and what is held but uncertain."""
    none = jax.tree.map(lambda _: False, scene)
    free = eqx.tree_at(lambda s: s.lens, jax.tree.map(lambda _: True, scene), none.lens)
    free = eqx.tree_at(lambda s: s.turntable.height, free, False)
    held = eqx.tree_at(lambda s: s.lens, none, jax.tree.map(lambda _: True, none.lens))
    return ArrowVariables(free, True), ArrowVariables(held, False)


def refine_board_turntable(
    start: ArrowVariables, photos: BoardPhotos, points: Float[Array, "points 3"], weight: Float[Array, "photos"]
) -> Estimate:
    """Turntable, board and angles of the smallest reprojection error; may be batched by `jax.vmap`.

    Args:
        start: BoardScene and the angles (photos,) [rad].
        photos: what was seen.
        points: of the board in its own frame [scene].
        weight: 1 for photos that count, 0 for those that pad.

    Returns:
        Estimate with value ArrowVariables(BoardScene, angles); lens and height as they were in the start.
    Source: stop-motion document, 4.2 (its build, estimated instead of assumed).
    """
    free, _ = _flags(start.shared)
    # The row of the held angle is one equation more.
    count = 2.0 * jnp.sum(jnp.sum(photos.seen.visible.astype(float), axis=1) * weight) + 1.0
    return least_squares(
        BOARD_PROBLEM, start, photos, points, free=free, weight=weight, count=count, by_block=True, pad=False
    )


def solve_board(
    start: ArrowVariables,
    photos: BoardPhotos,
    points: Float[Array, "points 3"],
    weight: Float[Array, "photos"],
    covariance_lens: Float[Array, "10 10"],
) -> TurntableEstimate:
    """The turntable from a board on it, with the covariance of everything that is reported.

    Args:
        start: as `refine_board_turntable`.
        photos: as there.
        points: as there.
        weight: as there.
        covariance_lens: of fx fy cx cy skew k1 k2 p1 p2 k3, as the camera file has it; zeros: exact.

    Returns:
        TurntableEstimate; `estimate.check()` says whether it converged.

    Raises:
        InputError: JAX in 32-bit mode.
    Source: as `refine_board_turntable`.
    """
    require_x64("solve_board")
    estimate = refine_board_turntable(start, photos, points, weight)
    value = estimate.value
    free, held = _flags(value.shared)
    factor = estimate.covariance.variance * estimate.covariance.inflation
    joint = joint_covariance(BOARD_PROBLEM, value, free, held, photos, points, weight, factor, covariance_lens)
    n = len(photos.stated)
    # Shared numbers: rotvec 3, distance, board 6; then the angles, of which the held one is not uncertain.
    keep = np.concatenate([np.arange(4), 10 + np.arange(n)])
    moves = np.concatenate([np.ones(4), ~np.asarray(photos.held) & (np.asarray(weight) > 0)]).astype(float)
    total, data = (np.asarray(c)[np.ix_(keep, keep)] * np.outer(moves, moves) for c in joint)
    r, corners = _board_description(value, photos, points)
    return TurntableEstimate(
        value.shared.turntable, value.local, total, data, r, corners, np.zeros((len(corners), 3, 3)), estimate
    )


@program
def _board_description(value: ArrowVariables, photos: BoardPhotos, points: Array) -> tuple[Array, Array]:
    r = jax.vmap(board_residuals, (None, 0, 0, None))(value.shared, value.local, photos, points)[:, :-1]
    return -r * photos.seen.sigma[..., None], jax.vmap(value.shared.T_world_board.act)(points)


def bead_prior(
    turntable: Turntable,
    stated: Float[Array, "photos"],
    held: Bool[Array, "photos"],
    *,
    covariance: Float[np.ndarray, "4 4"] | None = None,
    sigma_angle: float | None = None,
) -> BeadPrior:
    """What beads are solved with: the zero angle of each take held, and a scale from somewhere.

    Args:
        turntable: from a calibration, or nominal.
        stated: angles [rad].
        held: True for the photos that keep their stated angle (one of each take).
        covariance: of (rotvec, distance) of a calibrated turntable; None: only the distance is known, and held.
        sigma_angle: how far a stated angle may be off [rad]; None: anything. A photo without beads needs it.

    Returns:
        BeadPrior.
    Source: mission of the project: what the data leave free is held and named.
    """
    n = len(stated)
    root = np.zeros((4 + n, 4 + n))
    # Held: so stiff that nothing moves it, 1e-9 of its size.
    if covariance is None:
        root[3, 3] = 1e9 / float(turntable.distance)
    else:
        root[:4, :4] = np.linalg.inv(np.linalg.cholesky(covariance))
    loose = 0.0 if sigma_angle is None else 1.0 / sigma_angle
    root[4:, 4:] = np.diag(np.where(np.asarray(held), 1e9, loose))
    mean = jnp.concatenate([turntable.rotvec, turntable.distance[None], jnp.asarray(stated)])
    return BeadPrior(mean, jnp.asarray(root))


_ROUNDS = 3


def solve_beads(
    start: ArrowVariables,
    seen: PixelObservations,
    prior: BeadPrior,
    covariance_lens: Float[Array, "10 10"],
    *,
    trust_sigma: bool = False,
) -> TurntableEstimate:
    """Turntable, angles and beads of the smallest robust reprojection error.

    Args:
        start: BeadScene (turntable, stated angles, lens) and the beads (beads, 3) in the world [scene].
        seen: (beads, photos) where each bead was seen; a bead of fewer than two photos is left out. One bead is one
            place: another pose of the puppet is another bead, whose photos are others.
        prior: as `bead_prior` makes it.
        covariance_lens: of the lens, as in `solve_board`.
        trust_sigma: the stated sigmas of the pixels are only ever made larger by what the data say, never smaller:
            where they differ from pixel to pixel, most of them do not speak for the few.

    Returns:
        TurntableEstimate; `estimate.stats["sigma_scale"]` is by what the stated sigma of the pixels was multiplied.

    Raises:
        InputError: JAX in 32-bit mode.
    Source: stop-motion document, 4.2 and 5.2, as one problem.
    """
    require_x64("solve_beads")
    free, _ = _flags(start.shared)
    weight = (jnp.sum(seen.visible, axis=1) >= 2).astype(float)
    informative = jnp.sum(jnp.any(prior.root != 0, axis=1).astype(float)) - prior.mean.shape[0]
    count = 2.0 * jnp.sum(jnp.sum(seen.visible.astype(float), axis=1) * weight) + informative
    groups = (seen.visible & (weight[:, None] > 0)).reshape(-1)
    pixels = 2.0 * jnp.sum(groups.astype(float))
    value = start
    freedom = pixels
    for _ in range(_ROUNDS):
        r = _bead_sigmas(value, seen, prior).reshape(-1, 2)
        # Fitted residuals are smaller than the errors of the pixels.
        shrunk = jnp.sqrt(pixels / freedom)
        scale = jnp.maximum(scale_from_data(r, groups) * shrunk, 1.0 if trust_sigma else 1e-6)
        scaled = eqx.tree_at(lambda s: s.sigma, seen, seen.sigma * scale)
        # In units of the sigma found, so that the prior is weighed by what a pixel is really worth.
        common = (jnp.asarray(TUNING[_LOSS]), prior)
        estimate = least_squares(
            BEAD_PROBLEM, value, scaled, common, free=free, weight=weight, count=count, by_block=True, pad=False
        )
        value, freedom = estimate.value, jnp.maximum(estimate.stats["degrees_of_freedom"], 1.0)
    r = _bead_sigmas(value, scaled, prior)
    estimate = robust_covariance(estimate, r.reshape(-1, 2), groups, _LOSS, common[0])
    estimate = eqx.tree_at(lambda e: e.stats, estimate, {**estimate.stats, "sigma_scale": scale})
    return _bead_result(estimate, r, scaled, common, weight, covariance_lens, 1.0 if trust_sigma else 0.0)


@program
def _bead_sigmas(value: ArrowVariables, seen: PixelObservations, prior: BeadPrior) -> Array:
    return jax.vmap(bead_residuals, (None, 0, 0, None))(value.shared, value.local, seen, prior)


def _bead_result(
    estimate: Estimate,
    r: Array,
    seen: PixelObservations,
    common: tuple[Array, BeadPrior],
    weight: Array,
    covariance_lens: Array,
    least_variance: float,
) -> TurntableEstimate:
    value = estimate.value
    free, held = _flags(value.shared)
    factor = jnp.maximum(estimate.covariance.variance, least_variance) * estimate.covariance.inflation
    joint = joint_covariance(BEAD_PROBLEM, value, free, held, seen, common, weight, factor, covariance_lens)
    shared = 4 + len(value.shared.angles)
    total, data = (np.asarray(c) for c in joint)
    own = np.arange(len(weight))[:, None] * 3 + np.arange(3)[None, :] + shared
    return TurntableEstimate(
        value.shared.turntable,
        value.shared.angles,
        total[:shared, :shared],
        data[:shared, :shared],
        -r * seen.sigma[..., None],
        value.local,
        total[own[:, :, None], own[:, None, :]],
        estimate,
    )


class AxisNumbers(NamedTuple):
    """Where the axis is and how far the build is from nominal, with standard deviations."""

    point: np.ndarray
    """(3,) point of the axis nearest the camera centre, camera frame at angle 0 [scene]."""
    direction: np.ndarray
    """(3,) unit, upwards."""
    deviation: np.ndarray
    """(3,) turn of the camera away from nominal about its x, y, z [rad] (`Turntable.deviation`)."""
    sigma_point: np.ndarray
    sigma_direction: np.ndarray
    sigma_deviation: np.ndarray


@program
def _axis_numbers(turntable: Turntable, covariance: Float[Array, "4 4"]) -> tuple[Array, Array]:
    def numbers(x: Array) -> Array:
        t = Turntable(x[:3], x[3], turntable.height)
        return jnp.concatenate([*t.axis(), t.deviation()])

    x = jnp.concatenate([turntable.rotvec, turntable.distance[None]])
    J = jax.jacfwd(numbers)(x)
    return numbers(x), jnp.sqrt(jnp.maximum(jnp.einsum("ni,ij,nj->n", J, covariance, J), 0.0))


def axis_numbers(turntable: Turntable, covariance: Float[np.ndarray, "4 4"]) -> AxisNumbers:
    """What a turntable's numbers mean.

    Args:
        turntable: estimated.
        covariance: of (rotvec, distance), the leading part of `TurntableEstimate.covariance`.

    Returns:
        AxisNumbers.
    Source: first-order propagation through `Turntable.axis` and `Turntable.deviation`.
    """
    value, sigma = (np.asarray(x) for x in _axis_numbers(turntable, jnp.asarray(covariance)))
    return AxisNumbers(value[:3], value[3:6], value[6:], sigma[:3], sigma[3:6], sigma[6:])
