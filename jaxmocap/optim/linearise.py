"""Linearisation of an arrow problem: per-block normal equations by automatic differentiation alone.

    [ H_ss  H_sl ] [ d_s ]     [ g_s ]        H_ss (ns, ns), H_ls[i] (nl, ns), H_ll[i] (nl, nl)
    [ H_ls  H_ll ] [ d_l ] = - [ g_l ]        one H_ll and one H_ls per block, nothing between blocks

The residuals are linearised once; then each leaf is pushed alone through the linear part with every other leaf
closed over, so that the tangents of what does not depend on it are symbolic zeros and cost nothing. Blocks are taken
in chunks that fit the processor's second-level cache: the Jacobian of a chunk is made, multiplied up and forgotten
there, and the memory is that of the products.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from jaxmocap.optim.packing import ArrowVariables, Flat, Layout, unflatten_last

_CACHE_BYTES = 2**18  # a quarter of a common 1 MiB second-level cache, the rest is for coefficients and products
_LARGEST_CHUNK = 512
_UNROLL_ROWS = 48  # up to here products are written out row by row; above, one block at a time by matrix products


class ArrowProblem(eqx.Module):
    """A least-squares problem whose residuals fall into blocks that share some unknowns.

    The structure holds by construction: `block` is handed the unknowns of one block only, so no residual can
    couple two blocks, and nothing has to be checked.
    """

    block: Callable[[Any, Any, Any, Any], Array] = eqx.field(static=True)
    """(shared, local, data, common) -> residuals of one block, an array of any one shape, in units of sigma."""
    prior: Callable[[Any, Any], Array] | None = eqx.field(static=True, default=None)
    """(shared, common) -> residuals that depend on shared unknowns alone."""


class ArrowData(eqx.Module):
    """What the residuals are computed from, beside the unknowns; differentiable."""

    blocks: PyTree
    """Pytree with a block axis (leading for callers, last inside the solver), handed to `block` slice by slice."""
    common: PyTree
    """Handed to every block as it is."""
    weight: Float[Array, "blocks"]
    """1 for a block that counts, 0 for one that only pads the size."""


class NormalEquations(eqx.Module):
    """Undamped Gauss-Newton normal equations of an arrow problem."""

    ss: Float[Array, "ns ns"]
    ls: Float[Array, "nl ns blocks"]
    ll: Float[Array, "nl nl blocks"]
    g_s: Float[Array, "ns"]
    g_l: Float[Array, "nl blocks"]


def residuals(problem: ArrowProblem, y: ArrowVariables, data: ArrowData) -> Float[Array, "rows blocks"]:
    """Residuals of all blocks; here the block axis of `y.local` and `data.blocks` is last."""
    run = jax.vmap(problem.block, in_axes=(None, -1, -1, None), out_axes=-1)
    r = run(y.shared, y.local, data.blocks, data.common)
    return jnp.reshape(r, (-1, r.shape[-1])) * data.weight[None, :]


def prior_residuals(problem: ArrowProblem, shared: PyTree, data: ArrowData) -> Float[Array, "rows"]:
    """Residuals on shared unknowns alone (none: an empty array)."""
    if problem.prior is None:
        return jnp.zeros((0,), data.weight.dtype)
    return jnp.reshape(problem.prior(shared, data.common), -1)


def cost(problem: ArrowProblem, y: ArrowVariables, data: ArrowData) -> Float[Array, ""]:
    """Half the sum of squared residuals."""
    r, q = residuals(problem, y, data), prior_residuals(problem, y.shared, data)
    return 0.5 * (jnp.sum(r * r) + jnp.sum(q * q))


def no_normal_equations(y: Flat) -> NormalEquations:
    """Zeros in the shape of the normal equations at y."""
    (ns,), (nl, blocks) = y.shared.shape, y.local.shape
    shapes = ((ns, ns), (nl, ns, blocks), (nl, nl, blocks), (ns,), (nl, blocks))
    return NormalEquations(*(jnp.zeros(shape, y.shared.dtype) for shape in shapes))


def _push_leaves(fn: Callable[[list[Array]], Array], leaves: list[Array], flags_of: Any, tail: int) -> list[Array]:
    """Derivatives of fn by each free scalar of each leaf, each leaf pushed alone; `tail` block axes stay whole."""
    columns = []
    for k, (leaf, flags) in enumerate(zip(leaves, flags_of)):
        if not any(flags):
            continue

        def alone(x: Array, k: int = k) -> Array:
            return fn(leaves[:k] + [x] + leaves[k + 1 :])

        elements = leaf.shape[: leaf.ndim - tail]
        seeds = np.eye(len(flags))[np.flatnonzero(flags)].reshape((-1, *elements, *([1] * tail)))
        if len(flags) == 1:
            columns.append(jax.jvp(alone, (leaf,), (jnp.ones_like(leaf),))[1][None])
        else:
            tangents = jnp.broadcast_to(jnp.asarray(seeds, leaf.dtype), (len(seeds), *leaf.shape))
            columns.append(jax.vmap(lambda t, f=alone, x=leaf: jax.jvp(f, (x,), (t,))[1])(tangents))
    return columns


@partial(jax.jit, static_argnums=(0, 1), inline=True)
def block_jacobians(
    problem: ArrowProblem, layout: Layout, y: ArrowVariables, data: ArrowData
) -> tuple[Float[Array, "rows blocks"], Float[Array, "ns rows blocks"], Float[Array, "nl rows blocks"]]:
    """Residuals and their derivatives by the free shared and local numbers; block axes last.

    Compiled as a function of its own so that solver and covariance share one trace of it.
    """
    shared, shared_def = jax.tree.flatten(y.shared)
    local, local_def = jax.tree.flatten(y.local)

    def of_leaves(shared: list[Array], local: list[Array]) -> Array:
        both = ArrowVariables(jax.tree.unflatten(shared_def, shared), jax.tree.unflatten(local_def, local))
        return residuals(problem, both, data)

    # Pushing leaves through the linear part instead of through the residuals: nothing non-linear is evaluated or
    # compiled more than once. Bar problem, 24,576 blocks, best CPU time: 13.6 -> 8.5 ms; compile 4.2 -> 3.4 s.
    r, push = jax.linearize(of_leaves, shared, local)
    no_shared, no_local = jax.tree.map(jnp.zeros_like, (shared, local))
    by_shared = _push_leaves(lambda leaves: push(leaves, no_local), no_shared, layout.shared, 0)
    by_local = _push_leaves(lambda leaves: push(no_shared, leaves), no_local, layout.local, 1)
    empty = jnp.zeros((0, *r.shape), r.dtype)
    return (
        r,
        jnp.concatenate(by_shared) if by_shared else empty,
        jnp.concatenate(by_local) if by_local else empty,
    )


def _products(r: Array, J_s: Array, J_l: Array, counts: Array | None) -> NormalEquations:
    """Products of a chunk's Jacobian; blocks for which `counts` is 0 are left out of the sums."""
    ns, nl, rows = J_s.shape[0], J_l.shape[0], r.shape[0]
    if rows > _UNROLL_ROWS:  # the chunk is one block
        # All products in one: 1,024 blocks of 560 rows take 24 ms of CPU where sums over the rows take 70.
        J = jnp.concatenate([J_s, J_l, r[None]]).reshape(-1, rows)
        G, at = J @ J.T, ns + nl
        return NormalEquations(G[:ns, :ns], G[ns:at, :ns, None], G[ns:at, ns:at, None], G[:ns, at], G[ns:at, at, None])

    # A sum over a middle axis is not vectorised; written out it is. Per 8,192 blocks: 6.9 -> 2.4 ms (9 rows),
    # 29 -> 8 ms (40).
    def over_rows(term: Callable[[int], Array]) -> Array:
        return sum((term(k) for k in range(1, rows)), term(0))

    wide = (J_s if counts is None else J_s * counts[None, None]).reshape(ns, r.size)
    return NormalEquations(
        ss=wide @ J_s.reshape(ns, r.size).T,
        ls=over_rows(lambda k: J_l[:, None, k] * J_s[None, :, k]),
        ll=over_rows(lambda k: J_l[:, None, k] * J_l[None, :, k]),
        g_s=wide @ r.reshape(-1),
        g_l=over_rows(lambda k: J_l[:, k] * r[None, k]),
    )


