"""Derivatives through the solution equal central differences of the solution; memory is linear in the blocks."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrow_problems import flat_value, mixed_case

from jaxmocap.optim import ArrowVariables, least_squares

# Residuals of about 1 on curved functions: the exact Hessian is far from the Gauss-Newton one.
CASE = mixed_case(
    blocks=6,
    residual=0.6,
    bend=0.8,
    prior=True,
    free=ArrowVariables({"a": True, "b": False}, {"p": np.array([[True, False]]), "q": True}),
)


def numbers(inputs):
    """Weighted sums of the shared and the local part of the solution, as one vector of three."""
    d, common, b, p = inputs
    y0 = ArrowVariables({**CASE.y0.shared, "b": b}, {**CASE.y0.local, "p": CASE.y0.local["p"].at[:, 0, 1].set(p)})
    data = {**CASE.data, "d": d}
    # The smallest tolerance: the comparison is with differences of solutions.
    value = least_squares(CASE.problem, y0, data, {"bend": common}, free=CASE.free, rtol=1e-24, covariance=False).value
    return _summary(value.shared, value.local)


def _summary(shared, local):
    return jnp.stack(
        [
            shared["a"][0],
            jnp.sum(shared["a"]) + jnp.sum(local["q"] * jnp.cos(jnp.arange(12.0).reshape(6, 2))),
            jnp.sum(local["p"] ** 2) * 0.1,
        ]
    )


INPUTS = (CASE.data["d"], CASE.common["bend"], CASE.y0.shared["b"], CASE.y0.local["p"][:, 0, 1])
run = jax.jit(numbers)


@cache
def direction(which: int):
    """A random change of one of: data, common, frozen shared, frozen local; zero for the others."""
    rng = np.random.default_rng(which)
    return tuple(
        jnp.asarray(rng.normal(size=x.shape)) if k == which else jnp.zeros_like(x) for k, x in enumerate(INPUTS)
    )


# The same solution by Newton's method with dense exact derivatives: a reference without the solver's tolerance.


def _trees(z, inputs):
    d, common, b, p = inputs
    own = z[3:].reshape(6, 3)
    shared = {"a": z[:3], "b": b}
    local = {"p": jnp.stack([own[:, 0], p], axis=1)[:, None, :], "q": own[:, 1:]}
    return shared, local, {**CASE.data, "d": d}, {"bend": common}


def _dense_cost(z, inputs):
    shared, local, data, common = _trees(z, inputs)
    r = jax.vmap(CASE.problem.block, (None, 0, 0, None))(shared, local, data, common)
    return 0.5 * jnp.sum(r**2) + 0.5 * jnp.sum(CASE.problem.prior(shared, common) ** 2)


@jax.jit
def _newton(z, inputs):
    return z - jnp.linalg.solve(jax.hessian(_dense_cost)(z, inputs), jax.grad(_dense_cost)(z, inputs))


@cache
def _optimum():
    estimate = least_squares(CASE.problem, CASE.y0, CASE.data, CASE.common, free=CASE.free)
    assert estimate.success, estimate.sentence
    return estimate, jnp.asarray(flat_value(CASE, estimate.value))


def exact(inputs):
    """What `numbers` should return."""
    z = _optimum()[1]
    for _ in range(8):
        z = _newton(z, inputs)
    shared, local, _, _ = _trees(z, inputs)
    return _summary(shared, local)


def central(fn, t, h=2e-4):
    """Five-point difference of fn along t: error h^4."""
    at = lambda s: np.asarray(fn(jax.tree.map(lambda x, v: x + s * h * v, INPUTS, t)))  # noqa: E731
    return (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * h)


def test_gauss_newton_would_be_wrong():
    """The case is not one where any Hessian would do: dropping the second derivatives changes the answer."""
    _, z = _optimum()
    t = direction(0)

    def residual(z, inputs):
        shared, local, data, common = _trees(z, inputs)
        r = jax.vmap(CASE.problem.block, (None, 0, 0, None))(shared, local, data, common)
        return jnp.concatenate([r.ravel(), CASE.problem.prior(shared, common)])

    J = jax.jacfwd(residual)(z, INPUTS)
    change = jax.jvp(lambda x: jax.grad(_dense_cost)(z, x), (INPUTS,), (t,))[1]
    wrong = -jnp.linalg.solve(J.T @ J, change)[0]
    assert abs(float(wrong) / central(exact, t)[0] - 1.0) > 0.02


@pytest.mark.parametrize("which", range(4), ids=["data", "common", "frozen shared", "frozen local"])
def test_forward_and_reverse(which):
    t = direction(which)
    expected = central(exact, t)
    pushed, pulled = transposed(INPUTS, t)
    for forward in (jvp(INPUTS, t), pushed):
        np.testing.assert_allclose(forward, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
    product = [sum(float(jnp.sum(a[k] * b)) for a, b in zip(pulled, t)) for k in range(3)]
    np.testing.assert_allclose(product, pushed, rtol=1e-9, atol=1e-12)


jvp = jax.jit(lambda x, t: jax.jvp(numbers, (x,), (t,))[1])


@jax.jit
def transposed(x, t):
    """Forward and reverse at one and the same solution: two programs would stop at points that differ by rounding."""
    _, push = jax.linearize(numbers, x)
    return push(t), jax.vmap(jax.linear_transpose(push, x))(jnp.eye(3))[0]


def test_second_derivatives():
    """Derivative of the derivative by the data, against a difference of first derivatives."""
    t = direction(0)
    first = lambda x: jvp(x, t)[1]  # noqa: E731
    found = jax.jit(jax.grad(first))(INPUTS)
    assert all(np.all(np.isfinite(x)) for x in found)
    twice = sum(float(jnp.sum(a * b)) for a, b in zip(found, t))
    np.testing.assert_allclose(twice, _second_difference(t), rtol=1e-4)


def _second_difference(t, h=2e-3):
    at = lambda s: float(exact(jax.tree.map(lambda x, v: x + s * h * v, INPUTS, t))[1])  # noqa: E731
    return (-at(2) + 16 * at(1) - 30 * at(0) + 16 * at(-1) - at(-2)) / (12 * h * h)


def test_under_vmap_and_jit():
    t = direction(0)
    steps = jnp.asarray([0.0, 0.3, -0.2])
    moved = (INPUTS[0][None] + steps[:, None, None] * t[0][None], *(jnp.stack([x] * 3) for x in INPUTS[1:]))
    together = jax.jit(jax.vmap(lambda *x: jax.jvp(numbers, (x,), (t,))))(*moved)
    for k in range(3):
        alone = (INPUTS[0] + steps[k] * t[0], *INPUTS[1:])
        np.testing.assert_allclose(together[0][k], run(alone), rtol=1e-6)
        np.testing.assert_allclose(together[1][k], jvp(alone, t), rtol=1e-6)


def test_start_of_free_entries_has_no_influence():
    a = jax.jit(
        jax.grad(
            lambda a: jnp.sum(
                least_squares(
                    CASE.problem,
                    ArrowVariables({**CASE.y0.shared, "a": a}, CASE.y0.local),
                    CASE.data,
                    CASE.common,
                    free=CASE.free,
                    covariance=False,
                ).value.shared["a"]
            )
        )
    )(CASE.y0.shared["a"])
    np.testing.assert_array_equal(a, 0.0)


def _temporary_bytes(blocks):
    case = mixed_case(blocks=blocks, rows=8, residual=0.3)

    def value(d):
        estimate = least_squares(case.problem, case.y0, {**case.data, "d": d}, case.common, covariance=False)
        return jnp.sum(estimate.value.local["q"])

    compiled = jax.jit(jax.grad(value)).lower(case.data["d"]).compile()
    return compiled.memory_analysis().temp_size_in_bytes


def test_memory_of_reverse_mode_is_linear_in_blocks():
    assert _temporary_bytes(4096) < 4.5 * _temporary_bytes(1024)


def test_a_batch_of_problems_is_each_problem():
    """vmap over data and start; the problems need different numbers of steps."""
    cases = [mixed_case(blocks=6, seed=s, residual=r, prior=True) for s, r in ((0, 0.1), (1, 1.0), (2, 3.0))]
    stack = lambda *trees: jax.tree.map(lambda *x: jnp.stack(x), *trees)  # noqa: E731
    y0, data = stack(*[c.y0 for c in cases]), stack(*[c.data for c in cases])
    one = lambda y, d: least_squares(cases[0].problem, y, d, cases[0].common, by_block=True)  # noqa: E731
    together = jax.vmap(one)(y0, data)
    for k, case in enumerate(cases):
        alone = one(case.y0, case.data)
        np.testing.assert_allclose(together.value.shared["a"][k], alone.value.shared["a"], rtol=1e-9)
        np.testing.assert_allclose(together.value.local["q"][k], alone.value.local["q"], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(together.stats["cost"][k], alone.stats["cost"], rtol=1e-12)
        assert int(together.stats["steps"][k]) == int(alone.stats["steps"])
        np.testing.assert_allclose(
            jax.tree.map(lambda x, i=k: x[i], together.covariance).shared(), alone.covariance.shared(), rtol=1e-7
        )
        assert together.result._value[k] == alone.result._value


@jax.jit
@jax.value_and_grad
def stated(d):
    """One number that moves with the cost, the residual variance and every part of the covariance."""
    data = {**EASY.data, "d": d}
    estimate = least_squares(EASY.problem, EASY.y0, data, EASY.common, rtol=1e-24, by_block=True)
    k, stats = estimate.covariance, estimate.stats
    parts = (k.shared()[0, 1], k.local(2)[0, 0], k.cross(1)[0, 0], k.leave_one_out[1, 1], k.design_effect)
    total = jnp.dot(jnp.asarray([1e4, 1.0, 1e2, 1e4, 1.0]), jnp.stack(parts))
    return total + 3.0 * stats["cost"] + 10.0 * stats["residual_variance"]


EASY = mixed_case(blocks=6, residual=0.6, bend=0.8, prior=True)  # settles to rounding in few steps


def test_derivatives_of_cost_and_covariance():
    t, h, at = direction(0)[0], 1e-4, EASY.data["d"]
    a, b, c, d = (float(stated(at + s * h * t)[0]) for s in (-2, -1, 1, 2))
    np.testing.assert_allclose(jnp.sum(stated(at)[1] * t), (8 * (c - b) - (d - a)) / (12 * h), rtol=1e-6)
