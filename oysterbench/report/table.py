"""The one model of a table. `renderers` writes it: to the terminal, as HTML, Markdown, CSV, JSON and LaTeX.

>>> score = Column("score", "Score", kind="number", digits=3, better="higher")
>>> table = Table("Results", (Column("method", "Method"), score), (TableRow(("mine", 0.5)), TableRow(("lost", None))))
>>> table.texts
(('mine', '0.500'), ('lost', '–'))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

from oysterbench.evaluate.statistics import LEVEL, Interval

ABSENT = "\N{EN DASH}"
"""Stands where there is no value."""

ASTRAY = 10_000
"""Shown numbers from which on decimals mean nothing: most are errors of what diverged."""

MINUS = "\N{MINUS SIGN}"

Direction: TypeAlias = Literal["lower", "higher", ""]


@dataclass(frozen=True)
class Estimate:
    """A number with its interval, which is shown in brackets behind it where it is known."""

    value: float | None
    interval: Interval


Value: TypeAlias = str | int | float | Interval | Estimate | None


@dataclass(frozen=True)
class Bar:
    """An interval and its middle to be drawn, as shares (0 to 1) of the axis; of what begins or ends beyond it, low is
    below 0 or high above 1.

    zero:  the share of the axis at which 0 lies, where that is within it
    about: what the axis shows
    """

    low: float
    middle: float
    high: float
    zero: float | None = None
    about: str = "interval drawn from 0 to 1"

    @property
    def ends(self) -> tuple[float, float]:
        """Of what is drawn of it."""
        return max(0.0, self.low), min(1.0, self.high)


@dataclass(frozen=True)
class Cell:
    """A value with more than its looks.

    value: with every digit, in the metric's own unit; what CSV and JSON give, and what a page sorts by
    text:  shown instead of the value as its column writes it
    kind:  how it looks: "best", "warn", "soft"
    about: said where a pointer rests, as the reason why there is no value
    small: second line below the text; mark: a word in a frame behind it
    path:  page of the same site that it leads to; url: another address; small_url: that of the second line
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
        """What is said of it, or why there is no interval."""
        return self.about or (self.value.reason if isinstance(self.value, Interval) else "")

    @property
    def sort_value(self) -> str | float | None:
        """What a page sorts by, where that is not the text."""
        return self.value if isinstance(self.value, str) and self.text is not None else number_of(self.value)


@dataclass(frozen=True)
class Column:
    """A typed column.

    key:     heading in CSV and name in JSON
    heading: heading; short: the same for a terminal, where width is scarce (a line break in it takes the unit's line)
    unit:    of the numbers as shown, below the heading
    kind:    "estimate" is a number with its interval
    digits:  decimals of shown numbers; one more where a number lies below `small`; None: numbers as they are
    factor:  of the shown number over the value; signed: a plus before what is not negative
    cut:     decimals are cut, not rounded, so that nothing less than all is shown as 100 %
    better:  the direction of improvement; about: the definition
    sort:    what an address asks for to sort by it; empty where it cannot be
    hidden:  in CSV and JSON alone; wide: not in a terminal that is too narrow for the table
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
        """Whether its cells stand to the right."""
        return self.kind != "text"

    def texts(self, values: Sequence[Value]) -> list[str]:
        """Values as shown, all with the same decimals, so that the eye can compare them."""
        digits = self.digits
        if digits is not None and self.small:
            digits += any(0 < abs(number * self.factor) < self.small for number in map(number_of, values) if number)
        return [self._text(value, digits) for value in values]

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
        if self.cut and digits is not None:
            shown = math.floor(shown * 10**digits + 1e-9) / 10**digits
        if digits is not None and abs(shown) >= ASTRAY:
            digits = 0
        text = f"{shown:{sign}}" if digits is None else f"{shown:{sign}.{digits}f}"
        return text.replace("-", MINUS)


def interval_column(of: Column, key: str = "", heading: str = f"{LEVEL:.0%}", unit: str = "interval") -> Column:
    """A column of intervals of another column's numbers, written as these are."""
    about = "" if key else f"{LEVEL:.0%} interval of the mean."
    key = key or f"{of.key}_interval"
    return Column(key, heading, unit, "interval", digits=of.digits, factor=of.factor, signed=of.signed, about=about)


def number_of(value: Value) -> float | None:
    """The number in a value; None where there is none."""
    value = value.value if isinstance(value, Estimate) else value
    if value is None or isinstance(value, str | Interval) or not math.isfinite(value):
        return None
    return float(value)


@dataclass(frozen=True)
class TableRow:
    """A value, or a cell, for each column.

    kind: "mean", "failed", "withdrawn", or "first" of a group; key: what a form sends that chooses it
    """

    values: tuple[Value | Cell, ...]
    kind: str = ""
    key: str = ""

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """All as cells."""
        return tuple(value if isinstance(value, Cell) else Cell(value) for value in self.values)


@dataclass(frozen=True)
class Table:
    """Title, columns, rows, and sentences that stand below. name: what a paper refers to it by."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[TableRow, ...]
    notes: tuple[str, ...] = ()
    name: str = ""

    @cached_property
    def shown(self) -> tuple[tuple[int, Column], ...]:
        """Numbers and columns of those that are shown."""
        return tuple((i, column) for i, column in enumerate(self.columns) if not column.hidden)

    @cached_property
    def texts(self) -> tuple[tuple[str, ...], ...]:
        """Every cell as shown, by rows."""
        shown = []
        for i, column in enumerate(self.columns):
            cells = [row.cells[i] for row in self.rows]
            own = iter(column.texts([cell.value for cell in cells if cell.text is None]))
            shown.append([next(own) if cell.text is None else cell.text for cell in cells])
        return tuple(zip(*shown, strict=True))

    @cached_property
    def heads(self) -> int:
        """Number of the column whose cells head the rows: the first of text."""
        return next((i for i, column in self.shown if not column.number), -1)
