"""A page before it is rendered as HTML, JSON, CSV or TeX: its title, template, context and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from oysterbench.core.errors import OysterbenchError
from oysterbench.report.table import Table


class PageError(OysterbenchError):
    """A page that cannot be shown. status: HTTP status; the message says what was expected and got; hints: addresses
    within the site -> what is to be found there."""

    def __init__(self, message: str, status: int = 404, hints: Mapping[str, str] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.hints = dict(hints or {})


class Later(Mapping[str, Any]):
    """A mapping that is made on first access: the JSON of a page that is shown as HTML costs nothing."""

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
    """Content of an address.

    path:    without suffix, as `paths` writes it; query: those parameters of the query that are not at their defaults
    context: values for the template besides title, path and tables
    tables:  CSV has the first; TeX has all
    data:    content of the JSON
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
        """The main table; None where there is none."""
        return self.tables[0] if self.tables else None
