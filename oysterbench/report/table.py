"""The common model of a table. `renderers` writes it to the terminal, as HTML, Markdown, CSV, JSON and LaTeX.

>>> score = Column("score", "Score", kind="number", digits=3, better="higher")
>>> table = Table("Results", (Column("method", "Method"), score), (TableRow(("mine", 0.5)), TableRow(("lost", None))))
>>> table.texts
(('mine', '0.500'), ('lost', '–'))
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

from oysterbench.evaluate.statistics import LEVEL, Interval

ABSENT = "\N{EN DASH}"
"""Shown where there is no value."""

ASTRAY = 10_000
"""Numbers from which on decimals are meaningless: most are errors of diverged estimates."""

ENDLESS = 1e9
"""Numbers from which on three digits and a power of ten are shown, so that one cell does not widen a whole table."""

MINUS = "\N{MINUS SIGN}"

MOST_MORE = 6
"""Maximum number of decimals added to show that an interval excludes zero."""

Direction: TypeAlias = Literal["lower", "higher", ""]


@dataclass(frozen=True)
class Estimate:
    """A number with its interval, which is shown in brackets after it if it is known."""

    value: float | None
    interval: Interval


Value: TypeAlias = str | int | float | Interval | Estimate | None


@dataclass(frozen=True)
class Bar:
    """An interval and its middle to be drawn, as shares (0 to 1) of the axis; if it extends beyond the axis, low is
    below 0 or high above 1.

    zero:  the share of the axis at which 0 lies, if it is within the axis
    about: what the axis shows
    """

    low: float
    middle: float
    high: float
    zero: float | None = None
    about: str = "interval drawn from 0 to 1"

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends of the part that is drawn."""
        return max(0.0, self.low), min(1.0, self.high)


@dataclass(frozen=True)
class Cell:
    """A value with its presentation.

    value: with all digits, in the metric's own unit; written to CSV and JSON, and used by pages for sorting
    text:  shown instead of the value as formatted by its column
    kind:  style: "best", "warn", "soft"
    about: tooltip, such as the reason why there is no value
    small: second line below the text; mark: a framed word after it
    path:  page of the same site that it links to; url: another address; small_url: link of the second line
    """

    value: Value = None
    text: str | None = None
    kind: str = ""
    about: str = ""
    small: str = ""
    mark: str = ""
    path: str = ""
    url: str = ""
    small_url: str = ""
    bar: Bar | None = None

    @property
    def reason(self) -> str:
        """Tooltip, or the reason why there is no interval."""
        return self.about or (self.value.reason if isinstance(self.value, Interval) else "")

    @property
    def sort_value(self) -> str | float | None:
        """Value that a page sorts by, if it is not the text."""
        return self.value if isinstance(self.value, str) and self.text is not None else number_of(self.value)


