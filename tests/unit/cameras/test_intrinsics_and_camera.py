"""Projection by hand: skew, a turned camera, points behind, lenses that fold back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.cameras import (
    BrownDistortion,
    Camera,
    Intrinsics,
    camera_of,
    project,
    project_from_camera,
    ray_from_pixel,
    stack_cameras,
)
from jaxmocap.geometry import Pose

K = np.array([[800.0, 4, 320], [0, 810, 240], [0, 0, 1]])


def camera(k=(0.0,) * 5, rotvec=(0.0, 0, 0), translation=(0.0, 0, 0)) -> Camera:
    pose = Pose(jnp.array(rotvec, dtype=float), jnp.array(translation, dtype=float))
    lens = BrownDistortion.from_vector(jnp.array(k, dtype=float))
    return Camera(Intrinsics.from_matrix(jnp.array(K)), lens, pose, (640, 480))


def test_matrix_and_back():
    assert np.array_equal(Intrinsics.from_matrix(jnp.array(K)).matrix(), K)
    assert np.array_equal(BrownDistortion.from_vector(jnp.arange(5.0)).vector(), np.arange(5.0))
    assert np.array_equal(BrownDistortion.none().vector(), np.zeros(5))


def test_pixel_with_skew_by_hand():
    # (1, 2, 4): x = .25, y = .5; u = 800 * .25 + 4 * .5 + 320, v = 810 * .5 + 240
    uv, valid = project(camera(), jnp.array([1.0, 2.0, 4.0]))
    np.testing.assert_allclose(uv, [522, 645], rtol=1e-15)
    assert valid
    np.testing.assert_allclose(camera().intrinsics.normalised_from_pixel(uv), [0.25, 0.5], rtol=1e-14)


def test_distortion_by_hand():
    # x = 1, y = 2, r^2 = 5: radial = 1 + .1 * 5 + .01 * 25 + .001 * 125 = 1.875
    # x_d = 1.875 + 2 * .1 * 2 + .01 * (5 + 2) = 2.345;  y_d = 3.75 + .1 * (5 + 8) + 2 * .01 * 2 = 5.09
    lens = BrownDistortion.from_vector(jnp.array([0.1, 0.01, 0.1, 0.01, 0.001]))
    np.testing.assert_allclose(lens.distort(jnp.array([1.0, 2.0])), [2.345, 5.09], rtol=1e-14)


def test_skew_acts_on_the_distorted_point():
    # x = y = 1/2, k1 = .2: radial = 1.1; u = 800 * .55 + 4 * .55 + 320
    uv, _ = project(camera(k=(0.2, 0, 0, 0, 0)), jnp.array([1.0, 1.0, 2.0]))
    np.testing.assert_allclose(uv, [800 * 0.55 + 4 * 0.55 + 320, 810 * 0.55 + 240], rtol=1e-15)


def test_a_camera_that_looks_along_world_x():
    """R takes world x to camera z: a third of a turn, x -> z -> y -> x. Placed 5 back along world x."""
    third = -2 * np.pi / 3 / np.sqrt(3) * np.ones(3)
    view = camera(rotvec=third, translation=(0.0, 0, 5))
    uv, valid = project(view, jnp.array([3.0, 0.8, 1.6]))  # camera (0.8, 1.6, 8): x = .1, y = .2
    np.testing.assert_allclose(uv, [80 + 0.8 + 320, 162 + 240], rtol=1e-14)
    assert valid
    centre, direction, valid = ray_from_pixel(view, jnp.array([320.0, 240.0]))
    np.testing.assert_allclose(centre, [-5, 0, 0], atol=1e-14)
    np.testing.assert_allclose(direction, [1, 0, 0], atol=1e-15)
    assert valid


def pixel(view, p):
    return project(view, p)[0]


def test_behind_the_camera_is_not_valid_but_finite_with_finite_derivatives():
    view = camera(k=(0.1, 0, 1e-3, 0, 0))
    see, forward, reverse = jax.jit(project), jax.jit(jax.jacfwd(pixel, 1)), jax.jit(jax.jacrev(pixel, 1))
    for z in (0.0, -0.0, -1e-6, -1.0, -50.0):
        p = jnp.array([0.1, -0.2, z])
        uv, valid = see(view, p)
        assert not valid and np.all(np.isfinite(uv))
        assert np.all(np.isfinite(forward(view, p))) and np.all(np.isfinite(reverse(view, p)))
    assert not see(view, jnp.array([0.1, -0.2, -1e-300]))[1]


def test_a_lens_that_folds_back_is_not_valid_beyond_the_fold():
    """k1 = -1/3: r (1 - r^2 / 3) grows up to r = 1."""
    folding = camera(k=(-1 / 3, 0, 0, 0, 0))
    np.testing.assert_allclose(folding.distortion.valid_radius_squared(), 1, rtol=1e-14)
    see = jax.jit(project)
    for r, expected in [(0.0, True), (0.999, True), (1.001, False), (5.0, False)]:
        uv, valid = see(folding, jnp.array([r, 0.0, 1.0]))
        assert bool(valid) == expected and np.all(np.isfinite(uv))


def test_a_pixel_no_point_is_seen_at_is_flagged():
    """The same lens images nothing beyond radius 2/3; inside it, 0.5 is the image of 0.5547... (root of r - r^3/3)."""
    lens = BrownDistortion.from_vector(jnp.array([-1 / 3, 0, 0, 0, 0]))
    root = np.roots([-1 / 3, 0, 1, -0.5])
    inside = root[(root > 0) & (root < 1)][0]
    undistort = jax.jit(BrownDistortion.undistort)
    xy, valid = undistort(lens, jnp.array([0.5, 0.0]))
    assert valid
    np.testing.assert_allclose(xy, [inside, 0], rtol=1e-13)
    for radius in (0.66, 0.6666):
        assert undistort(lens, jnp.array([0.0, radius]))[1]
    for radius in (0.6667, 0.7, 1.0, 5.0, 1e3):
        xy, valid = undistort(lens, jnp.array([0.0, radius]))
        assert not valid and np.all(np.isfinite(xy))


def test_rays_where_the_lens_folds_back_are_flagged():
    folding = camera(k=(-1 / 3, 0, 0, 0, 0))
    centre, direction, valid = ray_from_pixel(folding, jnp.array([320.0 + 800, 240.0]))
    assert not valid and np.all(np.isfinite(centre)) and np.all(np.isfinite(direction))


def test_project_from_camera_is_project_without_the_pose():
    still = camera(k=(0.1, -0.02, 1e-3, 2e-3, 0.01))
    uv, valid = project_from_camera(still.intrinsics, still.distortion, jnp.array([0.3, -0.2, 2.0]))
    expected = project(still, jnp.array([0.3, -0.2, 2.0]))
    assert np.array_equal(uv, expected[0]) and valid == expected[1]


def test_a_rig_is_cameras_with_a_leading_axis():
    one, two = camera(), camera(translation=(1.0, 0, 0))
    rig = stack_cameras([one, two])
    assert rig.intrinsics.fx.shape == (2,) and rig.image_size == (640, 480)
    p = jnp.array([0.5, 0.25, 2.0])
    uv, valid = jax.vmap(project, in_axes=(0, None))(rig, p)
    np.testing.assert_allclose(uv, [[200 + 0.5 + 320, 341.25], [600 + 0.5 + 320, 341.25]])
    assert np.all(valid)
    np.testing.assert_allclose(project(camera_of(rig, 1), p)[0], uv[1])


def test_wrong_rigs_are_refused():
    with pytest.raises(InputError, match="at least one"):
        stack_cameras([])
    other = camera()
    other = Camera(other.intrinsics, other.distortion, other.T_camera_world, (1280, 720))
    with pytest.raises(InputError, match=r"one image size, got \[\(640, 480\), \(1280, 720\)\]"):
        stack_cameras([camera(), other])
