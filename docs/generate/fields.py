"""Fields of a dataclass with their documentation in the source: comments after or above them, or the string below."""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import io
import tokenize
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Told:
    """A field and its documentation in the source; empty if there is none."""

    field: dataclasses.Field[Any]
    text: str


def told_fields(kind: type) -> list[Told]:
    """Fields of a dataclass, including inherited ones, in order."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if dataclasses.is_dataclass(base):
            # A field that only narrows the inherited one keeps its text.
            texts |= {name: text for name, text in _texts(base).items() if text or name not in texts}
    return [Told(field, texts.get(field.name, "")) for field in dataclasses.fields(kind)]


@functools.cache
def _texts(kind: type) -> dict[str, str]:
    """Field -> text, for the fields that the class itself defines."""
    source = inspect.getsource(kind)
    comments = _comments(source)
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    texts: dict[str, str] = {}
    for statement, following in zip(definition.body, [*definition.body[1:], None], strict=True):
        if not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)):
            continue
        behind = [comments.pop(line, "") for line in range(statement.lineno, (statement.end_lineno or 0) + 1)]
        block = _block_above(comments, statement.lineno)
        texts[statement.target.id] = " ".join(filter(None, (block, *behind, _text_of(following))))
    return texts


def _comments(source: str) -> dict[int, str]:
    """Line number -> comment."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}


def _block_above(comments: dict[int, str], line: int) -> str:
    block: list[str] = []
    while (line := line - 1) in comments:
        block.insert(0, comments.pop(line))
    return " ".join(block)


def _text_of(statement: ast.stmt | None) -> str:
    """Text of a string that is a statement of its own, on one line; else empty."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        return " ".join(str(statement.value.value).split())
    return ""