@dataclass(frozen=True)
class Column:
    """A typed column.

    key:     heading in CSV and key in JSON
    heading: heading; short: the same for a terminal, where width is scarce (a second line in it replaces the unit)
    unit:    of the numbers as shown; printed below the heading
    kind:    "estimate" is a number with its interval
    digits:  decimals shown, one more if a number is below `small`; None: numbers as they are
    factor:  shown number divided by the value; signed: whether to put a plus before non-negative numbers
    cut:     truncate decimals instead of rounding, so that nothing less than all is shown as 100 %
    better:  direction of improvement; about: definition
    sort:    key with which a URL asks to sort by it; empty if it cannot
    hidden:  only in CSV and JSON; wide: omitted in a terminal that is too narrow for the table
    """

    key: str
    heading: str = ""
    unit: str = ""
    kind: Literal["text", "number", "interval", "estimate"] = "text"
    short: str = ""
    digits: int | None = None
    small: float = 0.0
    factor: float = 1.0
    signed: bool = False
    cut: bool = False
    better: Direction = ""
    about: str = ""
    sort: str = ""
    hidden: bool = False
    wide: bool = False

    @property
    def number(self) -> bool:
        """Whether its cells are right-aligned."""
        return self.kind != "text"

    def texts(self, values: Sequence[Value]) -> list[str]:
        """Format values as shown, all with the same number of decimals, so that they are easy to compare."""
        digits = self.digits
        if digits is not None and self.small:
            digits += any(0 < abs(number * self.factor) < self.small for number in map(number_of, values) if number)
        return [self._text(value, digits) for value in values]

    def resolving(self, intervals: Iterable[Interval]) -> Column:
        """The same column with as many decimals as show which of these intervals exclude zero.

        >>> Column("difference", kind="interval", digits=2).resolving([Interval(0.0004, 0.07)]).digits
        4
        """
        if self.digits is None:
            return self
        excluding = [one for one in intervals if one.known and one.low * one.high > 0]
        ends = [self.factor * min(abs(one.low), abs(one.high)) for one in excluding]
        needed = [math.ceil(-math.log10(2 * end)) for end in ends]
        return replace(self, digits=min(max([self.digits, *needed]), self.digits + MOST_MORE))

    def text(self, value: Value) -> str:
        """One value as shown."""
        return self.texts([value])[0]

    def _text(self, value: Value, digits: int | None) -> str:
        if isinstance(value, Estimate):
            bracketed = f" [{self._text(value.interval, digits)}]" if value.interval.known else ""
            return self._text(value.value, digits) + bracketed
        if isinstance(value, Interval):
            known = value.known and math.isfinite(value.low) and math.isfinite(value.high)
            return f"{self._text(value.low, digits)} to {self._text(value.high, digits)}" if known else ABSENT
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return ABSENT
        if isinstance(value, str):
            return value
        shown, sign = value if self.factor == 1.0 else value * self.factor, "+" if self.signed else ""
        if digits is not None and abs(shown) >= ENDLESS:
            return f"{shown:{sign}.3g}".replace("-", MINUS)
        if self.cut and digits is not None:
            shown = math.floor(shown * 10**digits + 1e-9) / 10**digits
        if digits is not None and abs(shown) >= ASTRAY:
            digits = 0
        if digits is not None and round(shown, digits) == 0:
            shown, sign = abs(shown), ""
        text = f"{shown:{sign}}" if digits is None else f"{shown:{sign}.{digits}f}"
        return text.replace("-", MINUS)


def interval_column(of: Column, key: str = "", heading: str = f"{LEVEL:.0%}", unit: str = "interval") -> Column:
    """Make a column for intervals of another column's numbers, in the same format."""
    about = "" if key else f"{LEVEL:.0%} interval of the mean."
    key = key or f"{of.key}_interval"
    return Column(key, heading, unit, "interval", digits=of.digits, factor=of.factor, signed=of.signed, about=about)


def number_of(value: Value) -> float | None:
    """Number in a value; None if there is none."""
    value = value.value if isinstance(value, Estimate) else value
    if value is None or isinstance(value, str | Interval) or not math.isfinite(value):
        return None
    return float(value)


@dataclass(frozen=True)
class TableRow:
    """A row: a value, or a cell, for each column.

    kind: "mean", "failed", "withdrawn", or "first" of a group; key: value that a form sends to select it
    """

    values: tuple[Value | Cell, ...]
    kind: str = ""
    key: str = ""

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """All values as cells."""
        return tuple(value if isinstance(value, Cell) else Cell(value) for value in self.values)


@dataclass(frozen=True)
class Table:
    """A table: title, columns, rows, and notes below it. name: label by which a paper refers to it."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[TableRow, ...]
    notes: tuple[str, ...] = ()
    name: str = ""

    @cached_property
    def shown(self) -> tuple[tuple[int, Column], ...]:
        """Indices and columns of those that are shown."""
        return tuple((i, column) for i, column in enumerate(self.columns) if not column.hidden)

    @cached_property
    def texts(self) -> tuple[tuple[str, ...], ...]:
        """Text of every cell as shown, by rows."""
        shown = []
        for i, column in enumerate(self.columns):
            cells = [row.cells[i] for row in self.rows]
            own = iter(column.texts([cell.value for cell in cells if cell.text is None]))
            shown.append([next(own) if cell.text is None else cell.text for cell in cells])
        return tuple(zip(*shown, strict=True))

    @cached_property
    def heads(self) -> int:
        """Index of the column whose cells head the rows: the first text column; -1 if there is none."""
        return next((i for i, column in self.shown if not column.number), -1)
