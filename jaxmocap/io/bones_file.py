"""Bone lengths of a puppet as a file: `unit`, and `[lengths]` by bone name."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from jaxmocap._errors import InputError
from jaxmocap.bodies.puppet import DEFAULT_LENGTHS, complete_lengths
from jaxmocap.io.atomic import write_text
from jaxmocap.io.length_units import METRES
from jaxmocap.io.text_file import nearest, read_text

_MAX_BYTES = 1 << 20
_KEYS = ("unit", "lengths")
_UNITS = (*METRES, "1")


@dataclass(frozen=True)
class BonesFile:
    """What a bones file says."""

    lengths: Mapping[str, float] = field(default_factory=dict)
    """By the name of the bone, in `unit`; bones that are missing take a default (`puppet.complete_lengths`)."""
    unit: str = "mm"
    """Unit of the lengths; "1": no physical unit, only their ratios count."""


def write_bones(path: str | Path, bones: BonesFile) -> None:
    """Write a bones file, whole or not at all; lengths read back exactly.

    Args:
        path: the file.
        bones: what to write.

    Raises:
        InputError: for an unknown bone or unit, a length that is not a positive number, or a file that cannot be
            written.
    """
    if bones.unit not in _UNITS:
        raise InputError(f"unit: expected one of {', '.join(_UNITS)}, got {bones.unit!r}.")
    complete_lengths(bones.lengths)
    ordered = {name: float(bones.lengths[name]) for name in DEFAULT_LENGTHS if name in bones.lengths}
    write_text(path, tomli_w.dumps({"unit": bones.unit, "lengths": ordered}))


def read_bones(path: str | Path) -> BonesFile:
    """Read a bones file.

    Args:
        path: the file.

    Returns:
        BonesFile with at least one length.

    Raises:
        InputError: naming the key: no TOML, a key that is no key of this file, a bone that does not
            exist (with the nearest name), a length that is not a positive number, no length at all.
    """
    document = _parse(path)
    for key in document:
        if key not in _KEYS:
            raise InputError(f"{path}: unknown key {key!r}; a bones file has {' and '.join(_KEYS)}.{_near(key, _KEYS)}")
    unit = document.get("unit")
    if unit not in _UNITS:
        said = "it is missing" if unit is None else f"got {unit!r}"[:60]
        raise InputError(f'{path}, unit: expected one of {", ".join(_UNITS)} in quotes ("1": none), {said}.')
    lengths = document.get("lengths")
    if not isinstance(lengths, dict) or not lengths:
        raise InputError(f"{path}, [lengths]: expected a table with at least one bone, such as l-elbow-joint = 33.")
    return BonesFile({name: _length(path, name, value) for name, value in lengths.items()}, unit)


def _parse(path: str | Path) -> dict[str, Any]:
    text = read_text(path, _MAX_BYTES)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: brackets are nested too deeply to be a bones file.") from None
    except ValueError as error:  # TOMLDecodeError is one; Python's limit on digits is another
        raise InputError(f"{path}: not valid TOML: {error}. A bones file has unit and [lengths].") from None


def _length(path: str | Path, name: str, value: Any) -> float:
    if name not in DEFAULT_LENGTHS:
        known = f" Bones are {', '.join(DEFAULT_LENGTHS)}."
        shown = name if len(name) < 60 else name[:57] + "..."
        raise InputError(f"{path}, [lengths]: there is no bone {shown!r}.{_near(name, DEFAULT_LENGTHS) or known}")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{path}, [lengths] {name}: expected a number, got {type(value).__name__}.")
    if not 0 < value < 1e9:
        raise InputError(f"{path}, [lengths] {name}: expected a positive length, got {value!r:.40}.")
    return float(value)


def _near(word: str, known: Any) -> str:
    close = f"{word}-joint" if f"{word}-joint" in known else nearest(word, known)
    return f" Did you mean {close!r}?" if close else ""
