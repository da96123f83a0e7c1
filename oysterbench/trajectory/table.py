"""Lines of numbers: read whole by a compiled reader where they are plain, and line by line where they are not."""

from __future__ import annotations

import io
import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from oysterbench.errors import TrajectoryError
from oysterbench.geometry import Array
from oysterbench.trajectory.columns import Columns

COMMENTS = ("#", "%")
PLAIN = b"0123456789+-.eE \t\n,"
"""Bytes of a file that the compiled reader may have; another one sends it to the reader that names lines."""

WORTH_COMPILED = 100_000
"""Bytes below which reading line by line is as fast as the import of the compiled reader."""

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
NO_NUMBER = re.compile(r"[+-]?(nan|inf(inity)?)", re.IGNORECASE)


@dataclass(frozen=True)
class Table:
    """The numbers of a file.

    stamps: (N,) texts of the stamps; empty where the layout has none
    sizes:  (N,) float64, the same as rounded numbers
    values: (N, K) float64, finite: the columns `Columns.numbers`
    where:  row, counted from 0 -> "path:line"
    """

    stamps: list[str]
    sizes: Array
    values: Array
    where: Callable[[int], str]

    def __len__(self) -> int:
        return len(self.values)


def is_comment(line: str) -> bool:
    """Whether a line holds no data."""
    stripped = line.strip()
    return not stripped or stripped.startswith(COMMENTS)


def split(line: str) -> list[str]:
    """Fields of a line: between commas or semicolons, or else between spaces and tabs."""
    for separator in (",", ";"):
        if separator in line:
            return [field.strip(" \t") for field in line.split(separator)]
    return re.split(r"[ \t]+", line.strip(" \t"))


def separator(line: str) -> str:
    """What stands between the fields, as a message names it."""
    return "commas" if "," in line else "semicolons" if ";" in line else "spaces"


def read_table(text: str, begin: int, columns: Columns, path: str, compiled: bool | None = None) -> Table:
    """The data lines of `text` from line `begin` (counted from 0) on.

    compiled: whether to try the compiled reader; None: where that is worth it. What it does not take for plain
    numbers is read line by line, so that both give the same table or the same error.
    """
    if compiled is None:
        compiled = len(text) > WORTH_COMPILED
    table = _read_compiled(text, begin, columns, path) if compiled else None
    return table or _read_lines(text, begin, columns, path)


def _read_compiled(text: str, begin: int, columns: Columns, path: str) -> Table | None:
    """The table by pandas' C reader, or None where anything is unusual."""
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
    # Every column is read as numbers, so that a line that breaks off leaves an empty cell, which is none.
    kinds: defaultdict[int, type] = defaultdict(lambda: float)
    if columns.stamp is not None:
        kinds[columns.stamp] = object
    # Before version 3 only this setting rounds decimals to the nearest float64; since then every one does.
    exact = {"float_precision": "round_trip"} if int(pd.__version__.split(".")[0]) < 3 else {}
    try:
        frame = pd.read_csv(
            io.BytesIO(data),
            sep="," if commas else r"\s+",
            header=None,
            dtype=kinds,
            na_filter=False,
            low_memory=False,
            **exact,
        )
        values = frame[columns.numbers].to_numpy(dtype=float)
        stamps = [] if columns.stamp is None else frame[columns.stamp].tolist()
        sizes = np.array(stamps, dtype=np.bytes_).astype(float)
    except (ValueError, LookupError, OverflowError):
        return None
    count = frame.shape[1]
    if not np.isfinite(values).all() or count < columns_needed(columns) or columns.exact not in (None, count):
        return None

    def where(row: int) -> str:
        numbers = (n for n, line in enumerate(text.split("\n")[begin:], begin + 1) if not is_comment(line))
        return f"{path}:{next(n for i, n in enumerate(numbers) if i == row)}"

    return Table(stamps, sizes, values, where)


def _read_lines(text: str, begin: int, columns: Columns, path: str) -> Table:
    """The table line by line. Raises TrajectoryError naming the line and what is wrong with it."""
    stamps: list[str] = []
    values: list[list[float]] = []
    numbers: list[int] = []
    wanted = columns.numbers
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
                raise TrajectoryError(f"{where}: expected a stamp, got {stamp[:40]!r}")
            stamps.append(stamp)
        for k in wanted:
            _check_number(fields[k], k, columns, where, line)
        values.append([float(fields[k]) for k in wanted])
        if not np.isfinite(values[-1]).all():
            raise TrajectoryError(f"{where}: expected numbers that a float64 holds, got {_shown(line)}")
        numbers.append(number)
    table = np.array(values, dtype=float).reshape(-1, len(wanted))
    return Table(stamps, np.array(stamps, dtype=float), table, lambda row: f"{path}:{numbers[row]}")


def columns_needed(columns: Columns) -> int:
    """The least number of columns that holds all of them."""
    return max(*columns.numbers, columns.stamp or 0) + 1


def _check_count(fields: list[str], columns: Columns, where: str, line: str) -> None:
    needed = columns_needed(columns)
    if len(fields) == columns.exact and len(fields) >= needed:
        return
    hint = ""
    if len(fields) == 12 and columns.stamp == 0:
        hint = " (KITTI poses carry no stamps: --format kitti and --times FILE)"
    expected = columns.exact if columns.exact and columns.exact >= needed else needed
    raise TrajectoryError(
        f"{where}: expected {expected} numbers `{columns.kind}`, got {len(fields)} fields: {_shown(line)}{hint}"
    )


def _check_number(text: str, column: int, columns: Columns, where: str, line: str) -> None:
    if NUMBER.fullmatch(text):
        return
    name = column_name(column, columns)
    if NO_NUMBER.fullmatch(text):
        raise TrajectoryError(f"{where}: expected finite numbers, got {name} = {text}; leave out poses not known")
    raise TrajectoryError(f"{where}: expected a number for {name}, got {text[:40]!r} in {_shown(line)}")


def column_name(column: int, columns: Columns) -> str:
    """What a column holds, in a word."""
    for names, places in (
        (("x", "y", "z"), columns.position),
        (("qx", "qy", "qz", "qw"), columns.quaternion),
    ):
        if column in places:
            return names[places.index(column)]
    return f"column {column + 1}"


def _shown(line: str) -> str:
    return repr(line.strip()[:60])
