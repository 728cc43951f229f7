"""The turntable as it is kept between commands: TOML, strict, whole or not at all."""

import importlib.metadata
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from jaxmocap._errors import InputError
from jaxmocap.io.atomic import write_text
from jaxmocap.io.text_file import nearest, read_text

SCHEMA = 1
"""Grows when the meaning of a key changes, so that an older jaxmocap refuses a file it would misread."""

KNOWN = ("rx", "ry", "rz", "distance")
"""What the covariance is of: rotation vector [rad], distance [unit]."""

_MAX_BYTES = 4 << 20
_LARGEST = 1e9
_KEYS = ("rotation", "distance", "height", "covariance", "axis", "sigma", "angles_deg", "sigma_angles_deg", "metadata")
_AXIS_KEYS = ("point", "direction", "sigma_point", "sigma_direction")
_METADATA_KEYS = ("schema", "jaxmocap", "unit", "error", "inputs", "settings", "held")


@dataclass(frozen=True)
class TurntableFile:
    """A turntable with what its file says about it."""

    rotation: tuple[float, float, float]
    """Rotation vector world -> camera at angle 0 [rad]; (pi, 0, 0) is the perfect build."""
    distance: float
    """Camera centre to axis [unit]."""
    height: float
    """Of the axis' point nearest the camera centre above the origin of the world [unit]."""
    unit: str = "1"
    """Unit of lengths; "1": none."""
    covariance: np.ndarray | None = None
    """(4, 4) of rotation [rad] and distance [unit]; None: not known."""
    axis: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """The axis in the camera frame at angle 0 for other programs: point, direction and their sigmas. It follows from
    rotation and distance, and is checked against them when read."""
    angles_deg: Mapping[str, float] = field(default_factory=dict)
    """Angle of each photo of the calibration [degrees]."""
    sigma_angles_deg: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations of these."""
    error: float | None = None
    """RMS reprojection error [px]."""
    held: tuple[str, ...] = ()
    """What the data leave free and was held."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the files it was computed from, by file name."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Whatever else the command that wrote it wants to record."""
    version: str = ""
    """Version of jaxmocap that wrote the file; set by reading, ignored by writing."""


def write_turntable(path: str | Path, table: TurntableFile) -> None:
    """Write a turntable as TOML, whole or not at all; numbers read back exactly.

    Args:
        path: the file.
        table: what to write.

    Raises:
        InputError: if it holds what no file can, or the file cannot be written.
    """
    write_text(path, turntable_text(table))


def turntable_text(table: TurntableFile) -> str:
    """The text that `write_turntable` writes.

    Raises:
        InputError: as `write_turntable`.
    """
    try:
        version = importlib.metadata.version("jaxmocap")
    except importlib.metadata.PackageNotFoundError:  # run from a source tree that was never installed
        version = "unknown"
    optional = {
        "error": None if table.error is None else float(table.error),
        "held": list(table.held),
        "inputs": {str(k): str(v) for k, v in table.inputs.items()},
        "settings": dict(table.settings),
    }
    metadata = {"schema": SCHEMA, "jaxmocap": version, "unit": table.unit}
    metadata |= {key: value for key, value in optional.items() if value not in (None, {}, [])}
    arrays = {"rotation": [float(x) for x in table.rotation], "distance": float(table.distance)}
    arrays |= {"height": float(table.height)}
    if table.covariance is not None:
        arrays["covariance"] = np.asarray(table.covariance, dtype=float).tolist()
    tables = {
        "axis": {key: [float(x) for x in value] for key, value in table.axis.items()},
        "angles_deg": {str(k): float(v) for k, v in table.angles_deg.items()},
        "sigma_angles_deg": {str(k): float(v) for k, v in table.sigma_angles_deg.items()},
        "metadata": metadata,
    }
    try:
        # Python's lists are TOML's; tomli_w would give every number of an array its own line.
        head = "".join(f"{key} = {value}\n" for key, value in arrays.items())
        text = head + "\n" + tomli_w.dumps({key: value for key, value in tables.items() if value})
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"turntable: settings hold what TOML cannot store ({error}).") from error
    _from_document("turntable", tomllib.loads(text))  # what would be refused when read is not written
    return text


def read_turntable(path: str | Path) -> TurntableFile:
    """Read a turntable file.

    Args:
        path: the file.

    Returns:
        The turntable. Of a file written by hand only rotation, distance, height and the unit are needed.

    Raises:
        InputError: naming the key of what is missing, misspelt, of the wrong type or impossible.
    """
    text = read_text(path, _MAX_BYTES)
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: brackets are nested too deeply to be a turntable file.") from None
    except ValueError as error:  # TOMLDecodeError is one; Python's limit on digits is another
        raise InputError(f"{path}: not valid TOML: {str(error)[:300]}. Is it another file?") from None
    return _from_document(str(path), document)


def _from_document(where: str, document: dict[str, Any]) -> TurntableFile:
    _only(where, document, _KEYS)
    metadata = _table(where, document, "metadata")
    _only(f"{where}, [metadata]", metadata, _METADATA_KEYS)
    schema = metadata.get("schema", SCHEMA)
    if isinstance(schema, bool) or not isinstance(schema, int) or schema > SCHEMA:
        raise InputError(
            f"{where}, [metadata] schema: this jaxmocap knows up to {SCHEMA}, got {str(schema)[:40]}. "
            "Upgrade jaxmocap, or calibrate the turntable again."
        )
    for key in ("rotation", "distance", "height"):
        if key not in document:
            close = nearest(key, [k for k in document if k not in _KEYS])
            hint = f"Is `{close}` a misspelling of it?" if close else "Calibrate the turntable, or give --distance."
            raise InputError(f"{where}: `{key}` is missing. {hint}")
    error = metadata.get("error")
    table = TurntableFile(
        rotation=_vector(f"{where}, rotation", document["rotation"]),
        distance=_number(f"{where}, distance", document["distance"], positive=True),
        height=_number(f"{where}, height", document["height"]),
        unit=_text(f"{where}, [metadata] unit", metadata.get("unit", "1")) or "1",
        covariance=_covariance(f"{where}, covariance", document["covariance"]) if "covariance" in document else None,
        axis=_axis(where, _table(where, document, "axis")),
        angles_deg=_numbers(where, document, "angles_deg"),
        sigma_angles_deg=_numbers(where, document, "sigma_angles_deg"),
        error=None if error is None else _number(f"{where}, [metadata] error", error, least=0.0),
        held=_held(where, metadata),
        inputs=_inputs(where, metadata),
        settings=_table(f"{where}, [metadata]", metadata, "settings"),
        version=_text(f"{where}, [metadata] jaxmocap", metadata.get("jaxmocap", "")),
    )
    _check_axis(where, table)
    return table


def _only(where: str, table: dict[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            close = nearest(key, known)
            hint = f"did you mean `{close}`?" if close else f"known are {', '.join(known)}."
            raise InputError(f"{where}: unknown key `{key[:60]}`; {hint}")


def _table(where: str, parent: dict[str, Any], key: str) -> dict[str, Any]:
    value = parent.get(key, {})
    if not isinstance(value, dict):
        raise InputError(f"{where}, {key}: expected a table [{key}], got {type(value).__name__}.")
    return value


def _number(where: str, value: Any, *, positive: bool = False, least: float = -_LARGEST) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= _LARGEST
    if not good or (positive and value <= 0):
        what = "a positive number" if positive else "a number" if least < 0 else "a number that is not negative"
        raise InputError(f"{where}: expected {what}, got {str(value)[:40]}.")
    return float(value)


def _vector(where: str, value: Any) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{where}: expected three numbers, got {str(value)[:60]}.")
    x, y, z = (_number(where, v) for v in value)
    return x, y, z


def _text(where: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{where}: expected text in quotes, got {type(value).__name__}.")
    return value


def _numbers(where: str, document: dict[str, Any], key: str) -> dict[str, float]:
    table = _table(where, document, key)
    return {name: _number(f"{where}, [{key}] {name[:60]}", value) for name, value in table.items()}


def _covariance(where: str, value: Any) -> np.ndarray:
    n = len(KNOWN)
    if not isinstance(value, list) or len(value) != n or not all(isinstance(r, list) and len(r) == n for r in value):
        raise InputError(f"{where}: expected {n} rows of {n} numbers (of {', '.join(KNOWN)}).")
    C = np.array([[_number(where, v) for v in row] for row in value])
    d = np.diag(C)
    if not (d > 0).all() or not np.allclose(C, C.T, rtol=1e-9, atol=1e-12 * d.max()):
        raise InputError(f"{where}: expected a symmetric matrix with a positive diagonal.")
    if np.linalg.eigvalsh(C / np.sqrt(np.outer(d, d)))[0] <= 0:
        raise InputError(f"{where}: not positive definite, so it is no covariance. Calibrate the turntable again.")
    return C


def _axis(where: str, axis: dict[str, Any]) -> dict[str, tuple[float, float, float]]:
    _only(f"{where}, [axis]", axis, _AXIS_KEYS)
    return {key: _vector(f"{where}, [axis] {key}", value) for key, value in axis.items()}


def _held(where: str, metadata: dict[str, Any]) -> tuple[str, ...]:
    value = metadata.get("held", [])
    if not isinstance(value, list):
        raise InputError(f"{where}, [metadata] held: expected a list of names, got {type(value).__name__}.")
    return tuple(_text(f"{where}, [metadata] held", entry) for entry in value)


def _inputs(where: str, metadata: dict[str, Any]) -> dict[str, str]:
    inputs = _table(f"{where}, [metadata]", metadata, "inputs")
    for name, digest in inputs.items():
        if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
            raise InputError(f"{where}, [metadata.inputs] {name[:60]}: expected 64 hexadecimal digits (SHA-256).")
    return inputs


def _check_axis(where: str, table: TurntableFile) -> None:
    """The axis written for others is that of rotation and distance, or somebody changed one and not the other."""
    angle = math.hypot(*table.rotation)
    if angle > 2 * math.pi:
        raise InputError(
            f"{where}, rotation: a rotation vector of {angle:.6g} rad turns more than once; is it degrees?"
        )
    k = np.array(table.rotation) / (angle or 1.0)
    expected = {}
    for key, v, size in (("direction", (0, 1, 0), 1.0), ("point", (0, 0, -1), table.distance)):
        v = np.array(v, float)
        turned = v * math.cos(angle) + np.cross(k, v) * math.sin(angle) + k * (k @ v) * (1 - math.cos(angle))
        expected[key] = turned * size
    for key, value in expected.items():
        if key in table.axis and not np.allclose(table.axis[key], value, atol=1e-6 * max(1.0, np.abs(value).max())):
            raise InputError(
                f"{where}, [axis] {key}: {list(table.axis[key])} is not what rotation and distance say "
                f"({[round(float(x), 6) for x in value]}). Change rotation and distance, and delete [axis]."
            )
