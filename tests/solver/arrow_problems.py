"""Random arrow problems, and the same problems as one dense residual function.

The dense side knows nothing of the package's packing, chunking or elimination: it concatenates plain Python lists
of residual vectors, one block after another, and everything about it is a dense matrix of numpy.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.optim import ArrowProblem, ArrowVariables, least_squares
from jaxmocap.optim.linearise import ArrowData
from jaxmocap.optim.packing import blocks_last, flatten, make_layout


def mixed_block(shared, local, data, common):
    """Smooth, mildly nonlinear, full rank; rows where `seen` is False are zero."""
    z = jnp.concatenate([shared["a"], shared["b"][None], local["p"].reshape(-1), local["q"]])
    r = data["A"] @ z + common["bend"] * jnp.tanh(data["B"] @ z) - data["d"]
    return jnp.where(data["seen"], r, 0.0)


def mixed_prior(shared, common):
    """Two residuals on shared numbers alone, one of them not linear."""
    return jnp.stack([shared["a"][0] - common["bend"], 2.0 * jnp.sin(shared["b"]) * shared["a"][1]])


def decay_block(shared, local, data, common):
    """Exponential decay with shared rates and a local height and floor."""
    t = data["t"]
    return local["height"] * jnp.exp(-jnp.exp(shared["rate"]) * t) + local["floor"] + common - data["y"]


def pinhole_block(shared, local, data, common):
    """A point seen by two pinhole cameras, the second one moved by a shared translation; focal length shared."""
    p = local["p"]
    first = shared["f"] * p[:2] / p[2]
    moved = p + shared["t"]
    second = shared["f"] * moved[:2] / moved[2]
    ruler = jnp.sum((p - common) ** 2)[None] / 50.0
    return jnp.concatenate([first - data["uv"][0], second - data["uv"][1], ruler - data["d"]])


@dataclass(frozen=True)
class Case:
    """One problem, ready for both sides."""

    problem: ArrowProblem
    y0: ArrowVariables
    data: Any
    common: Any
    free: ArrowVariables | None = None
    scale: ArrowVariables | None = None
    weight: np.ndarray | None = None

    @property
    def blocks(self) -> int:
        return jax.tree.leaves(self.y0.local)[0].shape[0]


def mixed_case(
    blocks=7, nl=(1, 2), rows=12, seed=0, prior=False, residual=0.3, masked=False, free=None, bend=0.4
) -> Case:
    """`nl`: rows of the 2-column leaf p, and size of the leaf q."""
    rng = np.random.default_rng([seed, blocks, *nl, rows])
    n = 4 + 2 * nl[0] + nl[1]
    A, B = rng.normal(size=(blocks, rows, n)), rng.normal(size=(blocks, rows, n)) / np.sqrt(n)
    # Columns of very different size, as pixels and 1/pixels are.
    A = A * np.geomspace(0.1, 10, n)[rng.permutation(n)]
    shared, local = rng.normal(size=4), rng.normal(size=(blocks, n - 4))
    z = np.concatenate([np.tile(shared, (blocks, 1)), local], axis=1)[..., None]
    d = (A @ z + bend * np.tanh(B @ z))[..., 0] + residual * rng.normal(size=(blocks, rows))
    seen = rng.uniform(size=(blocks, rows)) > (0.15 if masked else -1.0)
    s0, l0 = shared + 0.1 * rng.normal(size=4), local + 0.1 * rng.normal(size=local.shape)
    y0 = ArrowVariables(
        {"a": jnp.asarray(s0[:3]), "b": jnp.asarray(s0[3])},
        {"p": jnp.asarray(l0[:, : 2 * nl[0]].reshape(blocks, nl[0], 2)), "q": jnp.asarray(l0[:, 2 * nl[0] :])},
    )
    data = {"A": jnp.asarray(A), "B": jnp.asarray(B), "d": jnp.asarray(d), "seen": jnp.asarray(seen)}
    problem = ArrowProblem(mixed_block, mixed_prior if prior else None)
    return Case(problem, y0, data, {"bend": jnp.asarray(bend)}, free)


def decay_case(blocks=6, rows=9, seed=1, noise=0.02) -> Case:
    rng = np.random.default_rng(seed)
    t = np.tile(np.linspace(0, 3, rows), (blocks, 1))
    height, floor = rng.uniform(1, 3, blocks), rng.normal(size=blocks)
    y = height[:, None] * np.exp(-0.8 * t) + floor[:, None] + 0.5 + noise * rng.normal(size=t.shape)
    y0 = ArrowVariables({"rate": jnp.asarray(0.6)}, {"height": jnp.ones(blocks), "floor": jnp.zeros(blocks)})
    return Case(ArrowProblem(decay_block), y0, {"t": jnp.asarray(t), "y": jnp.asarray(y)}, jnp.asarray(0.5))


def pinhole_case(blocks=12, seed=2, noise=0.3) -> Case:
    rng = np.random.default_rng(seed)
    p = rng.uniform([-2, -2, 5], [2, 2, 9], (blocks, 3))
    t, f, origin = np.array([-1.0, 0.1, 0.2]), 500.0, np.array([0.3, -0.2, 6.0])
    uv = np.stack([f * p[:, :2] / p[:, 2:], f * (p + t)[:, :2] / (p + t)[:, 2:]], axis=1)
    d = np.sum((p - origin) ** 2, axis=1)[:, None] / 50.0
    data = {"uv": jnp.asarray(uv + noise * rng.normal(size=uv.shape)), "d": jnp.asarray(d)}
    y0 = ArrowVariables(
        {"f": jnp.asarray(520.0), "t": jnp.asarray(t + 0.05)}, {"p": jnp.asarray(p + 0.1 * rng.normal(size=p.shape))}
    )
    return Case(ArrowProblem(pinhole_block), y0, data, jnp.asarray(origin))


# The dense side -------------------------------------------------------------------------------------------------


def _mask(tree: Any, flags: Any) -> np.ndarray:
    """Free flags of a tree of arrays as one vector."""
    leaves, treedef = jax.tree.flatten(tree)
    given = [flags] * len(leaves) if isinstance(flags, bool) else treedef.flatten_up_to(flags)
    return np.concatenate([np.broadcast_to(np.asarray(f), np.shape(x)).ravel() for x, f in zip(leaves, given)])


def _vector(tree: Any) -> np.ndarray:
    return np.concatenate([np.ravel(x) for x in jax.tree.leaves(tree)])


def _slice(tree: Any, i: int) -> Any:
    return jax.tree.map(lambda x: jnp.asarray(x)[i], tree)


@dataclass(frozen=True)
class Dense:
    """A case as r(z): z is all free shared numbers, then the free numbers of block 0, block 1, ..."""

    z0: np.ndarray
    scale: np.ndarray | None
    ns: int
    nl: int
    blocks: int
    residual: Callable[..., Any]
    """(z, data, common) -> all residuals, blocks in order, then the prior."""
    rows: int
    """Rows of one block."""

    def jacobian(self, z: np.ndarray, data: Any, common: Any) -> tuple[np.ndarray, np.ndarray]:
        r = np.asarray(jax.jit(self.residual)(z, data, common))
        return r, np.asarray(jax.jit(jax.jacfwd(self.residual))(z, data, common))

    def block_columns(self, i: int) -> slice:
        return slice(self.ns + i * self.nl, self.ns + (i + 1) * self.nl)

    def split(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(ns,), (nl, blocks)."""
        return z[: self.ns], z[self.ns :].reshape(self.blocks, self.nl).T


