"""The drawn bar problem: perfect at the truth, in view, and the same for the same seed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._errors import InputError
from jaxmocap.cameras import BrownDistortion, Intrinsics, project_from_camera
from jaxmocap.synthetic import bar

BLOCKS = 40


def residuals(world: bar.BarWorld, at) -> np.ndarray:
    run = jax.vmap(bar.bar_residuals, (None, 0, 0, None))
    return np.asarray(run(at.shared, at.local, world.images, world.common))


@pytest.fixture(scope="module")
def world() -> bar.BarWorld:
    return bar.make_bar(BLOCKS, seed=3)


def test_residuals_of_perfect_images_are_zero_at_the_truth() -> None:
    perfect = bar.make_bar(BLOCKS, seed=3, noise=0.0)
    # 1e-10 px and 1e-14 m, in units of the sigmas.
    assert np.abs(residuals(perfect, perfect.truth)).max() < 1e-9


def test_shapes(world: bar.BarWorld) -> None:
    assert residuals(world, world.start).shape == (BLOCKS, 9)
    assert world.images.first.shape == world.images.second.shape == (BLOCKS, 2, 2)
    assert sum(x.size for x in jax.tree.leaves(world.start.shared)) == 18
    assert sum(x[0].size for x in jax.tree.leaves(world.start.local)) == 6
    assert jax.tree.structure(world.start) == jax.tree.structure(world.truth)


def test_same_seed_same_world_other_seed_other_world(world: bar.BarWorld) -> None:
    again, other = bar.make_bar(BLOCKS, seed=3), bar.make_bar(BLOCKS, seed=4)
    for a, b in zip(jax.tree.leaves(world), jax.tree.leaves(again)):
        np.testing.assert_array_equal(a, b)
    assert np.abs(np.asarray(world.images.first) - np.asarray(other.images.first)).max() > 1.0


def test_noise_has_the_stated_sigma() -> None:
    world = bar.make_bar(2000, seed=5)
    r = residuals(world, world.truth)[:, :8]
    # 16,000 numbers: their standard deviation is known to 1 / sqrt(32,000) = 0.6 %; five times that.
    assert abs(r.std() - 1.0) < 0.03
    assert np.abs(residuals(world, world.truth)[:, 8]).max() < 1e-9


def test_setting_is_the_documents(world: bar.BarWorld) -> None:
    T = world.truth.shared.T_second_first
    centre = np.asarray(T.inverse().translation)
    assert np.linalg.norm(centre) == pytest.approx(3.0, rel=0.02)
    axis = np.asarray(T.inverse().act(jnp.array([0.0, 0.0, 1.0]))) - centre
    assert np.degrees(np.arccos(axis[2])) == pytest.approx(90.0, abs=2.0)
    lengths = np.linalg.norm(np.asarray(world.truth.local.a - world.truth.local.b), axis=1)
    np.testing.assert_allclose(lengths, bar.BAR_LENGTH, rtol=1e-14)
    middle = 0.5 * np.asarray(world.truth.local.a + world.truth.local.b)
    assert np.linalg.norm(middle - [0.0, 0.0, 3.0 / np.sqrt(2.0)], axis=1).max() <= 0.5 * np.linalg.norm(bar.VOLUME)
    for uv in (world.images.first, world.images.second):
        assert (np.asarray(uv) > -2).all() and (np.asarray(uv) < np.array(bar.IMAGE_SIZE) + 1).all()


def test_start_is_a_few_percent_off(world: bar.BarWorld) -> None:
    start, truth = world.start, world.truth
    for k in ("first", "second"):
        a, b = getattr(start.shared, k), getattr(truth.shared, k)
        assert 0 < abs(float(a.fx / b.fx) - 1) < 0.1 and float(a.k1) == float(a.k2) == 0.0
    off = np.asarray(start.local.a / truth.local.a) - 1
    assert 0.015 < off.std() < 0.025


def test_camera_is_the_librarys_camera() -> None:
    camera = bar.true_cameras().first
    zero = jnp.zeros(())
    intrinsics = Intrinsics(camera.fx, camera.fy, camera.cx, camera.cy, zero)
    lens = BrownDistortion(camera.k1, camera.k2, zero, zero, zero)
    p = jnp.array([0.4, -0.3, 1.7])
    np.testing.assert_allclose(camera.project(p), project_from_camera(intrinsics, lens, p)[0], rtol=1e-14)


def test_no_blocks_are_refused() -> None:
    with pytest.raises(InputError, match="at least 1, got 0"):
        bar.make_bar(0)
