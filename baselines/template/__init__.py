"""A method to start from: copy the folder."""

from oysterbench_baselines.template.method import Template

__all__ = ["Template"]
