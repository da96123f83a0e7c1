"""Random search over the options of a method: what is tried is fixed by a seed, for every method alike.

Bergstra and Bengio (2012), "Random search for hyper-parameter optimization": with few of many options deciding, points
drawn at random find more than a grid of as many. The first trial is the method as it is.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.streams import stream
from oysterbench.methods.options import with_options


@dataclass(frozen=True, kw_only=True)
class OptionRange:
    """An option of a method. default: its value, None where the method itself has it; range: lowest and highest that
    tuning tries, on a scale of logarithms where `log` is true, whole numbers where both are; choices: the values it may
    have instead. One without range and choices is not tuned."""

    default: Any = None
    range: tuple[int | float, int | float] | None = None
    log: bool = False
    choices: tuple[Any, ...] = ()

    @property
    def tuned(self) -> bool:
        """Whether tuning may change it."""
        return self.range is not None or bool(self.choices)

    def draw(self, random: np.random.Generator) -> Any:
        """A value of it."""
        if self.range is None:
            return self.choices[int(random.integers(len(self.choices)))]
        low, high = self.range
        share = float(random.random())
        whole = isinstance(low, int) and isinstance(high, int)
        if whole:
            low, high = low - 0.5, high + 0.5  # so that the ends are as likely as what lies between
        value = low * (high / low) ** share if self.log else low + (high - low) * share
        return min(max(round(value), math.ceil(low)), math.floor(high)) if whole else float(f"{value:.3g}")


def trials(method: str, ranges: Mapping[str, OptionRange], count: int, seed: int = 0) -> list[str]:
    """References of so many variants of a method, the method itself first. Raises MethodError without ranges.

    >>> trials("mine", {"gain": OptionRange(range=(1.0, 9.0))}, 3)
    ['mine', 'mine[gain=6.93]', 'mine[gain=3.15]']
    """
    tuned = {key: option for key, option in ranges.items() if option.tuned}
    if not tuned:
        raise MethodError(f"method {method!r}: no option has a range or choices to try")
    found = [method]
    for number in range(1, count):
        drawn = {key: option.draw(stream(seed, b"", "tune", key, number)) for key, option in tuned.items()}
        found.append(with_options(method, [f"{key}={written(value)}" for key, value in drawn.items()]))
    return found


def written(value: Any) -> str:
    """A value as TOML has it, words without their quotes."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(value)


def read_ranges(path: Path) -> dict[str, OptionRange]:
    """Tables by the names of options. Raises MethodError, with file and key, where they are none."""
    found, key = {}, ""
    try:
        for key, table in tomllib.loads(path.read_text(encoding="utf-8")).items():
            found[key] = msgspec.convert(table, OptionRange)
    except (OSError, ValueError) as error:
        raise MethodError(f"{path}: {key}: {error}" if key else f"{path}: {error}") from None
    return found
