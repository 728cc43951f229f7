"""Points in space, one row each: `frame,marker,x,y,z,sigma_x,sigma_y,sigma_z,views`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.io.atomic import write_text
from jaxmocap.io.csv_text import read_table
from jaxmocap.io.tables import table_text

_SIGMAS = ("sigma_x", "sigma_y", "sigma_z")


@dataclass(frozen=True)
class Points:
    """Reconstructed markers, one row each."""

    frame: np.ndarray
    """(rows,) frame number, from 0."""
    marker: np.ndarray
    """(rows,) number of the marker, 0.. in order of first appearance."""
    marker_labels: tuple[str, ...]
    """Names of marker 0, 1, ..."""
    xyz: np.ndarray
    """(rows, 3) world [length unit of the rig]."""
    sigma: np.ndarray
    """(rows, 3) standard deviation of x, y, z; NaN where the file gives none."""
    views: np.ndarray | None
    """(rows,) cameras or photographs used; None where the file has no such column."""
    warnings: tuple[str, ...] = ()
    """What was odd when it was read."""

    def by_frame(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The rows as an array of frames.

        Returns:
            frame numbers (frames,), increasing; positions (frames, markers, 3) and sigmas (frames, markers, 3), NaN
            where a marker was not seen.
        """
        numbers, at = np.unique(self.frame, return_inverse=True)
        xyz = np.full((len(numbers), len(self.marker_labels), 3), np.nan)
        sigma = xyz.copy()
        xyz[at, self.marker] = self.xyz
        sigma[at, self.marker] = self.sigma
        return numbers, xyz, sigma


def read_points(path: str | Path) -> Points:
    """Read a table of points, columns in any order; other columns are named and left out.

    Args:
        path: CSV file: commas, a header, UTF-8. The sigmas and `views` may be absent, a sigma may be blank.

    Returns:
        The rows in the order of the file, at least one.

    Raises:
        InputError: naming line and column of what is wrong; if a marker stands twice in one frame.
    """
    table = read_table(path, required=("frame", "marker", "x", "y", "z"), optional=(*_SIGMAS, "views"))
    frame, labels = table.counts("frame"), table.labels("marker")
    order = {label: number for number, label in enumerate(dict.fromkeys(labels))}
    marker = np.array([order[label] for label in labels], dtype=np.int64)
    _, first, times = np.unique(np.stack([frame, marker]), axis=1, return_index=True, return_counts=True)
    if (times > 1).any():
        row = int(first[np.argmax(times > 1)])
        raise InputError(f"{path}: marker {labels[row]!r} stands twice in frame {frame[row]}. Keep one of the rows.")
    sigma = np.full((len(frame), 3), np.nan)
    for axis, column in enumerate(_SIGMAS):
        if table.has(column):
            sigma[:, axis] = table.numbers_or_blank(column)[:, 0]
            table.refuse(column, sigma[:, axis] < 0, "expected a standard deviation from 0")
    views = table.counts("views") if table.has("views") else None
    return Points(frame, marker, tuple(order), table.numbers("x", "y", "z"), sigma, views, table.warnings)


def write_points(
    path: str | Path,
    frame: np.ndarray,
    marker: Sequence[str],
    xyz: np.ndarray,
    sigma: np.ndarray | None = None,
    views: np.ndarray | None = None,
) -> str:
    """Write a table of points, whole or not at all.

    Args:
        path: the file.
        frame: (rows,) frame number from 0.
        marker: (rows,) names.
        xyz: (rows, 3) world; a row that is not finite was not seen and is left out.
        sigma: (rows, 3); blank in the file where not finite, or where None.
        views: (rows,) cameras or photographs used; None leaves the column out.

    Returns:
        One sentence on what was written.

    Raises:
        InputError: if the arguments differ in length, or the file cannot be written.
    """
    text, said = points_text(frame, marker, xyz, sigma, views)
    write_text(path, text)
    return f"{path}: {said}"


def points_text(
    frame: np.ndarray,
    marker: Sequence[str],
    xyz: np.ndarray,
    sigma: np.ndarray | None = None,
    views: np.ndarray | None = None,
) -> tuple[str, str]:
    """The text that `write_points` writes, and its sentence without the file name.

    Raises:
        InputError: if the arguments differ in length.
    """
    frame, xyz = np.asarray(frame), np.asarray(xyz, dtype=float)
    rows = len(frame)
    sigma = np.full((rows, 3), np.nan) if sigma is None else np.asarray(sigma, dtype=float)
    if len(marker) != rows or xyz.shape != (rows, 3) or sigma.shape != (rows, 3):
        raise InputError(
            f"points: expected {rows} rows as in frame, got marker {len(marker)}, xyz {xyz.shape}, sigma {sigma.shape}."
        )
    kept = np.flatnonzero(np.isfinite(xyz).all(axis=1)).tolist()
    columns = {"frame": frame[kept], "marker": [marker[row] for row in kept]}
    columns |= dict(zip("xyz", xyz[kept].T)) | dict(zip(_SIGMAS, sigma[kept].T))
    columns |= {} if views is None else {"views": np.asarray(views)[kept]}
    lost = f", {rows - len(kept)} not seen and left out" if len(kept) < rows else ""
    names = len({marker[row] for row in kept})
    said = f"{len(kept)} points, {names} markers in {len(np.unique(frame[kept]))} frames{lost}."
    return table_text(columns), said
