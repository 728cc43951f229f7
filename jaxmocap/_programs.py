"""Programs that outlive the process: what JAX traced once is kept in a folder and not traced again.

JAX's own cache keeps compiled code, yet every process traces and lowers its programs anew, which takes longer than
all the arithmetic of a calibration. Where a folder is set (`keep_in`; the command line does), a `program` is
exported on its first call and read back by the next process. Everywhere else it is `equinox.filter_jit`.

The key of an entry holds the shapes of the arrays, everything static among the arguments, and the text of this
package with the versions of what it stands on: another version never finds it. Functions among the arguments must be
defined at the top of a module of this package, since only those are known by name; with any other a program is traced
as usual, as it is under `jax.vmap`, `jax.grad` and the like.
"""

import dataclasses
import enum
import functools
import hashlib
import os
import pickle
import platform
import sys
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import equinox as eqx
import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

R = TypeVar("R")

_PACKAGE = Path(__file__).parent
_STANDS_ON = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
# XLA's newer emitters for fused loops take twice as long to compile and run no faster here (scripts/bench_bar.py:
# 0.0606 s with and 0.0585 s without at 2,500 blocks, first call 9.0 and 6.7 s).
_QUICK_TO_COMPILE: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False}
# A process that runs a program once is better off with plain code, unless the arrays are large: of 13 photographs
# (0.1 MB) a whole calibration takes 19.5 s of processor time with optimised code and 13.2 s without.
_RUN_ONCE: dict[str, Any] = {**_QUICK_TO_COMPILE, "xla_backend_optimization_level": 0}
_LARGE_BYTES = 2**20

_folder: Path | None = None


class _Unnameable(Exception):
    """A static argument that has no name which another process would understand."""


@dataclasses.dataclass(frozen=True)
class _Slot:
    """Stands for one array in the stored shape of a program's output."""

    index: int


def keep_in(folder: Path | None) -> None:
    """Keep programs in a folder that belongs to the user (it is trusted as code); None: in memory only."""
    global _folder
    _folder = folder if folder is None or _is_own(folder) else None


