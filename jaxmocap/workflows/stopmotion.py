"""Stop-motion capture, step by step: colours, a folder for a pose, its photographs, names, places, skeleton, files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._errors import InputError, SolveError
from jaxmocap.bodies.puppet import MARKERS, complete_lengths
from jaxmocap.io.bones_file import read_bones
from jaxmocap.io.colours_file import colours_text, read_colours
from jaxmocap.io.folder_lock import locked
from jaxmocap.io.json_file import json_bytes
from jaxmocap.io.length_units import unit_factor
from jaxmocap.io.points_table import points_text
from jaxmocap.io.puppet_folder import (
    CONTACT_SHEET,
    IDENTIFIED,
    POINTS,
    RECONSTRUCTION,
    PuppetFolder,
    add_photos,
    create_puppet_folder,
    open_puppet_folder,
    same_angle,
)
from jaxmocap.io.text_file import hash_files
from jaxmocap.reconstruction.skeleton import BONE_NAMES
from jaxmocap.tracking import BeadColours
from jaxmocap.vision import expand_photos
from jaxmocap.vision.photos import read_colour_photo
from jaxmocap.workflows.puppet_beads import (
    NamedBeads,
    Progress,
    colours_file,
    colours_or_document,
    find_in_photos,
    learn_from_tpose,
    name_beads,
    photo_problems,
)
from jaxmocap.workflows.puppet_pose import PuppetPose, reconstruct_pose
from jaxmocap.workflows.puppet_scene import PuppetScene, check_photo_size, load_scene
from jaxmocap.workflows.puppet_words import (
    beads_json,
    beads_summary,
    colours_json,
    colours_summary,
    pose_json,
    pose_summary,
    read_beads,
    record,
)
from jaxmocap.workflows.turntable import stated_angle


@dataclass(frozen=True)
class StepResult:
    """What a step has to say and to write."""

    summary: str
    content: Mapping[str, Any]
    """What `--json` writes."""
    files: Mapping[str | Path, bytes] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    value: Any = None
    """Colours, NamedBeads or PuppetPose, for further computing."""

    def json(self) -> bytes:
        """The machine-readable result."""
        return json_bytes(self.content)


def photos_by_angle(patterns: str | Path | Sequence[str | Path], angle: float | None = None) -> dict[float, Path]:
    """Photographs by stated angle in degrees, from names *_<angle>.jpg or for one photograph as given.

    Raises:
        InputError: no photograph, a name without an angle, two photographs at one angle.
    """
    listed = [patterns] if isinstance(patterns, str | Path) else list(patterns)
    paths = expand_photos(listed)
    if angle is not None:
        if len(paths) != 1:
            raise InputError(f"--angle: belongs to one photograph, {len(paths)} were given. Add them one by one.")
        if not abs(angle) <= 1e6:
            raise InputError(f"--angle: expected degrees, got {angle}.")
        return {float(angle): paths[0]}
    found: dict[float, Path] = {}
    for path in paths:
        at = stated_angle(path.name)
        twin = next((a for a in found if same_angle(a, at)), None)
        if twin is not None:
            raise InputError(f"{found[twin].name} and {path.name} both stand at {at:g} degrees. Rename or remove one.")
        found[at] = path
    return found


def learn_colours(
    tpose: str | Path | Sequence[str | Path],
    camera: str | Path,
    *,
    turntable: str | Path | None = None,
    output: str | Path = "colours.toml",
    command: str = "puppet colours",
    progress: Progress | None = None,
) -> StepResult:
    """Colours of the beads from a turn of the T-pose; beads are named from where they are.

    Args:
        tpose: photographs *_<angle>.jpg, or their folder.
        camera: rig file of the camera.
        turntable: turntable file; None: the document's build is the start.
        output: where the colours will be written.
        command: recorded in files.
        progress: called with photos done and their number.

    Returns:
        StepResult whose value is `tracking.BeadColours`.

    Raises:
        InputError: files are wrong.
        SolveError: the beads cannot be told apart.
    Source: stop-motion document, 3.2.
    """
    scene = load_scene(camera, turntable)
    photos = find_in_photos(photos_by_angle(tpose), scene, progress)
    found = learn_from_tpose(photos, scene)
    named = 0 if found.colours is None else len(found.colours.names)
    if named < len(MARKERS):
        missing = [m for m in MARKERS if found.colours is None or m not in found.colours.names]
        raise SolveError(
            f"{named} of {len(MARKERS)} beads were named; missing: {', '.join(missing)}. "
            + " ".join([*found.problems, *photos.notes])
        )
    file = colours_file(found, photos, command)
    notes = (*scene.notes, *photos.notes, *found.problems)
    return StepResult(
        colours_summary(found),
        {**record(command, scene.unit, notes), **colours_json(found)},
        {output: colours_text(file).encode()},
        tuple(notes),
        found.colours,
    )


def new_puppet(
    folder: str | Path,
    camera: str | Path,
    *,
    turntable: str | Path | None = None,
    distance: str | float | None = None,
    height: str | float | None = None,
    colours: str | Path | None = None,
    bones: str | Path | None = None,
) -> PuppetFolder:
    """Make a folder for a pose; every file is read first, so that a mistake shows now.

    Args:
        folder: new.
        camera: rig file of the camera.
        turntable: as `calibrate turntable` writes it; None: the document's build is the start.
        distance: of the camera from the axis, "400mm".
        height: of the camera above the origin, "80mm".
        colours: as `puppet colours` writes it; None: the document's table.
        bones: lengths of the bones; None: unknown.

    Returns:
        The folder.

    Raises:
        InputError: naming the file or option.
    """
    scene = load_scene(camera, turntable, distance, height)
    if turntable is not None and distance is not None:
        raise InputError("--distance: the turntable file states the distance. Give one of the two.")
    if colours is not None:
        read_colours(colours)
    if bones is not None:
        unit_factor(read_bones(bones).unit, scene.unit, "--bones")
    given = {"camera": camera, "turntable": turntable, "colours": colours, "bones": bones}
    inputs = {name: None if path is None else Path(path) for name, path in given.items()}
    far, high = float(scene.turntable.distance), float(scene.turntable.height)
    return create_puppet_folder(folder, inputs, unit=scene.unit, distance=far, height=high)


def add_to_puppet(
    folder: str | Path, photos: str | Path | Sequence[str | Path], angle: float | None = None
) -> tuple[PuppetFolder, list[str]]:
    """Put photographs into the folder of a pose; one at an angle that is there already replaces that one.

    Args:
        folder: of the pose.
        photos: files, folders or patterns, named *_<angle>.jpg unless `angle` is given.
        angle: of one photograph [degrees].

    Returns:
        The folder as it is then; sentences about photographs that were replaced (they are kept) and odd ones.

    Raises:
        InputError: a photograph is damaged, without colour or of another size; nothing is added then.
    """
    scene = _scene(open_puppet_folder(folder, repair=True))
    chosen = photos_by_angle(photos, angle)
    said = []
    for path in chosen.values():
        photo = read_colour_photo(path)
        check_photo_size(photo.name, photo.size, scene)
        said += photo.warnings
    with locked(folder):
        changed, replaced = add_photos(open_puppet_folder(folder, repair=True), chosen)
    return changed, replaced + said


def identify(folder: str | Path, *, command: str = "puppet identify", progress: Progress | None = None) -> StepResult:
    """Find the beads in all photographs of a pose and give them names.

    Returns:
        StepResult whose value is `NamedBeads`.

    Raises:
        InputError: the folder or a photograph is wrong.
        SolveError: no bead, or a turntable that did not turn or turned the other way.
    Source: stop-motion document, 3.3.
    """
    opened = open_puppet_folder(folder)
    _check_photos(opened)
    scene = _scene(opened)
    colours, said = colours_or_document(opened.input("colours"))
    photos = find_in_photos({a: opened.photo(n) for a, n in opened.photos.items()}, scene, progress)
    beads = name_beads(photos, scene, colours)
    notes = (*scene.notes, *said, *photos.notes, *beads.problems)
    content = {**record(command, scene.unit, notes), **beads_json(beads), "inputs": _hashes(opened)}
    content["photo_problems"] = photo_problems(beads, notes)
    return StepResult(
        beads_summary(beads), content, {opened.path / IDENTIFIED: json_bytes(content)}, tuple(notes), beads
    )


def reconstruct(
    folder: str | Path, *, command: str = "puppet reconstruct", progress: Progress | None = None
) -> StepResult:
    """Places of the beads, and the skeleton; photographs that changed are identified anew.

    Returns:
        StepResult whose value is `PuppetPose`.

    Raises:
        InputError: the folder or a photograph is wrong.
        SolveError: as `identify`, or fewer than two photographs show the same beads.
    Source: stop-motion document, sections 5 and 6.
    """
    opened = open_puppet_folder(folder)
    _check_photos(opened)
    scene = _scene(opened)
    files: dict[str | Path, bytes] = {}
    stored = _stored_beads(opened)
    if stored is None:
        step = identify(folder, command=command, progress=progress)
        files.update(step.files)
        stored = step.value, step.notes
    beads, notes = stored[0], list(stored[1])
    lengths, known, said = _lengths(opened, scene)
    pose = reconstruct_pose(beads, scene, lengths, known)
    notes += [*said, *pose.notes]
    content = {**record(command, scene.unit, notes), **pose_json(pose), "inputs": _hashes(opened)}
    files[opened.path / RECONSTRUCTION] = json_bytes(content)
    files[opened.path / POINTS] = pose_points(pose).encode()
    return StepResult(pose_summary(pose), content, files, tuple(notes), pose)


def pose_points(pose: PuppetPose) -> str:
    """The beads as a table (frame, marker, x, y, z, sigmas, views)."""
    rows = np.flatnonzero(pose.seen)
    names = [MARKERS[i] for i in rows]
    return points_text(np.zeros(len(rows), int), names, pose.points[rows], pose.sigma[rows], pose.views[rows])[0]


def contact_sheet(folder: str | Path, *, command: str = "puppet check", progress: Progress | None = None) -> StepResult:
    """One picture of all photographs with circled, named beads; a red frame marks those with a problem.

    Returns:
        StepResult; the picture is among its files.

    Raises:
        InputError: as `identify`.
        SolveError: as `identify`.
    Source: stop-motion document, 8.1 (the operator's check).
    """
    from jaxmocap.report.contact_sheet import Panel, contact_sheet_png

    step = identify(folder, command=command, progress=progress)
    opened = open_puppet_folder(folder)
    beads: NamedBeads = step.value
    panels = []
    for k, name in enumerate(beads.names):
        seen = np.flatnonzero(beads.visible[k])
        panels.append(
            Panel(
                title=f"{name}  {beads.stated_deg[k]:g}°",
                rgb=read_colour_photo(opened.photo(name)).rgb,
                names=tuple(MARKERS[i] for i in seen),
                uv=beads.uv[k, seen],
                radius=beads.radius[k, seen],
                rejected=beads.rejected[name],
                problems=tuple(step.content["photo_problems"][name]),
            )
        )
    red = [p.title.split("  ")[0] for p in panels if p.problems]
    said = f"{len(panels)} photographs, {len(red)} with a problem" + (f": {', '.join(red)}" if red else "")
    files = {opened.path / CONTACT_SHEET: contact_sheet_png(panels), **step.files}
    return StepResult(f"{said}\n{step.summary}", step.content, files, step.notes, beads)


def current_pose(folder: str | Path) -> tuple[PuppetPose, tuple[str, ...]]:
    """The pose as the folder's photographs give it now, and what is to be said of it.

    Raises:
        InputError: as `reconstruct`.
        SolveError: as `reconstruct`.
    """
    step = reconstruct(folder)
    return step.value, step.notes


def folder_colours(folder: str | Path) -> BeadColours:
    """Reference colours of a folder: of its colours file, or the document's."""
    return colours_or_document(open_puppet_folder(folder).input("colours"))[0]


def _scene(folder: PuppetFolder) -> PuppetScene:
    turntable = folder.input("turntable")
    unit = "" if folder.unit == "1" else folder.unit
    distance = None if turntable else f"{folder.distance!r}{unit}"
    camera = folder.input("camera")
    assert camera is not None  # checked when the folder was opened
    return load_scene(camera, turntable, distance, f"{folder.height!r}{unit}")


def _check_photos(folder: PuppetFolder) -> None:
    if not folder.photos:
        raise InputError(f"{folder.path}: holds no photograph yet. Add some with `jaxmocap puppet add`.")


def _hashes(folder: PuppetFolder) -> dict[str, str]:
    """SHA-256 of everything that the names of the beads depend on."""
    files = [folder.photo(name) for name in folder.photos.values()]
    files += [path for name in ("camera", "turntable", "colours") if (path := folder.input(name)) is not None]
    return hash_files(files)


def _stored_beads(folder: PuppetFolder) -> tuple[NamedBeads, tuple[str, ...]] | None:
    """What `identify` wrote and said, if it is of these files and whole."""
    stated = {name: angle for angle, name in folder.photos.items()}
    return read_beads(folder.path / IDENTIFIED, stated, _hashes(folder))


def _lengths(folder: PuppetFolder, scene: PuppetScene) -> tuple[np.ndarray, bool, list[str]]:
    path = folder.input("bones")
    if path is None:
        table = complete_lengths()
        factor = 1.0 if scene.unit == "1" else unit_factor("mm", scene.unit, "bones")
        said = ["No bone lengths were given: the skeleton has default ones (--bones)."]
    else:
        file = read_bones(path)
        table, said = complete_lengths(file.lengths), []
        factor = unit_factor(file.unit, scene.unit, "--bones")
    return np.array([table[name] for name in BONE_NAMES]) * factor, path is not None, said
