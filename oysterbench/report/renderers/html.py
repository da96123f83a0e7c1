"""A table as HTML; other templates import its macro from "table.html"."""

from __future__ import annotations

from oysterbench.core.html import environment
from oysterbench.report.table import Table

FOLDER = "oysterbench.report"
"""The package whose folder `templates` holds those of reports."""


def html_table(table: Table) -> str:
    """Render a table, which scrolls sideways on a narrow screen, and its notes."""
    return str(environment(FOLDER).get_template("table.html").module.table(table))  # type: ignore[attr-defined]
