"""Markdown elements that the generated pages are made of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table; cells are Markdown on one line, in which a bar is written as an entity."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines) + "\n"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "&#124;")


def code(text: object) -> str:
    """Write text as inline code."""
    return f"`{text}`"


def fence(text: str, language: str = "text") -> str:
    """Write text as a block of code."""
    return f"```{language}\n{text}\n```\n"
