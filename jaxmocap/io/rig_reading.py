"""Reading a rig file, ours or another program's: every table that holds `matrix` is a camera."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError
from jaxmocap.io.camera_numbers import (
    NamedCamera,
    assemble,
    check_names,
    intrinsics_from_matrix,
    lens_from_numbers,
    rotvec_from_numbers,
    size_from_numbers,
    translation_from_numbers,
)
from jaxmocap.io.rig_file import SCHEMA, UPS, RigFile
from jaxmocap.io.text_file import nearest, read_text

_MAX_BYTES = 8 << 20
_CAMERA_KEYS = ("name", "size", "matrix", "distortions", "rotation", "translation", "fisheye")
_METADATA_KEYS = (
    "schema", "jaxmocap", "unit", "up", "error", "seed", "skew", "sigmas", "inputs", "settings", "foreign",
)  # fmt: skip
_KINDS: dict[type, str] = {str: "text in quotes", int: "a whole number", float: "a number", dict: "a table"}


def read_rig(path: str | Path) -> RigFile:
    """Read a rig file of jaxmocap, aniposelib, Pose2Sim, caliscope or the like.

    Any table with a `matrix` is a camera (``[cam_0]``, ``[cameras.0]``, ``[demo]``), called by its `name` or
    else by its table. Rotation is a vector or a 3x3 matrix, world -> camera; distortions are 2, 4 or 5
    numbers in OpenCV's order. Keys that are not ours are kept and named in `warnings`.

    Args:
        path: the file.

    Returns:
        The rig; `unit` is "1" where the file does not say.

    Raises:
        InputError: naming table and key of what is missing, misspelt, of the wrong type or impossible; for a
            fisheye lens; for a file of a newer schema; if JAX is not in 64-bit mode.
    """
    require_x64("reading a rig")
    document = _parse(path)
    metadata = document.pop("metadata", {})
    if not isinstance(metadata, dict):
        raise InputError(f"{path}, metadata: expected a table [metadata], got {type(metadata).__name__}.")
    _check_metadata(path, metadata)
    found = list(_camera_tables(document, ()))
    if not found:
        names = ", ".join(list(document)[:8])[:200] or "nothing"
        raise InputError(f"{path}: no table holds a camera `matrix` (found: {names}). Is this a rig file?")
    cameras = tuple(_camera(path, keys, table, alone=len(found) == 1) for keys, table in found)
    try:
        check_names([named.name for named in cameras])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    tables = _without(document, [keys for keys, _ in found])
    names = {keys[-1]: named.name for (keys, _), named in zip(found, cameras)} | {c.name: c.name for c in cameras}
    return _rig(path, cameras, names, metadata, tables)


def _parse(path: str | Path) -> dict[str, Any]:
    text = read_text(path, _MAX_BYTES)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: brackets are nested too deeply to be a rig file.") from None
    except ValueError as error:  # TOMLDecodeError is one; Python's limit on digits is another
        hint = (
            " A key or table stands there twice; keep one."
            if "overwrite" in str(error) or "twice" in str(error)
            else ""
        )
        raise InputError(f"{path}: not valid TOML: {error}.{hint} Rig files are TOML; is it another format?") from None


def _camera_tables(table: dict[str, Any], keys: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Tables holding `matrix`, at the top or one below, in the order of the file."""
    for key, value in table.items():
        if not isinstance(value, dict):
            continue
        if "matrix" in value or "distortions" in value:  # the latter: a camera whose matrix was forgotten
            yield (*keys, key), value
        elif not keys:
            yield from _camera_tables(value, (key,))


def _without(document: dict[str, Any], taken: list[tuple[str, ...]]) -> dict[str, Any]:
    """What remains of the document when the camera tables are taken out."""
    rest: dict[str, Any] = {}
    for key, value in document.items():
        if isinstance(value, dict):
            kept = {k: v for k, v in value.items() if (key, k) not in taken}
            if (key,) not in taken and (kept or not value):
                rest[key] = kept
        else:
            rest[key] = value
    return rest


def _camera(path: str | Path, keys: tuple[str, ...], table: dict[str, Any], alone: bool) -> NamedCamera:
    where = f"{path}, [{'.'.join(keys)}]"
    name = table.get("name", keys[-1])
    if not isinstance(name, str):
        raise InputError(f"{where} name: expected text in quotes, got {type(name).__name__}.")
    _refuse_fisheye(where, table)
    warnings: list[str] = []
    size = size_from_numbers(f"{where} size", _required(where, table, "size", "Add size = [width, height]."))
    intrinsics = intrinsics_from_matrix(f"{where} matrix", _required(where, table, "matrix", "Calibrate it first."))
    ideal = "For an ideal lens add distortions = [0, 0, 0, 0, 0]."
    k = _required(where, table, "distortions", ideal)
    lens = lens_from_numbers(f"{where} distortions", k, warnings.append)
    camera = assemble(where, size, intrinsics, lens, _pose(where, table, alone, warnings), warnings.append)
    foreign = {key: value for key, value in table.items() if key not in _CAMERA_KEYS}
    return NamedCamera(name, camera, foreign, tuple(warnings))


def _required(where: str, table: dict[str, Any], key: str, advice: str) -> Any:
    if key in table:
        return table[key]
    close = nearest(key, [k for k in table if k not in _CAMERA_KEYS])
    raise InputError(f"{where}: `{key}` is missing. " + (f"Is `{close}` a misspelling of it?" if close else advice))


