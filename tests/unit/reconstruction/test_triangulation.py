"""Points from rays: against numbers by hand, OpenCV and numpy's least squares."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import view_samples as scene

from jaxmocap.reconstruction import fit_point_dlt, fit_point_linear, midpoint, point_as_printed, rays
from jaxmocap.reconstruction.triangulation import normals_as_printed

RIG = scene.rig()
POINTS = np.random.default_rng(1).uniform(-60, 60, (20, 3))
UV = scene.pixels(POINTS)
ALL = np.ones(UV.shape[:2], bool)


@jax.jit
def solved(cameras, uv, visible):
    """Rays and the point by each of three ways, for many points."""

    def one(uv, visible):
        r = rays(cameras, uv, visible)
        return r, point_as_printed(*r), fit_point_linear(*r), fit_point_dlt(cameras, uv, visible)

    return jax.vmap(one)(uv, visible)


def test_all_ways_return_the_point_that_was_projected():
    _, *ways = solved(RIG, jnp.asarray(UV), jnp.asarray(ALL))
    for p, valid in ways:
        assert valid.all()
        np.testing.assert_allclose(p, POINTS, atol=1e-7)


def test_least_squares_of_noisy_rays_is_numpy_s():
    noisy = UV + np.random.default_rng(2).normal(0, 2, UV.shape)
    (centre, v, use), printed, linear, _ = (jax.tree.map(np.asarray, x) for x in solved(RIG, jnp.asarray(noisy), ALL))
    for i in range(len(POINTS)):
        # Distance to a ray: the part of x - c across v.
        P = [np.eye(3) - np.outer(d, d) for d in v[i]]
        A, y = np.concatenate(P), np.concatenate([p @ c for p, c in zip(P, centre[i])])
        expected = np.linalg.lstsq(A, y, rcond=None)[0]
        np.testing.assert_allclose(printed[0][i], expected, atol=1e-8)
        np.testing.assert_allclose(linear[0][i], expected, atol=1e-9)
    assert use.all()


def test_dlt_is_opencv_s():
    noisy = UV + np.random.default_rng(3).normal(0, 2, UV.shape)
    two = np.zeros_like(ALL)
    two[:, [0, 2]] = True
    _, _, _, (p, valid) = solved(RIG, jnp.asarray(noisy), jnp.asarray(two))
    rotvec, t = scene.poses()
    P = [np.hstack([cv2.Rodrigues(r)[0], x[:, None]]) for r, x in zip(rotvec, t)]
    # OpenCV's own undistortion stops at five steps unless told otherwise; OpenCV 4 has a function of its own for it.
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)

    def undistort(uv):
        if hasattr(cv2, "undistortPointsIter"):
            return cv2.undistortPointsIter(uv, scene.K, scene.LENS, None, None, stop)[:, 0].T
        return cv2.undistortPoints(uv, scene.K, scene.LENS, criteria=stop)[:, 0].T

    ideal = [undistort(np.ascontiguousarray(noisy[:, k])) for k in (0, 2)]
    X = cv2.triangulatePoints(P[0], P[2], *ideal)
    assert valid.all()
    np.testing.assert_allclose(p, (X[:3] / X[3]).T, atol=1e-6)


def test_fewer_than_two_views_are_a_mask_not_a_number():
    seen = ALL.copy()
    seen[0], seen[1, 1:] = False, False
    _, *ways = solved(RIG, jnp.asarray(UV), jnp.asarray(seen))
    for p, valid in ways:
        np.testing.assert_array_equal(valid[:3], [False, False, True])
        assert np.isfinite(p).all()


def test_parallel_rays_are_not_determined():
    centre = jnp.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    v = jnp.tile(jnp.array([[0.0, 0, 1]]), (3, 1))
    use = jnp.ones(3, bool)
    for p, valid in (point_as_printed(centre, v, use), fit_point_linear(centre, v, use)):
        assert not valid and np.isfinite(p).all()
    p, gap, valid = midpoint(centre[0], v[0], centre[1], v[1])
    assert not valid and np.isfinite(p).all() and np.isfinite(gap)


@pytest.mark.parametrize("v", [[1.0, 0, 0], [0, 2, 0], [0, 0, -3], [1, 1, 1], [1e-9, 1, 0]])
def test_normals_of_eq_5_9_and_5_10(v):
    v = np.asarray(v, float)
    pair = np.stack([np.asarray(n) for n in normals_as_printed(jnp.asarray(v))])
    np.testing.assert_allclose(pair @ pair.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(pair @ v, 0, atol=1e-12)


def test_midpoint_by_hand():
    # The z axis, and a line along x at height z = 5 that passes it at a distance of 2.
    p, gap, valid = midpoint(*(jnp.asarray(x, float) for x in ([0, 0, 0], [0, 0, 3], [7, 2, 5], [1, 0, 0])))
    np.testing.assert_allclose(p, [0, 1, 5], atol=1e-12)
    assert valid and abs(gap - 2) < 1e-12


def test_the_well_conditioned_form_keeps_digits_that_the_printed_one_loses():
    """Two rays 1e-4 apart in direction, a million units from the origin of the world."""
    far = np.array([1e6, 2e6, 3e6])
    point = far + [3.0, 4.0, 1000.0]
    centre = far + np.array([[0.0, 0, 0], [0.1, 0, 0]])
    args = jnp.asarray(centre), jnp.asarray(point - centre), jnp.ones(2, bool)
    printed = np.abs(np.asarray(point_as_printed(*args)[0]) - point).max()
    linear = np.abs(np.asarray(fit_point_linear(*args)[0]) - point).max()
    assert linear < 1e-3 and linear < 0.01 * printed


def test_derivatives_are_finite_also_where_nothing_is_determined():
    seen = ALL[:3].copy()
    seen[1, 1:], seen[2] = False, False

    def total(uv):
        _, *ways = solved(RIG, uv, jnp.asarray(seen))
        return sum(jnp.sum(p) for p, _ in ways)

    assert np.isfinite(jax.grad(total)(jnp.asarray(UV[:3]))).all()
