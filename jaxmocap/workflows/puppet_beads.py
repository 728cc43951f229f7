"""From photographs of a puppet to named beads: find, name, check the turn. No formula."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap._arrays import require_x64
from jaxmocap._errors import SolveError
from jaxmocap.bodies.puppet import DOCUMENT_COLOURS, MARKERS
from jaxmocap.io.colours_file import ColoursFile, read_colours
from jaxmocap.tracking import BeadColours, Identification, identify_beads
from jaxmocap.tracking.tpose import TPoseColours, colours_from_tpose
from jaxmocap.vision import BeadCandidates, find_beads
from jaxmocap.vision.photos import read_colour_photo
from jaxmocap.workflows.puppet_scene import Angles, PuppetScene, cameras_at, check_photo_size, refiner

Progress = Callable[[int, int], None]
# A bead that stands still while the table turns by a step stays within the error of its centre; one 5 mm off the axis
# moves by 5 px per 30 degrees in the document's build. Three sigma of a coarse centre are well between.
_STILL_PX = 1.0
_STILL_SHARE = 0.8
_BEAD_PX = 1.0  # three sigma of a coarse centre, too: a residual beyond it is no error of centres
_CLEAR_ARC = 0.75  # of the outline: a bead that is seen as a whole but for what touches it


@dataclass(frozen=True)
class BeadPhotos:
    """The photographs of one take and what was found in them."""

    names: tuple[str, ...]
    stated_deg: np.ndarray
    candidates: tuple[BeadCandidates, ...]
    inputs: Mapping[str, str]
    """SHA-256 by file name."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class NamedBeads:
    """Where every bead was seen; arrays in the order of the photographs and of `puppet.MARKERS`."""

    names: tuple[str, ...]
    stated_deg: np.ndarray
    uv: np.ndarray
    """(photos, markers, 2) [px]; zero where not visible."""
    visible: np.ndarray
    sigma: np.ndarray
    """(photos, markers) [px]; 1 where not visible."""
    radius: np.ndarray
    """(photos, markers) [px]; zero where not visible."""
    rejected: Mapping[str, np.ndarray]
    """Candidates that bear no name, (n, 2) [px] by photograph."""
    unsure: Mapping[str, int]
    """How many of these are as bright as a bead."""
    problems: tuple[str, ...]
    inputs: Mapping[str, str]


def find_in_photos(photos: Mapping[float, Path], scene: PuppetScene, progress: Progress | None = None) -> BeadPhotos:
    """Read photographs and find beads in them.

    Args:
        photos: file by stated angle in degrees.
        scene: whose camera took them.
        progress: called with photos done and their number.

    Returns:
        BeadPhotos, ascending in angle.

    Raises:
        InputError: a file that is gone, damaged, without colour or of another size.
        SolveError: no bead in any photograph.
    """
    names, found, inputs, notes = [], [], {}, []
    listed = sorted(photos.items())
    for done, (_, path) in enumerate(listed, start=1):
        photo = read_colour_photo(path)
        check_photo_size(photo.name, photo.size, scene)
        candidates = find_beads(photo.rgb)
        names.append(photo.name)
        found.append(candidates)
        inputs[photo.name] = photo.sha256
        notes += photo.warnings
        if not len(candidates.uv):
            notes.append(f"{photo.name}: no bead was found. Is the puppet in the picture, and lit?")
        if progress:
            progress(done, len(listed))
    if not any(len(c.uv) for c in found):
        raise SolveError(
            "No bead was found in any photograph. Check that the puppet is in the picture, the beads are lit and the "
            "background is dark."
        )
    return BeadPhotos(tuple(names), np.array([a for a, _ in listed], float), tuple(found), inputs, tuple(notes))


def colours_or_document(path: Path | None) -> tuple[BeadColours, list[str]]:
    """Reference colours of a file, or the document's table; and what is to be said of them."""
    if path is None:
        return BeadColours.of(DOCUMENT_COLOURS), [
            "No colours file was given: the beads are taken to have the colours of the document's table. Learn them "
            "with `jaxmocap puppet colours`."
        ]
    content = read_colours(path)
    return content.colours, list(content.warnings)


def name_beads(photos: BeadPhotos, scene: PuppetScene, colours: BeadColours, mode: str = "best") -> NamedBeads:
    """Give the candidates names.

    Args:
        photos: what was found.
        scene: camera and turntable.
        colours: references.
        mode: see `tracking.identify_beads`.

    Returns:
        NamedBeads.

    Raises:
        SolveError: the turntable did not turn between the photographs, or turned the other way.
    Source: stop-motion document, 3.3.
    """
    require_x64("Identification")
    _refuse_still(photos)
    result = _identify(photos, scene, colours, mode, photos.stated_deg)
    if mode == "best" and len(photos.names) > 2:

        def mirrored() -> _Fit:
            return _fit_of_names(_identify(photos, scene, colours, mode, -photos.stated_deg))

        _refuse_backwards(_fit_of_names(result), mirrored)
    return _named(photos, colours, result)


def learn_from_tpose(photos: BeadPhotos, scene: PuppetScene) -> TPoseColours:
    """Colours of the beads from a turn of the T-pose.

    Raises:
        SolveError: the turntable did not turn or turned the other way, or fewer than three photographs.
    Source: stop-motion document, 3.2.
    """
    require_x64("Learning colours")
    if len(photos.names) < 3:
        raise SolveError(
            f"{len(photos.names)} photographs of the T-pose: three or more are needed to name the beads by where they "
            "are. Take one every 30 degrees."
        )
    _refuse_still(photos)
    found = _tpose(photos, scene, photos.stated_deg)
    _refuse_backwards(_fit_of_tpose(found), lambda: _fit_of_tpose(_tpose(photos, scene, -photos.stated_deg)))
    return found


