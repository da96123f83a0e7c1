"""Presentation of results: tables for the terminal, Markdown, LaTeX and CSV, figures, and self-contained HTML pages."""

from oysterbench.report.formats import csv_text, latex_text, markdown_text, tables
from oysterbench.report.html import html_report, write_html_report
from oysterbench.report.images import DatasetRow, ImageRun, dataset_tables, images_csv
from oysterbench.report.renderers import terminal_table
from oysterbench.report.sequences import SlamRun
from oysterbench.report.table import Column, Table, TableRow
from oysterbench.report.tables import comparison_tables, results_table, results_tables, runs_table

__all__ = [
    "Column",
    "DatasetRow",
    "ImageRun",
    "SlamRun",
    "Table",
    "TableRow",
    "comparison_tables",
    "csv_text",
    "dataset_tables",
    "html_report",
    "images_csv",
    "latex_text",
    "markdown_text",
    "results_table",
    "results_tables",
    "runs_table",
    "tables",
    "terminal_table",
    "write_html_report",
]
