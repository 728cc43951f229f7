"""The part of OpenCV's YAML that calibration files use: top-level scalars, number lists and matrices.

OpenCV's own reader is not used: on a damaged file it raises SystemError, asks for the memory that a forged
`rows` names, and returns matrices of NaN without a word. YAML libraries stop at its header ``%YAML:1.0``.
"""

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path

from jaxmocap._errors import InputError
from jaxmocap.io.text_file import NUMBER, read_text

_MAX_BYTES = 64 << 20  # the sample programs also store every corner of every view
_LINE_END = re.compile(r"\r\n|\r|\n")  # splitlines() would also split at characters that a name may hold
_MATRIX_KEYS = ("rows", "cols", "data")
_WORDS = {".nan": math.nan, ".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf}


@dataclass(frozen=True)
class Entry:
    """One top-level key of the file and what stands after it, not yet understood."""

    where: str
    """File, line and key, for messages."""
    lines: list[str]
    """The rest of the line of the key, and the lines up to the next key."""

    def scalar(self) -> str:
        """The entry as text, without quotes."""
        text = self.lines[0].strip()
        try:
            return str(json.loads(text)) if text.startswith('"') else text.strip("'")
        except ValueError:
            return text.strip('"')

    def number(self) -> float:
        """The entry as one number.

        Raises:
            InputError: if it is not one.
        """
        return _number(self.where, self.lines[0].strip())

    def sequence(self) -> list[float]:
        """The entry as numbers, ``[ 640, 480 ]`` or one per line after a dash.

        Raises:
            InputError: if it holds something else.
        """
        text = " ".join(self.lines).strip()
        items = text.strip("[]").split(",") if text.startswith("[") else re.split(r"(?:^|\s)-\s", text)[1:]
        return [_number(self.where, item.strip()) for item in items]

    def matrix(self) -> list[list[float]]:
        """The entry as rows of numbers: rows, cols and data.

        Raises:
            InputError: if one of them is missing, or they do not agree.
        """
        parts = _matrix_parts(self.lines)
        for key in _MATRIX_KEYS:
            if key not in parts:
                raise InputError(f"{self.where}: expected a matrix of rows, cols and data; `{key}` is missing.")
        rows, cols = (_number(f"{self.where} {key}", parts[key].strip()) for key in ("rows", "cols"))
        data = _data(f"{self.where} data", parts["data"].strip())
        if rows < 1 or cols < 1 or rows * cols != len(data) or cols != int(cols):
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
    start = text.lstrip()[:1]
    if start in ("<", "{"):
        raise InputError(f"{path}: this is {'XML' if start == '<' else 'JSON'}. Save the calibration as .yml.")
    entries: dict[str, Entry] = {}
    lines: list[str] | None = None
    for number, line in enumerate(_LINE_END.split(text), start=1):
        if not line.strip() or line.startswith(("%", "---", "...", "#")):
            continue
        if line[0] not in " \t-]":
            key, lines = _open_entry(path, number, line)
            if key in entries:
                raise InputError(f"{path}, line {number}: the key `{key}` stands there twice. Keep one.")
            entries[key] = Entry(f"{path}, line {number}, {key}", lines)
        elif lines is None:
            raise InputError(f"{path}, line {number}: text before the first key. Is this an OpenCV YAML file?")
        else:
            lines.append(line)
    return entries


def matrix_text(key: str, rows: list[list[float]]) -> str:
    """A matrix as OpenCV writes it; the numbers read back exactly."""
    data = ", ".join(repr(float(number)) for row in rows for number in row)
    shape = f"   rows: {len(rows)}\n   cols: {len(rows[0])}\n"
    return f"{key}: !!opencv-matrix\n{shape}   dt: d\n   data: [ {data} ]\n"


def _open_entry(path: str | Path, number: int, line: str) -> tuple[str, list[str]]:
    key, colon, value = line.partition(":")
    if not colon or not key.strip() or (value and value[0] not in " \t"):
        raise InputError(f"{path}, line {number}: expected `key: value`, got {line[:40]!r}. Is this OpenCV YAML?")
    return key.strip().strip("\"'"), [value]


def _matrix_parts(lines: list[str]) -> dict[str, str]:
    """The texts after rows, cols and data; the data run on over the lines up to their bracket."""
    parts: dict[str, str] = {}
    data: list[str] | None = None
    for line in lines[1:]:
        key, _, value = line.partition(":")
        if data is not None:
            data.append(line)
        elif key.strip() == "data":
            data = [value]
        elif key.strip() in _MATRIX_KEYS:
            parts[key.strip()] = value
        if data is not None and line.rstrip().endswith("]"):
            parts["data"], data = " ".join(data), None
    if data is not None:
        parts["data"] = " ".join(data)
    return parts


def _data(where: str, text: str) -> list[float]:
    if not (text.startswith("[") and text.endswith("]")):
        raise InputError(f"{where}: expected numbers between [ and ]. The file is cut off; write it again.")
    return [_number(where, item.strip()) for item in text[1:-1].split(",")]


def _number(where: str, text: str) -> float:
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]  # refused by whoever uses it, with a better reason
    if not NUMBER.fullmatch(text):
        raise InputError(f"{where}: expected a number, got {text[:40]!r}. The file is damaged; write it again.")
    return float(text)
