"""The part of OpenCV's YAML that calibration files use: top-level scalars, number lists and matrices.

OpenCV's own reader is not used: on a damaged file it raises SystemError, asks for the memory that a forged `rows`
names, and returns matrices of NaN without a word. A YAML library would stop at the header ``%YAML:1.0``.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

from jaxmocap._errors import InputError
from jaxmocap.io.text_file import read_text

_MAX_BYTES = 64 << 20  # the sample programs also store every corner of every view
_KEY = re.compile(r"""(?:"([^"]*)"|'([^']*)'|([^\s:#"'\[{][^:#]*?))\s*:(?:\s+(.*))?""")
_MATRIX_KEY = re.compile(r"^\s*(rows|cols|data)\s*:\s*(.*)$", re.DOTALL)
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WORDS = {".nan": math.nan, ".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf}


@dataclass(frozen=True)
class Entry:
    """One top-level key of the file: what stands after it, not yet understood."""

    where: str
    """File, line and key, for messages."""
    text: str
    """Everything up to the next key."""

    def scalar(self) -> str:
        """The text of a scalar without quotes."""
        return self.text.strip().strip("\"'")

    def number(self) -> float:
        """The entry as one number.

        Raises:
            InputError: if it is not one.
        """
        return _number(self.where, self.text.strip())

    def sequence(self) -> list[float]:
        """The entry as numbers, ``[ 640, 480 ]`` or one per line.

        Raises:
            InputError: if it holds something else.
        """
        return [_number(self.where, item) for item in _items(self.text)]

    def matrix(self) -> list[list[float]]:
        """The entry as rows of numbers: rows, cols and data.

        Raises:
            InputError: if one of them is missing, or they do not agree.
        """
        parts = _matrix_parts(self.text)
        for key in ("rows", "cols", "data"):
            if key not in parts:
                raise InputError(
                    f"{self.where}: expected a matrix with rows, cols and data; `{key}` is missing."
                )
        rows, cols = (_number(f"{self.where} {key}", parts[key].strip()) for key in ("rows", "cols"))
        if not parts["data"].rstrip().endswith("]"):
            raise InputError(
                f"{self.where}: the data have no end (`]`). The file is cut off; write it again."
            )
        data = [_number(f"{self.where} data", item) for item in _items(parts["data"])]
        if rows < 1 or cols < 1 or rows * cols != len(data):
            raise InputError(
                f"{self.where}: rows x cols is {rows:g} x {cols:g}, but there are {len(data)} numbers. "
                "The file is damaged; write it again."
            )
        width = int(cols)
        return [data[start : start + width] for start in range(0, len(data), width)]


def read_entries(path: str | Path) -> dict[str, Entry]:
    """Top-level entries of an OpenCV YAML file.

    Args:
        path: the file.

    Raises:
        InputError: if it is no YAML (OpenCV also writes XML and JSON), or a key stands in it twice.
    """
    text = read_text(path, _MAX_BYTES)
    start = text.lstrip()
    if start.startswith(("<", "{")):
        raise InputError(
            f"{path}: this is {'XML' if start[0] == '<' else 'JSON'}. Save the calibration as .yml."
        )
    blocks: list[tuple[str, int, list[str]]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith(("%", "---", "...", "#")):
            continue
        if line[0] in " \t-]":
            if not blocks:
                raise InputError(
                    f"{path}, line {number}: text before the first key. Is this an OpenCV YAML file?"
                )
            blocks[-1][2].append(line)
        else:
            blocks.append(_open_block(path, number, line))
    entries: dict[str, Entry] = {}
    for key, number, lines in blocks:
        if key in entries:
            raise InputError(f"{path}, line {number}: the key `{key}` stands there twice. Keep one.")
        entries[key] = Entry(f"{path}, line {number}, {key}", "\n".join(lines))
    return entries


def _open_block(path: str | Path, number: int, line: str) -> tuple[str, int, list[str]]:
    match = _KEY.fullmatch(line.rstrip())
    if not match:
        raise InputError(
            f"{path}, line {number}: expected `key: value`, got {line[:40]!r}. Is this OpenCV YAML?"
        )
    key = next(name for name in match.groups()[:3] if name is not None)
    return key, number, [match[4] or ""]


def _matrix_parts(text: str) -> dict[str, str]:
    """The texts after rows, cols and data of a matrix block; lines without a key continue the one before."""
    parts: dict[str, str] = {}
    current = ""
    for line in text.splitlines():
        match = _MATRIX_KEY.match(line)
        if match:
            current = match[1]
            parts[current] = match[2]
        elif current == "data" and not parts["data"].rstrip().endswith("]"):
            parts["data"] += " " + line
    return parts


def _items(text: str) -> list[str]:
    """The items of ``[ a, b ]`` or of lines ``- a``."""
    inner = text.strip()
    if inner.startswith("["):
        return [item.strip() for item in inner[1:].rstrip("]").split(",") if item.strip()]
    return [line.strip()[1:].strip() for line in inner.splitlines() if line.strip().startswith("-")]


def _number(where: str, text: str) -> float:
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]  # refused by whoever uses it, with a better reason
    if not _NUMBER.fullmatch(text):
        raise InputError(
            f"{where}: expected a number, got {text[:40]!r}. The file is damaged; write it again."
        )
    return float(text)


def matrix_text(key: str, rows: list[list[float]]) -> str:
    """A matrix as OpenCV writes it; the numbers read back exactly."""
    data = ", ".join(repr(float(number)) for row in rows for number in row)
    return f"{key}: !!opencv-matrix\n   rows: {len(rows)}\n   cols: {len(rows[0])}\n   dt: d\n   data: [ {data} ]\n"
