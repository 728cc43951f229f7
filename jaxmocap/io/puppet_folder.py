"""The folder of one pose of a puppet: photographs by turntable angle, and what belongs to them.

    puppet.toml      unit, distance, height, and the photographs: [photos] "30" = "wave_030.jpg"
    camera.toml      and turntable.toml, colours.toml, bones.toml: copies of the files it was made with
    photos/          the photographs, called as they were
    replaced/        photographs that were taken again
    identified.json, reconstruction.json, points.csv, contact_sheet.png: results

`puppet.toml` is the one place that says what counts. It is written last and whole, so that a folder is consistent
after an interruption at any moment: a photograph that it does not name is not there.
"""

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tomli_w

from jaxmocap._errors import InputError
from jaxmocap.io.atomic import write_bytes, write_many, write_text
from jaxmocap.io.folder_lock import LOCK
from jaxmocap.io.length_units import METRES
from jaxmocap.io.text_file import nearest, read_text, short

SCHEMA = 1
INDEX = "puppet.toml"
INPUTS = ("camera", "turntable", "colours", "bones")
IDENTIFIED, RECONSTRUCTION, POINTS, CONTACT_SHEET = (
    "identified.json", "reconstruction.json", "points.csv", "contact_sheet.png",
)  # fmt: skip
_PHOTOS, _REPLACED = "photos", "replaced"
_KEYS = ("schema", "unit", "distance", "height", "inputs", "photos")
_OWN = {INDEX, IDENTIFIED, RECONSTRUCTION, POINTS, CONTACT_SHEET, _PHOTOS, _REPLACED, LOCK}
_OWN |= {f"{name}.toml" for name in INPUTS}
_MAX_BYTES = 1 << 20
_CLOSE_DEG = 1e-6


@dataclass(frozen=True)
class PuppetFolder:
    """What `puppet.toml` says."""

    path: Path
    unit: str
    distance: float
    """Camera centre to axis where no turntable file says better, in `unit`."""
    height: float
    """Origin below the point of the axis nearest the camera centre, in `unit`."""
    photos: Mapping[float, str] = field(default_factory=dict)
    """File name in photos/ by stated angle in degrees, ascending."""
    inputs: tuple[str, ...] = ("camera",)
    """Which of `INPUTS` it was made with."""

    def photo(self, name: str) -> Path:
        """Where a photograph lies."""
        return self.path / _PHOTOS / name

    def input(self, name: str) -> Path | None:
        """The copy of "camera", "turntable", "colours" or "bones"; None if it was made without."""
        path = self.path / f"{name}.toml"
        return path if path.exists() else None


def create_puppet_folder(
    path: str | Path, inputs: Mapping[str, Path | None], *, unit: str, distance: float, height: float
) -> PuppetFolder:
    """Make a folder for one pose.

    Args:
        path: new folder, or an empty one; parents are made.
        inputs: "camera" and, as given, "turntable", "colours", "bones": files that are copied.
        unit: of lengths.
        distance: of the camera centre from the axis.
        height: of that point of the axis above the origin.

    Returns:
        The folder.

    Raises:
        InputError: the folder exists with something in it, or cannot be written.
    """
    path = Path(path)
    if (path / INDEX).exists():
        raise InputError(f"{path}: is a puppet's folder already. Give another name, or add photographs to this one.")
    try:
        foreign = sorted(p.name for p in path.iterdir() if not _ours(p.name)) if path.exists() else []
        if foreign:
            raise InputError(f"{path}: holds other files ({', '.join(foreign[:3])}). Give a new or empty folder.")
        (path / _PHOTOS).mkdir(parents=True, exist_ok=True)
        copies = {path / f"{name}.toml": file.read_bytes() for name, file in inputs.items() if file is not None}
    except OSError as error:
        raise InputError(f"{path}: cannot be made or read: {error.strerror or error}. Choose another place.") from None
    for name in INPUTS:  # left over from an interrupted start with other options
        if path / f"{name}.toml" not in copies:
            (path / f"{name}.toml").unlink(missing_ok=True)
    write_many(copies)
    given = tuple(name for name in INPUTS if path / f"{name}.toml" in copies)
    folder = PuppetFolder(path, unit, float(distance), float(height), inputs=given)
    _write_index(folder)
    return folder


