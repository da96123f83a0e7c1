"""Several columns of times in a table: whether they are one time, and what that says of the unit of the stamps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory.columns import Columns
from oysterbench.core.trajectory.stamps import SHIFTS, scaled_integer
from oysterbench.core.trajectory.table import is_comment, split

SAME_NS = 1_000_000
"""Most that two columns of one time differ by, ns: one may be rounded to ms."""
SAME_PART = 0.01
"""Most that they differ by as a part of the largest: in ns, any small numbers are the same to 1 ms."""


def held_against_clocks(columns: Columns, text: str, begin: int, names: list[str], path: Path) -> Columns:
    """Columns with the unit of the stamps, where their name does not say it and another time of the table, whose name
    does, has their values in that unit. begin: line of the first pose; names: of the columns.

    Raises TrajectoryError where a time of the stamp's name but for the unit has others than it in every unit: in the
    first row or the last, as the parts of one stamp, or times on two clocks have.
    """
    if columns.stamp is None or not columns.clocks:
        return columns
    lines = [line for line in text.split("\n")[begin:] if not is_comment(line)]
    rows = [split(lines[0]), split(lines[-1])]
    for column, unit, same_name in columns.clocks:
        values = [(row[columns.stamp], row[column]) for row in rows]
        ours, theirs = ([one] if one else list(SHIFTS) for one in (columns.time_unit, unit))
        either = columns.time_unit or unit  # of two names without a unit, none says that it is not the other's
        units = [a for a in ours for b in theirs if (either or a == b) and _agree(values, a, b)]
        if same_name and not units:
            one, other = names[columns.stamp], names[column]
            raise TrajectoryError(
                f"{path}: expected one time in {one!r} and {other!r}, by their names, got {values[0][0]:.30} and "
                f"{values[0][1]:.30} first, {values[1][0]:.30} and {values[1][1]:.30} last; delete the one that is not "
                "the stamp of the poses, or say its unit (--time-unit); parts of one stamp are stamp_sec, stamp_nsec"
            )
        if columns.time_unit is None and units and "s" not in units:
            columns = replace(columns, time_unit=units[0])
    return columns


def _agree(values: list[tuple[str, str]], unit: str, other: str) -> bool:
    """Whether pairs of times, the first of each in one unit and the second in another, are the same."""
    try:
        pairs = [(scaled_integer(a, SHIFTS[unit]), scaled_integer(b, SHIFTS[other])) for a, b in values]
    except ValueError:
        return False
    largest = max(abs(value) for pair in pairs for value in pair)
    return all(abs(a - b) <= min(SAME_NS, SAME_PART * largest) for a, b in pairs)
