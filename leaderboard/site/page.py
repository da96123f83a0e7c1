"""A page, before it is written as HTML, JSON, CSV or TeX: title, template, context, and the tables in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from oysterbench.core.errors import OysterbenchError


class PageError(OysterbenchError):
    """A page that cannot be had. status: of HTTP; the message says what was expected and got; hints: addresses within
    the site -> what is to be found there."""

    def __init__(self, message: str, status: int = 404, hints: Mapping[str, str] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.hints = dict(hints or {})


@dataclass(frozen=True)
class Column:
    """Of a table.

    key:    heading in CSV and name in JSON, with the unit where there is one; text, unit: heading on the page
    about:  its definition; better: the direction of improvement
    sort:   what an address asks for to sort by it; empty where it cannot be
    hidden: in CSV alone
    """

    key: str
    text: str = ""
    unit: str = ""
    number: bool = False
    about: str = ""
    better: Literal["lower", "higher", ""] = ""
    sort: str = ""
    hidden: bool = False


@dataclass(frozen=True)
class Bar:
    """An interval and its middle, as shares (0 to 1) of the axis they are drawn on."""

    low: float
    middle: float
    high: float


@dataclass(frozen=True)
class Cell:
    """Of a table.

    text:  as shown; small: second line below it, mark: a word in a frame behind it, kind: how it looks ("best", "warn")
    value: with every digit, for CSV and for sorting; the text where it is left out
    path:  page of this site that it leads to, url: another address; about: said where a pointer rests
    """

    text: str
    value: str | int | float | None = None
    path: str = ""
    url: str = ""
    small: str = ""
    mark: str = ""
    kind: str = ""
    about: str = ""
    bar: Bar | None = None

    @property
    def plain(self) -> str | int | float:
        """The value, or else the text."""
        return self.text if self.value is None else self.value


@dataclass(frozen=True)
class Line:
    """Of a table: a cell for each column. kind: "first" of a group, "withdrawn", "failed"; key: what a form sends."""

    cells: tuple[Cell, ...]
    kind: str = ""
    key: str = ""


@dataclass(frozen=True)
class Table:
    """Its caption, columns, lines, and sentences that stand below it. name: what a paper refers to it by."""

    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()
    name: str = "table"


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
