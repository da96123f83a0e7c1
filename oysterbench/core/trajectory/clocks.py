"""Several columns of times in a table: whether they are one time, and what that says of the unit of the stamps."""

from __future__ import annotations

import re
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory.columns import Columns
from oysterbench.core.trajectory.stamps import MIN_NANOSECONDS, SHIFTS, scaled_integer
from oysterbench.core.trajectory.table import NO_NUMBER, NUMBER, is_comment, split

SAME_NS = 1_000_000
"""Most that two columns of one time differ by, ns: one may be rounded to ms."""
SAME_PART = 0.01
"""Most that they differ by as a part of the largest: in ns, any small numbers are the same to 1 ms."""
LARGEST_DIGIT_NS = 10_000_000
"""Largest last digit by which a time is taken for a rounded one: whole seconds and tenths may be exact."""


def held_against_clocks(
    columns: Columns, text: str, begin: int, names: list[str], path: Path, asked: str | None
) -> Columns:
    """Columns with the unit of the stamps, where their name does not say it and another time of the table, whose name
    does, has their values in that unit. begin: line of the first pose; names: of the columns; asked: unit of the stamps
    that is asked for, by which those are chosen from times whose names say another.

    Raises TrajectoryError where a time of the stamp's name but for the unit has others than it in every unit: in the
    first row or the last, as the parts of one stamp, or times on two clocks have.
    """
    if columns.stamp is None or not columns.clocks:
        return columns
    lines = [line for line in text.split("\n")[begin:] if not is_comment(line)]
    rows = [split(lines[0]), split(lines[-1])]
    for column, unit, same_name in columns.clocks:
        values = [(row[columns.stamp], row[column]) for row in rows]
        if (asked is not None and unit != columns.time_unit) or any(_is_word(other) for _, other in values):
            continue
        either = columns.time_unit is None or unit is None
        readings = _readings(columns, unit, asked, [text for pair in values for text in pair])
        units = [a for a, b in readings if _agree(values, a, b, rounded=not either)]
        if same_name and not units:
            one, other = names[columns.stamp], names[column]
            unnamed = ", or say its unit (--time-unit)" if unit != columns.time_unit else ""
            raise TrajectoryError(
                f"{path}: expected one time in {one!r} and {other!r}, by their names, got {values[0][0][:30]!r} and "
                f"{values[0][1][:30]!r} first, {values[1][0][:30]!r} and {values[1][1][:30]!r} last; delete the one "
                f"that is not the stamp of the poses{unnamed}; one in two parts is stamp_sec, whole, and stamp_nsec, "
                "the ns beyond it, below 10^9"
            )
        if unit is not None and columns.time_unit is None and units:
            columns = replace(columns, time_unit=units[0])
    return columns


def _readings(columns: Columns, unit: str | None, asked: str | None, texts: list[str]) -> list[tuple[str, str]]:
    """Units in which the stamps and another time, whose name says `unit`, may be. Where neither name says one, none
    says that it is not the other's, and the one that their size implies is meant: in some unit, any are the same."""
    own = columns.time_unit or asked
    if own is None and unit is None:
        huge = all(NUMBER.fullmatch(text) and abs(float(text)) >= MIN_NANOSECONDS for text in texts)
        own = unit = "ns" if huge or (columns.euroc and not re.search("[.eE]", "".join(texts))) else "s"
    return [(a, b) for a in ([own] if own else SHIFTS) for b in ([unit] if unit else SHIFTS)]


def _agree(values: list[tuple[str, str]], unit: str, other: str, rounded: bool) -> bool:
    """Whether pairs of times, the first of each in one unit and the second in another, are the same. rounded: or are by
    the last digits that are written."""
    try:
        pairs = [(scaled_integer(a, SHIFTS[unit]), scaled_integer(b, SHIFTS[other])) for a, b in values]
    except ValueError:
        return False
    most = min(SAME_NS, SAME_PART * max(abs(value) for pair in pairs for value in pair))
    digits = [(_last_digit_ns(a, unit), _last_digit_ns(b, other)) if rounded else (0.0, 0.0) for a, b in values]
    return all(abs(a - b) <= max(most, sum(digit) / 2) for (a, b), digit in zip(pairs, digits, strict=True))


def _last_digit_ns(text: str, unit: str) -> float:
    """What one more in the last digit of a time is, ns; 0 where that may be more than rounding."""
    exponent = Decimal(text).as_tuple().exponent
    digit = 10.0 ** (int(exponent) + SHIFTS[unit])
    return digit if digit <= LARGEST_DIGIT_NS else 0.0


def _is_word(text: str) -> bool:
    """Whether a field, such as a date that is written out, is neither a number nor one that is missing."""
    return bool(text) and not NUMBER.fullmatch(text) and not NO_NUMBER.fullmatch(text)
