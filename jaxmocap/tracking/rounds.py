"""From a rough start to tight tracks: find tracks with a wide gate, let the cameras be improved, tighten, repeat."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.cameras.camera import Camera
from jaxmocap.tracking.candidates import CandidateTable
from jaxmocap.tracking.tracks import Tracks, find_tracks
from jaxmocap.tracking.views import PhotoViews, look

Refine = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[Camera, np.ndarray, float]]
"""refine(uv (photos, markers, 2) [px], visible (photos, markers), sigma (photos, markers) [px]) -> new cameras
(stacked over the photos), points (markers, 3), gate [px] that the next round should use. The markers are nameless and
in no order; a marker that is nowhere visible is an empty column. It should be robust: some tracks may be wrong."""

GATE = 25.0
"""Default of the first gate [px]: a camera turned by 1 degree shifts a picture by f tan 1 deg = 15 px at
f = 859 px (the document's webcam), a tilted axis and uneven steps add a few each."""

_MAX_ROUNDS = 5
_COLUMNS = 16  # tracks handed to `refine`, always as many, so that it is compiled once
_MIN_GATE_SIGMA = 4.0  # a gate under this many sigma of a candidate would throw away good ones


@dataclass(frozen=True)
class Rounds:
    """What the rounds ended with."""

    tracks: Tracks
    views: PhotoViews
    cameras: Camera
    gate: float


def tighten(table: CandidateTable, cameras: Camera, gate: float, refine: Refine | None) -> Rounds:
    """Tracks, with the cameras improved and the gate tightened as far as they let it.

    Args:
        table: the candidates.
        cameras: stacked over the photographs; start values where `refine` is given.
        gate: first gate [px].
        refine: improves the cameras from tracks; None: the cameras are taken as they are.

    Returns:
        Tracks, views and cameras of the last round, and its gate.

    Raises:
        InputError: if the gate is not positive.
    Source: the procedure is ours; what it makes up for: stop-motion document, 4.2 (the build is taken as exact).
    """
    if not gate > 0:
        raise InputError(f"gate: expected a positive number of pixels, got {gate}.")
    views = look(cameras, table)
    tracks = find_tracks(table, views, gate)
    for _ in range(_MAX_ROUNDS if refine is not None else 0):
        chosen = tracks.take(_strong(tracks))
        if len(chosen.index) < 2:
            break
        cameras, _, wanted = refine(*_columns(table, chosen))  # pyright: ignore[reportOptionalCall]
        floor = _MIN_GATE_SIGMA * float(np.median(table.sigma[table.filled]))
        next_gate = min(gate, max(float(wanted), floor))
        settled = next_gate > 0.7 * gate
        gate = next_gate
        views = look(cameras, table)
        tracks = find_tracks(table, views, gate)
        if settled:
            break
    return Rounds(tracks, views, cameras, gate)


def _strong(tracks: Tracks) -> np.ndarray:
    """Tracks that chance would not make, the best supported first."""
    return np.flatnonzero(tracks.support > 0)[:_COLUMNS]


def _columns(table: CandidateTable, tracks: Tracks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    photos, count = len(table.uv), len(tracks.index)
    uv, visible, sigma = (
        np.zeros((photos, _COLUMNS, 2)),
        np.zeros((photos, _COLUMNS), bool),
        np.ones((photos, _COLUMNS)),
    )
    k = np.arange(photos)[:, None]
    slot = np.maximum(tracks.index.T, 0)
    uv[:, :count], sigma[:, :count], visible[:, :count] = table.uv[k, slot], table.sigma[k, slot], tracks.index.T >= 0
    return uv, visible, sigma
