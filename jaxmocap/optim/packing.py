"""Arrow variables as flat arrays: freezing, flattening, and back.

The solver sees two arrays only: the free shared numbers, shape (ns,), and the free numbers of all blocks, shape
(nl, blocks). The block axis is LAST everywhere inside the solver: a scalar of a block becomes a contiguous vector
over blocks, which is what a CPU or GPU wants.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from jaxmocap._errors import InputError


class ArrowVariables(eqx.Module):
    """Unknowns of an arrow problem: what all blocks share, and what each block has for itself."""

    shared: PyTree
    """Any pytree of arrays."""
    local: PyTree
    """Pytree of arrays with a leading block axis."""


class Flat(eqx.Module):
    """The free numbers of an arrow problem, as the solver sees them."""

    shared: Float[Array, "ns"]
    local: Float[Array, "nl blocks"]


class Layout(eqx.Module):
    """Which entries of which leaf are free. Hashable, so it can steer tracing."""

    shared: tuple[tuple[bool, ...], ...] = eqx.field(static=True)
    """Per leaf of `shared`: one flag per element, row-major."""
    local: tuple[tuple[bool, ...], ...] = eqx.field(static=True)
    """Per leaf of `local`: one flag per element of one block."""

    @property
    def shared_size(self) -> int:
        """Number of free shared scalars."""
        return sum(sum(flags) for flags in self.shared)

    @property
    def local_size(self) -> int:
        """Number of free scalars of one block."""
        return sum(sum(flags) for flags in self.local)


def _flags(what: str, leaves: list[Any], free: PyTree, treedef: Any) -> tuple[tuple[bool, ...], ...]:
    sizes = [int(np.prod(shape)) for shape in leaves]
    if isinstance(free, bool):
        return tuple((free,) * n for n in sizes)
    try:
        free_leaves = treedef.flatten_up_to(free)
    except ValueError as error:
        raise InputError(f"free.{what}: expected the tree of the variables, got another one ({error})") from None
    out = []
    for k, (shape, flag) in enumerate(zip(leaves, free_leaves)):
        try:
            full = np.broadcast_to(np.asarray(flag, dtype=bool), shape)
        except ValueError:
            raise InputError(f"free.{what}: leaf {k} has shape {shape}, its flags have {np.shape(flag)}") from None
        out.append(tuple(bool(x) for x in full.reshape(-1)))
    return tuple(out)


def make_layout(y: ArrowVariables, free: ArrowVariables | None) -> Layout:
    """Layout of a set of variables.

    Args:
        y: the variables (only shapes are looked at).
        free: same tree with a bool, or an array of bools, in place of each leaf (for `local`: of one block);
            None or True: everything is free.

    Returns:
        The layout.

    Raises:
        InputError: if trees or shapes do not fit, or nothing is free.
    """
    shared, shared_def = jax.tree.flatten(y.shared)
    local, local_def = jax.tree.flatten(y.local)
    flags = free if free is not None else ArrowVariables(True, True)
    layout = Layout(
        _flags("shared", [np.shape(x) for x in shared], flags.shared, shared_def),
        _flags("local", [np.shape(x)[1:] for x in local], flags.local, local_def),
    )
    if layout.shared_size + layout.local_size == 0:
        raise InputError("free: expected at least one free parameter, got none")
    return layout


def block_count(y: ArrowVariables) -> int:
    """Number of blocks; InputError if the leaves of `local` disagree or there are none."""
    sizes = {np.shape(leaf)[0] if np.ndim(leaf) else -1 for leaf in jax.tree.leaves(y.local)}
    if len(sizes) != 1 or -1 in sizes or 0 in sizes:
        raise InputError(f"local: expected one leading block axis on every leaf, got sizes {sorted(sizes)}")
    return sizes.pop()


def flatten(layout: Layout, y: ArrowVariables) -> Flat:
    """Free numbers of the variables; the leading block axis becomes the last one."""
    shared = [
        jnp.reshape(leaf, -1)[np.flatnonzero(flags)]
        for leaf, flags in zip(jax.tree.leaves(y.shared), layout.shared)
        if any(flags)
    ]
    local = [
        jnp.moveaxis(jnp.reshape(leaf, (leaf.shape[0], -1))[:, np.flatnonzero(flags)], 0, 1)
        for leaf, flags in zip(jax.tree.leaves(y.local), layout.local)
        if any(flags)
    ]
    blocks = block_count(y)
    dtype = jnp.result_type(*jax.tree.leaves(y))
    return Flat(
        jnp.concatenate(shared) if shared else jnp.zeros((0,), dtype),
        jnp.concatenate(local) if local else jnp.zeros((0, blocks), dtype),
    )


def _put(leaf: Array, flags: tuple[bool, ...], values: Array) -> Array:
    """The leaf (trailing axes = elements after the first `values.ndim - 1` are blocks last) with free entries set."""
    if all(flags):
        return jnp.reshape(values, leaf.shape)
    flat = jnp.reshape(leaf, (len(flags),) + values.shape[1:])
    return jnp.reshape(flat.at[np.flatnonzero(flags)].set(values), leaf.shape)


def unflatten_last(layout: Layout, flat: Flat, base: ArrowVariables) -> ArrowVariables:
    """Variables of the free numbers, frozen ones from `base`; here `local` leaves have the block axis LAST."""
    out = []
    for tree, flags_of, values in (
        (base.shared, layout.shared, flat.shared),
        (base.local, layout.local, flat.local),
    ):
        leaves, treedef = jax.tree.flatten(tree)
        at, new = 0, []
        for leaf, flags in zip(leaves, flags_of):
            n = sum(flags)
            new.append(_put(leaf, flags, values[at : at + n]) if n else leaf)
            at += n
        out.append(jax.tree.unflatten(treedef, new))
    return ArrowVariables(*out)


def blocks_last(tree: PyTree) -> PyTree:
    """Every leaf with its leading block axis moved to the end."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), tree)


def blocks_first(tree: PyTree) -> PyTree:
    """Every leaf with its trailing block axis moved to the front."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), tree)


def bucket(count: int, steps: int = 4) -> int:
    """Padded number of blocks or rows: rounded up by at most 1/steps, so that few sizes are ever compiled.

    Compiling costs 20 to 500 solves, and a set of photographs or frames has a new length every time.

    Args:
        count: how many there are.
        steps: sizes between a power of two and the next, itself a power of two.

    Returns:
        The padded number; small ones, up to 2 steps, stay as they are.
    """
    if count <= 2 * steps:
        return count
    step = 2 ** (count.bit_length() - 1) // steps
    return -(-count // step) * step