def dense(case: Case) -> Dense:
    y0, blocks = case.y0, case.blocks
    flags = case.free or ArrowVariables(True, True)
    shared_free, local_free = _mask(y0.shared, flags.shared), _mask(_slice(y0.local, 0), flags.local)
    ns, nl = int(shared_free.sum()), int(local_free.sum())
    shared_all, local_all = _vector(y0.shared), np.stack([_vector(_slice(y0.local, i)) for i in range(blocks)])
    weight = np.ones(blocks) if case.weight is None else case.weight

    def rebuild(tree: Any, vector: Any) -> Any:
        leaves, treedef = jax.tree.flatten(tree)
        out, at = [], 0
        for leaf in leaves:
            out.append(jnp.reshape(vector[at : at + np.size(leaf)], np.shape(leaf)))
            at += np.size(leaf)
        return jax.tree.unflatten(treedef, out)

    where_s, where_l = np.flatnonzero(shared_free), np.flatnonzero(local_free)

    def residual(z, data, common):
        z = jnp.asarray(z)
        shared = rebuild(y0.shared, jnp.asarray(shared_all).at[where_s].set(z[:ns]))
        parts = []
        for i in range(blocks):
            own = jnp.asarray(local_all[i]).at[where_l].set(z[ns + i * nl : ns + (i + 1) * nl])
            r = case.problem.block(shared, rebuild(_slice(y0.local, 0), own), _slice(data, i), common)
            parts.append(weight[i] * jnp.ravel(r))
        if case.problem.prior is not None:
            parts.append(jnp.ravel(case.problem.prior(shared, common)))
        return jnp.concatenate(parts)

    scale = None
    if case.scale is not None:
        own = np.stack([_vector(_slice(case.scale.local, i))[where_l] for i in range(blocks)])
        scale = np.concatenate([_vector(case.scale.shared)[where_s], own.ravel()])
    z0 = np.concatenate([shared_all[where_s], local_all[:, where_l].ravel()])
    rows = jax.eval_shape(lambda: jnp.ravel(
        case.problem.block(y0.shared, _slice(y0.local, 0), _slice(case.data, 0), case.common)
    )).shape[0]  # fmt: skip
    return Dense(z0, scale, ns, nl, blocks, residual, rows)


