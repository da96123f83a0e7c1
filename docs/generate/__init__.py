"""Pages of the site that are generated from the code at build time, so that they are never out of date."""

from __future__ import annotations

from docs.generate.api import api_pages
from docs.generate.citation import citation_page
from docs.generate.commands import commands_page
from docs.generate.metrics import metrics_page
from docs.generate.recipes import recipe_page, rig_page
from docs.generate.splits import splits_page
from docs.generate.topics import topics_page
from docs.generate.versions import versions_page


def generated_pages() -> dict[str, str]:
    """Place in the site -> Markdown, for every page that is generated from the code."""
    return {
        "reference/commands.md": commands_page(),
        "reference/recipe.md": recipe_page(),
        "reference/rig.md": rig_page(),
        "reference/topics.md": topics_page(),
        "reference/metrics.md": metrics_page(),
        "reference/splits.md": splits_page(),
        "reference/evaluators.md": versions_page(),
        "citing.md": citation_page(),
        **api_pages(),
    }
