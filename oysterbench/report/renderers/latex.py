"""Tables for a paper with booktabs: all text is escaped, and the packages and engine that it needs are stated."""

from __future__ import annotations

import re
from collections.abc import Sequence

from oysterbench.report.table import Cell, Column, Table

NEEDS = "% needs \\usepackage{booktabs,graphicx}"
"""Comment at the head of a file of tables."""

SYMBOLS = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "\N{EN DASH}": "--",
    "\N{MINUS SIGN}": "$-$",
    "\N{SUPERSCRIPT TWO}": r"\textsuperscript{2}",
    "\N{DOWNWARDS ARROW}": r"$\downarrow$",
    "\N{UPWARDS ARROW}": r"$\uparrow$",
    "\N{RIGHTWARDS ARROW}": r"$\rightarrow$",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
    "\N{PLUS-MINUS SIGN}": r"$\pm$",
    "\N{LESS-THAN OR EQUAL TO}": r"$\leq$",
    "\N{GREATER-THAN OR EQUAL TO}": r"$\geq$",
    "\N{DEGREE SIGN}": r"$^{\circ}$",
    "\N{MICRO SIGN}": r"$\mu$",
    "\N{GREEK SMALL LETTER MU}": r"$\mu$",
    "\N{MIDDLE DOT}": r"$\cdot$",
    "\N{SUPERSCRIPT THREE}": r"\textsuperscript{3}",
    "\N{HORIZONTAL ELLIPSIS}": r"\ldots{}",
    "\N{EM DASH}": "---",
    "\N{LEFT SINGLE QUOTATION MARK}": "`",
    "\N{RIGHT SINGLE QUOTATION MARK}": "'",
    "\N{LEFT DOUBLE QUOTATION MARK}": "``",
    "\N{RIGHT DOUBLE QUOTATION MARK}": "''",
    "\N{NO-BREAK SPACE}": " ",
    "\N{NARROW NO-BREAK SPACE}": r"\,",
}
"""Escapes for characters that are commands, and for those that pdfLaTeX does not know, or only in some fonts."""

LIGATURES = ("--", ",,", "''", "``", "!`", "?`")
"""Pairs that TeX would typeset as one character."""

AFTER_LINES = ("[", "*")
"""Characters that would be taken for a part of the line break before them."""

LATIN = re.compile("[\u00a1-\u017f]")
"""Letters and signs in the T1 encoding."""

OTHER = re.compile("[^\x00-\x7f\u00a1-\u017f]")


def latex_tables(tables: Sequence[Table], about: str = "") -> str:
    """Write a file of tables, which needs only what is stated at its head; about: a comment before them."""
    written = [_table(table) for table in tables]
    return "\n".join([*needs("\n".join(written)), *([f"% {_comment(about)}"] if about else []), *written])


def _table(table: Table) -> str:
    """Write a table, scaled down if it is wider than the line."""
    shown = table.shown
    units = [latex_escape(f"[{column.unit}]") if column.unit else "" for _, column in shown]
    label = [rf"\label{{tab:{re.sub('[^a-z0-9-]+', '-', table.name)}}}"] if table.name else []
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex_escape(table.title)}}}",
        *label,
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        rf"\begin{{tabular}}{{{''.join('r' if column.number else 'l' for _, column in shown)}}}",
        r"\toprule",
        _row([latex_escape(column.heading) for _, column in shown]),
        *([_row(units)] if any(units) else []),
        r"\midrule",
    ]
    kinds = [row.kind for row in table.rows]
    for k, (row, texts) in enumerate(zip(table.rows, table.texts, strict=True)):
        if k and kinds[k] == "mean" != kinds[k - 1]:
            lines.append(r"\midrule")
        lines.append(_row([_cell(texts[i], row.cells[i], column) for i, column in shown]))
    notes = [f"% {_comment(note)}" for note in table.notes]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}}", r"\end{table}", *notes, ""])


def _row(cells: Sequence[str]) -> str:
    return f"{' & '.join(cells)} \\\\"


def _cell(text: str, cell: Cell, column: Column) -> str:
    small = f" ({cell.small})" if cell.small and not column.number else ""
    written = latex_escape(f"{text}{small}{f' ({cell.mark})' if cell.mark else ''}")
    return rf"\textbf{{{written}}}" if cell.kind == "best" else written


def _comment(text: str) -> str:
    """Put a comment on one line, since a line break would end it."""
    return " ".join(text.split())


def latex_escape(text: str) -> str:
    """Escape text so that nothing in it is a command."""
    text = " ".join(re.split(r"[ \t\r\n]+", text.strip()))
    found = []
    for i, character in enumerate(text):
        found.append(SYMBOLS.get(character, character))
        if text[i : i + 2] in LIGATURES:
            found.append("{}")
    written = "".join(found)
    return f"{{{written}}}" if text.startswith(AFTER_LINES) else written


def needs(written: str) -> list[str]:
    """Comments for the head of a file: the packages, and the engine, that it needs."""
    needed = [NEEDS]
    code = re.sub(r"(?m)(?<!\\)%.*$", "", written)
    if LATIN.search(code):
        needed.append("% needs \\usepackage[T1]{fontenc}")
    if others := "".join(dict.fromkeys(OTHER.findall(code))):
        needed.append(f"% needs lualatex or xelatex, and a font that has {' '.join(others)}")
    return needed