def chunk_size(columns: int, rows: int, blocks: int) -> int:
    """Blocks per chunk: as many as keep the chunk's Jacobian in cache, a power of two from 8 to 512.

    Blocks with many rows come one by one: their rows are vectors long enough.
    """
    if rows > _UNROLL_ROWS:
        return 1
    fit = _CACHE_BYTES // (8 * max(columns * rows, 1))
    size = 2 ** max(fit, 8).bit_length() // 2
    return max(1, min(size, _LARGEST_CHUNK, blocks))


def chunk_start(chunk: Array, size: int, blocks: int) -> tuple[Array, Array | None]:
    """First block of a chunk, and which of its blocks count (None: all).

    The last chunk is moved back so that it ends with the last block; what it shares with the chunk before counts
    there. Cutting chunks where they lie saves the copies that stacking them would need.
    """
    start = chunk * size
    if blocks % size == 0:
        return start, None
    moved = jnp.minimum(start, blocks - size)
    return moved, (moved + jnp.arange(size, dtype=moved.dtype) >= start).astype(float)


def cut_chunk(tree: PyTree, start: Array, size: int) -> PyTree:
    """The blocks of one chunk; block axes last."""
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, start, size, -1), tree)


def put_chunk(tree: PyTree, chunk: PyTree, start: Array) -> PyTree:
    """The arrays with one chunk written; inside a loop this happens in place."""
    return jax.tree.map(lambda x, c: jax.lax.dynamic_update_slice_in_dim(x, c, start, -1), tree, chunk)


