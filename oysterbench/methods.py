"""What a method is; finding one by its name, running it, measuring the run."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from typing import Any, Protocol, runtime_checkable

from oysterbench.errors import MethodError, OysterbenchError
from oysterbench.sequence.types import Sequence
from oysterbench.trajectory import Trajectory

ENTRY_POINTS = "oysterbench.methods"


@dataclass(frozen=True)
class Estimate:
    """What a SLAM method gives: poses T_odom_base at the stamps it chooses; z of odom points up.

    info: anything the method wants to keep with the result (JSON values).
    """

    trajectory: Trajectory
    info: Mapping[str, Any] = field(default_factory=dict)


@runtime_checkable
class Method(Protocol):
    """A method: a name, a track, and `run`, which is given the sensors and never the truth."""

    name: str
    track: str

    def run(self, sequence: Sequence) -> Estimate:
        """Estimate from the sensors, read in time order."""
        ...


@dataclass(frozen=True)
class Run:
    """One run of a method on a sequence, with what it cost."""

    estimate: Estimate
    wall_s: float
    cpu_s: float


def method_names(track: str | None = None) -> list[str]:
    """Names of the installed methods (of a track)."""
    names = sorted({point.name for point in entry_points(group=ENTRY_POINTS)})
    return names if track is None else [name for name in names if find_method(name).track == track]


def find_method(name: str) -> Method:
    """The installed method of that name."""
    points = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
    if name not in points:
        raise MethodError(f"unknown method {name!r}; installed methods: {', '.join(sorted(points)) or 'none'}")
    try:
        method = points[name].load()()
    except ImportError as error:
        raise MethodError(
            f"method {name!r} cannot be loaded: {error}; install what it needs, e.g. pip install 'oysterbench[slam]'"
        ) from None
    if not isinstance(method, Method):
        raise MethodError(f"method {name!r}: expected an object with name, track and run, got {type(method)}")
    return method


def run_method(method: Method, sequence: Sequence) -> Run:
    """Run a method on the sensors of a sequence. Any exception of the method becomes a MethodError."""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        estimate = method.run(sequence.for_method())
    except OysterbenchError:
        raise
    except Exception as error:
        raise MethodError(
            f"method {method.name!r} failed on sequence {sequence.name}: {type(error).__name__}: {error}"
        ) from error
    return Run(estimate, time.perf_counter() - wall, time.process_time() - cpu)
