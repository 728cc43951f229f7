"""Whether the outputs of a command can be written, asked before minutes of work."""

import os
from collections.abc import Sequence
from pathlib import Path

from jaxmocap._errors import InputError
from jaxmocap.cli.ending import INPUT_SUFFIXES, Outputs


def check_places(outputs: Outputs, inputs: Sequence[str | Path]) -> None:
    """Refuse at once what could not be written later, or would overwrite an input.

    Raises:
        InputError: a folder that is missing or protected, an output that is an input, two outputs of one name.
    """
    for path in outputs.all:
        if path.is_dir():
            raise InputError(f"{path} is a folder; give the name of a file to write")
        if not path.absolute().parent.is_dir():
            raise InputError(f"{path}: the folder {path.absolute().parent} does not exist; make it first")
        if not os.access(path.absolute().parent, os.W_OK):
            raise InputError(f"{path}: the folder {path.absolute().parent} cannot be written to; choose another")
        same = any(path.exists() and Path(i).exists() and path.samefile(i) for i in inputs)
        if same or (path.exists() and path.suffix.lower() in INPUT_SUFFIXES):
            raise InputError(f"{path} is, or looks like, one of the inputs; give another name for the output")
    if len({path.resolve() for path in outputs.all}) < len(outputs.all):
        raise InputError("two outputs have the same name; give each its own")
