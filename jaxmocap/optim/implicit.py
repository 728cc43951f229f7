"""Derivatives through the solution of an arrow problem, by the implicit function theorem.

At the optimum the gradient g(y, a) of the cost is zero, so dy = -H^-1 (dg/da) da with the exact Hessian H of the cost
(not its Gauss-Newton part: with residuals that are not zero the two differ). H has arrow shape too; its blocks
come from second derivatives of one block at a time, so time and memory are linear in the number of blocks, in
forward and in reverse mode.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap.optim.linearise import ArrowData, ArrowProblem, cost, prior_residuals
from jaxmocap.optim.packing import ArrowVariables, Flat, Layout, blocks_first, unflatten_last

_HESSIAN_BATCH = 256  # blocks whose second derivatives are held at once


def _gradient(problem: ArrowProblem, layout: Layout, y: Flat, base: ArrowVariables, data: ArrowData) -> Flat:
    return jax.grad(lambda f: cost(problem, unflatten_last(layout, f, base), data))(y)


def exact_hessian(
    problem: ArrowProblem, layout: Layout, y: Flat, base: ArrowVariables, data: ArrowData
) -> tuple[Float[Array, "ns ns"], Float[Array, "blocks nl ns"], Float[Array, "blocks nl nl"]]:
    """Exact second derivatives of the cost: shared, cross and local parts (block axis first here)."""
    ns = layout.shared_size

    def block_cost(z: Array, local: Any, block_data: Any, weight: Array) -> Array:
        # One block, written as a problem with a single block so that packing is the same as in the solver.
        one = Flat(z[:ns], z[ns:, None])
        base_one = ArrowVariables(base.shared, jax.tree.map(lambda x: x[..., None], local))
        data_one = ArrowData(jax.tree.map(lambda x: x[..., None], block_data), data.common, weight[None])
        y_one = unflatten_last(layout, one, base_one)
        bare = ArrowProblem(problem.block)
        return cost(bare, y_one, data_one)

    def second(inputs: Any) -> Array:
        local_flat, local, block_data, weight = inputs
        z = jnp.concatenate([y.shared, local_flat])
        return jax.hessian(block_cost)(z, local, block_data, weight)

    per_block = (y.local.T, blocks_first(base.local), blocks_first(data.blocks), data.weight)
    H = jax.lax.map(second, per_block, batch_size=min(_HESSIAN_BATCH, y.local.shape[1]))
    ss = jnp.sum(H[:, :ns, :ns], axis=0)
    if problem.prior is not None:

        def prior_cost(s: Array) -> Array:
            shared = unflatten_last(layout, Flat(s, y.local), base).shared
            q = prior_residuals(problem, shared, data)
            return 0.5 * jnp.sum(q * q)

        ss = ss + jax.hessian(prior_cost)(y.shared)
    return ss, H[:, ns:, :ns], H[:, ns:, ns:]


def _solve_hessian(hessian: tuple[Array, Array, Array], g: Flat) -> Flat:
    """H^-1 g; a parameter that nothing depends on stays where it is."""
    ss, ls, ll = hessian
    ll = ll + jax.vmap(jnp.diag)(jnp.where(jnp.diagonal(ll, axis1=1, axis2=2) == 0, 1.0, 0.0))
    ss = ss + jnp.diag(jnp.where(jnp.diagonal(ss) == 0, 1.0, 0.0))
    # Two solves, not one for both right sides: T must not look as if it depended on g, or reverse mode, which
    # transposes what is linear in g, meets the product of T and d_s and stops.
    T = jnp.linalg.solve(ll, ls)
    t = jnp.linalg.solve(ll, g.local.T[:, :, None])[:, :, 0]
    S = ss - jnp.einsum("bls,blt->st", ls, T)
    d_s = jnp.linalg.solve(S, g.shared - jnp.einsum("bls,bl->s", ls, t)) if ss.shape[0] else g.shared
    d_l = t - jnp.einsum("bls,s->bl", T, d_s)
    return Flat(d_s, d_l.T)


@eqx.filter_custom_jvp
def attach(y: Flat, problem: ArrowProblem, layout: Layout, base: ArrowVariables, data: ArrowData) -> Flat:
    """The solution y, with the derivatives that the implicit function theorem gives it.

    Args:
        y: optimum (taken as it is).
        problem: residual functions.
        layout: which entries are free.
        base: frozen numbers, block axis last.
        data: observations, block axis last.

    Returns:
        y; differentiable with respect to `base` and `data`, in both modes and repeatedly.
    Source: implicit function theorem; the analogue of optimistix' ImplicitAdjoint without a dense operator.
    """
    del problem, layout, base, data
    return y


@attach.def_jvp
def _attach_jvp(primals: Any, tangents: Any) -> Any:
    y, problem, layout, base, data = primals
    _, _, _, t_base, t_data = tangents
    solution = attach(y, problem, layout, base, data)
    moving = jax.tree.map(lambda t: t is not None, (t_base, t_data), is_leaf=lambda t: t is None)
    diff, fixed = eqx.partition((base, data), moving)

    def gradient_of_inputs(d: Any) -> Flat:
        b, a = eqx.combine(d, fixed)
        return _gradient(problem, layout, solution, b, a)

    if jax.tree.leaves(diff):
        g = jax.jvp(gradient_of_inputs, (diff,), ((t_base, t_data),))[1]
        step = _solve_hessian(exact_hessian(problem, layout, solution, base, data), g)
        tangent = jax.tree.map(jnp.negative, step)
    else:
        tangent = jax.tree.map(jnp.zeros_like, solution)
    return solution, tangent


@eqx.filter_custom_jvp
def follow(value: Any, fn: Callable[..., Any], inputs: Any) -> Any:
    """A value that was computed on the way and equals fn(*inputs), with the derivatives of fn at the inputs.

    Args:
        value: pytree of arrays.
        fn: the same value from the inputs alone; evaluated only where a derivative is asked for.
        inputs: arguments of fn; what moves with the solution comes from `attach`.

    Returns:
        value.
    Source: chain rule.
    """
    del fn, inputs
    return value


@follow.def_jvp
def _follow_jvp(primals: Any, tangents: Any) -> Any:
    value, fn, inputs = primals
    moving = jax.tree.map(lambda t: t is not None, tangents[2], is_leaf=lambda t: t is None)
    diff, fixed = eqx.partition(inputs, moving)

    def numbers(d: Any) -> Any:
        return eqx.filter(fn(*eqx.combine(d, fixed)), eqx.is_inexact_array)

    if not jax.tree.leaves(diff):
        return value, jax.tree.map(jnp.zeros_like, eqx.filter(value, eqx.is_inexact_array))
    return value, jax.jvp(numbers, (diff,), (tangents[2],))[1]
