"""Renderers of the table model: one module per format."""

from oysterbench.report.renderers.csv import csv_table
from oysterbench.report.renderers.html import html_table
from oysterbench.report.renderers.json import json_rows, json_table
from oysterbench.report.renderers.latex import latex_escape, latex_tables
from oysterbench.report.renderers.markdown import markdown_table
from oysterbench.report.renderers.terminal import terminal_table

__all__ = [
    "csv_table",
    "html_table",
    "json_rows",
    "json_table",
    "latex_escape",
    "latex_tables",
    "markdown_table",
    "terminal_table",
]
