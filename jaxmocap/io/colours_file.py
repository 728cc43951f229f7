"""Reference colours of the beads as a TOML file: `[colours]` by bead `{h, s, b, sd, n, covariance}`."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from jaxmocap._errors import InputError
from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.io.atomic import write_text
from jaxmocap.io.text_file import nearest, read_text
from jaxmocap.tracking.bead_colours import BeadColours, covariance_of_sd, sd_of_covariance
from jaxmocap.tracking.colour_space import VIEW_SD

SCHEMA = 1
"""Grows when the meaning of a key changes."""

_MAX_BYTES = 1 << 20
_BEAD_KEYS = ("h", "s", "b", "sd", "n", "covariance")
_METADATA_KEYS = ("schema", "inputs", "settings")
_LOWER = np.tril_indices(3)


@dataclass(frozen=True)
class ColoursFile:
    """Colours with what the file says about them."""

    colours: BeadColours
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the photographs, by file name."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Whatever else the command that wrote it wants to record."""
    warnings: tuple[str, ...] = ()
    """What was odd when it was read."""


def write_colours(path: str | Path, content: ColoursFile) -> None:
    """Write reference colours as TOML, whole or not at all; numbers read back exactly.

    `covariance` holds the lower triangle, row by row, of the covariance in the colour cone (see
    `jaxmocap.tracking.colour_space`); `sd` are the standard deviations of h, s, b that follow from it.

    Raises:
        InputError: if a number is none, or the file cannot be written.
    """
    write_text(path, colours_text(content))


def colours_text(content: ColoursFile) -> str:
    """The text that `write_colours` writes.

    Raises:
        InputError: as `write_colours`.
    """
    colours, lines = content.colours, ["[colours]"]
    for name, hsb, sd, covariance, n in zip(colours.names, colours.hsb, colours.sd, colours.covariance, colours.n):
        numbers = [*hsb.tolist(), *sd.tolist(), *covariance[_LOWER].tolist()]
        if not all(math.isfinite(value) for value in numbers):
            raise InputError(f"colours of {name}: NaN or infinity cannot be written.")
        key = tomli_w.dumps({name: 0}).rsplit(" = ", 1)[0]
        lines.append(
            f"{key} = {{ h = {numbers[0]!r}, s = {numbers[1]!r}, b = {numbers[2]!r}, "
            f"sd = {numbers[3:6]!r}, n = {int(n)}, covariance = {numbers[6:]!r} }}"
        )
    metadata = {"schema": SCHEMA, "inputs": dict(content.inputs), "settings": dict(content.settings)}
    metadata = {key: value for key, value in metadata.items() if value != {}}
    try:
        return "\n".join(lines) + "\n\n" + tomli_w.dumps({"metadata": metadata})
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"colours: settings hold what TOML cannot store ({error}).") from error


def read_colours(path: str | Path, beads: Sequence[str] = MARKERS) -> ColoursFile:
    """Read reference colours.

    A bead needs h, s, b in 0..1; `sd` and `covariance` may be missing, then the scatter expected of any bead is
    taken; where both are given, they must agree.

    Args:
        path: the file.
        beads: names that may occur; one that is missing in the file is named in `warnings`.

    Returns:
        The colours, in the order of `beads`.

    Raises:
        InputError: naming bead and key of what is missing, misspelt, of the wrong type or impossible.
    """
    document = _parse(path)
    for key in document:
        if key not in ("colours", "metadata"):
            close = nearest(key, ("colours", "metadata"))
            raise InputError(f"{path}: unknown table or key `{key}`; " + (f"did you mean `{close}`?" if close else
                             "a colours file holds [colours] and [metadata]."))  # fmt: skip
    table = document.get("colours")
    if not isinstance(table, dict) or not table:
        raise InputError(f"{path}: the table [colours] is missing or empty. Is this a colours file?")
    found = {name: _bead(f"{path}, {name}", entry) for name, entry in _by_bead(path, table, beads).items()}
    names = tuple(name for name in beads if name in found)
    hsb, sd, covariance, n = (np.array([found[name][i] for name in names]) for i in range(4))
    missing = [name for name in beads if name not in found]
    warnings = [f"{path}: no colour of {', '.join(missing)}; such beads cannot be named."] if missing else []
    inputs, settings = _metadata(path, document.get("metadata", {}), warnings)
    return ColoursFile(BeadColours(names, hsb, sd, covariance, n), inputs, settings, tuple(warnings))


def _parse(path: str | Path) -> dict[str, Any]:
    text = read_text(path, _MAX_BYTES)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: brackets are nested too deeply to be a colours file.") from None
    except ValueError as error:  # TOMLDecodeError is one; Python's limit on digits is another
        raise InputError(f"{path}: not valid TOML: {str(error)[:300]}. Is it another format?") from None


