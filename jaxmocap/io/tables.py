"""Tidy CSV tables: pixels in, results out."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.io.atomic import write_text
from jaxmocap.io.csv_text import Table, read_table

Column = Sequence[Any] | np.ndarray | jax.Array
"""One value per row."""


@dataclass(frozen=True)
class Correspondences:
    """Known points and the pixels at which they were seen, one row each."""

    view: np.ndarray
    """(rows,) number of the view, 0.. in order of first appearance."""
    view_labels: tuple[str, ...]
    """What the file calls view 0, 1, ..."""
    xyz: np.ndarray
    """(rows, 3) known point [length unit of the target]."""
    uv: np.ndarray
    """(rows, 2) raw pixel [px], (0, 0) at the centre of the top-left one."""
    sigma: np.ndarray | None
    """(rows,) standard deviation of u and of v [px]; None where the file has none."""
    camera: np.ndarray | None
    """(rows,) number of the camera, 0.. in order of first appearance; None where the file has none."""
    camera_labels: tuple[str, ...]
    """What the file calls camera 0, 1, ...; empty where it has none."""
    warnings: tuple[str, ...]
    """What was odd when it was read."""


@dataclass(frozen=True)
class Observations:
    """Markers or blobs seen by cameras, one row each."""

    frame: np.ndarray
    """(rows,) frame number, from 0, in the order of the file."""
    camera: np.ndarray
    """(rows,) number of the camera, 0.. in order of first appearance."""
    camera_labels: tuple[str, ...]
    """Names of camera 0, 1, ..."""
    marker: np.ndarray
    """(rows,) number of the marker, 0.. in order of first appearance; -1 for an anonymous blob."""
    marker_labels: tuple[str, ...]
    """Names of marker 0, 1, ..."""
    uv: np.ndarray
    """(rows, 2) raw pixel [px]."""
    sigma: np.ndarray | None
    """(rows,) standard deviation of u and of v [px]; None where the file has none."""
    warnings: tuple[str, ...]
    """What was odd when it was read."""


def read_correspondences(path: str | Path) -> Correspondences:
    """Read ``view,x,y,z,u,v[,sigma][,camera]``, columns in any order; other columns are named and left out.

    Args:
        path: CSV file: commas, a header, UTF-8.

    Returns:
        The rows in the order of the file, at least one.

    Raises:
        InputError: naming line and column of what is wrong.
    """
    table = read_table(path, required=("view", "x", "y", "z", "u", "v"), optional=("sigma", "camera"))
    view, view_labels = _numbered(table.labels("view"))
    camera, camera_labels = _numbered(table.labels("camera")) if table.has("camera") else (None, ())
    return Correspondences(
        view=view,
        view_labels=view_labels,
        xyz=table.numbers("x", "y", "z"),
        uv=table.numbers("u", "v"),
        sigma=_sigma(table),
        camera=camera,
        camera_labels=camera_labels,
        warnings=table.warnings,
    )


def read_observations(path: str | Path) -> Observations:
    """Read ``frame,camera,marker,u,v[,sigma]``, columns in any order; other columns are named and left out.

    Args:
        path: CSV file: commas, a header, UTF-8.

    Returns:
        The rows in the order of the file, at least one.

    Raises:
        InputError: naming line and column of what is wrong.
    """
    table = read_table(path, required=("frame", "camera", "marker", "u", "v"), optional=("sigma",))
    camera, camera_labels = _numbered(table.labels("camera"))
    marker, marker_labels = _numbered(table.labels("marker", may_be_blank=True))
    return Observations(
        frame=table.counts("frame"),
        camera=camera,
        camera_labels=camera_labels,
        marker=marker,
        marker_labels=marker_labels,
        uv=table.numbers("u", "v"),
        sigma=_sigma(table),
        warnings=table.warnings,
    )


def write_table(path: str | Path, columns: Mapping[str, Column]) -> None:
    """Write a CSV table, whole or not at all.

    Args:
        path: the file.
        columns: values by column name, all of one length. Floats are written so that they read back exactly;
            NaN, infinity and None leave the cell blank; true and false become 1 and 0.

    Raises:
        InputError: if columns differ in length or hold several values per row, or the file cannot be written.
    """
    write_text(path, table_text(columns))


def table_text(columns: Mapping[str, Column]) -> str:
    """The text that `write_table` writes.

    Raises:
        InputError: if columns differ in length or hold more than one value per row.
    """
    if not columns:
        raise InputError("columns: expected at least one, got none.")
    lists = {name: _column(name, values) for name, values in columns.items()}
    lengths = {name: len(values) for name, values in lists.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"columns: expected one length, got {lengths}.")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(lists)
    writer.writerows(zip(*lists.values()))
    return text.getvalue()


def _column(name: str, values: Column) -> list[str]:
    array = np.asarray(values) if hasattr(values, "__array__") else None
    if array is not None and array.ndim != 1:
        raise InputError(f"column {name!r}: expected one value per row, got shape {array.shape}.")
    return [_cell(name, value) for value in (values if array is None else array.tolist())]


def _cell(name: str, value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    if isinstance(value, int | np.integer):
        return str(int(value))
    if hasattr(value, "__float__"):
        number = float(value)  # type: ignore[arg-type]
        return repr(number) if math.isfinite(number) else ""
    raise InputError(
        f"column {name!r}: {type(value).__name__} has no place in a table. Convert it to a number or text."
    )


def _numbered(labels: list[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Labels as numbers in order of first appearance; the empty label is -1."""
    order = {label: i for i, label in enumerate(dict.fromkeys(label for label in labels if label))}
    return np.array([order.get(label, -1) for label in labels], dtype=np.int64), tuple(order)


def _sigma(table: Table) -> np.ndarray | None:
    if not table.has("sigma"):
        return None
    sigma = table.numbers("sigma")[:, 0]
    table.refuse("sigma", sigma <= 0, "expected a positive standard deviation in pixels")
    return sigma
