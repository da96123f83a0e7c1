"""Base of evaluator settings: frozen dataclasses whose fields state what they allow, checked on construction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from itertools import pairwise
from typing import Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from oysterbench.core.errors import OysterbenchError


@dataclass(frozen=True)
class EvaluatorSettings:
    """Base class of all evaluators' settings. An invalid value raises `error`, naming key, allowed values and value."""

    error: ClassVar[type[OysterbenchError]]

    def __post_init__(self) -> None:
        hints = get_type_hints(type(self))
        for key in fields(self):
            value, hint = getattr(self, key.name), hints[key.name]
            if isinstance(value, list):
                value = tuple(value)
                object.__setattr__(self, key.name, value)
            if get_origin(hint) is tuple and not isinstance(value, tuple):
                self.refuse(key.name, f"a list of {key.metadata.get('expected', 'values')}", value)
            if get_origin(hint) is Literal and value not in get_args(hint):
                self.refuse(key.name, f"one of {', '.join(get_args(hint))}", value)
            if "allows" in key.metadata and not key.metadata["allows"](value):
                self.refuse(key.name, key.metadata["expected"], value)

    def refuse(self, key: str, expected: str, value: Any) -> None:
        """Raise `error` for an invalid value."""
        raise self.error(f"evaluator setting {key!r}: expected {expected}, got {value!r}")

    def as_dict(self) -> dict[str, Any]:
        """The settings as a JSON-compatible dict."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def setting(default: Any, expected: str, allows: Callable[[Any], bool]) -> Any:
    """Declare a field: its default, what it expects in words, and a predicate that tells whether a value is allowed."""
    return field(default=default, metadata={"expected": expected, "allows": allows})


def positive(default: float, unit: str) -> Any:
    """Declare a field for a finite number above 0."""
    return setting(default, f"more than 0 {unit}", lambda value: is_number(value) and 0 < value < math.inf)


def share(default: float, most: float) -> Any:
    """Declare a field for a number above 0, up to `most`."""
    return setting(default, f"more than 0, up to {most:g}", lambda value: is_number(value) and 0 < value <= most)


def whole(default: int | None, least: int) -> Any:
    """Declare a field for an integer of at least `least`; None is allowed too if it is the default."""
    return setting(
        default,
        f"a whole number from {least}",
        lambda value: (
            (value is None and default is None)
            or (isinstance(value, int) and not isinstance(value, bool) and value >= least)
        ),
    )


def edges(*default: float) -> Any:
    """Declare a field for class boundaries: numbers above 0, each greater than the one before."""
    return setting(
        default,
        "rising numbers above 0",
        lambda value: all(is_number(edge) and edge > 0 for edge in value) and all(a < b for a, b in pairwise(value)),
    )


def is_number(value: Any) -> bool:
    """Whether a value is an int or a float, but neither a bool nor NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)
