"""Whether the outputs of a command can be written, asked before minutes of work."""

import os
from collections.abc import Sequence
from pathlib import Path

from jaxmocap._errors import InputError
from jaxmocap.cli.ending import INPUT_SUFFIXES, Outputs

_POINTS = b"frame,marker,x,y,z"


def check_places(outputs: Outputs, inputs: Sequence[str | Path]) -> None:
    """Refuse at once what could not be written later, or would overwrite an input.

    Raises:
        InputError: a folder that is missing or protected, a name that is too long, an output that is an input, two
            outputs of one name.
    """
    from jaxmocap.io.atomic import cannot_write

    for path in outputs.all:
        try:
            _check_place(path, inputs, path in outputs.tables)
        except OSError as error:  # from the mere looking: too long a name, a folder that may not be entered
            raise cannot_write(path, error) from error
    if len({os.path.realpath(path) for path in outputs.all}) < len(outputs.all):
        raise InputError("two outputs have the same name; give each its own")


def _check_place(path: Path, inputs: Sequence[str | Path], table: bool) -> None:
    folder = path.absolute().parent
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the name of a file to write")
    if not folder.is_dir():
        raise InputError(f"{path}: the folder {folder} does not exist; make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder {folder} cannot be written to; choose another")
    looks_so = path.suffix.lower() in INPUT_SUFFIXES and not (table and path.exists() and _is_points_table(path))
    if path.exists() and (looks_so or any(_same(path, i) for i in inputs)):
        raise InputError(f"{path} is, or looks like, one of the inputs; give another name for the output")


def _is_points_table(path: Path) -> bool:
    """Whether a file begins as a table of points does: a result that may be written anew."""
    with open(path, "rb") as file:
        return file.read(len(_POINTS)) == _POINTS


def _same(path: Path, other: str | Path) -> bool:
    """Whether an input is this file; one that cannot be looked at is refused by whoever reads it."""
    try:
        return path.samefile(other)
    except (OSError, ValueError):
        return False
