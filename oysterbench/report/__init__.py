"""Results to read: tables for the terminal, Markdown, LaTeX and CSV, and a self-contained HTML page."""

from oysterbench.report.columns import COLUMNS, Column
from oysterbench.report.formats import (
    csv_text,
    latex_table,
    latex_text,
    markdown_table,
    markdown_text,
    slam_table,
    tables,
    terminal_table,
)
from oysterbench.report.html import html_report, write_html_report
from oysterbench.report.images import DatasetRow, ImageRun, dataset_tables, images_csv
from oysterbench.report.sequences import SlamRun
from oysterbench.report.tables import comparison_tables, results_table, results_tables, rows, runs_table

__all__ = [
    "COLUMNS",
    "Column",
    "DatasetRow",
    "ImageRun",
    "SlamRun",
    "comparison_tables",
    "csv_text",
    "dataset_tables",
    "html_report",
    "images_csv",
    "latex_table",
    "latex_text",
    "markdown_table",
    "markdown_text",
    "results_table",
    "results_tables",
    "rows",
    "runs_table",
    "slam_table",
    "tables",
    "terminal_table",
    "write_html_report",
]
