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
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import tomli_w

from jaxmocap._errors import InputError
from jaxmocap.io.atomic import write_bytes, write_many, write_text
from jaxmocap.io.length_units import METRES
from jaxmocap.io.text_file import nearest, read_text

SCHEMA = 1
INDEX = "puppet.toml"
INPUTS = ("camera", "turntable", "colours", "bones")
IDENTIFIED, RECONSTRUCTION, POINTS, CONTACT_SHEET = (
    "identified.json", "reconstruction.json", "points.csv", "contact_sheet.png",
)  # fmt: skip
_PHOTOS, _REPLACED, _LOCK = "photos", "replaced", ".lock"
_KEYS = ("schema", "unit", "distance", "height", "photos")
_OWN = {INDEX, IDENTIFIED, RECONSTRUCTION, POINTS, CONTACT_SHEET, _PHOTOS, _REPLACED, _LOCK}
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
        foreign = sorted({p.name for p in path.iterdir()} - _OWN) if path.exists() else []
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
    folder = PuppetFolder(path, unit, float(distance), float(height))
    _write_index(folder)
    return folder


def open_puppet_folder(path: str | Path) -> PuppetFolder:
    """Read what a folder holds.

    Raises:
        InputError: no puppet's folder, a damaged `puppet.toml`, or photographs that are gone (each named).
    """
    path = Path(path)
    index = path / INDEX
    if not index.is_file():
        raise InputError(f"{path}: is no puppet's folder (it has no {INDEX}). Make one with `jaxmocap puppet new`.")
    try:
        table = tomllib.loads(read_text(index, _MAX_BYTES))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{index}: not valid TOML: {error}. Restore it, or make the folder anew.") from None
    folder = _checked(path, table)
    gone = [name for name in folder.photos.values() if not folder.photo(name).is_file()]
    if gone:
        raise InputError(
            f"{path}: photographs are gone: {', '.join(gone)}. Put them back into {_PHOTOS}/, or take them again with "
            "`jaxmocap puppet add`."
        )
    if folder.input("camera") is None:
        raise InputError(f"{path}: camera.toml is gone. Put the camera's file back under that name.")
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
        at = next((a for a in listed if _same_angle(a, angle)), angle)
        other = next((a for a, name in listed.items() if name == file.name and a != at), None)
        if other is not None:
            raise InputError(
                f"{file.name}: a photograph of this name stands at {other:g} degrees already. Rename the new one."
            )
        content = _bytes_of(file)
        if at in listed:
            kept = _keep(folder, listed[at])
            said.append(f"{listed[at]} at {at:g} degrees was replaced by {file.name}; the old one is {kept}.")
        write_bytes(folder.photo(file.name), content)
        listed[at] = file.name
    changed = replace(folder, photos=dict(sorted(listed.items())))
    _write_index(changed)
    return changed, said


@contextmanager
def locked(path: str | Path) -> Iterator[None]:
    """Keep other processes from changing the folder meanwhile.

    Raises:
        InputError: another process that is alive holds it, or the folder cannot be written.
    """
    lock = Path(path) / _LOCK
    for _ in range(2):
        try:
            handle = os.open(lock, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
            break
        except FileExistsError:
            holder = _holder(lock)
            if holder is not None:
                raise InputError(
                    f"{path}: process {holder} is working in this folder. Wait for it, or end it and try again."
                ) from None
            lock.unlink(missing_ok=True)  # its process has died
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}. Check the folder's rights.") from None
    else:
        raise InputError(f"{path}: another process took the folder in this moment. Try again.")
    try:
        os.write(handle, str(os.getpid()).encode())
        os.close(handle)
        yield
    finally:
        lock.unlink(missing_ok=True)


def _holder(lock: Path) -> int | None:
    """The living process that holds a lock."""
    try:
        pid = int(lock.read_text() or "0")
        if pid <= 0:
            return None
        os.kill(pid, 0)
    except (OSError, ValueError) as error:
        return int(lock.read_text()) if isinstance(error, PermissionError) else None
    return pid


def _same_angle(a: float, b: float) -> bool:
    return abs((a - b + 180.0) % 360.0 - 180.0) < _CLOSE_DEG


def _keep(folder: PuppetFolder, name: str) -> str:
    """Copy a photograph aside; its name there."""
    aside = folder.path / _REPLACED
    stem, suffix = os.path.splitext(name)
    k = 1
    while (aside / f"{stem}.{k}{suffix}").exists():
        k += 1
    try:
        aside.mkdir(exist_ok=True)
        content = folder.photo(name).read_bytes()
    except OSError as error:
        raise InputError(f"{aside}: the old photograph cannot be kept: {error.strerror}.") from None
    write_bytes(aside / f"{stem}.{k}{suffix}", content)
    return f"{_REPLACED}/{stem}.{k}{suffix}"


def _bytes_of(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}. Check name and rights.") from None


def _write_index(folder: PuppetFolder) -> None:
    table = {
        "schema": SCHEMA,
        "unit": folder.unit,
        "distance": folder.distance,
        "height": folder.height,
        "photos": {f"{angle:.10g}": name for angle, name in folder.photos.items()},
    }
    write_text(folder.path / INDEX, tomli_w.dumps(table))


def _checked(path: Path, table: dict[str, object]) -> PuppetFolder:
    where = f"{path / INDEX}"
    for key in table:
        if key not in _KEYS:
            close = nearest(key, _KEYS)
            raise InputError(f"{where}: unknown key `{key}`" + (f"; did you mean `{close}`?" if close else "."))
    schema = table.get("schema")
    if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1:
        raise InputError(f"{where} schema: expected {SCHEMA}, got {schema!r}.")
    if schema > SCHEMA:
        raise InputError(f"{where}: written by a newer jaxmocap (this one knows up to {SCHEMA}). Upgrade jaxmocap.")
    unit = table.get("unit")
    if not isinstance(unit, str) or (unit != "1" and unit not in METRES):
        raise InputError(f"{where} unit: expected one of {', '.join(METRES)} or 1, got {unit!r}.")
    distance, height = (_number(f"{where} {key}", table.get(key)) for key in ("distance", "height"))
    if not distance > 0:
        raise InputError(f"{where} distance: expected a positive length, got {distance:g}.")
    listed = table.get("photos", {})
    if not isinstance(listed, dict):
        raise InputError(
            f'{where} photos: expected a table such as "30" = "wave_030.jpg", got {type(listed).__name__}.'
        )
    photos = {_angle(where, key): _file_name(where, name) for key, name in listed.items()}
    if len(set(photos.values())) < len(listed):
        raise InputError(f"{where} photos: an angle or a photograph is listed twice.")
    return PuppetFolder(path, unit, distance, height, dict(sorted(photos.items())))


def _number(where: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        raise InputError(f"{where}: expected a number, got {value!r}.")
    return float(value)


def _angle(where: str, text: str) -> float:
    try:
        angle = float(text)
    except ValueError:
        angle = math.nan
    if not abs(angle) <= 1e6:
        raise InputError(f"{where} photos: expected angles in degrees as keys, got {text!r}.")
    return angle


def _file_name(where: str, name: object) -> str:
    """A plain name: a path could lead out of the folder."""
    if not isinstance(name, str) or not name or name != os.path.basename(name) or "\\" in name or name in (".", ".."):
        raise InputError(f"{where} photos: expected the name of a file in {_PHOTOS}/, got {name!r}.")
    return name
