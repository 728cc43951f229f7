"""The rig as it is kept between commands, and how it is written: TOML as aniposelib and Pose2Sim read it."""

import importlib.metadata
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from jaxmocap._errors import InputError
from jaxmocap.io.atomic import write_text
from jaxmocap.io.camera_numbers import NamedCamera, check_names, plain_camera

SCHEMA = 1
"""Grows when the meaning of a key changes, so that an older jaxmocap refuses a file it would misread."""

# The parser that aniposelib and Pose2Sim use (toml 0.10) misreads these within the name of a table.
_UNSAFE = re.compile(r'["\\\x00-\x1f\x7f]')

UPS = ("", "x", "-x", "y", "-y", "z", "-z")
"""World axis that points up; empty when nobody has said."""


@dataclass(frozen=True)
class RigFile:
    """Cameras with what a rig file says about them."""

    cameras: tuple[NamedCamera, ...]
    """In order; the world of an unmoved rig is the first one."""
    unit: str = "1"
    """Unit of translations; "1": no physical unit."""
    up: str = ""
    """World axis that points up, one of `UPS`; "" is unknown."""
    error: float | None = None
    """RMS reprojection error [px]."""
    sigmas: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Standard deviations by camera name and parameter name, in the unit of the parameter."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the files it was computed from, by file name."""
    seed: int | None = None
    """Seed of the random numbers used, if any."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Whatever else the command that wrote it wants to record."""
    version: str = ""
    """Version of jaxmocap that wrote the file; set by reading, ignored by writing."""
    foreign_metadata: Mapping[str, Any] = field(default_factory=dict)
    """Keys of [metadata] that are not ours: kept and written back."""
    foreign_tables: Mapping[str, Any] = field(default_factory=dict)
    """Tables that are no cameras: written back within [metadata], where no program takes them for one."""
    warnings: tuple[str, ...] = ()
    """What was odd when it was read, cameras included."""


def write_rig(path: str | Path, rig: RigFile) -> list[str]:
    """Write a rig as TOML, whole or not at all.

    One table ``[cam_<name>]`` per camera with name, size, matrix, distortions (k1 k2 p1 p2 k3), rotation
    (vector, world -> camera), translation; the rest in ``[metadata]``. Numbers read back exactly.

    Args:
        path: the file.
        rig: what to write.

    Returns:
        Sentences to say: what other programs will not see, what was left out.

    Raises:
        InputError: if the rig holds what no file can, or the file cannot be written.
    """
    text, said = rig_text(rig)
    write_text(path, text)
    return said


def rig_text(rig: RigFile) -> tuple[str, list[str]]:
    """The text that `write_rig` writes and the sentences it returns.

    Raises:
        InputError: as `write_rig`.
    """
    names = [named.name for named in rig.cameras]
    check_names(names)
    plain = {named.name: plain_camera(named) for named in rig.cameras}
    said: list[str] = []
    tables = dict(zip(names, table_names(names)))
    metadata = _metadata(rig, _skews(plain, said), _finite_sigmas(rig, tables, said))
    try:
        texts = [_camera_text(tables[named.name], named, plain[named.name]) for named in rig.cameras]
        return "\n".join([*texts, tomli_w.dumps({"metadata": metadata})]), said
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"rig: settings or foreign keys hold what TOML cannot store ({error}).") from error


def _camera_text(table: str, named: NamedCamera, plain: Mapping[str, Any]) -> str:
    """One camera's table, each array on one line (tomli_w would give every number its own)."""
    header = tomli_w.dumps({table: {}})
    arrays = "".join(f"{key} = {value}\n" for key, value in plain.items())  # Python's lists are TOML's
    foreign = tomli_w.dumps({table: named.foreign}).removeprefix(header) if named.foreign else ""
    # fisheye = false stands there because Pose2Sim writes it; aniposelib and caliscope look for it.
    return header + tomli_w.dumps({"name": named.name}) + arrays + "fisheye = false\n" + foreign


