import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jaxmocap import InputError
from jaxmocap.optim.robust import TUNING, apply, rho, robustify, scale_from_data, weight

WIDTH = jnp.asarray(1.5)


def test_losses_by_hand():
    s = jnp.asarray([0.0, 1.0, 2.25, 9.0])
    np.testing.assert_allclose(rho("huber", s, WIDTH), [0, 1, 2.25, 2 * 1.5 * 3 - 2.25])
    np.testing.assert_allclose(rho("cauchy", s, WIDTH), 2.25 * np.log([1, 1 + 1 / 2.25, 2, 5]))


@pytest.mark.parametrize("loss", TUNING)
def test_weight_is_the_derivative(loss):
    s = jnp.asarray([0.0, 0.5, 2.0, 3.0, 50.0])
    slope = jax.vmap(jax.grad(lambda x: rho(loss, x, WIDTH)))(s)
    np.testing.assert_allclose(weight(loss, s, WIDTH), slope, rtol=1e-12)
    assert np.all(np.diff(np.asarray(slope)) <= 0)


@pytest.mark.parametrize("loss", TUNING)
def test_squares_of_applied_residuals_are_the_loss(loss):
    r = jnp.asarray(np.random.default_rng(0).normal(size=(50, 2)) * np.geomspace(1e-9, 50, 50)[:, None])
    s = jnp.sum(r**2, axis=1)
    np.testing.assert_allclose(jnp.sum(apply(loss, r, WIDTH) ** 2, axis=1), rho(loss, s, WIDTH), rtol=1e-9)
    J = jax.jacfwd(lambda x: apply(loss, x[None], WIDTH)[0])(jnp.zeros(2))
    np.testing.assert_allclose(J, np.eye(2))


def test_same_block_same_function():
    block = lambda shared, local, data, common: data  # noqa: E731
    assert robustify(block, "huber") is robustify(block, "huber")
    with pytest.raises((InputError, TypeError), match="cauchy"):  # TypeError: from the strict types of the tests
        robustify(block, "tukey")


@pytest.mark.parametrize("d", [1, 2, 3])
def test_scale_from_data_ignores_outliers_and_masked(d):
    rng = np.random.default_rng(d)
    r = 0.7 * rng.normal(size=(20001, d))
    r[::10] *= 1000
    seen = rng.uniform(size=len(r)) > 0.3
    r[~seen] = 1e9
    # The median of 90 % good lengths is their 0.5 / 0.9 quantile.
    expected = 0.7 * np.sqrt(scipy.stats.chi2.ppf(0.5 / 0.9, d) / scipy.stats.chi2.ppf(0.5, d))
    np.testing.assert_allclose(scale_from_data(jnp.asarray(r), jnp.asarray(seen)), expected, rtol=0.03)
    with pytest.raises(InputError, match="groups of 1, 2 or 3"):
        scale_from_data(jnp.zeros((3, 4)), jnp.ones(3, bool))
