"""Tables of numbers as text: plain ones are read by a compiled reader all at once, others line by line."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory.columns import Columns

COMMENTS = ("#", "%")
PLAIN = b"0123456789+-.eE \t\n,"
"""Bytes that the compiled reader accepts; any other sends a file to the reader that names lines."""

WORTH_COMPILED = 100_000
"""Size below which reading line by line is as fast as importing the compiled reader."""

STAMP_WIDTH = 32
"""Limit on the length of stamps that are read all at once: numpy writes 24 characters."""

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
NO_NUMBER = re.compile(r"[+-]?(nan|inf(inity)?)", re.IGNORECASE)


@dataclass(frozen=True)
class NumberTable:
    """Numbers of a file.

    stamps: (N,) texts of the stamps, ASCII; empty where the layout has none
    sizes:  (N,) float64, the stamps as rounded numbers
    values: (N, K) float64, the columns `Columns.numbers`; finite, but for those of covariances
    where:  row, counted from 0 -> "path:line"
    """

    stamps: NDArray[np.bytes_]
    sizes: Array
    values: Array
    where: Callable[[int], str]

    def stamp(self, row: int) -> str:
        """Text of a row's stamp, shortened for a message."""
        return str(self.stamps[row].decode()[:40])

    def __len__(self) -> int:
        return len(self.values)


def is_comment(line: str) -> bool:
    """Whether a line holds no data: it is a comment or blank."""
    stripped = line.strip()
    return not stripped or stripped.startswith(COMMENTS)


def split(line: str) -> list[str]:
    """Split a line into its fields, at commas or semicolons, or else at spaces and tabs."""
    for separator in (",", ";"):
        if separator in line:
            fields = [field.strip(" \t") for field in line.split(separator)]
            return [field.strip('"') for field in fields] if '"' in line else fields
    return re.split(r"[ \t]+", line.strip(" \t"))


def separator(line: str) -> str:
    """Name, for messages, of what separates the fields of a line."""
    return "commas" if "," in line else "semicolons" if ";" in line else "spaces"


def read_table(text: str, begin: int, columns: Columns, path: str, compiled: bool | None = None) -> NumberTable:
    """Read the data lines of `text` from line `begin` (counted from 0) on.

    compiled: whether to try the compiled reader; None: where that is worthwhile. What it does not recognise as plain
    numbers is read line by line, so that both give the same table or the same error.
    """
    if compiled is None:
        compiled = len(text) > WORTH_COMPILED
    table = _read_compiled(text, begin, columns, path) if compiled else None
    return table or _read_lines(text, begin, columns, path)


def _read_compiled(text: str, begin: int, columns: Columns, path: str) -> NumberTable | None:
    """Read the table with pandas' C reader; None where anything is unusual."""
    import pandas as pd

    if any(sign in text for sign in COMMENTS):
        lines = text.split("\n")[begin:]
        body = "\n".join([line for line in lines if not line.lstrip().startswith(COMMENTS)])
    else:
        body = text.split("\n", begin)[begin] if begin else text
    try:
        data = body.encode("ascii")
    except UnicodeEncodeError:
        return None
    if data.translate(None, PLAIN):
        return None
    commas = b"," in data
    if commas and (b" " in data or b"\t" in data):
        data = data.replace(b", ", b",")
        if b" " in data or b"\t" in data:
            return None
    # Before version 3, only this setting rounds decimals to the nearest float64; since then, all of them do.
    read: Callable[..., pd.DataFrame] = pd.read_csv
    exact = {"float_precision": "round_trip"} if int(pd.__version__.split(".")[0]) < 3 else {}
    separator = "," if commas else " " if _single_spaces(data) else r"\s+"
    how: dict[str, object] = {"sep": separator, "header": None, "na_filter": False, "low_memory": False}
    try:
        # Every column is read as numbers, so that a truncated line leaves an empty cell, which is no number.
        frame = read(io.BytesIO(data), dtype=float, **how, **exact)
        values = frame[columns.numbers].to_numpy()
        stamps, sizes = np.empty(0, dtype="S1"), np.empty(0)
        if columns.stamp is not None:
            sizes = frame[columns.stamp].to_numpy()
            first = _first_fields(data) if columns.stamp == 0 else None
            if first is None or len(first) != len(frame):
                texts = read(io.BytesIO(data), usecols=[columns.stamp], dtype=object, **how)
                first = np.array(texts[columns.stamp].tolist(), dtype=np.bytes_)
            stamps = first
    except (ValueError, LookupError, OverflowError):
        return None
    count = frame.shape[1]
    if not np.isfinite(values).all() or count < columns_needed(columns) or columns.exact not in (None, count):
        return None

    def where(row: int) -> str:
        numbers = (n for n, line in enumerate(text.split("\n")[begin:], begin + 1) if not is_comment(line))
        return f"{path}:{next(n for i, n in enumerate(numbers) if i == row)}"

    return NumberTable(stamps, sizes, values, where)


