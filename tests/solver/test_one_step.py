"""One damped step of the block solver is the dense step."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrow_problems import CASES, dense, dense_step, inner_form

from jaxmocap.optim.arrow_solver import ArrowDescent, ArrowInfo
from jaxmocap.optim.linearise import linearise

DAMPINGS = (0.0, 1e-12, 1e-8, 1e-4, 1e-2, 1.0, 1e2, 1e6)


@pytest.fixture(scope="module", params=CASES)
def both(request):
    case = CASES[request.param]()
    layout, flat, base, data, scale = inner_form(case)
    normal = jax.jit(lambda f: linearise(case.problem, layout, f, base, data))(flat)
    reference = dense(case)
    r, J = reference.jacobian(reference.z0, case.data, case.common)
    return normal, scale, reference, r, J, flat


def test_normal_equations(both):
    normal, _, reference, r, J, _ = both
    ns, size = reference.ns, np.abs(J).max() ** 2 * len(r)
    np.testing.assert_allclose(normal.ss, J[:, :ns].T @ J[:, :ns], atol=1e-13 * size)
    np.testing.assert_allclose(normal.g_s, J[:, :ns].T @ r, atol=1e-13 * size)
    for i in range(reference.blocks):
        own = J[:, reference.block_columns(i)]
        np.testing.assert_allclose(normal.ll[:, :, i], own.T @ own, atol=1e-13 * size)
        np.testing.assert_allclose(normal.ls[:, :, i], own.T @ J[:, :ns], atol=1e-13 * size)
        np.testing.assert_allclose(normal.g_l[:, i], own.T @ r, atol=1e-13 * size)


def test_step_is_the_dense_step(both):
    normal, scale, reference, r, J, flat = both
    D = np.sum(J**2, axis=0) if scale is None else reference.scale**-2.0
    moved = np.any(J != 0, axis=0)  # the rest belongs to blocks that do not count, and stays
    descent = ArrowDescent(scale)
    info = ArrowInfo(normal, jnp.asarray(0.5 * r @ r))
    state = descent.query(flat, info, descent.init(flat, info))
    step = eqx.filter_jit(descent.step)
    for damping in DAMPINGS:
        found, _ = step(jnp.asarray(1.0 / damping if damping else np.inf), state)
        expected = np.zeros(len(D))
        expected[moved] = dense_step(r, J[:, moved], damping, D[moved])
        if damping == 0.0 and not moved.all():
            continue  # without damping such a block has no factor; the solver never goes below 1e-15
        shared, local = reference.split(expected)
        limit = 1e-8 * np.abs(expected).max()
        # Small components of a step lose digits to the large ones where the problem is ill conditioned and hardly
        # damped (pinhole: condition 7.5e3, whose square times eps is 6e-9); elsewhere each has its own eight digits.
        rtol = 1e-8 if damping >= 1e-4 else 0.0
        atol = limit * 1e-3 if damping >= 1e-4 else limit
        np.testing.assert_allclose(found.shared, shared, rtol=rtol, atol=atol)
        np.testing.assert_allclose(found.local, local, rtol=rtol, atol=atol)
