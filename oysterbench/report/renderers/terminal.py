"""A table for the terminal."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from oysterbench.core.text import printable
from oysterbench.report.table import Column, Table

if TYPE_CHECKING:
    from rich.table import Table as RichTable

UNBOUNDED = 10_000
SPACE = 2
"""Characters between columns."""
LEAST_NAME = 12
"""Width in characters below which a name is not broken into lines."""
PROSE = 40
"""Width in characters that suffices to read a column of sentences, which take several lines."""
STYLES = {"best": "bold green", "warn": "red"}
"""Kind of a cell -> its style in colour."""


def terminal_table(table: Table, titled: bool = True, width: int = UNBOUNDED) -> RichTable:
    """Render a table for rich, with its notes below it. width: of the terminal, in characters; if it is too small,
    `wide` columns are left out and then, if it is too small for names broken into lines, all but the first ones up to
    the first by which rows are judged; in both cases the last of them first. They are named below."""
    shown = [i for i, _ in table.shown]
    for i in reversed([i for i in shown if table.columns[i].wide]):
        if sum(min(_width(table, k), PROSE + SPACE) for k in shown) > width:
            shown.remove(i)
    judged = next((i for i in shown if table.columns[i].better), table.heads)
    for i in reversed([i for i in shown if i > judged >= 0]):
        if sum(_least_width(table, k) for k in shown) > width:
            shown.remove(i)
    left_out = [" ".join(_heading(column).split()) for i, column in table.shown if i not in shown]
    notes = [*table.notes, *([f"Left out at this width: {', '.join(left_out)}."] if left_out else [])]
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

    def styled(text: str, style: str) -> Text:
        return Text(printable(text), style=style)

    made = RichTable(
        title=styled(table.title, "bold") if titled else None,
        title_style="",
        title_justify="left",
        header_style="bold",
        caption=styled("\n".join(notes), "yellow") if notes else None,
        caption_style="",
        caption_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for i in shown:
        column = table.columns[i]
        if column.number:
            made.add_column(_heading(column), justify="right", no_wrap=True)
        else:
            made.add_column(_heading(column), overflow="fold", min_width=_least_width(table, i) - SPACE)
    means = [row.kind == "mean" for row in table.rows]
    ends = [not before and after for before, after in pairwise([*means, False])]
    for row, texts, end in zip(table.rows, table.texts, ends, strict=True):
        cells = [styled(texts[i], STYLES.get(row.cells[i].kind, "")) for i in shown]
        made.add_row(*cells, style="bold" if row.kind == "mean" else "", end_section=end)
    return made


def _width(table: Table, i: int) -> int:
    """Width in characters of a column, with the space that separates it from the next one."""
    from rich.cells import cell_len

    lines = [*_heading(table.columns[i]).split("\n"), *(row[i] for row in table.texts)]
    return max(map(cell_len, lines)) + SPACE


def _least_width(table: Table, i: int) -> int:
    """Width in characters that a column needs: all of it for numbers, for text that of a name broken into lines."""
    width = _width(table, i)
    return width if table.columns[i].number else min(width, LEAST_NAME + SPACE)


def _heading(column: Column) -> str:
    heading = column.short or column.heading
    return heading if "\n" in heading or not column.unit else f"{heading}\n{column.unit}"
