"""Settings of an evaluator: fields of a frozen dataclass that carry what they allow, and are checked when made."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from itertools import pairwise
from typing import Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from oysterbench.core.errors import OysterbenchError


@dataclass(frozen=True)
class EvaluatorSettings:
    """What all evaluators' settings have in common. A bad value raises `error`, with key, what is allowed and value."""

    error: ClassVar[type[OysterbenchError]]

    def __post_init__(self) -> None:
        hints = get_type_hints(type(self))
        for key in fields(self):
            value, hint = getattr(self, key.name), hints[key.name]
            if isinstance(value, list):
                value = tuple(value)
                object.__setattr__(self, key.name, value)
            if get_origin(hint) is Literal and value not in get_args(hint):
                self.refuse(key.name, f"one of {', '.join(get_args(hint))}", value)
            if "allows" in key.metadata and not key.metadata["allows"](value):
                self.refuse(key.name, key.metadata["expected"], value)

    def refuse(self, key: str, expected: str, value: Any) -> None:
        """Raise the error for a value."""
        raise self.error(f"evaluator setting {key!r}: expected {expected}, got {value!r}")

    def as_dict(self) -> dict[str, Any]:
        """The settings for JSON."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def setting(default: Any, expected: str, allows: Callable[[Any], bool]) -> Any:
    """A field: its default, what it expects in words, and whether it allows a value."""
    return field(default=default, metadata={"expected": expected, "allows": allows})


def positive(default: float, unit: str) -> Any:
    """A finite number above 0."""
    return setting(default, f"more than 0 {unit}", lambda value: is_number(value) and 0 < value < math.inf)


def share(default: float, most: float) -> Any:
    """A number above 0, up to `most`."""
    return setting(default, f"more than 0, up to {most:g}", lambda value: is_number(value) and 0 < value <= most)


def whole(default: int | None, least: int) -> Any:
    """A whole number from `least`; None too where that is the default."""
    return setting(
        default,
        f"a whole number from {least}",
        lambda value: (
            (value is None and default is None)
            or (isinstance(value, int) and not isinstance(value, bool) and value >= least)
        ),
    )


def edges(*default: float) -> Any:
    """Numbers above 0, each greater than the one before: between classes."""
    return setting(
        default,
        "rising numbers above 0",
        lambda value: all(is_number(edge) and edge > 0 for edge in value) and all(a < b for a, b in pairwise(value)),
    )


def is_number(value: Any) -> bool:
    """Whether it is a number, and not one that is none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)
