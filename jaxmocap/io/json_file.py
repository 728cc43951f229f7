"""JSON for other programs: plain numbers only, null for what is not a number, the same bytes every time."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.io.atomic import write_bytes


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file, whole or not at all, keys in the order given.

    Args:
        path: the file.
        content: lists, tuples, mappings, texts, paths, numbers; arrays and scalars of numpy and JAX. NaN and
            infinity become null.

    Raises:
        InputError: if something in it is none of these, or the file cannot be written.
    """
    write_bytes(path, json_bytes(content))


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """The bytes that `write_json` writes.

    Raises:
        InputError: if something in it has no place in JSON.
    """
    text = json.dumps(_plain(content, "content"), indent=2, ensure_ascii=False, allow_nan=False)
    # A file name that is not UTF-8 holds half of a surrogate pair; escaped it is legal JSON.
    return (text + "\n").encode("utf-8", errors="backslashreplace")


def _plain(value: Any, where: str) -> Any:
    if isinstance(value, Mapping):
        return {_key(key, where): _plain(entry, f"{where}[{key!r}]") for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry, f"{where}[{i}]") for i, entry in enumerate(value)]
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "__array__"):  # numpy and JAX
        return _from_array(np.asarray(value), where)
    raise InputError(f"{where}: {type(value).__name__} has no place in JSON. Convert it to numbers or text first.")


def _from_array(array: np.ndarray, where: str) -> Any:
    if array.dtype.kind not in "biufU":
        raise InputError(f"{where}: an array of {array.dtype} has no place in JSON. Convert it to numbers first.")
    return _plain(array.tolist(), where)


def _key(key: object, where: str) -> str:
    if not isinstance(key, str | int):
        raise InputError(f"{where}: expected a text as key, got {type(key).__name__} {key!r}.")
    return str(key)
