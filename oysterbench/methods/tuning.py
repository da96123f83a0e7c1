"""Random search over the options of a method; a seed fixes what is tried, in the same way for every method.

Bergstra and Bengio (2012), "Random search for hyper-parameter optimization": if only a few of many options matter,
random points find more than a grid with as many points. The first trial is the method as it is.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.streams import stream
from oysterbench.methods.options import as_word, with_options

DIGITS = 3
"""Significant digits of a drawn value: more make no difference to a method, and names long."""


@dataclass(frozen=True, kw_only=True)
class OptionRange:
    """An option of a method. default: its value, None if the method itself sets it; range: lowest and highest value
    that tuning tries, on a logarithmic scale if `log`, integers only if both are; choices: the allowed values, in place
    of a range. An option with neither is not tuned."""

    default: Any = None
    range: tuple[int | float, int | float] | None = None
    log: bool = False
    choices: tuple[Any, ...] = ()

    @property
    def tuned(self) -> bool:
        """Whether tuning may change it."""
        return self.range is not None or bool(self.choices)

    @property
    def ends(self) -> tuple[Any, ...]:
        """Lowest and highest value that it may get, as it is written, or all choices."""
        if self.range is None:
            return self.choices
        whole = all(isinstance(end, int) for end in self.range)
        return tuple(end if whole else float(end) for end in self.range)

    def draw(self, random: np.random.Generator) -> Any:
        """Draw a value, uniformly over the range (or its logarithm) or the choices. It has three digits, or as many as
        three digits of the range's width need."""
        if self.range is None:
            return self.choices[int(random.integers(len(self.choices)))]
        low, high = self.range
        share = float(random.random())
        whole = isinstance(low, int) and isinstance(high, int)
        if whole:
            low, high = low - 0.5, high + 0.5  # so that both ends are as likely as the values between
        value = low * (high / low) ** share if self.log else low + (high - low) * share
        if whole:
            return min(max(round(value), math.ceil(low)), math.floor(high))
        scale = min(abs(value), high - low) or abs(value) or 1.0
        return float(min(max(round(value, DIGITS - 1 - math.floor(math.log10(scale))), low), high))


def trials(method: str, ranges: Mapping[str, OptionRange], count: int, seed: int = 0) -> list[str]:
    """References of up to `count` variants of a method, itself the first; one that is drawn again is not repeated, nor
    is the method itself, where the ranges say all its values. Raises MethodError if there is nothing to tune.

    >>> trials("mine", {"gain": OptionRange(range=(1.0, 9.0))}, 3)
    ['mine', 'mine[gain=6.93]', 'mine[gain=3.15]']
    """
    tuned = {key: option for key, option in ranges.items() if option.tuned}
    if not tuned:
        raise MethodError(f"method {method!r}: no option has a range or choices to try")
    found = {tuple(_canonical(option.default) for option in tuned.values()): method}
    for number in range(1, count):
        drawn = {key: option.draw(stream(seed, b"", "tune", key, number)) for key, option in tuned.items()}
        values = tuple(map(_canonical, drawn.values()))
        found.setdefault(values, with_options(method, [f"{key}={written(value)}" for key, value in drawn.items()]))
    return list(found.values())


def _canonical(value: Any) -> str | None:
    """Write a value such that equal ones are written alike, 1.0 as 1; None, which is never drawn, stays None."""
    if value is None:
        return None
    return written(int(value) if isinstance(value, float) and value.is_integer() else value)


def written(value: Any) -> str:
    """Write a value as in TOML, but strings without quotes where they need none."""
    if isinstance(value, bool):
        return str(value).lower()
    return as_word(value) if isinstance(value, str) else repr(value)


def read_ranges(path: Path) -> dict[str, OptionRange]:
    """Read a TOML file with a table for each option. Raises MethodError, with file and key, where one is invalid."""
    found, key = {}, ""
    try:
        for key, table in tomllib.loads(path.read_text(encoding="utf-8")).items():
            found[key] = msgspec.convert(table, OptionRange)
            if problem := _problem(table, found[key]):
                raise ValueError(problem)
    except (OSError, ValueError) as error:
        raise MethodError(f"{path}: [{key}] {error}" if key else f"{path}: {error}") from None
    return found


def _problem(table: Mapping[str, Any], option: OptionRange) -> str:
    """What is wrong with the table of an option, empty if nothing is."""
    known = [each.name for each in fields(OptionRange)]
    if unknown := [name for name in table if name not in known]:
        return f"expected {', '.join(known)}, got {unknown[0]!r}"
    if "choices" in table and not option.choices:
        return "choices: expected at least one value, got none"
    if option.choices and option.range is not None:
        return "expected either range or choices, got both"
    if option.range is None:
        return "log: expected a range with it, got none" if option.log else ""
    low, high = option.range
    got = f"got [{low}, {high}]"
    if not (math.isfinite(low) and math.isfinite(high)):
        return f"range: expected finite numbers, {got}"
    if low > high:
        return f"range: expected the lowest value first, {got}"
    return f"range: expected numbers above 0 with log = true, {got}" if option.log and low <= 0 else ""
