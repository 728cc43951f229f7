import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.calibration.homography import apply_homography, fit_homography_linear, refine_homography

XY = np.stack(np.meshgrid(np.arange(5.0) * 30, np.arange(4.0) * 30), axis=-1).reshape(-1, 2)
ALL = jnp.ones(20, bool)
H_TRUE = np.array([[3.0, 0.4, 100.0], [-0.3, 2.7, 60.0], [1e-3, -5e-4, 1.0]])


def _apply(H, xy):
    m = np.hstack([xy, np.ones((len(xy), 1))]) @ H.T
    return m[:, :2] / m[:, 2:]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exact_points_and_sign(sign):
    found = fit_homography_linear(jnp.asarray(XY), jnp.asarray(_apply(sign * H_TRUE, XY)), ALL)
    np.testing.assert_allclose(found, H_TRUE / np.linalg.norm(H_TRUE), atol=1e-12)


def test_four_points_and_masked_ones():
    uv = _apply(H_TRUE, XY)
    mask = np.isin(np.arange(20), [0, 4, 15, 19])
    uv[~mask] = -1e5
    found = fit_homography_linear(jnp.asarray(XY), jnp.asarray(uv), jnp.asarray(mask))
    np.testing.assert_allclose(found, H_TRUE / np.linalg.norm(H_TRUE), atol=1e-11)
    np.testing.assert_allclose(
        refine_homography(found, jnp.asarray(XY), jnp.asarray(uv), jnp.asarray(mask)), found, atol=1e-9
    )


@pytest.mark.parametrize("seed", range(3))
def test_noisy_points_against_opencv(seed):
    """cv2.findHomography with method 0 refines the linear solution by Levenberg-Marquardt, too."""
    uv = _apply(H_TRUE, XY) + np.random.default_rng(seed).normal(0, 0.5, XY.shape)
    found = np.asarray(
        refine_homography(
            fit_homography_linear(jnp.asarray(XY), jnp.asarray(uv), ALL), jnp.asarray(XY), jnp.asarray(uv), ALL
        )
    )
    theirs = cv2.findHomography(XY, uv, 0)[0]
    error, their_error = (np.sum((_apply(H, XY) - uv) ** 2) for H in (found, theirs))
    assert error <= their_error * (1 + 1e-9)
    np.testing.assert_allclose(_apply(found, XY), _apply(theirs, XY), atol=1e-3)


def test_finite_on_the_vanishing_line():
    H = jnp.asarray([[1.0, 0, 0], [0, 1.0, 0], [1.0, 0, 0]])
    assert np.all(np.isfinite(apply_homography(H, jnp.array([0.0, 1.0]))))