def _refuse_fisheye(where: str, table: dict[str, Any]) -> None:
    fisheye = table.get("fisheye", False)
    if not isinstance(fisheye, bool):
        raise InputError(f"{where} fisheye: expected true or false, got {type(fisheye).__name__}.")
    if fisheye:
        raise InputError(
            f"{where} fisheye = true: fisheye lenses are not supported; its distortions read as k1 k2 p1 p2 "
            "would give wrong pixels without a sign. Calibrate it with the k1 k2 model or leave it out."
        )


def _pose(where: str, table: dict[str, Any], alone: bool, warnings: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector and translation; a single camera may lack both."""
    if alone and "rotation" not in table and "translation" not in table:
        warnings.append(f"{where}: no rotation and translation; the camera's own frame is taken as the world.")
        return np.zeros(3), np.zeros(3)
    advice = "Where the camera stands is not known: calibrate the rig, or take the camera out of the file."
    rotvec = rotvec_from_numbers(f"{where} rotation", _required(where, table, "rotation", advice), warnings.append)
    return rotvec, translation_from_numbers(f"{where} translation", _required(where, table, "translation", advice))


def _check_metadata(path: str | Path, metadata: dict[str, Any]) -> None:
    """Refuse what would be misread: a newer schema, a misspelt key."""
    schema = _value(path, metadata, "schema", int, SCHEMA)
    if schema > SCHEMA:
        raise InputError(
            f"{path}, [metadata] schema: written by a newer jaxmocap (this one knows up to {SCHEMA}). "
            "Upgrade jaxmocap to read it."
        )
    for key in metadata:
        close = None if key in _METADATA_KEYS else nearest(key, _METADATA_KEYS)
        if close:
            raise InputError(f"{path}, [metadata]: unknown key `{key}`; did you mean `{close}`?")


def _rig(
    path: str | Path,
    cameras: tuple[NamedCamera, ...],
    names: dict[str, str],
    metadata: dict[str, Any],
    tables: dict[str, Any],
) -> RigFile:
    warnings = [sentence for named in cameras for sentence in named.warnings]
    foreign_keys = dict.fromkeys(key for named in cameras for key in named.foreign)
    if foreign_keys:
        warnings.append(f"{path}, cameras: keys of another program are kept: {', '.join(foreign_keys)}.")
    foreign_metadata = {key: value for key, value in metadata.items() if key not in _METADATA_KEYS}
    if foreign_metadata:
        warnings.append(f"{path}, [metadata]: keys of another program are kept: {', '.join(foreign_metadata)}.")
    if tables:
        warnings.append(f"{path}: tables and keys that are no cameras are kept: {', '.join(tables)}.")
    if "unit" not in metadata:
        warnings.append(f'{path}: the unit of lengths is not given; add unit = "m" (or another) under [metadata].')
    sigmas = _sigmas(path, metadata, names, warnings)
    up = _value(path, metadata, "up", str, "")
    if up not in UPS:
        raise InputError(f"{path}, [metadata] up: expected one of {', '.join(map(repr, UPS))}, got {up!r}.")
    error = _value(path, metadata, "error", float, None)
    return RigFile(
        cameras=cameras,
        unit=_value(path, metadata, "unit", str, "1") or "1",
        up=up,
        error=None if error is None else _positive(f"{path}, [metadata] error", error),
        sigmas=sigmas,
        inputs=_inputs(path, metadata),
        seed=_value(path, metadata, "seed", int, None),
        settings=_value(path, metadata, "settings", dict, {}),
        version=_value(path, metadata, "jaxmocap", str, ""),
        foreign_metadata=foreign_metadata,
        foreign_tables={**_value(path, metadata, "foreign", dict, {}), **tables},
        warnings=tuple(warnings),
    )


def _value(path: str | Path, metadata: dict[str, Any], key: str, kind: type, default: Any) -> Any:
    """The value of a key of [metadata] if it is of the right kind."""
    value = metadata.get(key, default)
    allowed = (int, float) if kind is float else kind
    if key in metadata and (isinstance(value, bool) or not isinstance(value, allowed)):
        raise InputError(f"{path}, [metadata] {key}: expected {_KINDS[kind]}, got {type(value).__name__}.")
    return value


def _positive(where: str, value: Any) -> float:
    """A number that is finite and not negative (nor an integer beyond the floats)."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1e300:
        raise InputError(f"{where}: expected a number that is not negative, got {type(value).__name__}.")
    return float(value)


def _sigmas(
    path: str | Path, metadata: dict[str, Any], names: dict[str, str], warnings: list[str]
) -> dict[str, dict[str, float]]:
    """Sigmas by camera name; the file may also call a camera by its table."""
    sigmas: dict[str, dict[str, float]] = {}
    for key, values in _value(path, metadata, "sigmas", dict, {}).items():
        where = f"{path}, [metadata.sigmas"
        if not isinstance(values, dict):
            raise InputError(f"{where}] {key}: expected a table, got {type(values).__name__}.")
        if key in names:
            sigmas[names[key]] = {name: _positive(f"{where}.{key}] {name}", sigma) for name, sigma in values.items()}
        else:
            warnings.append(f"{where}.{key}]: no camera is called so; left out.")
    return sigmas


def _inputs(path: str | Path, metadata: dict[str, Any]) -> dict[str, str]:
    inputs = _value(path, metadata, "inputs", dict, {})
    for name, digest in inputs.items():
        if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
            raise InputError(f"{path}, [metadata.inputs] {name}: expected 64 hexadecimal digits (SHA-256).")
    return inputs
