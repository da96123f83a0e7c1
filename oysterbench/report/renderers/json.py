"""A table for JSON: rows keyed by column, all digits, null where there is no value."""

from __future__ import annotations

import math
from typing import Any

from oysterbench.evaluate.statistics import Interval
from oysterbench.report.table import Cell, Estimate, Table, Value


def json_table(table: Table) -> dict[str, Any]:
    """Convert a table: title, columns (key, heading, unit, factor, direction, definition), rows, notes."""
    columns = [
        {"key": c.key, "heading": c.heading, "unit": c.unit, "factor": c.factor, "better": c.better, "about": c.about}
        for c in table.columns
    ]
    return {"title": table.title, "columns": columns, "rows": json_rows(table), "notes": list(table.notes)}


def json_rows(table: Table) -> list[dict[str, Any]]:
    """Convert the rows, including hidden columns."""
    return [{c.key: _plain(cell) for c, cell in zip(table.columns, row.cells, strict=True)} for row in table.rows]


def _plain(cell: Cell) -> Any:
    return cell.text if cell.value is None else plain(cell.value)


def plain(value: Value) -> Any:
    """Convert a value for JSON."""
    if isinstance(value, Estimate):
        return {"value": plain(value.value), **plain(value.interval)}
    if isinstance(value, Interval):
        return {"low": plain(value.low), "high": plain(value.high)}
    return None if isinstance(value, float) and not math.isfinite(value) else value