def table_names(names: list[str]) -> list[str]:
    """TOML tables of cameras: cam_<name>, where a leading "cam" or "cam_" is not doubled.

    Numbers are padded to one width, because aniposelib sorts tables as text: cam_10 would come before cam_2.
    Where two cameras would meet in one table ("cam1" and "01"), all are numbered in their order.
    """
    matches = [re.fullmatch(r"(?:cam_?)?([0-9]+)", name) for name in names]
    width = max((len(m[1]) for m in matches if m), default=0)
    tables = [
        f"cam_{m[1].zfill(width)}" if m else "cam_" + _UNSAFE.sub("_", name.removeprefix("cam_"))
        for name, m in zip(names, matches)
    ]
    if len(set(tables)) == len(tables):
        return tables
    return [f"cam_{i:0{len(str(len(names)))}}" for i in range(1, len(names) + 1)]


def _metadata(rig: RigFile, skews: dict[str, float], sigmas: dict[str, dict[str, float]]) -> dict[str, Any]:
    if rig.up not in UPS:
        raise InputError(f"up: expected one of {', '.join(repr(u) for u in UPS)}, got {rig.up!r}.")
    if not rig.unit:
        raise InputError('unit: expected a unit such as "mm", or "1" for none, got an empty text.')
    if rig.error is not None and not (math.isfinite(rig.error) and rig.error >= 0):
        raise InputError(f"error: expected an RMS in pixels, got {rig.error}. A failed solve must not be written.")
    optional = {
        "error": None if rig.error is None else float(rig.error),
        "seed": None if rig.seed is None else int(rig.seed),
        "skew": skews,
        "sigmas": sigmas,
        "inputs": {str(name): str(digest) for name, digest in rig.inputs.items()},
        "settings": dict(rig.settings),
        "foreign": dict(rig.foreign_tables),
    }
    return {
        "schema": SCHEMA,
        "jaxmocap": _version(),
        "unit": rig.unit,
        "up": rig.up,
        **{key: value for key, value in optional.items() if value not in (None, {})},
        **rig.foreign_metadata,
    }


def _version() -> str:
    try:
        return importlib.metadata.version("jaxmocap")
    except importlib.metadata.PackageNotFoundError:  # run from a source tree that was never installed
        return "unknown"


def _skews(plain: Mapping[str, Mapping[str, Any]], said: list[str]) -> dict[str, float]:
    """Skews that are not zero: OpenCV has no skew, so programs built on it drop K[0][1] without a word."""
    skews = {name: numbers["matrix"][0][1] for name, numbers in plain.items()}
    skews = {name: skew for name, skew in skews.items() if skew != 0}
    for name, skew in skews.items():
        said.append(
            f"Camera {name!r} has a skew of {skew:.4g} px. Programs built on OpenCV (aniposelib, Pose2Sim, caliscope) "
            "ignore it; calibrate without skew if the rig is for them."
        )
    return skews


def _finite_sigmas(rig: RigFile, tables: Mapping[str, str], said: list[str]) -> dict[str, dict[str, float]]:
    """Sigmas that are numbers; one that is not belongs to a parameter that the data do not determine.

    They go by the name of the camera, or by its table where the name would break a table of its own.
    """
    kept: dict[str, dict[str, float]] = {}
    for camera, sigmas in rig.sigmas.items():
        if camera not in tables:
            raise InputError(f"sigmas: no camera is called {camera!r}; there are {', '.join(map(repr, tables))}.")
        finite = {name: float(sigma) for name, sigma in sigmas.items() if math.isfinite(sigma)}
        if finite:
            kept[tables[camera] if _UNSAFE.search(camera) else camera] = finite
        lost = [name for name in sigmas if name not in finite]
        if lost:
            said.append(f"Camera {camera!r}: no finite sigma of {', '.join(lost)}; left out of the rig file.")
    return kept