def _by_bead(path: str | Path, table: dict[str, Any], beads: Sequence[str]) -> dict[str, Any]:
    """Entries by bead; head.1 without quotes is a table in a table for TOML, and is meant the same."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        inner = value if isinstance(value, dict) else {}
        if key not in beads and inner and all(f"{key}.{sub}" in beads for sub in inner):
            entries = {f"{key}.{sub}": entry for sub, entry in inner.items()}
        else:
            entries = {key: value}
        for name, entry in entries.items():
            if name in flat:
                raise InputError(f"{path}, [colours]: `{name}` stands there twice; keep one.")
            if name not in beads:
                close = nearest(name, beads)
                hint = f"did you mean `{close}`?" if close else f"known are {', '.join(beads)}."
                raise InputError(f"{path}, [colours]: unknown bead `{name[:60]}`; {hint}")
            flat[name] = entry
    return flat


def _bead(where: str, entry: object) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected {{ h = ..., s = ..., b = ... }}, got {type(entry).__name__}.")
    for key in entry:
        if key not in _BEAD_KEYS:
            close = nearest(key, _BEAD_KEYS)
            hint = f"did you mean `{close}`?" if close else f"known are {', '.join(_BEAD_KEYS)}."
            raise InputError(f"{where}: unknown key `{key[:60]}`; {hint}")
    for key in ("h", "s", "b"):
        if key not in entry:
            raise InputError(f"{where}: `{key}` is missing. A colour is h, s, b in 0..1.")
    hsb = np.array([_number(f"{where} {key}", entry[key], 0.0, 1.0) for key in ("h", "s", "b")])
    n = entry.get("n", 0)
    if isinstance(n, bool) or not isinstance(n, int) or not 0 <= n <= 10**6:
        raise InputError(f"{where} n: expected a number of photographs, got {str(n)[:40]}.")
    sd = None if "sd" not in entry else _numbers(f"{where} sd", entry["sd"], 3, 0.0, 1.0)
    if "covariance" in entry:
        covariance = _covariance(where, entry["covariance"])
        expected = sd_of_covariance(hsb, covariance)
        if sd is not None and not np.allclose(sd, expected, rtol=1e-3, atol=1e-9):
            raise InputError(f"{where}: sd and covariance do not agree. Remove `covariance` if `sd` was edited.")
        return hsb, expected if sd is None else sd, covariance, n
    if sd is not None:
        return hsb, sd, covariance_of_sd(hsb, sd), n
    covariance = np.diag(VIEW_SD**2)
    return hsb, sd_of_covariance(hsb, covariance), covariance, n


def _covariance(where: str, value: object) -> np.ndarray:
    lower = _numbers(f"{where} covariance", value, 6, -1.0, 1.0)
    covariance = np.zeros((3, 3))
    covariance[_LOWER] = lower
    covariance = covariance + np.tril(covariance, -1).T
    if np.linalg.eigvalsh(covariance)[0] <= 1e-12:
        raise InputError(f"{where} covariance: not the lower triangle of a positive definite matrix.")
    return covariance


def _numbers(where: str, value: object, count: int, low: float, high: float) -> np.ndarray:
    if not isinstance(value, list) or len(value) != count:
        got = f"{len(value)}" if isinstance(value, list) else type(value).__name__
        raise InputError(f"{where}: expected a list of {count} numbers, got {got}.")
    return np.array([_number(where, number, low, high) for number in value])


def _number(where: str, value: object, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: expected a number, got {type(value).__name__}.")
    if not low <= value <= high:  # also refuses NaN
        hint = " Hue is in turns, not in degrees." if where.endswith(" h") else ""
        raise InputError(f"{where}: expected a number from {low:g} to {high:g}, got {str(value)[:40]}.{hint}")
    return float(value)


def _metadata(path: str | Path, metadata: object, warnings: list[str]) -> tuple[dict[str, str], dict[str, Any]]:
    if not isinstance(metadata, dict):
        raise InputError(f"{path}, metadata: expected a table [metadata], got {type(metadata).__name__}.")
    for key in metadata:
        close = None if key in _METADATA_KEYS else nearest(key, _METADATA_KEYS)
        if close:
            raise InputError(f"{path}, [metadata]: unknown key `{key}`; did you mean `{close}`?")
    foreign = [key[:60] for key in metadata if key not in _METADATA_KEYS]
    if foreign:
        warnings.append(f"{path}, [metadata]: keys of another program are left out: {', '.join(foreign[:8])}.")
    schema = metadata.get("schema", SCHEMA)
    if isinstance(schema, bool) or not isinstance(schema, int):
        raise InputError(f"{path}, [metadata] schema: expected a whole number, got {type(schema).__name__}.")
    if schema > SCHEMA:
        raise InputError(
            f"{path}, [metadata] schema: written by a newer jaxmocap (this one knows up to {SCHEMA}). Upgrade it."
        )
    inputs, settings = metadata.get("inputs", {}), metadata.get("settings", {})
    if not isinstance(inputs, dict) or not all(isinstance(value, str) for value in inputs.values()):
        raise InputError(f"{path}, [metadata] inputs: expected SHA-256 texts by file name.")
    if not isinstance(settings, dict):
        raise InputError(f"{path}, [metadata] settings: expected a table, got {type(settings).__name__}.")
    return inputs, settings