def read_index(path: str | Path) -> PuppetFolder:
    """What a `puppet.toml` says, whether or not its files are there.

    Raises:
        InputError: naming file and key.
    """
    index = Path(path)
    try:
        table = tomllib.loads(read_text(index, _MAX_BYTES))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{index}: not valid TOML: {str(error)[:300]}. Restore it, or make the folder anew.") from None
    return _checked(index.parent, index, table)


def inputs_of(path: str | Path) -> list[Path]:
    """Files of a folder that no result may replace: its index, copies of what it was made with, photographs."""
    path = Path(path)
    own = [path / INDEX, *(path / f"{name}.toml" for name in INPUTS)]
    return own + [file for folder in (_PHOTOS, _REPLACED) for file in (path / folder).glob("*")]


def open_puppet_folder(path: str | Path, *, repair: bool = False) -> PuppetFolder:
    """Read what a folder holds.

    Args:
        path: of the folder.
        repair: photographs may be gone, since they are to be taken again.

    Returns:
        What `puppet.toml` says.

    Raises:
        InputError: no puppet's folder, a damaged `puppet.toml`, or files that are gone (each named).
    """
    path = Path(path)
    if not (path / INDEX).is_file():
        raise InputError(f"{path}: is no puppet's folder (it has no {INDEX}). Make one with `jaxmocap puppet new`.")
    folder = read_index(path / INDEX)
    gone = [name for name in folder.photos.values() if not folder.photo(name).is_file()]
    if gone and not repair:
        raise InputError(
            f"{path}: photographs are gone: {', '.join(gone)}. Put them back into {_PHOTOS}/, or take them again with "
            "`jaxmocap puppet add`."
        )
    lost = [f"{name}.toml" for name in folder.inputs if folder.input(name) is None]
    if lost:
        raise InputError(
            f"{path}: {', '.join(lost)} of this pose {'is' if len(lost) == 1 else 'are'} gone. Put the file back under "
            "that name: the pose was made with it."
        )
    return folder


def add_photos(folder: PuppetFolder, photos: Mapping[float, Path]) -> tuple[PuppetFolder, list[str]]:
    """Put photographs into a folder; one at an angle that is there already takes its place, and the old one is kept.

    Args:
        folder: as read.
        photos: file by stated angle in degrees.

    Returns:
        The folder as it is then, and a sentence for each photograph that was replaced.

    Raises:
        InputError: files that cannot be read or written, or one name for two angles.
    """
    listed, said = dict(folder.photos), []
    for angle, file in photos.items():
        at = next((a for a in listed if same_angle(a, angle)), angle)
        other = next((a for a, name in listed.items() if name == file.name and a != at), None)
        if other is not None:
            raise InputError(
                f"{file.name}: a photograph of this name stands at {other:g} degrees already. Rename the new one."
            )
        content = _bytes_of(file)
        if at in listed:
            if listed[at] == file.name and _same_content(folder.photo(file.name), content):
                continue  # the same photograph once more
            kept = _keep(folder, listed[at])
            said.append(f"{listed[at]} at {at:g} degrees was replaced by {file.name}; {kept}.")
        write_bytes(folder.photo(file.name), content)
        listed[at] = file.name
    changed = replace(folder, photos=dict(sorted(listed.items())))
    _write_index(changed)
    for name in set(folder.photos.values()) - set(listed.values()):  # kept aside; gone from here only now
        folder.photo(name).unlink(missing_ok=True)
    return changed, said


def _ours(name: str) -> bool:
    """Whether a name is of a puppet's folder, or of a file that was being written there when its process was killed."""
    return name in _OWN or (name.startswith(".") and name.endswith(".tmp") and any(f".{own}." in name for own in _OWN))


def same_angle(a: float, b: float) -> bool:
    """Whether two angles in degrees are one place of the turntable."""
    return abs((a - b + 180.0) % 360.0 - 180.0) < _CLOSE_DEG


