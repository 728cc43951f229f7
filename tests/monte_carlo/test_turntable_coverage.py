"""Do the stated sigmas of a turntable hold? Repeats on made-up data, lens errors drawn anew each time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.boards import Lens, chessboard_points
from jaxmocap.calibration.held_numbers import joint_covariance
from jaxmocap.calibration.turntable import (
    BOARD_PROBLEM,
    BoardPhotos,
    BoardScene,
    _flags,
    axis_numbers,
    bead_prior,
    board_residuals,
    refine_board_turntable,
    solve_beads,
)
from jaxmocap.calibration.turntable_start import start_beads
from jaxmocap.cameras import BrownDistortion, Intrinsics, Turntable, pixel_of_point
from jaxmocap.geometry import Pose
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowVariables

REPEATS = 200
SIGMA = 0.1
RNG = np.random.default_rng(11)
# A build that is not perfect: axis tilted by a degree, camera turned by one, steps off by half a degree.
TRUE = Turntable(
    jnp.asarray((Rotation.from_rotvec([0.014, 0.017, -0.011]) * Rotation.from_rotvec([np.pi, 0, 0])).as_rotvec()),
    jnp.asarray(405.0),
    jnp.asarray(80.0),
)
STATED = np.radians([-60.0, -30, 0, 30, 60])
ANGLES = STATED + np.where(STATED == 0, 0.0, np.radians(RNG.uniform(-0.5, 0.5, 5)))
NUMBERS = np.array([859.0, 860.0, 337.0, 288.0, 0, -0.12, 0.03, 0, 0, 0])
SIGMA_LENS = np.array([0.4, 0.4, 0.3, 0.4, 0, 0.002, 0.01, 0, 0, 0])
POINTS = chessboard_points(5, 4, 20.0)
BOARD = Pose(jnp.array([2.93, 0.05, 0.02]), jnp.array([-40.0, 75.0, -3.0]))


def lens_of(x):
    return Lens(Intrinsics(*x[:5]), BrownDistortion(*x[5:]))


def repeats_of_lens():
    # fx and fy go together, as they do in a calibration.
    C = np.diag(SIGMA_LENS**2)
    C[0, 1] = C[1, 0] = 0.95 * SIGMA_LENS[0] * SIGMA_LENS[1]
    lenses = NUMBERS + RNG.multivariate_normal(np.zeros(10), C, REPEATS)
    return jnp.asarray(C), jnp.asarray(lenses)


def within_three(cover, share, n):
    """Whether a coverage differs from its share by less than three standard deviations of a binomial, or is larger."""
    return cover > share - 3 * np.sqrt(share * (1 - share) / n)


@pytest.fixture(scope="module")
def board_repeats():
    C, lenses = repeats_of_lens()
    held = jnp.asarray(STATED == 0)
    scene = BoardScene(TRUE, BOARD, lens_of(jnp.asarray(NUMBERS)))
    zeros = PixelObservations.of(jnp.zeros((5, 20, 2)))
    blank = BoardPhotos(zeros, jnp.asarray(STATED), held)
    exact = jax.jit(jax.vmap(board_residuals, (None, 0, 0, None)))(scene, jnp.asarray(ANGLES), blank, POINTS)[:, :-1]
    uv = np.asarray(exact) + RNG.normal(0, SIGMA, (REPEATS, 5, 20, 2))

    def one(uv, lens):
        start = ArrowVariables(BoardScene(TRUE, BOARD, lens_of(lens)), jnp.asarray(STATED))
        photos = BoardPhotos(PixelObservations.of(uv), jnp.asarray(STATED), held)
        e = refine_board_turntable(start, photos, jnp.asarray(POINTS), jnp.ones(5))
        free, uncertain = _flags(start.shared)
        factor = e.covariance.variance * e.covariance.inflation
        joint = joint_covariance(
            BOARD_PROBLEM, e.value, free, uncertain, photos, jnp.asarray(POINTS), jnp.ones(5), factor, C
        )
        t = e.value.shared.turntable
        return jnp.concatenate([t.rotvec, t.distance[None], e.value.local]), joint.total, e.covariance.determined

    x, total, determined = jax.jit(jax.vmap(one))(jnp.asarray(uv), lenses)
    keep = np.concatenate([np.arange(4), 10 + np.arange(5)])
    return np.asarray(x), np.asarray(total)[:, keep][:, :, keep], np.asarray(determined)


def test_board_sigmas_cover_turntable_and_angles(board_repeats):
    x, C, determined = board_repeats
    assert determined.all()
    error = x - np.concatenate([TRUE.rotvec, [405.0], ANGLES])
    free = np.array([0, 1, 2, 3, 4, 5, 7, 8])  # the angle of photo 2 is held
    z = error[:, free] / np.sqrt(np.diagonal(C, axis1=1, axis2=2))[:, free]
    assert np.all(within_three(np.mean(np.abs(z) < 1, axis=0), 0.683, REPEATS)), np.mean(np.abs(z) < 1, axis=0)
    assert np.all(within_three(np.mean(np.abs(z) < 2, axis=0), 0.954, REPEATS)), np.mean(np.abs(z) < 2, axis=0)
    assert z.std() > 0.8  # and they are not larger than they need be
    e, C = error[:, :4], C[:, :4, :4]
    chi2 = np.einsum("ni,nij,nj->n", e, np.linalg.inv(C), e)
    assert 4 - 1.2 < chi2.mean() < 4 + 3 * np.sqrt(8 / REPEATS)


def test_board_sigmas_cover_point_and_direction_of_the_axis(board_repeats):
    x, C, _ = board_repeats
    true = [np.asarray(v) for v in TRUE.axis()]
    z = []
    for row, c in zip(x, C):
        axis = axis_numbers(Turntable(jnp.asarray(row[:3]), jnp.asarray(row[3]), TRUE.height), c[:4, :4])
        z.append([(axis.point - true[0]) / axis.sigma_point, (axis.direction - true[1]) / axis.sigma_direction])
    z = np.array(z)[:, :, [0, 2]]  # y of point and direction follow from the others to second order
    assert np.all(within_three(np.mean(np.abs(z) < 2, axis=0), 0.954, REPEATS)), np.mean(np.abs(z) < 2, axis=0)


def test_bead_sigmas_cover_turntable_angles_and_beads():
    """Scale from the calibrated turntable, with its covariance; every repeat draws that turntable anew."""
    C_lens, lenses = repeats_of_lens()
    repeats = 40
    beads = RNG.uniform([-60, 20, -25], [60, 150, 25], (10, 3))
    angles = np.radians(np.arange(12) * 30.0) + np.where(np.arange(12), RNG.uniform(-0.009, 0.009, 12), 0.0)
    stated, held = np.radians(np.arange(12) * 30.0), np.arange(12) == 0
    lens = lens_of(jnp.asarray(NUMBERS))

    def see(a, p):
        return pixel_of_point(lens.intrinsics, lens.distortion, TRUE.act(a, p))

    exact = jax.jit(jax.vmap(jax.vmap(see, (0, None)), (None, 0)))(jnp.asarray(angles), jnp.asarray(beads))
    visible = RNG.random((10, 12)) < 0.6
    known = np.diag(np.array([5e-4, 5e-4, 5e-4, 0.3]) ** 2)
    z_turn, z_angle, z_bead = [], [], []
    for k in range(repeats):
        off = RNG.multivariate_normal(np.zeros(4), known)
        file = Turntable(TRUE.rotvec + off[:3], TRUE.distance + off[3], TRUE.height)
        seen = PixelObservations.of(exact + RNG.normal(0, 0.15, exact.shape), jnp.asarray(visible), 0.5)
        prior = bead_prior(file, jnp.asarray(stated), jnp.asarray(held), covariance=known)
        used = lens_of(lenses[k])
        e = solve_beads(start_beads(file, jnp.asarray(stated), used, seen), seen, prior, C_lens)
        assert e.estimate.success
        s = np.sqrt(np.diag(np.asarray(e.covariance)))
        x = np.concatenate([e.turntable.rotvec, [float(e.turntable.distance)], e.angles])
        z = (x - np.concatenate([TRUE.rotvec, [405.0], angles])) / np.where(s > 0, s, 1)
        z_turn.append(z[:4])
        z_angle.append(z[5:])
        own = np.sqrt(np.diagonal(np.asarray(e.covariance_points), axis1=1, axis2=2))
        z_bead.append((np.asarray(e.points) - beads) / own)
    for name, z in (("turntable", z_turn), ("angles", z_angle), ("beads", z_bead)):
        # Numbers of one repeat go together: the repeats count, and the root mean square is what can be asked.
        rms = np.sqrt(np.mean(np.square(z), axis=tuple(range(1, np.ndim(z)))))
        assert 0.6 < np.sqrt(np.mean(rms**2)) < 1.3, (name, np.sqrt(np.mean(rms**2)))
        assert np.mean(np.abs(z) < 3) > 0.98, name
