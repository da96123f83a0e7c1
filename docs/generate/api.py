"""A page for each public module, whose content mkdocstrings takes from the docstrings."""

from __future__ import annotations

MODULES = {
    "api/index.md": ("oysterbench", "The library"),
    "api/metrics.md": ("oysterbench.metrics", "Metrics"),
    "api/torch.md": ("oysterbench.torch", "Data sets for PyTorch"),
    "api/sequence.md": ("oysterbench.sequence", "Sequences"),
    "api/measurements.md": ("oysterbench.core.measurements", "Measurements"),
    "api/trajectory.md": ("oysterbench.core.trajectory", "Trajectories"),
    "api/methods.md": ("oysterbench.methods", "Methods"),
    "api/slam.md": ("oysterbench.evaluate.slam", "Evaluation of SLAM"),
    "api/segmentation.md": ("oysterbench.evaluate.segmentation", "Evaluation of segmentation"),
    "api/detection.md": ("oysterbench.evaluate.detection", "Evaluation of detection"),
    "api/statistics.md": ("oysterbench.evaluate.statistics", "Statistics"),
    "api/annotations.md": ("oysterbench.annotations", "Labelled images"),
    "api/recipe.md": ("oysterbench.recipe", "Recipes"),
    "api/errors.md": ("oysterbench.core.errors", "Errors"),
}
"""Place below `reference/` -> module, and the title of its page."""


def api_pages() -> dict[str, str]:
    """Place in the site -> Markdown, for the reference of each public module."""
    return {f"reference/{place}": f"# {title}\n\n::: {module}\n" for place, (module, title) in MODULES.items()}
