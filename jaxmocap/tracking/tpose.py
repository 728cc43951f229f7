"""Colours of the beads from a turn of photographs of the figure in its T-pose."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxmocap.bodies.puppet import MARKERS
from jaxmocap.cameras.camera import Camera
from jaxmocap.tracking.bead_colours import BeadColours, learn_colours
from jaxmocap.tracking.candidates import stack_candidates
from jaxmocap.tracking.layout import Layout, facing, name_tpose
from jaxmocap.tracking.naming import look_alike
from jaxmocap.tracking.rounds import GATE, Refine, tighten
from jaxmocap.tracking.tracks import Tracks, without_doubles


@dataclass(frozen=True)
class TPoseColours:
    """What a T-pose turn teaches."""

    colours: BeadColours | None
    """Of the beads that were named, in the order of `MARKERS`; None if there are none."""
    index: Int[np.ndarray, "photos markers"]
    """Candidate of each of `MARKERS` in each photograph, -1 where none."""
    p_world: Float[np.ndarray, "markers 3"]
    """Points [scene]; zero where the bead is missing."""
    cameras: Camera
    """As improved on the way."""
    gate: float
    """Gate of the last round [px]."""
    turned: float
    """Angle of the figure's front from the world's z about y [rad]."""
    problems: tuple[str, ...]
    """What is missing or wrong and what to do, in sentences."""

    @property
    def complete(self) -> bool:
        """True if all beads have a colour."""
        return self.colours is not None and len(self.colours.names) == len(MARKERS)


def colours_from_tpose(
    photos: Sequence[Any], cameras: Camera, *, gate: float = GATE, refine: Refine | None = None
) -> TPoseColours:
    """Reference colour of every bead from a turn of photographs of the T-pose, without any table of colours.

    Candidates that are alike in colour and meet in one point become tracks; the points get their names from the
    layout of the pose; the colours of a track are the samples of its bead.

    Args:
        photos: candidates of every photograph, see `candidates.stack_candidates`.
        cameras: stacked over the photographs; y of their world up, z to the front of the figure.
        gate: first gate [px], see `rounds.tighten`.
        refine: improves the cameras between rounds; None takes them as they are.

    Returns:
        Mean, standard deviations, covariance and number of views by bead; beads that look alike, beads that are
        missing and a pose that is no T-pose are named in `problems`.

    Raises:
        InputError: if an argument is wrong.
    Source: stop-motion document, 3.2; the naming by layout is ours.
    """
    table = stack_candidates(photos)
    rounds = tighten(table, cameras, gate, refine)
    tracks = without_doubles(rounds.tracks, table, rounds.views)
    tracks, layout = _laid_out(tracks.take(np.flatnonzero(tracks.support > 0)), rounds.views.centre_world)
    found = np.flatnonzero(layout.point >= 0)
    index, p_world = np.full((len(photos), len(MARKERS)), -1), np.zeros((len(MARKERS), 3))
    index[:, found] = tracks.index[layout.point[found]].T
    p_world[found] = tracks.p_world[layout.point[found]]
    samples = [table.hsb[np.flatnonzero(row >= 0), row[row >= 0]] for row in index.T[found]]
    colours = learn_colours([MARKERS[m] for m in found], samples) if len(found) else None
    alike = () if colours is None else look_alike(colours)
    return TPoseColours(colours, index, p_world, rounds.cameras, rounds.gate, layout.turned, (*layout.problems, *alike))


def _laid_out(tracks: Tracks, centre_world: Float[np.ndarray, "photos 3"]) -> tuple[Tracks, Layout]:
    """Tracks and their names; where there are more than beads, the worst supported are left out until names fit."""
    best: tuple[Tracks, Layout] | None = None
    for count in range(len(tracks.index), 0, -1):
        kept = tracks.take(np.sort(np.argsort(-tracks.support, kind="stable")[:count]))
        front, ahead = facing(kept.p_world, centre_world, kept.index >= 0)
        kept = kept.take(np.flatnonzero(ahead))
        layout = name_tpose(kept.p_world, front, kept.views)
        if best is None or (layout.point >= 0).sum() > (best[1].point >= 0).sum():
            best = kept, layout
        if layout.complete or count <= len(MARKERS):
            break
    return best or (tracks, name_tpose(tracks.p_world))
