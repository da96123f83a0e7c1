"""What a method is; finding one by its name, running it, measuring the run. Each name is imported when it is used: what
is known of weights, in this package as well, is asked by commands that run nothing."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oysterbench.methods.finding import ENTRY_POINTS, find_method, method_names
    from oysterbench.methods.health import Health
    from oysterbench.methods.here import Run, run_method
    from oysterbench.methods.map import LandmarkMap
    from oysterbench.methods.method import Estimate, Method, seed_of

__all__ = [
    "ENTRY_POINTS",
    "Estimate",
    "Health",
    "LandmarkMap",
    "Method",
    "Run",
    "find_method",
    "method_names",
    "run_method",
    "seed_of",
]

_HOMES = {
    "ENTRY_POINTS": "finding",
    "Estimate": "method",
    "Health": "health",
    "LandmarkMap": "map",
    "Method": "method",
    "Run": "here",
    "find_method": "finding",
    "method_names": "finding",
    "run_method": "here",
    "seed_of": "method",
}
"""Public name -> module that has it."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = found
    return found
