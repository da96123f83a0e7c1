"""Other representations of a page: JSON, CSV and LaTeX, made from the same tables and values as its HTML."""

from __future__ import annotations

import orjson

from oysterbench.report.renderers import csv_table, latex_tables
from oysterbench_leaderboard.site.page import Page


def represent(page: Page, suffix: str) -> bytes:
    """Represent a page as JSON (its path, title and all data), as CSV (its first table), or as LaTeX (all tables)."""
    if suffix == ".json":
        about = {"path": page.path, "title": page.title}
        return orjson.dumps({**about, **page.data}, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)
    if suffix == ".csv":
        return csv_table(page.tables[0]).encode() if page.tables else b""
    return latex_tables(page.tables, page.title).encode()
