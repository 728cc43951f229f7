"""Every row of PAIRS: forward = reverse = closed form = central difference, at singular and random samples."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import over

from jaxmocap.closed_forms import PAIRS

H = 1e-6


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
def test_closed_form_is_the_derivative(pair):
    samples = pair.sampler(np.random.default_rng(0))
    forward, reverse = (over(d(pair.function), *samples) for d in (jax.jacfwd, jax.jacrev))
    closed, difference = over(pair.closed_form, *samples), over(central(pair.function), *samples)
    assert len(forward) == 16 and np.all(np.isfinite(forward)) and np.all(np.isfinite(closed))
    scale = np.maximum(1.0, np.abs(forward).reshape(16, -1).max(axis=1)).reshape(16, *[1] * (forward.ndim - 1))
    assert np.max(np.abs(forward - reverse) / scale) < 1e-12
    assert np.max(np.abs(forward - closed) / scale) < pair.tolerance
    assert np.max(np.abs(forward - difference) / scale) < 1e-5
    assert np.min(np.abs(forward).reshape(16, -1).max(axis=1)) > 0 or pair.name == "real point by lens numbers"


def central(fn):
    def difference(x, *rest):
        return jnp.stack([(fn(x + H * e, *rest) - fn(x - H * e, *rest)) / (2 * H) for e in jnp.eye(x.size)], axis=-1)

    return difference


def test_rows_are_named_once_and_say_where_they_come_from():
    assert len({(pair.document, pair.equation, pair.name) for pair in PAIRS}) == len(PAIRS)
    for pair in PAIRS:
        assert pair.document in ("000", "002", "004") and pair.equation and pair.name
        assert 0 < pair.tolerance <= 1e-9


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
def test_samplers_are_repeatable(pair):
    first, second = (jax.tree.leaves(pair.sampler(np.random.default_rng(3))) for _ in range(2))
    for a, b in zip(first, second):
        assert np.array_equal(a, b)
