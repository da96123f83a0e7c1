"""HTML from Jinja2 templates: always escaped, and an undefined name is an error."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


@lru_cache(maxsize=16)
def environment(*packages: str) -> Environment:
    """Jinja2 environment with the templates of packages, each from its folder `templates`, then those of core:
    `page.html` is the frame that pages extend."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in (*packages, "oysterbench.core")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
    made.globals["ARROWS"] = {"lower": "\N{DOWNWARDS ARROW}", "higher": "\N{UPWARDS ARROW}", "": ""}
    made.filters["capital"] = capital
    return made


def render(template: str, context: Mapping[str, Any], *packages: str) -> str:
    """Render a template with the values of `context`."""
    return environment(*packages).get_template(template).render(**context)


def capital(text: str, names: Collection[str] = ()) -> str:
    """Capitalise the first letter of a sentence, unless it is that of one of `names`; the rest stays as it is.

    >>> capital("one GPU"), capital("slam-mini is small", names=["slam-mini"])
    ('One GPU', 'slam-mini is small')
    """
    named = any(re.match(rf"{re.escape(name)}(?![\w-])", text) for name in names if name)
    return text if named else text[:1].upper() + text[1:]
