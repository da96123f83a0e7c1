"""What a method is, how to find one by name, and how to run and measure it.

Names are imported on first use: commands that run nothing also need this package, for what is known about weights.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oysterbench.methods.finding import ENTRY_POINTS, find_method, method_names
    from oysterbench.methods.health import Health
    from oysterbench.methods.in_process import Run, run_method
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
    "Run": "in_process",
    "find_method": "finding",
    "method_names": "finding",
    "run_method": "in_process",
    "seed_of": "method",
}
"""Public name -> module that defines it."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = found
    return found
