"""A CSV file as columns of text that remember their line, so that every message can say where a bad cell is.

The standard library's reader is used because it keeps line numbers. Every function raises `ValueError` with one
sentence: file, line (the header is line 1), column, what was expected, what was found.
"""

import csv
import hashlib
import io
import math
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

_LONGEST = 40  # characters of a bad cell shown in a message
_OTHER_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}


class Table(NamedTuple):
    """columns: stripped cells by column name; lines: where each row is in the file; digest: of the file's bytes."""

    file: str
    columns: dict[str, list[str]]
    lines: list[int]
    digest: str


def problem(file: str | Path, line: int, column: str | None, expected: str, found: str) -> ValueError:
    """The one sentence about a bad place in a file."""
    where = "" if column is None else f" column {column!r}:"
    return ValueError(f"{file}: line {line}:{where} expected {expected}, found {found}")


def quoted_cell(cell: str) -> str:
    """A cell as a message shows it: on one line, and short."""
    return "an empty cell" if not cell else repr(cell if len(cell) <= _LONGEST else cell[:_LONGEST] + "…")


def read_table(path: str | Path) -> Table:
    """Reads a comma-separated UTF-8 file with a header.

    A byte-order mark, Windows line ends, empty rows at the end, blanks around cells, and columns without a name
    (such as the one after a trailing comma) are no part of the data.
    """
    content = _read_bytes(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise problem(path, 1, None, "text in UTF-8", "text in UTF-16") from None
        line = content[: error.start].count(b"\n") + 1
        raise problem(path, line, None, "text in UTF-8", f"the byte 0x{content[error.start]:02x}") from None
    rows, lines = _read_rows(path, text)
    if not rows:
        raise problem(path, 1, None, "a header with column names", "an empty file")
    header = rows.pop(0)
    if other := next((mark for mark in _OTHER_SEPARATORS if len(header) == 1 and mark in header[0]), None):
        raise problem(
            path, lines[0], None, "commas between columns", f"{_OTHER_SEPARATORS[other]} in {quoted_cell(header[0])}"
        )
    for name, times in Counter(name for name in header if name).items():
        if times > 1:
            raise problem(path, lines[0], name, "every column name once", f"it {times} times")
    named = [i for i, name in enumerate(header) if name]
    if not named:
        raise problem(path, lines[0], None, "a header with column names", "a row without any")
    # A column that only its trailing comma announces may be left out of a row: it has no name, nothing reads it.
    needed = named[-1] + 1
    for row, line in zip(rows, lines[1:], strict=True):
        if len(row) < needed:
            raise problem(path, line, header[len(row)] or None, f"{needed} cells", str(len(row)))
        if any(row[len(header) :]):
            raise problem(path, line, header[needed - 1], f"{len(header)} cells", str(len(row)))
    return Table(str(path), {header[i]: [row[i] for row in rows] for i in named}, lines[1:], fingerprint(content))


def numbers(table: Table, name: str, needed: Bool[np.ndarray, " rows"] | None = None) -> Float[np.ndarray, " rows"]:
    """The column as finite float64 numbers; where `needed` is False an empty or infinite cell is allowed, and is 0."""
    values = np.zeros(len(table.lines))
    for row, cell in enumerate(column(table, name)):
        value, allowed = math.nan, needed is not None and not needed[row]
        try:
            value = float(cell.replace("_", "text") or "nan")  # Python's own `1_000` is written by no other program
        except ValueError:
            allowed = False
        if math.isfinite(value):
            values[row] = value
        elif not allowed:
            raise problem(table.file, table.lines[row], name, "a finite number", quoted_cell(cell))
    return values


def column(table: Table, name: str) -> list[str]:
    """The cells of a column that must be there."""
    if name not in table.columns:
        there = ", ".join(map(repr, table.columns)) or "no named column"
        raise problem(table.file, 1, name, "a column of this name", there)
    return table.columns[name]


def _read_bytes(path: str | Path) -> bytes:
    file = Path(path).expanduser()
    try:
        return file.read_bytes()
    except (FileNotFoundError, ValueError):  # ValueError: a null character in the name
        found = "no such file"
    except OSError as error:
        found = "a folder" if isinstance(error, IsADirectoryError) else (error.strerror or type(error).__name__).lower()
    raise ValueError(f"{path}: expected a readable CSV file, found {found}")


def _read_rows(path: str | Path, text: str) -> tuple[list[list[str]], list[int]]:
    """Stripped rows and the line on which each starts, without the empty rows at the end."""
    # newline="" leaves line ends to the csv module, as it asks for.
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    rows, lines, start = list[list[str]](), list[int](), 1
    try:
        for row in reader:
            rows.append([cell.strip() for cell in row])
            lines.append(start)
            start = reader.line_num + 1
    except csv.Error as error:
        raise problem(path, start, None, "comma-separated values", f"a malformed row ({error})") from None
    while rows and not any(rows[-1]):
        rows.pop()
        lines.pop()
    return rows, lines


def fingerprint(content: bytes) -> str:
    """The first 12 hexadecimal digits of the SHA-256 of a file's bytes."""
    return hashlib.sha256(content).hexdigest()[:12]
