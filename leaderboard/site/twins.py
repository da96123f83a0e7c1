"""A page in other forms: JSON, CSV, LaTeX, made of the same tables and values as its HTML."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence

import orjson

from oysterbench.report.formats import latex_tabular
from oysterbench_leaderboard.latex import escape, needs
from oysterbench_leaderboard.site.page import Cell, Column, Page, Table

RISKY = ("=", "+", "-", "@", "\t", "\r")
"""What a spreadsheet takes for the begin of a formula."""


def twin(page: Page, suffix: str) -> bytes:
    """A page's twin."""
    if suffix == ".json":
        return json_bytes(page)
    return (csv_text(page.tables) if suffix == ".csv" else tex_text(page)).encode()


def json_bytes(page: Page) -> bytes:
    """What the page is about, and all that it holds."""
    about = {"path": page.path, "title": page.title}
    return orjson.dumps({**about, **page.data}, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def csv_text(tables: Sequence[Table]) -> str:
    """The first table, every digit, headings by their keys; text that a spreadsheet would run is quoted."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for table in tables[:1]:
        writer.writerow([column.key for column in table.columns])
        for line in table.lines:
            writer.writerow([_field(cell.plain) for cell in line.cells])
    return text.getvalue()


def _field(value: str | int | float) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    if isinstance(value, int):
        return str(value)
    bare = value.lstrip()
    return f"'{value}" if value.startswith(RISKY) or bare.startswith(RISKY) else value


def tex_text(page: Page) -> str:
    """All tables; what they need is said before them."""
    tables = [_tex(table) for table in page.tables]
    return "\n".join([*needs("\n".join(tables)), f"% {_comment(page.title)}", *tables])


def _tex(table: Table) -> str:
    shown = [(i, column) for i, column in enumerate(table.columns) if not column.hidden]
    units = [escape(f"[{column.unit}]") if column.unit else "" for _, column in shown]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{escape(table.title)}}}",
        rf"\label{{tab:{re.sub('[^a-z0-9-]+', '-', table.name)}}}",
    ]
    rows = [
        f"{' & '.join(escape(column.text) for _, column in shown)} \\\\",
        *([f"{' & '.join(units)} \\\\"] if any(units) else []),
        r"\midrule",
    ]
    for line in table.lines:
        rows.append(f"{' & '.join(_tex_cell(line.cells[i], column) for i, column in shown)} \\\\")
    notes = [f"% {_comment(note)}" for note in table.notes]
    columns = "".join("r" if column.number else "l" for _, column in shown)
    return "\n".join([*lines, *latex_tabular(columns, rows), r"\end{table}", *notes, ""])


def _tex_cell(cell: Cell, column: Column) -> str:
    mark = f" ({cell.mark})" if cell.mark else ""
    small = f" ({cell.small})" if cell.small and not column.number else ""
    return escape(f"{cell.text}{small}{mark}")


def _comment(text: str) -> str:
    """In one line, as what follows a line break is no comment."""
    return " ".join(text.split())
