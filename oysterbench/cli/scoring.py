"""Options of a command that decide how an estimate is brought to the truth and what is measured of it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from oysterbench.evaluate.slam.scoring import SlamSettings

ALIGNMENTS = ("none", "origin", "se3", "posyaw", "sim3", "scale")
ASSOCIATIONS = ("interpolate", "nearest")
PAIRS = ("all", "consecutive")


class Offset(click.ParamType):
    """Seconds, or the word that asks for them to be found."""

    name = "SECONDS|estimate"

    def convert(self, value: Any, param: click.Parameter | None, context: click.Context | None) -> Any:
        """As the settings take it."""
        if value == "estimate":
            return value
        try:
            return float(value)
        except ValueError:
            self.fail(f"expected seconds or 'estimate', got {value!r}", param, context)


OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "align": ("--align", {"type": click.Choice(ALIGNMENTS), "help": "How it is aligned.  [default: posyaw]"}),
    "align_first": (
        "--align-first",
        {"type": int, "help": "Fit the alignment to so many first poses.  [default: all]"},
    ),
    "associate": (
        "--associate",
        {"type": click.Choice(ASSOCIATIONS), "help": "How stamps meet.  [default: interpolate]"},
    ),
    "max_gap_s": ("--max-gap", {"type": float, "help": "Interpolate across at most so many seconds.  [default: 0.3]"}),
    "max_difference_s": (
        "--max-difference",
        {"type": float, "help": "Nearest poses are at most so many seconds away.  [default: 0.01]"},
    ),
    "time_offset_s": (
        "--time-offset",
        {
            "type": Offset(),
            "help": "Added to the estimate's stamps; found from the motion by 'estimate'.  [default: 0]",
        },
    ),
    "rpe_pairs": (
        "--rpe-pairs",
        {"type": click.Choice(PAIRS), "help": "Relative errors from every start, or end to end.  [default: all]"},
    ),
    "subpath_m": (
        "--subpath",
        {
            "type": float,
            "multiple": True,
            "help": "Length of segments in m; repeatable.  [default: shares of the path]",
        },
    ),
}
"""Setting of the evaluator -> the option's name, and what click is told of it. What is not given keeps its default."""


@dataclass(frozen=True)
class Scoring:
    """What was given; called, it makes the evaluator's settings."""

    values: dict[str, Any]

    @property
    def given(self) -> list[str]:
        """The options, by name."""
        return [OPTIONS[key][0] for key in self.values]

    def __call__(self) -> SlamSettings:
        from oysterbench.evaluate.slam.scoring import SlamSettings

        return SlamSettings(**self.values)


def scoring_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options, and the argument `settings` (`Scoring`)."""

    @functools.wraps(command)
    def wrapped(**values: Any) -> Any:
        given = {key: value for key in OPTIONS if (value := values.pop(key)) not in (None, ())}

        return command(settings=Scoring(given), **values)

    for key, (name, about) in reversed(OPTIONS.items()):
        wrapped = click.option(name, key, **about)(wrapped)
    return wrapped
