"""What `least_squares` refuses before anything is traced: wrong trees, shapes and precision, named by argument."""

from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError
from jaxmocap.optim.packing import ArrowVariables, Layout, block_count


def check_arguments(y0: Any, data: PyTree, free: Any, scale: Any, weight: Any) -> int:
    """Number of blocks.

    Raises:
        InputError: naming the argument, what was expected and what came.
    """
    require_x64("least_squares")
    for name, value in (("y0", y0), ("free", free), ("scale", scale)):
        if not isinstance(value, ArrowVariables) and (name == "y0" or value is not None):
            raise InputError(f"{name}: expected ArrowVariables(shared, local), got {type(value).__name__}")
    blocks = block_count(y0)
    for leaf in jax.tree.leaves(data):
        if np.ndim(leaf) == 0 or np.shape(leaf)[0] != blocks:
            raise InputError(f"data: expected a leading axis of {blocks} blocks on every leaf, got {np.shape(leaf)}")
    if weight is not None and np.shape(weight) != (blocks,):
        raise InputError(f"weight: expected shape ({blocks},), one number per block, got {np.shape(weight)}")
    if scale is not None:
        _check_scale(y0, scale)
    return blocks


def _check_scale(y0: ArrowVariables, scale: ArrowVariables) -> None:
    if jax.tree.structure(scale) != jax.tree.structure(y0):
        raise InputError(f"scale: expected the tree of y0, {jax.tree.structure(y0)}, got {jax.tree.structure(scale)}")
    for (path, leaf), size in zip(jax.tree_util.tree_leaves_with_path(y0), jax.tree.leaves(scale)):
        if np.shape(size) != np.shape(leaf):
            where = jax.tree_util.keystr(path)
            raise InputError(f"scale{where}: expected shape {np.shape(leaf)} as in y0, got {np.shape(size)}")


def check_precision(y0: ArrowVariables, layout: Layout) -> None:
    """Refuse free numbers that are not float64: the solver would lose half of its digits, or fail deep inside JAX.

    Raises:
        InputError: naming the leaf.
    """
    for part, tree, flags_of in (("shared", y0.shared, layout.shared), ("local", y0.local, layout.local)):
        for (path, leaf), flags in zip(jax.tree_util.tree_leaves_with_path(tree), flags_of):
            kind = jax.numpy.result_type(leaf)
            labels = kind.kind != "f" and not any(flags)  # whole numbers that are frozen do no harm
            if kind != np.float64 and not labels:
                raise InputError(
                    f"y0.{part}{jax.tree_util.keystr(path)}: expected float64, got {kind}. "
                    "Convert it with jnp.asarray(x, dtype=float)."
                )
