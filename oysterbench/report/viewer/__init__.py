"""Viewer of a sequence as one self-contained HTML page."""

from oysterbench.report.viewer.page import view_page

__all__ = ["view_page"]
