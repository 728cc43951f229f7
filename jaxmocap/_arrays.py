"""Shared array aliases, dimension words, and eager checks that name argument, got and expected.

Dimension words used in annotations everywhere: ``cameras views frames markers points joints boards blocks``.
"""

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._errors import InputError

Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Vector2 = Float[Array, "2"]
Vector3 = Float[Array, "3"]
Matrix3 = Float[Array, "3 3"]


def require_x64(what: str) -> None:
    """Refuse to calibrate in single precision, which loses four of the digits a calibration needs.

    Raises:
        InputError: if JAX is not in 64-bit mode; the sentence says how to switch it on.
    """
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise InputError(
            f"{what} needs 64-bit numbers, but JAX is in 32-bit mode. "
            "Put `import jax; jax.config.update('jax_enable_x64', True)` before any array is made, "
            "or set the environment variable JAX_ENABLE_X64=1."
        )


def check_shape(name: str, array: object, expected: tuple[int | None, ...]) -> np.ndarray:
    """The argument as a float64 array of the expected shape (None: any size).

    Raises:
        InputError: naming the argument, the expected shape and the one that came.
    """
    try:
        value = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected numbers, got {type(array).__name__} ({error})") from None
    words = "(" + ", ".join("any" if size is None else str(size) for size in expected) + ")"
    if value.ndim != len(expected) or any(e not in (None, s) for s, e in zip(value.shape, expected)):
        raise InputError(f"{name}: expected shape {words}, got {value.shape}")
    return value


def check_finite(name: str, array: np.ndarray, next_step: str) -> None:
    """Refuse NaN and infinity, naming how many and where the first one stands.

    Raises:
        InputError: with the index of the first entry that is not finite and what to do.
    """
    bad = ~np.isfinite(array)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"{name}: {int(bad.sum())} of {array.size} numbers are NaN or infinite, the first at index {first}. "
            f"{next_step}"
        )
