import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap import InputError
from jaxmocap.calibration.boards import (
    chessboard_points,
    free_parameters,
    parameter_names,
    refine_targets,
    reproject,
    residual_pixels,
    view_residuals,
    visible_views,
)
from jaxmocap.synthetic.chessboards import add_noise, chessboard_world, lens_of_numbers


@pytest.fixture(scope="module")
def world():
    lens = lens_of_numbers(700.0, 690.0, 320.0, 230.0, (-0.2, 0.05))
    return chessboard_world(8, [lens], [(640, 480)], board=(6, 5), seed=2)


def test_points_row_by_row():
    np.testing.assert_array_equal(
        chessboard_points(3, 2, 10.0), [[0, 0, 0], [10, 0, 0], [20, 0, 0], [0, 10, 0], [10, 10, 0], [20, 10, 0]]
    )
    with pytest.raises(InputError, match="2x2"):
        chessboard_points(1, 5, 1.0)
    for square in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="square"):
            chessboard_points(9, 6, square)


def test_names_in_the_order_of_the_covariance():
    free = free_parameters(2, "k1k2p1p2k3", True, frozen=(("cx", "k3"), ()))
    found = parameter_names(free)
    assert found[:8] == tuple((0, n) for n in ("fx", "fy", "cy", "skew", "k1", "k2", "p1", "p2"))
    assert found[8:18] == tuple((1, n) for n in ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3"))
    assert found[18:] == tuple((1, n) for n in ("rx", "ry", "rz", "tx", "ty", "tz"))
    assert len(found) == sum(jax.tree.leaves(jax.tree.map(lambda f: 1 if f else 0, free.shared))) + 4  # 2 x 3 numbers


def test_residuals_by_opencv(world):
    view = jax.tree.map(lambda x: x[3], world.views)
    T = jax.tree.map(lambda x: x[3], world.truth.local)
    expected = cv2.projectPoints(
        np.array(view.points),
        np.array(T.rotvec),
        np.array(T.translation),
        np.array(world.truth.shared.lenses[0].intrinsics.matrix()),
        np.array([-0.2, 0.05, 0, 0, 0]),
    )[0].reshape(-1, 2)
    np.testing.assert_allclose(reproject(world.truth.shared, T, view.points)[0], expected, atol=1e-9)
    moved = jax.tree.map(lambda x: x, view)
    object.__setattr__(moved.seen, "uv", view.seen.uv + jnp.asarray([3.0, -4.0]).reshape(1, 1, 2))
    object.__setattr__(moved.seen, "sigma", 2.0 * view.seen.sigma)
    object.__setattr__(moved.seen, "visible", view.seen.visible.at[0, 5].set(False))
    r = np.asarray(view_residuals(world.truth.shared, T, moved, None))
    np.testing.assert_array_equal(r[5], 0.0)
    np.testing.assert_allclose(np.delete(r, 5, axis=0), [[-1.5, 2.0]] * 29, atol=1e-9)


def test_rms_is_that_of_lengths_and_sign_of_residuals(world):
    noisy = add_noise(world.views, 0.3, jax.random.key(0))
    estimate = refine_targets(world.truth, noisy, free_parameters(1, "k1k2", False))
    assert estimate.success
    r = np.asarray(residual_pixels(estimate.value, noisy))
    np.testing.assert_allclose(estimate.stats["rms_px"], np.sqrt(np.mean(np.sum(r**2, axis=-1))), rtol=1e-10)
    assert int(estimate.stats["observations"]) == 8 * 30
    assert float(estimate.stats["degrees_of_freedom"]) == 2 * 240 - 6 - 48
    predicted = np.asarray(
        jax.vmap(lambda T, p: reproject(estimate.value.shared, T, p)[0])(estimate.value.local, noisy.points)
    )
    np.testing.assert_allclose(r[:, 0], np.asarray(noisy.seen.uv[:, 0]) - predicted, atol=1e-12)


def test_rotation_vectors_beyond_pi_are_brought_back(world):
    far = jax.tree.map(lambda x: x, world.truth)
    turns = np.array(far.local.rotvec)
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    long = jnp.asarray(turns * (1 + 2 * np.pi / angle))  # the same rotations once round
    object.__setattr__(far.local, "rotvec", long)
    estimate = refine_targets(far, world.views, free_parameters(1, "k1k2", False))
    assert estimate.success and float(estimate.stats["rms_px"]) < 1e-8
    assert np.all(np.linalg.norm(estimate.value.local.rotvec, axis=1) < np.pi + 0.1)
    back = Rotation.from_rotvec(np.array(estimate.value.local.rotvec)) * Rotation.from_rotvec(turns).inv()
    assert np.max(back.magnitude()) < 1e-9


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_fit_hardly_sees_gross_errors(world, loss):
    free = free_parameters(1, "k1k2", False)
    noisy = add_noise(world.views, 0.2, jax.random.key(1))
    spoiled = jax.tree.map(lambda x: x, noisy)
    at = (np.array([0, 1, 2, 3, 4, 5, 6, 7] * 2), 0, np.arange(16))
    object.__setattr__(spoiled.seen, "uv", noisy.seen.uv.at[at].add(15.0))
    plain, robust = refine_targets(world.truth, spoiled, free), refine_targets(world.truth, spoiled, free, loss=loss)
    clean = refine_targets(world.truth, noisy, free)
    assert robust.success
    fx = lambda e: float(e.value.shared.lenses[0].intrinsics.fx)  # noqa: E731
    sigma = float(np.sqrt(clean.covariance.shared_plain()[0, 0]))
    assert abs(fx(robust) - fx(clean)) < 3 * sigma < abs(fx(plain) - fx(clean))


def test_unknown_model():
    with pytest.raises((InputError, TypeError), match="k1k2"):
        free_parameters(1, "k1k2k4", False)


def test_visible_views():
    visible = np.zeros((3, 2, 4), bool)
    visible[0, 0, 1] = visible[2, 0, 0] = visible[1, 1, 3] = True
    np.testing.assert_array_equal(visible_views(visible), [2, 1])
