"""A table as GitHub Markdown."""

from __future__ import annotations

import re
from collections.abc import Sequence

from oysterbench.report.table import Table


def markdown_table(table: Table) -> str:
    """Render title, table, and its notes; the best cells are bold."""
    shown = table.shown
    lines = [
        f"### {escape(table.title)}\n",
        _pipes([escape(f"{c.heading} [{c.unit}]" if c.unit else c.heading) for _, c in shown]),
        _pipes(["---:" if column.number else ":---" for _, column in shown]),
    ]
    for row, texts in zip(table.rows, table.texts, strict=True):
        cells = [escape(texts[i] + (f" ({row.cells[i].mark})" if row.cells[i].mark else "")) for i, _ in shown]
        bold = [row.cells[i].kind == "best" for i, _ in shown]
        lines.append(_pipes([f"**{cell}**" if best else cell for cell, best in zip(cells, bold, strict=True)]))
    return "\n".join([*lines, "", *(f"{escape(note)}\n" for note in table.notes)])


def _pipes(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def escape(text: str) -> str:
    """Escape text so that nothing in it is markup."""
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", " ".join(text.split()))
