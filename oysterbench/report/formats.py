"""Tables in text: for the terminal, as Markdown, as LaTeX (booktabs, graphicx); and all runs as CSV."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from oysterbench.evaluate.conditions import CONDITIONS
from oysterbench.report.tables import Table, comparison_tables, results_table, results_tables
from oysterbench.results.records import ResultRecord

if TYPE_CHECKING:
    from rich.table import Table as RichTable

RUN_COLUMNS = (
    "track",
    "split",
    "split_digest",
    "sequence",
    "method",
    "run",
    "seed",
    "failure",
    "evaluator_version",
    "oysterbench_version",
    "created",
)
"""Of a record, before its conditions and metrics, in CSV."""

LATEX_NEEDS = "% needs \\usepackage{booktabs,graphicx}"
"""Stands at the head of a file of tables."""

_LATEX = {
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
    "\n": " ",
}


def tables(records: Sequence[ResultRecord], first: Sequence[Table] = ()) -> list[Table]:
    """What every form shows: results by sequence, then the comparison where there is something to compare.

    first: what a track shows before them.
    """
    return [*first, *results_tables(records), *comparison_tables(records)]


def csv_text(records: Sequence[ResultRecord], first: Sequence[Table] = ()) -> str:
    """One line per run, all conditions and metrics, every digit; an empty field where there is no value. No tables."""
    conditions = [key for key in CONDITIONS if any(key in record.conditions for record in records)]
    conditions += sorted({key for record in records for key in record.conditions} - set(conditions))
    metrics = list(dict.fromkeys(key for record in records for key in record.metrics))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*RUN_COLUMNS, *(f"condition.{key}" for key in conditions), *metrics, "settings"])
    for record in records:
        values: list[Any] = [getattr(record, key) for key in RUN_COLUMNS]
        values += [record.conditions.get(key) for key in conditions]
        values += [record.metrics.get(key) for key in metrics]
        values.append(json.dumps({"evaluator": dict(record.settings), "method": dict(record.method_settings)}))
        writer.writerow([_field(value) for value in values])
    return text.getvalue()


def _field(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return repr(float(value)) if isinstance(value, float) else str(value)


def markdown_text(records: Sequence[ResultRecord], first: Sequence[Table] = ()) -> str:
    """Tables as GitHub shows them, each with what stands below it."""
    return "\n".join(markdown_table(table) for table in tables(records, first))


def markdown_table(table: Table) -> str:
    """One table as GitHub shows it, with what stands below it."""
    headings = [_markdown_text(f"{h.text} [{h.unit}]" if h.unit else h.text) for h in table.headings]
    lines = [
        f"### {_markdown_text(table.title)}\n",
        _pipes(headings),
        _pipes(["---:" if heading.number else ":---" for heading in table.headings]),
    ]
    for line in table.lines:
        cells = [_markdown_text(cell) for cell in line.cells]
        best = line.best or (False,) * len(cells)
        lines.append(_pipes([f"**{cell}**" if mark else cell for cell, mark in zip(cells, best, strict=True)]))
    return "\n".join([*lines, "", *(f"{_markdown_text(note)}\n" for note in table.notes)])


def _pipes(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _markdown_text(text: str) -> str:
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", " ".join(text.split()))


def latex_text(records: Sequence[ResultRecord], first: Sequence[Table] = ()) -> str:
    """Tables for a paper, which need what `LATEX_NEEDS` says and nothing else."""
    return "\n".join([LATEX_NEEDS, *(latex_table(table) for table in tables(records, first))])


def latex_table(table: Table) -> str:
    """One table for a paper."""
    columns = "".join("r" if heading.number else "l" for heading in table.headings)
    units = [latex_escape(f"[{h.unit}]") if h.unit else "" for h in table.headings]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex_escape(table.title)}}}",
    ]
    rows = [
        f"{' & '.join(latex_escape(heading.text) for heading in table.headings)} \\\\",
        *([f"{' & '.join(units)} \\\\"] if any(units) else []),
        r"\midrule",
    ]
    before = ""
    for line in table.lines:
        if line.kind == "mean" and before not in ("mean", "") and line is not table.lines[0]:
            rows.append(r"\midrule")
        before = line.kind or "line"
        cells = [latex_escape(cell) for cell in line.cells]
        best = line.best or (False,) * len(cells)
        marked = [rf"\textbf{{{cell}}}" if mark else cell for cell, mark in zip(cells, best, strict=True)]
        rows.append(f"{' & '.join(marked)} \\\\")
    notes = [f"% {' '.join(note.split())}" for note in table.notes]
    return "\n".join([*lines, *latex_tabular(columns, rows), r"\end{table}", *notes, ""])


def latex_tabular(columns: str, rows: Sequence[str]) -> list[str]:
    """Lines of a tabular between rules, made smaller where it would not fit into the line. columns: as LaTeX's."""
    return [
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        *rows,
        r"\bottomrule",
        r"\end{tabular}}",
    ]


def latex_escape(text: str) -> str:
    """Text in which nothing is a command; a bracket or a star after a line break would be taken for a part of it."""
    escaped = "".join(_LATEX.get(character, character) for character in text)
    return f"{{{escaped}}}" if escaped.startswith(("[", "*")) else escaped


def terminal_table(table: Table, colour: bool = True, titled: bool = True) -> RichTable:
    """For the terminal; what stands below the table stands below it in words."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

    title = Text(table.title, style="bold" if colour else "") if titled else None
    made = RichTable(
        title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, caption_justify="left", title_justify="left"
    )
    made.title_style = ""
    made.header_style = "bold" if colour else ""
    two_lines = any(heading.unit for heading in table.headings)
    for heading in table.headings:
        text = f"{heading.text}\n{heading.unit}" if two_lines else heading.text
        if heading.number:
            made.add_column(text, justify="right", no_wrap=True)
        else:
            made.add_column(heading.text, overflow="fold")
    before = ""
    for line in table.lines:
        if line.kind == "mean" and before == "line":
            made.add_section()
        before = line.kind if line.kind == "mean" else "line"
        cells = []
        for i, cell in enumerate(line.cells):
            style = "bold green" if line.best and line.best[i] else ""
            if line.kind == "failed" and table.headings[i].text == "method":
                style = "red"
            cells.append(Text(cell, style=style if colour else ""))
        made.add_row(*cells, style="bold" if colour and line.kind == "mean" else "")
    if table.notes:
        made.caption = Text("\n".join(table.notes), style="yellow" if colour else "")
        made.caption_style = ""
    return made


def slam_table(records: Sequence[ResultRecord], colour: bool = True) -> RichTable:
    """Results by sequence in at most 80 columns where names are short; failures and notes stand below."""
    return terminal_table(results_table(records), colour, titled=False)
