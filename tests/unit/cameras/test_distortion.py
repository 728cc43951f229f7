"""The invertible radius against numpy's roots, and derivatives of the inverse."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import cameras, central_difference, growth_roots, over

from jaxmocap.cameras import BrownDistortion, undistort
from jaxmocap.cameras.distortion import parameter_names, undistort_many


def radius_squared(k):
    return BrownDistortion.from_vector(k).valid_radius_squared()


def inverse(k, xy):
    return undistort(BrownDistortion.from_vector(k), xy)


def ideal(k, xy):
    return inverse(k, xy)[0]


def test_names_are_in_the_order_of_files():
    assert parameter_names(BrownDistortion.none()) == ("k1", "k2", "p1", "p2", "k3")


def test_valid_radius_against_numpy_roots_for_random_lenses():
    rng = np.random.default_rng(0)
    k = rng.normal(size=(3000, 5)) * np.exp(rng.uniform(-6, 3, size=(3000, 5)))
    expected = np.array([roots[0] if len(roots := growth_roots(row)) else np.inf for row in k])
    np.testing.assert_allclose(over(radius_squared, k), expected, rtol=1e-9)


@pytest.mark.parametrize("used", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (0, 0, 0)])
def test_valid_radius_when_coefficients_are_zero(used):
    rng = np.random.default_rng([1, *used])
    k = np.zeros((500, 5))
    k[:, [0, 1, 4]] = rng.normal(size=(500, 3)) * np.exp(rng.uniform(-8, 3, size=(500, 3))) * used
    expected = np.array([roots[0] if len(roots := growth_roots(row)) else np.inf for row in k])
    np.testing.assert_allclose(over(radius_squared, k), expected, rtol=1e-9)


@pytest.mark.parametrize("tiny", [1e-2, 1e-5, 1e-8, 1e-12, 1e-16, 1e-20, 1e-30])
def test_no_positive_coefficient_however_small_makes_a_lens_fold_back(tiny):
    """The radius of a pincushion lens is infinite, also where a solver has just begun to move k2 or k3 off zero."""
    rng = np.random.default_rng(3)
    k = np.zeros((2000, 5))
    k[:, 0] = rng.uniform(0, 2, 2000)
    k[:, 1] = tiny * rng.uniform(0, 1, 2000) * rng.integers(0, 2, 2000)
    k[:, 4] = tiny * rng.uniform(0, 1, 2000) * rng.integers(0, 2, 2000)
    assert np.all(over(radius_squared, k) == np.inf)


@pytest.mark.parametrize("tiny", [1e-2, 1e-5, 1e-8, 1e-12, 1e-16])
def test_a_small_negative_k3_folds_a_pincushion_lens_far_out(tiny):
    """1 + 3 k1 s - 7 tiny s^3 = 0: the root by halving a bracket, in plain Python."""
    for k1 in (0.01, 0.3, 2.0):
        low, high = 1e-3, 1e12
        for _ in range(400):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if 1 + 3 * k1 * middle - 7 * tiny * middle**3 > 0 else (low, middle)
        np.testing.assert_allclose(radius_squared(jnp.array([k1, 0, 0, 0, -tiny])), low, rtol=1e-9)


def test_valid_radius_by_hand():
    cases = {
        (-1 / 3, 0, 0): 1.0,  # 1 - s
        (0, -1 / 5, 0): 1.0,  # 1 - s^2
        (0, 0, -1 / 7): 1.0,  # 1 - s^3
        (-1.0, 0.4, 0): 0.5,  # 1 - 3 s + 2 s^2 = (1 - s)(1 - 2 s)
        (0.5, 0.3, 0.1): np.inf,
        (2.0, 0, 0): np.inf,
    }
    for (k1, k2, k3), expected in cases.items():
        np.testing.assert_allclose(radius_squared(jnp.array([k1, k2, 0.3, 0.3, k3])), expected, rtol=1e-12)


def test_undistort_is_exact_up_to_just_below_the_fold():
    """Ideal points at 10 .. 99.99 percent of the invertible radius of a barrel lens come back."""
    k = np.array([-0.3, 0.05, 0.0, 0.0, -0.002])
    radius = np.sqrt(growth_roots(k)[0])
    m = radius * np.array([0.1, 0.5, 0.9, 0.99, 0.999, 0.9999])[:, None] * np.array([[0.6, -0.8]])
    L = 1 + np.sum(m * m, axis=1) * (k[0] + np.sum(m * m, axis=1) * (k[1] + np.sum(m * m, axis=1) * k[4]))
    got, valid = over(inverse, np.tile(k, (6, 1)), m * L[:, None])
    assert np.all(valid)
    np.testing.assert_allclose(got[:-2], m[:-2], rtol=1e-13)
    np.testing.assert_allclose(got[-2:], m[-2:], rtol=1e-11)  # the slope is 1e-4 there


def test_undistort_of_the_ideal_lens_and_of_the_centre():
    xy, valid = undistort(BrownDistortion.none(), jnp.array([0.3, -5.0]))
    assert valid and np.array_equal(xy, [0.3, -5.0])
    xy, valid = inverse(jnp.array([-0.3, 0.1, 1e-3, 1e-3, 0.0]), jnp.zeros(2))
    assert valid and np.array_equal(xy, [0, 0])


def test_undistort_many_is_undistort_of_each():
    lens = BrownDistortion.from_vector(jnp.array([-0.2, 0.05, 1e-3, -1e-3, 0.0]))
    xy = jnp.array([[0.1, 0.2], [-0.3, 0.1]])
    got, valid = jax.jit(undistort_many)(lens, xy)
    each = jax.jit(undistort)
    for i in range(2):
        np.testing.assert_allclose(got[i], each(lens, xy[i])[0], rtol=1e-14)
    assert np.all(valid)


def both_ways(k, xy):
    return jax.jacfwd(ideal, (0, 1))(k, xy), jax.jacrev(ideal, (0, 1))(k, xy)


def test_derivatives_of_undistort_by_pixel_and_by_every_lens_number():
    """Forward = reverse = central difference, and the same under jit and vmap."""
    value, jitted = jax.jit(ideal), jax.jit(both_ways)
    rng = np.random.default_rng(2)
    drawn = cameras(4, seed=5)
    lenses = np.array([numbers.k for numbers in drawn] + [np.zeros(5)])
    points = np.array([0.4 * numbers.radius_in_view() * rng.normal(size=2) for numbers in drawn] + [[0.2, 0.1]])
    assert np.all(over(inverse, lenses, points)[1])
    batched = over(both_ways, lenses, points)
    for i, (k, xy) in enumerate(zip(lenses, points)):
        (k_forward, xy_forward), (k_reverse, xy_reverse) = jitted(jnp.array(k), jnp.array(xy))
        np.testing.assert_allclose(k_forward, k_reverse, atol=1e-13)
        np.testing.assert_allclose(xy_forward, xy_reverse, atol=1e-13)
        np.testing.assert_allclose(k_forward, central_difference(partial(swapped, value, xy), k), atol=1e-8)
        np.testing.assert_allclose(xy_forward, central_difference(partial(value, k), xy), atol=1e-8)
        np.testing.assert_allclose(batched[0][0][i], k_forward, atol=1e-13)
        np.testing.assert_allclose(batched[1][1][i], xy_reverse, atol=1e-13)


def swapped(fn, second, first):
    return fn(first, second)


def test_derivative_by_one_number_while_the_others_are_frozen():
    """As a solver does it: the lens is split, and only part of it carries a tangent."""
    lens = BrownDistortion.from_vector(jnp.array([-0.2, 0.05, 1e-3, -1e-3, 0.01]))
    xy = jnp.array([0.3, -0.2])
    only_k1 = eqx.tree_at(lambda lens: lens.k1, jax.tree.map(lambda _: False, lens), True)
    free, frozen = eqx.partition(lens, only_k1)

    def moved(free):
        return undistort(eqx.combine(free, frozen), xy)[0]

    whole = jax.jit(jax.jacfwd(ideal))(lens.vector(), xy)
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(derivative(moved))(free).k1, whole[:, 0], rtol=1e-12)


def test_inverse_function_has_second_derivatives():
    k, xy = np.array([-0.2, 0.05, 1e-3, -1e-3, 0.01]), np.array([0.3, -0.2])
    first = jax.jit(jax.jacfwd(ideal, 1))
    second = jax.jit(jax.jacfwd(jax.jacfwd(ideal, 1), 1))(jnp.array(k), jnp.array(xy))
    np.testing.assert_allclose(second, central_difference(lambda a: first(jnp.array(k), a), xy), atol=1e-7)


def test_where_the_lens_folds_back_values_and_derivatives_are_finite():
    k = np.tile([-0.4, 0.0, 1e-3, 1e-3, 0.0], (4, 1))
    xy = np.outer([0.6, 0.62, 1.0, 100.0], [1.0, 0.3])
    m, valid = over(inverse, k, xy)
    assert not np.any(valid) and np.all(np.isfinite(m))
    assert np.all(np.isfinite(over(jax.jacfwd(ideal, 0), k, xy)))
    assert np.all(np.isfinite(over(jax.jacrev(ideal, 1), k, xy)))
