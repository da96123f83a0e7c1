"""A sequence as one HTML page that needs nothing else."""

from oysterbench.report.viewer.page import view_page

__all__ = ["view_page"]