def dense_step(r: np.ndarray, J: np.ndarray, damping: float, D: np.ndarray) -> np.ndarray:
    """Minimiser of |J d + r|^2 + damping |sqrt(D) d|^2 by least squares on the stacked matrix (QR/SVD, no J^T J)."""
    stacked = np.concatenate([J, np.diag(np.sqrt(damping * D))])
    return np.linalg.lstsq(stacked, -np.concatenate([r, np.zeros(len(D))]), rcond=None)[0]


def flat_value(case: Case, value: ArrowVariables) -> np.ndarray:
    """Free numbers of a solution in the order of `Dense`."""
    flags = case.free or ArrowVariables(True, True)
    shared_free, local_free = _mask(case.y0.shared, flags.shared), _mask(_slice(case.y0.local, 0), flags.local)
    own = [_vector(_slice(value.local, i))[local_free] for i in range(case.blocks)]
    return np.concatenate([_vector(value.shared)[shared_free], *own])


# The package's inner form ---------------------------------------------------------------------------------------


def inner_form(case: Case):
    """layout, flat start, base and data with the block axis last, as `least_squares` hands them on."""
    layout = make_layout(case.y0, case.free)
    base = ArrowVariables(case.y0.shared, blocks_last(case.y0.local))
    weight = np.ones(case.blocks) if case.weight is None else case.weight
    data = ArrowData(blocks_last(case.data), case.common, jnp.asarray(weight))
    flat_scale = None if case.scale is None else flatten(layout, case.scale)
    return layout, flatten(layout, case.y0), base, data, flat_scale


CASES: dict[str, Callable[[], Case]] = {
    "mixed": mixed_case,
    "masked and weighted": lambda: replace(mixed_case(masked=True, rows=14), weight=np.array([1, 1, 0, 1, 1, 1, 0.0])),
    "prior": lambda: mixed_case(prior=True),
    "frozen parts": lambda: mixed_case(
        free=ArrowVariables(
            {"a": np.array([True, False, True]), "b": False}, {"p": np.array([[True, False]]), "q": True}
        )
    ),
    "scale": lambda: _with_scale(mixed_case()),
    "scale and frozen": lambda: _with_scale(
        mixed_case(free=ArrowVariables({"a": True, "b": False}, {"p": True, "q": np.array([False, True])}))
    ),
    "14 local": lambda: mixed_case(blocks=4, nl=(5, 4), rows=24),
    "no shared": lambda: mixed_case(free=ArrowVariables(False, True)),
    "no local": lambda: mixed_case(free=ArrowVariables(True, False)),
    "many blocks": lambda: mixed_case(blocks=40, rows=9),
    "decay": decay_case,
    "pinhole": pinhole_case,
}


def _with_scale(case: Case) -> Case:
    rng = np.random.default_rng(5)
    sizes = jax.tree.map(lambda x: jnp.asarray(rng.uniform(0.1, 10, np.shape(x))), case.y0)
    return replace(case, scale=sizes)


@cache
def solved(name: str):
    """Case, its dense form, the package's estimate (with leave-one-out), and the dense (r, J) at that estimate."""
    case = CASES[name]()
    estimate = least_squares(
        case.problem,
        case.y0,
        case.data,
        case.common,
        free=case.free,
        scale=case.scale,
        weight=None if case.weight is None else jnp.asarray(case.weight),
        count=visible_rows(case),
        by_block=True,
    )
    reference = dense(case)
    z = flat_value(case, estimate.value)
    return case, reference, estimate, z, *reference.jacobian(z, case.data, case.common)


def visible_rows(case: Case) -> float | None:
    """Number of residuals that are not masked, in blocks that count."""
    if "seen" not in case.data:
        return None
    weight = np.ones(case.blocks) if case.weight is None else case.weight
    return float(np.sum(np.asarray(case.data["seen"]) * weight[:, None]))