def _single_spaces(data: bytes) -> bool:
    """Whether fields are separated by exactly one space everywhere, with no spaces elsewhere."""
    characters = np.frombuffer(data, dtype=np.uint8)
    spaces = characters == ord(" ")
    blanks = spaces | (characters == ord("\n"))
    touching = (spaces[1:] & blanks[:-1]).any() or (spaces[:-1] & blanks[1:]).any()
    return not (touching or b"\t" in data or data.startswith(b" ") or data.endswith(b" "))


def _first_fields(data: bytes) -> NDArray[np.bytes_] | None:
    """First field of every line, or None where one is empty or too long (`STAMP_WIDTH`)."""
    characters = np.frombuffer(data, dtype=np.uint8)
    breaks = np.flatnonzero(characters == ord("\n"))
    starts = np.concatenate([[0], breaks + 1])
    starts = starts[starts < len(characters)]
    padded = np.concatenate([characters, np.zeros(STAMP_WIDTH, dtype=np.uint8)])
    fields = sliding_window_view(padded, STAMP_WIDTH)[starts]
    ends = (fields == ord(" ")) | (fields == ord("\t")) | (fields == ord(",")) | (fields == ord("\n"))
    lengths = ends.argmax(axis=1)
    if not ends.any(axis=1).all() or not lengths.all():
        return None
    fields[np.arange(STAMP_WIDTH) >= lengths[:, None]] = 0
    return np.asarray(fields.view(f"S{STAMP_WIDTH}").ravel())


def _read_lines(text: str, begin: int, columns: Columns, path: str) -> NumberTable:
    """Read the table line by line. Raises TrajectoryError naming the line and what is wrong with it."""
    stamps: list[str] = []
    values: list[list[float]] = []
    numbers: list[int] = []
    wanted, uncertain = columns.numbers, set(columns.covariance.values())
    sign: str | None = None
    for number, line in enumerate(text.split("\n")[begin:], begin + 1):
        if is_comment(line):
            continue
        where = f"{path}:{number}"
        fields = split(line)
        if sign is None:
            sign = separator(line)
            columns = replace(columns, exact=columns.exact or len(fields))
        elif separator(line) != sign:
            raise TrajectoryError(
                f"{where}: expected {sign} between the numbers as on the lines before, got {separator(line)}: "
                f"{_shown(line)}"
            )
        _check_count(fields, columns, where, line)
        if columns.stamp is not None:
            stamp = fields[columns.stamp]
            if not NUMBER.fullmatch(stamp):
                raise TrajectoryError(f"{where}: expected a timestamp, got {stamp[:40]!r}")
            stamps.append(stamp)
        for k in wanted:
            if k not in uncertain or not (NO_NUMBER.fullmatch(fields[k]) or not fields[k]):
                _check_number(fields[k], k, columns, where, line)
        values.append([float(fields[k] or "nan") for k in wanted])
        if not np.isfinite([value for value, k in zip(values[-1], wanted, strict=True) if k not in uncertain]).all():
            raise TrajectoryError(f"{where}: expected numbers that a float64 holds, got {_shown(line)}")
        numbers.append(number)
    table = np.array(values, dtype=float).reshape(-1, len(wanted))
    return NumberTable(
        np.array(stamps, dtype=np.bytes_), np.array(stamps, dtype=float), table, lambda row: f"{path}:{numbers[row]}"
    )


def columns_needed(columns: Columns) -> int:
    """Least number of columns that a line must have to hold all of `columns`."""
    return max(*columns.numbers, columns.stamp or 0) + 1


def _check_count(fields: list[str], columns: Columns, where: str, line: str) -> None:
    needed = columns_needed(columns)
    if len(fields) == columns.exact and len(fields) >= needed:
        return
    hint = ""
    if len(fields) == 12 and columns.stamp == 0:
        hint = " (KITTI poses have no timestamps: --format kitti and --times FILE)"
    expected = columns.exact if columns.exact and columns.exact >= needed else needed
    raise TrajectoryError(
        f"{where}: expected {expected} numbers `{columns.kind}`, got {len(fields)} fields: {_shown(line)}{hint}"
    )


def _check_number(text: str, column: int, columns: Columns, where: str, line: str) -> None:
    if NUMBER.fullmatch(text):
        return
    name = column_name(column, columns)
    if NO_NUMBER.fullmatch(text):
        raise TrajectoryError(f"{where}: expected finite numbers, got {name} = {text}; leave out unknown poses")
    raise TrajectoryError(f"{where}: expected a number for {name}, got {text[:40]!r} in {_shown(line)}")


def column_name(column: int, columns: Columns) -> str:
    """Short name, for messages, of what a column holds."""
    for names, places in (
        (("x", "y", "z"), columns.position),
        (("qx", "qy", "qz", "qw"), columns.quaternion),
    ):
        if column in places:
            return names[places.index(column)]
    return f"column {column + 1}"


def _shown(line: str) -> str:
    return repr(line.strip()[:60])
