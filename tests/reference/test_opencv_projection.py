"""Projection and its inverse against OpenCV on the same numbers.

OpenCV ignores K[0][1], so the skew is zero here; its effect is computed by hand in unit/cameras.
"""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import CameraNumbers, cameras, points_in_view

from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, project, ray_from_pixel, undistort
from jaxmocap.geometry import Pose

VIEWS = cameras(8, seed=1, skew=False)
each_view = pytest.mark.parametrize("numbers", VIEWS, ids=lambda n: f"f={n.K[0, 0]:.0f}")
project_all = jax.jit(jax.vmap(project, in_axes=(None, 0)))
rays = jax.jit(jax.vmap(ray_from_pixel, in_axes=(None, 0)))
undistort_all = jax.jit(jax.vmap(undistort, in_axes=(None, 0)))


def camera_from(numbers: CameraNumbers) -> Camera:
    return Camera(
        Intrinsics.from_matrix(jnp.array(numbers.K)),
        BrownDistortion.from_vector(jnp.array(numbers.k)),
        Pose(jnp.array(numbers.rotvec), jnp.array(numbers.translation)),
        numbers.size,
    )


@each_view
def test_project_against_project_points(numbers):
    p_world, _ = points_in_view(numbers, 50)
    expected, jacobian = cv2.projectPoints(p_world, numbers.rotvec, numbers.translation, numbers.K, numbers.k)
    uv, valid = project_all(camera_from(numbers), jnp.array(p_world))
    assert np.all(valid)
    np.testing.assert_allclose(uv, expected[:, 0], atol=1e-9)


@each_view
def test_derivatives_against_project_points(numbers):
    """OpenCV's own derivatives by rotation vector and translation (columns 0-5) and focal lengths (6-7)."""
    p_world, _ = points_in_view(numbers, 10)
    jacobian = cv2.projectPoints(p_world, numbers.rotvec, numbers.translation, numbers.K, numbers.k)[1]
    J = derivatives(camera_from(numbers), jnp.array(p_world))
    pose, K = J.T_camera_world, J.intrinsics
    got = np.concatenate([pose.rotvec, pose.translation, np.stack([K.fx, K.fy], axis=-1)], axis=-1)
    np.testing.assert_allclose(got.reshape(20, 8), jacobian[:, :8], rtol=1e-7, atol=1e-7)
    lens = np.stack([getattr(J.distortion, name) for name in ("k1", "k2", "p1", "p2", "k3")], axis=-1)
    np.testing.assert_allclose(lens.reshape(20, 5), jacobian[:, 10:15], rtol=1e-7, atol=1e-7)


@jax.jit
def derivatives(camera, points):
    return jax.vmap(jax.jacfwd(lambda c, p: project(c, p)[0]), in_axes=(None, 0))(camera, points)


@each_view
def test_undistort_against_undistort_points(numbers):
    """OpenCV given 500 rounds of its fixed point, at pixels that are images of points inside the radius."""
    p_world, _ = points_in_view(numbers, 50, seed=2)
    pixels = cv2.projectPoints(p_world, numbers.rotvec, numbers.translation, numbers.K, numbers.k)[0]
    rounds = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-15)
    iterate = getattr(cv2, "undistortPointsIter", None)  # OpenCV 4 keeps the rounds in a function of their own
    if iterate is not None:
        expected = iterate(pixels, numbers.K, numbers.k, None, None, rounds)[:, 0]
    else:
        expected = cv2.undistortPoints(pixels, numbers.K, numbers.k, criteria=rounds)[:, 0]
    camera = camera_from(numbers)
    xy = jax.vmap(camera.intrinsics.normalised_from_pixel)(jnp.array(pixels[:, 0]))
    got, valid = undistort_all(camera.distortion, xy)
    assert np.all(valid)
    np.testing.assert_allclose(got, expected, atol=1e-8)


@each_view
def test_rays_pass_through_the_points_opencv_projects(numbers):
    p_world, p_camera = points_in_view(numbers, 50, seed=3)
    pixels = cv2.projectPoints(p_world, numbers.rotvec, numbers.translation, numbers.K, numbers.k)[0][:, 0]
    centre, direction, valid = rays(camera_from(numbers), jnp.array(pixels))
    distance = np.linalg.norm(p_camera, axis=1)
    assert np.all(valid)
    np.testing.assert_allclose(centre + distance[:, None] * direction, p_world, atol=1e-11 * distance.max())