def _is_own(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()
    except OSError:
        return False


@functools.cache
def _known() -> bool:
    """Whether this version of XLA knows the options above."""
    try:
        jax.jit(lambda x: x, compiler_options=_RUN_ONCE)(np.zeros(()))
    except Exception:  # whatever an unknown option raises in this version
        return False
    return True


def _compile(fn: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    return jax.jit(fn, compiler_options=options if _known() else None)


@functools.cache
def _fingerprint() -> str:
    """Text of this package and versions below it."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(_PACKAGE).as_posix().encode() + path.read_bytes())
    versions = [f"{name} {metadata.version(name)}" for name in _STANDS_ON]
    x64 = jax.config.jax_enable_x64  # type: ignore[attr-defined]
    digest.update(repr((versions, sys.version, platform.machine(), jax.default_backend(), x64)).encode())
    return digest.hexdigest()


def _name(x: Any) -> str:
    """Name of a function or class of this package, by which another process finds the same one."""
    module, path = getattr(x, "__module__", None), getattr(x, "__qualname__", "<")
    if module is None or "<" in path or not (module == "jaxmocap" or module.startswith("jaxmocap.")):
        raise _Unnameable(repr(x))
    return f"{module}:{path}"


def _signature(x: Any) -> Any:
    """Everything about an argument but the numbers in its arrays."""
    if isinstance(x, (jax.Array, np.ndarray)):
        return ("array", x.shape, str(x.dtype), bool(getattr(x, "weak_type", False)))
    if x is None or isinstance(x, (bool, int, float, str)):
        return repr(x)
    if isinstance(x, enum.Enum):
        return (_name(type(x)), x.name)
    if isinstance(x, (tuple, list)):
        kind = type(x).__name__ if type(x) in (tuple, list) else _name(type(x))
        return (kind, *(_signature(v) for v in x))
    if isinstance(x, dict):
        return ("dict", *((repr(k), _signature(v)) for k, v in x.items()))
    if dataclasses.is_dataclass(x) and not isinstance(x, type):
        fields = ((f.name, _signature(getattr(x, f.name, None))) for f in dataclasses.fields(x))
        return (_name(type(x)), *fields)
    return _name(x)


def _flat(fn: Callable[..., Any], arguments: Any) -> tuple[Callable[..., list[Any]], list[Any], list[Any]]:
    """The function on its arrays alone, those arrays, and a list that receives the shape of the output."""
    dynamic, static = eqx.partition(arguments, eqx.is_array)
    leaves, treedef = jax.tree.flatten(dynamic)
    shape: list[Any] = []

    def run(*arrays: Any) -> list[Any]:
        out = fn(*eqx.combine(jax.tree.unflatten(treedef, arrays), static))
        moving, still = eqx.partition(out, eqx.is_array)
        results, out_def = jax.tree.flatten(moving)
        slots = jax.tree.unflatten(out_def, [_Slot(k) for k in range(len(results))])
        shape[:] = [eqx.combine(slots, still)]
        return results

    return run, leaves, shape


def _fill(shape: Any, results: list[Any]) -> Any:
    """The output with its arrays."""
    is_slot = lambda x: isinstance(x, _Slot)  # noqa: E731
    return jax.tree.map(lambda x: results[x.index] if is_slot(x) else x, shape, is_leaf=is_slot)


def _write(path: Path, content: bytes) -> None:
    """Put a whole entry in its place, or none."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new")
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(name, path)
    except OSError:
        pass  # a full or protected disk: slower next time, nothing else


class Program(Generic[R]):
    """A compiled function; see the module. NumPy arrays are as good as JAX's, so its arguments are not typed."""

    def __init__(self, fn: Callable[..., R]):
        functools.update_wrapper(self, fn)
        self._fn = fn
        self._inner = eqx.filter_jit(fn)
        self._outer: Callable[..., Any] | None = None
        self._ready: dict[str, tuple[Callable[..., Any], Any]] = {}

    def __call__(self, *args: Any, **kwargs: Any) -> R:
        """The function's value."""
        # A number made here is traced if this call stands inside another program, whatever its arguments are.
        if any(isinstance(x, Tracer) for x in jax.tree.leaves((args, kwargs, jnp.zeros(())))):
            return self._inner(*args, **kwargs)  # options may only be given to the outermost program
        if self._outer is None:
            options: Any = {"compiler_options": _QUICK_TO_COMPILE} if _known() else {}
            self._outer = eqx.filter_jit(self._fn, **options)
        folder = _folder
        if folder is None or kwargs:
            return self._outer(*args, **kwargs)
        try:
            described = repr((_name(self._fn), _signature(args), _fingerprint()))
        except _Unnameable:
            return self._outer(*args, **kwargs)
        key = hashlib.sha256(described.encode()).hexdigest()
        run, leaves, shape = _flat(self._fn, args)
        if key not in self._ready:
            self._ready[key] = _load(folder / key) or _store(folder / key, run, leaves, shape)
        call, out = self._ready[key]
        return cast(R, _fill(out, call(*leaves)))


def _load(path: Path) -> tuple[Callable[..., Any], Any] | None:
    """A stored program and the shape of its output; None if there is none that can be read."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    try:
        exported, out = pickle.loads(content)
        program = jax.export.deserialize(bytearray(exported))
        return _compile(program.call, _options(program)), out
    except Exception:  # damaged: whatever the readers raise; it is made anew
        return None


def _store(path: Path, run: Callable[..., Any], leaves: list[Any], shape: list[Any]) -> tuple[Callable[..., Any], Any]:
    """Export a program, put it into the folder, and hand it over."""
    exported = jax.export.export(jax.jit(run))(*leaves)
    out = shape[0]
    try:
        _write(path, pickle.dumps((bytes(exported.serialize()), out)))
    except (pickle.PicklingError, TypeError, AttributeError, ValueError):
        pass  # an output that cannot be written down: traced anew by every process
    return _compile(exported.call, _options(exported)), out


def _options(exported: jax.export.Exported) -> dict[str, Any]:
    size = sum(int(np.prod(x.shape)) * x.dtype.itemsize for x in exported.in_avals)
    return _RUN_ONCE if size < _LARGE_BYTES else _QUICK_TO_COMPILE


def program(fn: Callable[..., R]) -> Program[R]:
    """Compile a function; arrays among its arguments are traced, everything else is static."""
    return Program(fn)
