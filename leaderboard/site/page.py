"""A page, before it is written as HTML, JSON, CSV or TeX: title, template, context, and the tables in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from oysterbench.core.errors import OysterbenchError
from oysterbench.report.table import Table


class PageError(OysterbenchError):
    """A page that cannot be had. status: of HTTP; the message says what was expected and got; hints: addresses within
    the site -> what is to be found there."""

    def __init__(self, message: str, status: int = 404, hints: Mapping[str, str] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.hints = dict(hints or {})


class Later(Mapping[str, Any]):
    """Values that are made when somebody asks for them: the JSON of a page that is read as HTML costs nothing."""

    def __init__(self, make: Callable[[], Mapping[str, Any]]) -> None:
        self._make = make

    @cached_property
    def _made(self) -> Mapping[str, Any]:
        return self._make()

    def __getitem__(self, key: str) -> Any:
        return self._made[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


@dataclass(frozen=True)
class Page:
    """What an address stands for.

    path:    without suffix, as `paths` writes it; query: what of the question is not as usual
    context: what the template is given besides title, path and tables
    tables:  the first is what CSV gives; TeX gives all
    data:    what JSON gives
    """

    path: str
    title: str
    template: str
    context: Mapping[str, Any] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    query: Mapping[str, str | list[str]] = field(default_factory=dict)

    @property
    def table(self) -> Table | None:
        """The main one."""
        return self.tables[0] if self.tables else None
