"""Examples in docstrings that stand outside of a section of their own, as blocks of code: a griffe extension."""

from __future__ import annotations

import re
from typing import Any

import griffe

_EXAMPLE = re.compile(r"^>>> .*(?:\n(?!\n).+)*", re.M)
_SECTION = re.compile(r"^Examples\n-+$", re.M)


def fenced(docstring: str) -> str:
    """A docstring with its loose examples in fences; those of a section `Examples` are recognised anyway."""
    section = _SECTION.search(docstring)
    end = section.start() if section else len(docstring)
    return _EXAMPLE.sub(lambda match: f"```pycon\n{match.group()}\n```", docstring[:end]) + docstring[end:]


class LooseExamples(griffe.Extension):
    """Applies `fenced` to every docstring."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            obj.docstring.value = fenced(obj.docstring.value)
