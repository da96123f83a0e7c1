"""Results as text files: tables as Markdown and LaTeX, and all runs as CSV."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from oysterbench.evaluate.conditions import CONDITIONS
from oysterbench.report import renderers
from oysterbench.report.table import Column, Table, TableRow, Value
from oysterbench.report.tables import comparison_tables, results_tables
from oysterbench.results.records import ResultRecord

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
"""Columns of a record in CSV, before its conditions and metrics."""


def tables(records: Sequence[ResultRecord], first: Sequence[Table] = ()) -> list[Table]:
    """Tables that every format shows: results by sequence, then the comparison if there is something to compare.

    first: tables that a track shows before them.
    """
    return [*first, *results_tables(records), *comparison_tables(records)]


def csv_text(records: Sequence[ResultRecord]) -> str:
    """Write one line per run with all conditions and metrics, all digits; an empty field where there is no value."""
    conditions = [key for key in CONDITIONS if any(key in record.conditions for record in records)]
    conditions += sorted({key for record in records for key in record.conditions} - set(conditions))
    metrics = list(dict.fromkeys(key for record in records for key in record.metrics))
    columns = (*RUN_COLUMNS, *(f"condition.{key}" for key in conditions), *metrics, "settings")
    lines = []
    for record in records:
        settings = json.dumps({"evaluator": dict(record.settings), "method": dict(record.method_settings)})
        values = [getattr(record, key) for key in RUN_COLUMNS]
        values += [record.conditions.get(key) for key in conditions]
        lines.append((*values, *(record.metrics.get(key) for key in metrics), settings))
    return renderers.csv_table(Table("Runs", tuple(map(Column, columns)), tuple(map(TableRow, lines))))


def csv_of(lines: Sequence[Mapping[str, Any]]) -> str:
    """Write rows, given as column -> value, with all digits; columns in order of first appearance."""
    keys = tuple(dict.fromkeys(key for line in lines for key in line))
    rows: list[tuple[Value, ...]] = [tuple(line.get(key) for key in keys) for line in lines]
    return renderers.csv_table(Table("", tuple(map(Column, keys)), tuple(map(TableRow, rows))))


def markdown_text(records: Sequence[ResultRecord], first: Sequence[Table] = ()) -> str:
    """Write the tables as GitHub Markdown, each with its notes."""
    return "\n".join(map(renderers.markdown_table, tables(records, first)))


def latex_text(records: Sequence[ResultRecord], first: Sequence[Table] = ()) -> str:
    """Write the tables for a paper; they need only the packages stated at the head of the file."""
    return renderers.latex_tables(tables(records, first))
