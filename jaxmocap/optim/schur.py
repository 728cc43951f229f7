"""Solving arrow-shaped normal equations by eliminating the blocks (Schur complement).

    S = H_ss + lambda D_s - sum_i W_i^T W_i,       W_i = L_i^-1 H_ls[i],   L_i L_i^T = H_ll[i] + lambda D_l[i]
    S d_s = -(g_s - sum_i W_i^T w_i),              w_i = L_i^-1 g_l[i]
    d_l[i] = -L_i^-T (w_i + W_i d_s)

Work is split into three tiers: once per problem (layout), once per accepted point (`linearise`), once per trial
damping (this file). Small blocks are factorised by scalar formulas written out over vectors of blocks: a batched
LAPACK call on 25,000 6x6 matrices takes longer than everything else in an iteration.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap.optim.linearise import NormalEquations, chunk_size, join_chunks, split_chunks
from jaxmocap.optim.packing import Flat

_UNROLL_UP_TO = 12  # n^3/6 scalar operations are written out; beyond this, compiling takes longer than it saves


class BlockFactors(eqx.Module):
    """Cholesky factors of the blocks and the coupling seen through them."""

    L: Float[Array, "nl nl blocks"]
    W: Float[Array, "nl ns blocks"]
    w: Float[Array, "nl blocks"]


def cholesky_blocks(A: Float[Array, "n n blocks"]) -> Float[Array, "n n blocks"]:
    """Lower Cholesky factors, block axis last; NaN where a block is not positive definite."""
    n = A.shape[0]
    if n > _UNROLL_UP_TO:
        return jnp.moveaxis(jnp.linalg.cholesky(jnp.moveaxis(A, -1, 0)), 0, -1)
    L: list[list[Array]] = [[jnp.zeros_like(A[0, 0])] * n for _ in range(n)]
    for j in range(n):
        L[j][j] = jnp.sqrt(A[j, j] - sum((L[j][k] ** 2 for k in range(j)), jnp.zeros_like(A[0, 0])))
        inverse = 1.0 / L[j][j]
        for i in range(j + 1, n):
            L[i][j] = (A[i, j] - sum((L[i][k] * L[j][k] for k in range(j)), jnp.zeros_like(A[0, 0]))) * inverse
    return jnp.stack([jnp.stack(row) for row in L]) if n else A


def forward_blocks(L: Float[Array, "n n blocks"], B: Float[Array, "n m blocks"]) -> Float[Array, "n m blocks"]:
    """L^-1 B for every block."""
    n = L.shape[0]
    if n > _UNROLL_UP_TO:
        solve = jax.vmap(lambda a, b: jax.scipy.linalg.solve_triangular(a, b, lower=True), (-1, -1), -1)
        return solve(L, B)
    rows: list[Array] = []
    for i in range(n):
        row = B[i]
        for k in range(i):
            row = row - L[i, k][None] * rows[k]
        rows.append(row / L[i, i][None])
    return jnp.stack(rows) if n else B


def backward_blocks(L: Float[Array, "n n blocks"], B: Float[Array, "n m blocks"]) -> Float[Array, "n m blocks"]:
    """L^-T B for every block."""
    n = L.shape[0]
    if n > _UNROLL_UP_TO:
        solve = jax.vmap(lambda a, b: jax.scipy.linalg.solve_triangular(a.T, b, lower=False), (-1, -1), -1)
        return solve(L, B)
    rows: list[Array] = [B[0]] * n if n else []
    for i in reversed(range(n)):
        row = B[i]
        for k in range(i + 1, n):
            row = row - L[k, i][None] * rows[k]
        rows[i] = row / L[i, i][None]
    return jnp.stack(rows) if n else B


def eliminate(
    normal: NormalEquations, add_l: Float[Array, "nl blocks"]
) -> tuple[BlockFactors, Float[Array, "ns ns"], Float[Array, "ns"]]:
    """Factors of the blocks with `add_l` on their diagonals, and what they subtract from the shared system.

    Returns:
        factors, sum_i W_i^T W_i, sum_i W_i^T w_i.
    """
    nl, ns, blocks = normal.ls.shape
    size = chunk_size(nl + ns, 2 * (nl + 1), blocks)
    arrays = (normal.ll, normal.ls, normal.g_l, add_l, jnp.ones((blocks,), normal.ll.dtype))
    chunks = split_chunks(arrays, size)
    counts = jnp.arange(chunks[4].size).reshape(chunks[4].shape) < blocks

    def body(total: tuple[Array, Array], chunk: tuple[Array, ...]):
        ll, ls, g_l, add, count = chunk
        L = cholesky_blocks(ll + jnp.eye(nl, dtype=ll.dtype)[:, :, None] * add[:, None])
        right = forward_blocks(L, jnp.concatenate([ls, g_l[:, None]], axis=1))
        W, w = right[:, :ns], right[:, ns]
        # The repeated last block of the last chunk must not count twice.
        flat_W = jnp.moveaxis(jnp.where(count[None, None], W, 0.0), 1, 0).reshape(ns, w.size)
        return (total[0] + flat_W @ flat_W.T, total[1] + flat_W @ w.reshape(-1)), (L, W, w)

    zero = (jnp.zeros((ns, ns), normal.ss.dtype), jnp.zeros((ns,), normal.ss.dtype))
    (taken, taken_g), per_chunk = jax.lax.scan(body, zero, (*chunks[:4], counts))
    return BlockFactors(*join_chunks(per_chunk, blocks)), taken, taken_g


def damped_step(
    normal: NormalEquations,
    damping: Float[Array, ""],
    D_s: Float[Array, "ns"],
    D_l: Float[Array, "nl blocks"],
) -> Flat:
    """The step d with (H + damping D) d = -g.

    Args:
        normal: undamped normal equations.
        damping: lambda, not negative.
        D_s: diagonal weights of the shared parameters.
        D_l: the same for each block.

    Returns:
        d; NaN where the matrix is not positive definite.
    Source: Triggs et al., Bundle Adjustment, 2000, section 6.1; Marquardt 1963.
    """
    factors, taken, taken_g = eliminate(normal, damping * D_l)
    if normal.ss.shape[0]:
        S = normal.ss + jnp.diag(damping * D_s) - taken
        d_s = -solve_positive(S, normal.g_s - taken_g)
    else:
        d_s = jnp.zeros_like(normal.g_s)
    coupled = factors.w + jnp.sum(factors.W * d_s[None, :, None], axis=1)
    d_l = -backward_blocks(factors.L, coupled[:, None])[:, 0]
    return Flat(d_s, d_l)


def solve_positive(S: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """S^-1 b for a positive definite S, scaled to unit diagonal first; NaN if it is not positive definite."""
    scale = 1.0 / jnp.sqrt(jnp.diagonal(S))
    factor = jnp.linalg.cholesky(S * scale[:, None] * scale[None, :])
    return scale * jax.scipy.linalg.cho_solve((factor, True), scale * b)
