"""Solving arrow-shaped normal equations by eliminating the blocks (Schur complement).

    S = H_ss + lambda D_s - sum_i W_i^T W_i,       W_i = L_i^-1 H_ls[i],   L_i L_i^T = H_ll[i] + lambda D_l[i]
    S d_s = -(g_s - sum_i W_i^T w_i),              w_i = L_i^-1 g_l[i]
    d_l[i] = -L_i^-T L_i^-1 (g_l[i] + H_ls[i] d_s)

Work is split into three tiers: once per problem (layout), once per accepted point (`linearise`), once per trial
damping (this file). Small blocks are factorised by scalar formulas written out over vectors of blocks: a batched
LAPACK call on 25,000 6x6 matrices takes longer than everything else in an iteration.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap.optim.linearise import NormalEquations, chunk_size, chunk_start, cut_chunk, put_chunk
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


def _eliminate_rows(M: Float[Array, "n width blocks"]) -> list[Float[Array, "_ blocks"]]:
    """Rows j of L^-1 [A B] from column j on, for M = [A B] with A = L L^T: row j is L[j:, j] and then row j of L^-1 B.

    Whole rows at a time: compiles in 0.7 s of CPU where scalar by scalar takes 1.0, and 28,672 blocks of 6 rows and 19
    right-hand sides take 18-21 ms where that takes 24 (chunks of 128 both; with chunks of 256 it takes 42).
    """
    rows: list[Array] = []
    for j in range(M.shape[0]):
        row = M[j, j:]
        for k in range(j):
            row = row - rows[k][j - k][None] * rows[k][j - k :]
        # Without the barrier XLA recomputes earlier rows inside later ones.
        row = jax.lax.optimization_barrier(row)
        rows.append(row / jnp.sqrt(row[0])[None])
    return rows


def _factor(ll: Array, right: Array) -> tuple[Float[Array, "n n blocks"], Float[Array, "n m blocks"]]:
    """Cholesky factors L of the blocks, and L^-1 right."""
    n = ll.shape[0]
    if n > _UNROLL_UP_TO or not n:
        L = cholesky_blocks(ll)
        return L, forward_blocks(L, right)
    rows = _eliminate_rows(jnp.concatenate([ll, right], axis=1))
    columns = [jnp.pad(row[: n - j], [(j, 0), (0, 0)]) for j, row in enumerate(rows)]
    return jnp.stack(columns, axis=1), jnp.stack([row[n - j :] for j, row in enumerate(rows)])


def _reduce(
    normal: NormalEquations, add_l: Float[Array, "nl blocks"], keep_W: bool
) -> tuple[tuple[Array, ...], Float[Array, "n n"]]:
    """(L,) or (L, W, w), and the sum of [W w]^T [W w] over all blocks."""
    nl, ns, blocks = normal.ls.shape
    size = chunk_size(nl + ns, 2 * (nl + 1), blocks)
    dtype = normal.ll.dtype

    def body(chunk: Array, total: tuple[tuple[Array, ...], Array]):
        start, counts = chunk_start(chunk, size, blocks)
        ll, ls, g_l, add = cut_chunk((normal.ll, normal.ls, normal.g_l, add_l), start, size)
        damped = ll + jnp.eye(nl, dtype=dtype)[:, :, None] * add[:, None]
        L, right = jax.lax.optimization_barrier(_factor(damped, jnp.concatenate([ls, g_l[:, None]], axis=1)))
        wide = jnp.moveaxis(right, 1, 0)
        once = wide if counts is None else jnp.where(counts[None, None] > 0, wide, 0.0)
        products = once.reshape(ns + 1, -1) @ wide.reshape(ns + 1, -1).T
        new = (L, right[:, :ns], right[:, ns]) if keep_W else (L,)
        return put_chunk(total[0], new, start), total[1] + products

    shapes = ((nl, nl, blocks), (nl, ns, blocks), (nl, blocks))[: 3 if keep_W else 1]
    zero = (tuple(jnp.zeros(s, dtype) for s in shapes), jnp.zeros((ns + 1, ns + 1), dtype))
    return jax.lax.fori_loop(0, -(-blocks // size), body, zero)


def eliminate(
    normal: NormalEquations, add_l: Float[Array, "nl blocks"]
) -> tuple[BlockFactors, Float[Array, "ns ns"], Float[Array, "ns"]]:
    """Factors of the blocks with `add_l` on their diagonals, and what they subtract from the shared system.

    Returns:
        factors, sum_i W_i^T W_i, sum_i W_i^T w_i.
    """
    factors, products = _reduce(normal, add_l, keep_W=True)
    return BlockFactors(*factors), products[:-1, :-1], products[:-1, -1]


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
    # W is not kept. Bar problem, 25,000 blocks: this whole step takes 18-20 ms of CPU, `eliminate` alone, which
    # does keep it, 19-24.
    (L,), taken = _reduce(normal, damping * D_l, keep_W=False)
    if normal.ss.shape[0]:
        S = normal.ss + jnp.diag(damping * D_s) - taken[:-1, :-1]
        d_s = -solve_positive(S, normal.g_s - taken[:-1, -1])
    else:
        d_s = jnp.zeros_like(normal.g_s)
    # Row by row of ls: a product with its middle axis takes 17 ms at 28,672 blocks, this 3.4 ms.
    gradient = normal.g_l + jax.vmap(lambda row: d_s @ row)(normal.ls)
    d_l = -backward_blocks(L, forward_blocks(L, gradient[:, None]))[:, 0]
    return Flat(d_s, d_l)


def solve_positive(S: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """S^-1 b for a positive definite S, scaled to unit diagonal first; NaN if it is not positive definite."""
    scale = 1.0 / jnp.sqrt(jnp.diagonal(S))
    factor = jnp.linalg.cholesky(S * scale[:, None] * scale[None, :])
    return scale * jax.scipy.linalg.cho_solve((factor, True), scale * b)