def _keep(folder: PuppetFolder, name: str) -> str:
    """Copy a photograph aside; where it is then, in words."""
    aside = folder.path / _REPLACED
    stem, suffix = os.path.splitext(name)
    k = 1
    while (aside / f"{stem}.{k}{suffix}").exists():
        k += 1
    try:
        content = folder.photo(name).read_bytes()
        aside.mkdir(exist_ok=True)
    except FileNotFoundError:
        return "the old one was gone"
    except OSError as error:
        raise InputError(
            f"{aside}: the old photograph cannot be kept: {error.strerror}. Check the folder's rights."
        ) from None
    write_bytes(aside / f"{stem}.{k}{suffix}", content)
    return f"the old one is {_REPLACED}/{stem}.{k}{suffix}"


def _bytes_of(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}. Check name and rights.") from None


def _same_content(file: Path, content: bytes) -> bool:
    try:
        return file.read_bytes() == content
    except OSError:
        return False


def _write_index(folder: PuppetFolder) -> None:
    table = {
        "schema": SCHEMA,
        "unit": folder.unit,
        "distance": folder.distance,
        "height": folder.height,
        "inputs": list(folder.inputs),
        "photos": {f"{angle:.10g}": name for angle, name in folder.photos.items()},
    }
    write_text(folder.path / INDEX, tomli_w.dumps(table))


def _checked(path: Path, index: Path, table: dict[str, object]) -> PuppetFolder:
    where = str(index)
    for key in table:
        if key not in _KEYS:
            close = nearest(key, _KEYS)
            raise InputError(f"{where}: unknown key `{key[:60]}`" + (f"; did you mean `{close}`?" if close else "."))
    schema = table.get("schema")
    if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1:
        raise InputError(f"{where} schema: expected {SCHEMA}, got {short(schema)}.")
    if schema > SCHEMA:
        raise InputError(f"{where}: written by a newer jaxmocap (this one knows up to {SCHEMA}). Upgrade jaxmocap.")
    unit = table.get("unit")
    if not isinstance(unit, str) or (unit != "1" and unit not in METRES):
        raise InputError(f"{where} unit: expected one of {', '.join(METRES)} or 1, got {short(unit)}.")
    distance, height = (_number(f"{where} {key}", table.get(key)) for key in ("distance", "height"))
    if not distance > 0:
        raise InputError(f"{where} distance: expected a positive length, got {distance:g}.")
    inputs = table.get("inputs", ["camera"])
    if not isinstance(inputs, list) or "camera" not in inputs or not all(name in INPUTS for name in inputs):
        raise InputError(
            f"{where} inputs: expected some of {', '.join(INPUTS)}, camera always, got {short(inputs)}. Restore it."
        )
    listed = table.get("photos", {})
    if not isinstance(listed, dict):
        raise InputError(
            f'{where} photos: expected a table such as "30" = "wave_030.jpg", got {type(listed).__name__}.'
        )
    photos = {_angle(where, key): _file_name(where, name) for key, name in listed.items()}
    one_turn = {round(angle / _CLOSE_DEG) % round(360.0 / _CLOSE_DEG) for angle in photos}
    if min(len(one_turn), len(set(photos.values()))) < len(listed):
        raise InputError(f"{where} photos: an angle or a photograph is listed twice.")
    return PuppetFolder(path, unit, distance, height, dict(sorted(photos.items())), tuple(inputs))


def _number(where: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        raise InputError(f"{where}: expected a number, got {short(value)}.")
    return float(value)


def _angle(where: str, text: str) -> float:
    try:
        angle = float(text)
    except ValueError:
        angle = math.nan
    if not abs(angle) <= 1e6:
        raise InputError(f"{where} photos: expected angles in degrees as keys, got {short(text)}.")
    return angle


def _file_name(where: str, name: Any) -> str:
    """A plain name: a path could lead out of the folder."""
    plain = isinstance(name, str) and name == os.path.basename(name) and not {"\\", "\0"} & set(name)
    if not plain or name in ("", ".", ".."):
        raise InputError(f"{where} photos: expected the name of a file in {_PHOTOS}/, got {short(name)}.")
    return name