def colours_file(found: TPoseColours, photos: BeadPhotos, command: str) -> ColoursFile:
    """What `puppet colours` writes."""
    assert found.colours is not None
    return ColoursFile(found.colours, inputs=photos.inputs, settings={"command": command})


class _Fit(NamedTuple):
    """How well photographs agree with their angles."""

    beads: int
    """Named in two photographs or more."""
    gate: float
    """Three standard deviations of what is left between beads and pixels [px]."""


def _fit_of_names(result: Identification) -> _Fit:
    return _Fit(int(((result.index >= 0).sum(axis=0) >= 2).sum()), float(result.gate))


def _fit_of_tpose(found: TPoseColours) -> _Fit:
    return _Fit(int(((found.index >= 0).sum(axis=0) >= 2).sum()), float(found.gate))


def _refuse_backwards(stated: _Fit, mirrored: Callable[[], _Fit]) -> None:
    """Refuse angles that fit better with the other sign.

    A figure seen from afar looks the same when its depth is reversed and it turns the other way: beads do get names
    then, some of them wrong ones. What perspective changes, some pixels, remains as residual.
    """
    if stated.beads >= 0.75 * len(MARKERS) and stated.gate < _BEAD_PX:
        return
    other = mirrored()
    # Half as many again: chance makes one or two beads meet, not half of the puppet.
    more = other.beads > 1.5 * max(stated.beads, 2)
    sharper = other.beads >= max(stated.beads, len(MARKERS) // 2) and other.gate < 0.5 * stated.gate
    if more or sharper:
        raise SolveError(
            f"The turntable turned the other way: with the angles taken as negative, {other.beads} beads fit together "
            f"within {other.gate:.1f} px; as stated, {stated.beads} within {stated.gate:.1f} px. Angles count "
            "anticlockwise seen from above, so that the puppet's front moves to the right of the picture: rename the "
            "photos to 360 minus their angle."
        )


def _tpose(photos: BeadPhotos, scene: PuppetScene, stated_deg: np.ndarray) -> TPoseColours:
    angles = Angles.of(stated_deg)
    cameras = cameras_at(scene, scene.turntable, angles.stated)
    return colours_from_tpose(photos.candidates, cameras, refine=refiner(scene, angles))


def _identify(
    photos: BeadPhotos, scene: PuppetScene, colours: BeadColours, mode: str, stated_deg: np.ndarray
) -> Identification:
    angles = Angles.of(stated_deg)
    cameras = cameras_at(scene, scene.turntable, angles.stated)
    refine = refiner(scene, angles) if mode == "best" and len(photos.names) > 1 else None
    return identify_beads(photos.candidates, cameras, colours, mode=mode, refine=refine)


def _named(photos: BeadPhotos, colours: BeadColours, result: Identification) -> NamedBeads:
    n, m = len(photos.names), len(MARKERS)
    uv, visible = np.zeros((n, m, 2)), np.zeros((n, m), bool)
    sigma, radius = np.ones((n, m)), np.zeros((n, m))
    for column, name in enumerate(result.names):
        row = MARKERS.index(name)
        for k, slot in enumerate(result.index[:, column]):
            if slot >= 0:
                seen = photos.candidates[k]
                uv[k, row], visible[k, row] = seen.uv[slot], True
                sigma[k, row], radius[k, row] = seen.sigma[slot], seen.radius[slot]
    rejected = {name: c.uv[f] for name, c, f in zip(photos.names, photos.candidates, result.foreign)}
    # Half as bright as the dimmest bead, and most of a circle: no reflection, and no bead that mostly hides.
    bright = 0.5 * float(colours.hsb[:, 2].min())
    unsure = {
        name: int(((c.hsb[f, 2] > bright) & (c.arc[f] > _CLEAR_ARC)).sum())
        for name, c, f in zip(photos.names, photos.candidates, result.foreign)
    }
    return NamedBeads(
        photos.names, photos.stated_deg, uv, visible, sigma, radius, rejected, unsure, result.problems, photos.inputs
    )


def _refuse_still(photos: BeadPhotos) -> None:
    """Refuse photographs between which nothing moved although their angles differ."""
    still = [
        (photos.names[k], photos.names[k + 1])
        for k in range(len(photos.names) - 1)
        if _same_picture(photos.candidates[k], photos.candidates[k + 1])
    ]
    if not still:
        return
    if len(still) == len(photos.names) - 1:
        raise SolveError(
            "The turntable did not turn: the beads stand at the same places in all photographs. Turn it by its step "
            "before each photograph."
        )
    pairs = "; ".join(f"{a} and {b}" for a, b in still)
    raise SolveError(
        f"The turntable did not turn between {pairs}: the beads stand at the same places. Take one of each pair again "
        "(`jaxmocap puppet add`), or remove it."
    )


def _same_picture(a: BeadCandidates, b: BeadCandidates) -> bool:
    if min(len(a.uv), len(b.uv)) < 4:
        return False
    apart = np.linalg.norm(a.uv[:, None] - b.uv[None], axis=2).min(axis=1)
    return bool(np.mean(apart < _STILL_PX) > _STILL_SHARE)


def photo_problems(beads: NamedBeads, notes: Sequence[str]) -> dict[str, list[str]]:
    """Sentences by photograph: what makes its frame red."""
    out: dict[str, list[str]] = {name: [] for name in beads.names}
    for k, name in enumerate(beads.names):
        out[name] += [text for text in notes if text.startswith(f"{name}:")]
        if not beads.visible[k].any():
            out[name].append("No bead was named.")
        if beads.unsure[name]:
            said = "spot looks like a bead and bears" if beads.unsure[name] == 1 else "spots look like beads and bear"
            out[name].append(f"{beads.unsure[name]} {said} no name.")
    return out
