"""Least squares within bounds: against scipy's, and what is refused or said."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from jaxmocap._errors import InputError
from jaxmocap.optim.bounded import bounded_least_squares
from jaxmocap.results import RESULTS


def bananas(x, args):
    """Rosenbrock's valley three times, as residuals; the minimum without bounds is at 1."""
    return jnp.concatenate([args * (x[1::2] - x[::2] ** 2), 1.0 - x[::2]])


@pytest.mark.parametrize("high", [5.0, 0.7, 1.0])
def test_same_optimum_as_scipy(high):
    low, up = np.full(6, -2.0), np.array([high, 5.0, 5.0, high, 0.3, 5.0])
    start = np.array([-1.2, 1.0, -1.2, 1.0, -1.2, 1.0])
    start = np.minimum(start, up)
    of = lambda x: np.asarray(bananas(jnp.array(x), 10.0))  # noqa: E731
    tight = dict(xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=5000)
    peer = scipy.optimize.least_squares(of, start, bounds=(low, up + 1e-15), **tight)
    ours = bounded_least_squares(bananas, jnp.array(start), jnp.array(low), jnp.array(up), 10.0)
    assert ours.result == RESULTS.successful
    assert np.all(ours.x >= low) and np.all(ours.x <= up)
    np.testing.assert_allclose(ours.x, peer.x, atol=1e-5)
    assert float(ours.cost) <= peer.cost + 1e-12


def test_bounds_that_hold_are_named():
    line = lambda x, target: x - target  # noqa: E731
    target, inf = jnp.array([3.0, -3.0, 0.5]), jnp.full(3, jnp.inf)
    s = bounded_least_squares(line, jnp.zeros(3), -jnp.ones(3), jnp.ones(3), target)
    np.testing.assert_allclose(s.x, [1.0, -1.0, 0.5], atol=1e-12)
    assert s.at_bound.tolist() == [True, True, False] and s.result == RESULTS.successful
    np.testing.assert_allclose(s.cost, 0.5 * (4 + 4), rtol=1e-12)
    free = bounded_least_squares(line, jnp.zeros(3), -inf, inf, target)
    np.testing.assert_allclose(free.x, target, atol=1e-9)


def test_a_start_that_is_not_finite_is_said():
    """jaxopt hands such a start back as solved."""
    s = bounded_least_squares(lambda x, a: jnp.log(x), jnp.array([-1.0]), jnp.array([-2.0]), jnp.array([2.0]))
    assert s.result == RESULTS.not_finite_at_start


@pytest.mark.parametrize(
    "x0, low, high, said",
    [
        ([0.0], [1.0], [0.0], "upper bound"),
        ([np.nan], [0.0], [1.0], "NaN"),
        ([0.0], [np.nan], [1.0], "NaN"),
        ([0.0, 1.0], [0.0], [1.0], "one size"),
    ],
)
def test_wrong_calls_are_refused(x0, low, high, said):
    with pytest.raises(InputError, match=said):
        bounded_least_squares(lambda x, a: x, *(jnp.array(a) for a in (x0, low, high)))
