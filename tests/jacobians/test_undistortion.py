"""The document's printed removal of distortion does not return the inverse; the corrected one does."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import over

from jaxmocap.cameras import BrownDistortion, Intrinsics, undistort
from jaxmocap.closed_forms.undistortion import undistort_pixel_corrected, undistort_pixel_printed

K = Intrinsics.from_matrix(jnp.array([[800.0, 2, 320], [0, 810, 240], [0, 0, 1]]))
LENS = BrownDistortion.from_vector(jnp.array([-0.2, 0.05, 0.0, 0.0, 0.0]))


def observed() -> tuple[np.ndarray, np.ndarray]:
    """Ideal pixels on a grid, and where LENS images them, by the document's 4.15-4.18 written out here."""
    x, y = (a.ravel() for a in np.meshgrid([-0.35, -0.1, 0.05, 0.3], [-0.25, 0.1, 0.2]))
    r2 = x * x + y * y
    L = 1 - 0.2 * r2 + 0.05 * r2 * r2
    ideal = np.stack([800 * x + 2 * y + 320, 810 * y + 240], axis=1)
    return ideal, np.stack([800 * L * x + 2 * L * y + 320, 810 * L * y + 240], axis=1)


@cache
def repeated(fn, steps):
    return jax.jit(jax.vmap(lambda uv: fn(K, LENS, uv, steps)))


@pytest.mark.parametrize("steps", [1, 2, 3, 5, 10])
def test_the_printed_iteration_moves_away_from_the_ideal_pixel(steps):
    ideal, real = observed()
    got = np.asarray(repeated(undistort_pixel_printed, steps)(jnp.array(real)))
    error, before = np.linalg.norm(got - ideal, axis=1), np.linalg.norm(real - ideal, axis=1)
    assert not np.any(error < 10 * before)  # every pixel is worse off than untouched, or not a number


def test_one_printed_step_by_hand():
    """u = 480, v = 240: x = .2, r^2 = .04, k = -.2 * .04 + .05 * .0016 = -.00792; u <- (480 + 320 k)/k."""
    got = undistort_pixel_printed(K, LENS, jnp.array([480.0, 240.0]), 1)
    np.testing.assert_allclose(got, [480 / -0.00792 + 320, 240 / -0.00792 + 240], rtol=1e-12)


def test_the_corrected_iteration_converges_to_the_ideal_pixel():
    ideal, real = observed()
    error = [
        np.linalg.norm(repeated(undistort_pixel_corrected, n)(jnp.array(real)) - ideal, axis=1) for n in (0, 2, 4, 30)
    ]
    assert np.all(error[1] < 0.05 * error[0]) and np.all(error[2] < 0.05 * error[1] + 1e-12)
    assert np.all(error[3] < 1e-11)


def ours(uv):
    xy, valid = undistort(LENS, K.normalised_from_pixel(uv))
    return K.pixel_from_normalised(xy), valid


def test_ours_is_what_the_corrected_iteration_converges_to():
    _, real = observed()
    uv, valid = over(ours, real)
    assert np.all(valid)
    np.testing.assert_allclose(uv, repeated(undistort_pixel_corrected, 60)(jnp.array(real)), rtol=0, atol=1e-10)