def linearise(problem: ArrowProblem, layout: Layout, flat: Flat, base: ArrowVariables, data: ArrowData):
    """Normal equations at a point.

    Args:
        problem: residual functions.
        layout: which entries are free.
        flat: the point (free numbers).
        base: variables that hold the frozen numbers; block axis of `local` last.
        data: block axis of `blocks` last.

    Returns:
        NormalEquations.
    Source: optical tracking document, algorithm 3 (refinement); Triggs et al., Bundle Adjustment, 2000, section 6.
    """
    y = unflatten_last(layout, flat, base)
    blocks = flat.local.shape[1]
    rows = jax.eval_shape(lambda: residuals(problem, y, data)).shape[0]
    ns, nl = layout.shared_size, layout.local_size
    size = chunk_size(ns + nl, rows, blocks)

    def body(chunk: Array, total: NormalEquations) -> NormalEquations:
        start, counts = chunk_start(chunk, size, blocks)
        part = ArrowData(cut_chunk(data.blocks, start, size), data.common, cut_chunk(data.weight, start, size))
        point = ArrowVariables(y.shared, cut_chunk(y.local, start, size))
        r, J_s, J_l = block_jacobians(problem, layout, point, part)
        # Without the barrier XLA recomputes the Jacobian inside every product.
        r, J_s, J_l = jax.lax.optimization_barrier((r, J_s, J_l))
        n = _products(r, J_s, J_l, counts)
        ls, ll, g_l = put_chunk((total.ls, total.ll, total.g_l), (n.ls, n.ll, n.g_l), start)
        return NormalEquations(ss=total.ss + n.ss, ls=ls, ll=ll, g_s=total.g_s + n.g_s, g_l=g_l)

    n = jax.lax.fori_loop(0, -(-blocks // size), body, no_normal_equations(flat))
    if problem.prior is not None:
        shared, shared_def = jax.tree.flatten(y.shared)
        q = prior_residuals(problem, y.shared, data)
        J = jnp.concatenate(
            _push_leaves(
                lambda leaves: prior_residuals(problem, jax.tree.unflatten(shared_def, leaves), data),
                shared,
                layout.shared,
                0,
            )
        )
        n = NormalEquations(ss=n.ss + J @ J.T, ls=n.ls, ll=n.ll, g_s=n.g_s + J @ q, g_l=n.g_l)
    return n
