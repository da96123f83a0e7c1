"""Griffe extension, loaded by mkdocstrings, that converts docstrings to Markdown."""

from __future__ import annotations

from typing import Any

import griffe

from docs.generate.docstrings import as_markdown


class Layout(griffe.Extension):
    """Extension that applies `as_markdown` to every docstring."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)
