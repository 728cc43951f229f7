"""A CSV file as typed columns, with the line and the column in every complaint."""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from jaxmocap._errors import InputError
from jaxmocap.io.text_file import NUMBER, nearest, read_text

_MAX_BYTES = 256 << 20
_MAX_COUNT = 2**53  # beyond it a float, and so another program, could not tell neighbours apart


@dataclass(frozen=True)
class Table:
    """The cells of a CSV file by column."""

    path: str | Path
    cells: dict[str, list[str]]
    """Stripped texts by column name."""
    lines: list[int]
    """Line of the file that each row ends on."""
    warnings: tuple[str, ...]

    def has(self, column: str) -> bool:
        """Whether the file has this column."""
        return column in self.cells

    def labels(self, column: str, may_be_blank: bool = False) -> list[str]:
        """A column as texts.

        Raises:
            InputError: if one is blank and may not be.
        """
        cells = self.cells[column]
        if not may_be_blank and "" in cells:
            self._complain(column, cells.index(""), "is blank; every row needs one")
        return cells

    def numbers(self, *columns: str) -> np.ndarray:
        """Columns as floats, shape (rows, columns).

        Raises:
            InputError: if a cell is no finite number.
        """
        return np.stack([self._floats(column) for column in columns], axis=1)

    def numbers_or_blank(self, *columns: str) -> np.ndarray:
        """Columns as floats, shape (rows, columns), NaN where the cell is blank.

        Raises:
            InputError: if a cell is neither blank nor a finite number.
        """
        return np.stack([self._floats(column, may_be_blank=True) for column in columns], axis=1)

    def counts(self, column: str) -> np.ndarray:
        """A column as whole numbers from 0, shape (rows,).

        Raises:
            InputError: if a cell is none.
        """
        cells = self.cells[column]
        for row, cell in enumerate(cells):
            if not re.fullmatch("[0-9]{1,16}", cell) or int(cell) > _MAX_COUNT:
                self._complain(column, row, f"expected a whole number from 0, got {_quoted(cell)}")
        return np.array([int(cell) for cell in cells], dtype=np.int64)

    def refuse(self, column: str, bad: np.ndarray, expected: str) -> None:
        """Complain about the first row where `bad` is true.

        Raises:
            InputError: if there is one.
        """
        if bad.any():
            row = int(np.argmax(bad))
            self._complain(column, row, f"{expected}, got {_quoted(self.cells[column][row])}")

    def _floats(self, column: str, may_be_blank: bool = False) -> np.ndarray:
        cells = self.cells[column]
        blank = np.array([may_be_blank and not cell for cell in cells])
        for row, cell in enumerate(cells):
            if not blank[row] and not NUMBER.fullmatch(cell):
                self._complain(column, row, _not_a_number(cell))
        values = np.array([float(cell or "nan") for cell in cells])
        self.refuse(column, ~np.isfinite(values) & ~blank, "expected a number that a computer can hold")
        return values

    def _complain(self, column: str, row: int, what: str) -> NoReturn:
        raise InputError(f"{self.path}, line {self.lines[row]}, column {column!r}: {what}.")


def read_table(path: str | Path, required: tuple[str, ...], optional: tuple[str, ...]) -> Table:
    """Read a CSV file with these columns, in any order.

    Args:
        path: the file.
        required: columns that must be there.
        optional: columns that may be there; further ones are named in `warnings` and left out.

    Returns:
        The table, at least one row.

    Raises:
        InputError: for other separators, a missing header, columns missing, misspelt or double, ragged rows.
    """
    text = read_text(path, _MAX_BYTES)
    header, rows, lines = _split(path, text)
    warnings = _check_header(path, header, required, optional)
    if not rows:
        raise InputError(f"{path}: the table has a header but no rows. Check that the program that wrote it finished.")
    columns = zip(*rows)
    cells = {name: list(column) for name, column in zip(header, columns) if name in required + optional}
    return Table(path, cells, lines, tuple(warnings))


def _split(path: str | Path, text: str) -> tuple[list[str], list[list[str]], list[int]]:
    """Header, rows of equally many stripped cells, and their lines; blank lines are skipped."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    header: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            if not header:
                header = cells
                _check_separator(path, reader.line_num, cells)
            elif len(cells) != len(header):
                raise InputError(_ragged(path, reader.line_num, len(cells), len(header)))
            else:
                rows.append(cells)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: not valid CSV ({error}). Check the quotes there.") from None
    return header, rows, lines


def _check_separator(path: str | Path, line: int, header: list[str]) -> None:
    """Refuse semicolons and tabs, and a first row of numbers."""
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise InputError(
                f"{path}, line {line}: columns are separated by {word}. "
                "Save the table with commas between columns and points in numbers (locale: English)."
            )
    if any(NUMBER.fullmatch(cell) for cell in header):
        raise InputError(
            f"{path}, line {line}: the first row holds numbers, so the header is missing. Name the columns there."
        )


def _check_header(
    path: str | Path, header: list[str], required: tuple[str, ...], optional: tuple[str, ...]
) -> list[str]:
    """Refuse double, missing and misspelt columns; what to say about the others."""
    double = [name for name in dict.fromkeys(header) if header.count(name) > 1]
    if double:
        raise InputError(f"{path}: column {double[0]!r} stands in the header twice. Remove or rename one.")
    others = [name for name in header if name not in required + optional]
    absent = [name for name in required + optional if name not in header]
    for name in others:
        close = nearest(name, absent)
        if close:
            raise InputError(f"{path}: unknown column {name!r}; did you mean {close!r}?")
    missing = [name for name in required if name in absent]
    if missing:
        expected = ",".join(required) + "".join(f"[,{name}]" for name in optional)
        found = ",".join(header)[:200]
        raise InputError(
            f"{path}: missing columns: {', '.join(missing)}. Expected the header {expected}; found {found}."
        )
    return [f"{path}: columns that mean nothing here are left out: {', '.join(map(repr, others))}."] if others else []


def _ragged(path: str | Path, line: int, got: int, expected: int) -> str:
    cause = (
        "Are there decimal commas, or a comma in a name without quotes?" if got > expected else "Is the row cut off?"
    )
    return f"{path}, line {line}: expected {expected} cells as in the header, got {got}. {cause}"


def _not_a_number(cell: str) -> str:
    if not cell:
        return "is blank; leave the whole row out where nothing was seen"
    if re.fullmatch("[+-]?[0-9]+,[0-9]+", cell):
        return f"{_quoted(cell)} has a decimal comma; write a point"
    if cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"{_quoted(cell)} is no measurement; leave the whole row out"
    return f"expected a number, got {_quoted(cell)}"


def _quoted(cell: str) -> str:
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")
