"""How a command ends: exit status, one sentence of error, and the machine-readable failure."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxmocap._errors import JaxMocapError, SolveError

DONE, WRONG_INPUT, NOT_SOLVED, INTERRUPTED = 0, 2, 3, 130

INPUT_SUFFIXES = {".jpg", ".jpeg", ".jpe", ".png", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm", ".pnm", ".csv"}
"""An existing file that ends so is somebody's recording: no output of a calibration, and no failure, replaces it."""

_SETTINGS_SUFFIXES = {".toml", ".yml", ".yaml", ".xml"}
"""So end cameras, colours, the index of a folder: a failure is none of these, whatever was typed."""


@dataclass(frozen=True)
class Outputs:
    """The files a command was asked to write."""

    results: tuple[Path, ...] = ()
    """Rig, tables, models: written if the command succeeds, else untouched."""
    report: Path | None = None
    json: Path | None = None
    tables: tuple[Path, ...] = ()
    """Those of `results` that may replace a .csv that is a table of points."""

    @property
    def all(self) -> list[Path]:
        """Each of them."""
        return [*self.results, *(path for path in (self.report, self.json) if path)]


def command_line() -> str:
    """The command line as it was typed, for the record."""
    import shlex

    return shlex.join(["jaxmocap", *sys.argv[1:]])


def status_of(error: JaxMocapError) -> int:
    """3 if the data could not be solved, 2 if the input is wrong."""
    return NOT_SOLVED if isinstance(error, SolveError) else WRONG_INPUT


def failed(message: str, status: int) -> int:
    """Say why, and hand on the exit status."""
    print(f"error: {message}", file=sys.stderr)
    return status


def write_failure(outputs: Outputs, message: str) -> None:
    """The machine-readable failure and, if asked for, a page that says the same; nothing else is touched."""
    from importlib.metadata import version

    from jaxmocap.io.atomic import write_bytes
    from jaxmocap.io.json_file import json_bytes
    from jaxmocap.report.failure import failure_html

    command = command_line()
    content: dict[str, Any] = {
        "jaxmocap": version("jaxmocap"),
        "command": command,
        "success": False,
        "message": message,
        "unit": None,
        "seed": None,
        "warnings": [],
    }
    page = failure_html(command, message).encode(errors="backslashreplace")
    results, never = {os.path.realpath(path) for path in outputs.results}, INPUT_SUFFIXES | _SETTINGS_SUFFIXES
    for path, data in ((outputs.json, json_bytes(content)), (outputs.report, page)):
        # Whatever was typed, a failure replaces neither a recording nor a result.
        if path is None or path.suffix.lower() in never or os.path.realpath(path) in results:
            continue
        try:
            write_bytes(path, data)
        except JaxMocapError as second:
            print(f"error: {second}", file=sys.stderr)


def write_usage_failure(arguments: Sequence[str], error: Exception) -> None:
    """The machine-readable failure of a command line that could not be understood, where it names --json FILE."""
    split = [word for a in arguments for word in (("--json", a[7:]) if a.startswith("--json=") else (a,))]
    given = [i + 1 for i, word in enumerate(split[:-1]) if word == "--json" and not split[i + 1].startswith("-")]
    if len(given) == 1 and split[given[0]]:
        others = [Path(word) for i, word in enumerate(split) if i != given[0] and not word.startswith("-")]
        write_failure(Outputs(tuple(others), json=Path(split[given[0]])), " ".join(str(error).split()))
