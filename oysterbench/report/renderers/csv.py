"""A table as CSV (RFC 4180): keys as headings, all digits, an empty field where there is no value."""

from __future__ import annotations

import csv
import io
import math

from oysterbench.core.text import IGNORABLE, compatible
from oysterbench.evaluate.statistics import Interval
from oysterbench.report.table import Cell, Column, Estimate, Table

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""Characters that a spreadsheet takes for the start of a formula."""


def csv_table(table: Table) -> str:
    """Write a table, including hidden columns; an interval has a column for each end. Text that a spreadsheet would run
    as a formula is quoted."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([key for column in table.columns for key in _keys(column)])
    for row in table.rows:
        writer.writerow([field for c, cell in zip(table.columns, row.cells, strict=True) for field in _fields(c, cell)])
    return text.getvalue()


def _keys(column: Column) -> list[str]:
    ends = [f"{column.key}_low", f"{column.key}_high"]
    return {"interval": ends, "estimate": [column.key, *ends]}.get(column.kind, [column.key])


def _fields(column: Column, cell: Cell) -> list[str]:
    value = cell.value
    interval = value.interval if isinstance(value, Estimate) else value if isinstance(value, Interval) else None
    ends = [field(interval.low), field(interval.high)] if interval is not None else ["", ""]
    if column.kind == "interval":
        return ends
    number = value.value if isinstance(value, Estimate) else None if isinstance(value, Interval) else value
    first = field(cell.text if number is None and cell.text is not None else number)
    return [first, *ends] if column.kind == "estimate" else [first]


def field(value: str | float | None) -> str:
    """Format a field as text, with all digits; text that looks like a formula gets an apostrophe before it."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, str):
        value = value.replace(
            "\r", "\N{SYMBOL FOR CARRIAGE RETURN}"
        )  # Python's writer leaves it unquoted, where it ends a line
        begins = compatible(IGNORABLE.sub("", value)).lstrip()[:1]  # as a spreadsheet may see it
        return f"'{value}" if value.startswith(FORMULA) or begins in FORMULA else value
    return repr(float(value)) if isinstance(value, float) else str(value)
