"""What a method is, and what it answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from oysterbench.sequence.types import Sequence
from oysterbench.trajectory import Trajectory


@dataclass(frozen=True)
class Estimate:
    """What a SLAM method gives: poses T_odom_base at the stamps it chooses; z of odom points up.

    info: anything the method wants to keep with the result (JSON values).
    """

    trajectory: Trajectory
    info: Mapping[str, Any] = field(default_factory=dict)


@runtime_checkable
class Method(Protocol):
    """A method: a name, a track, and `run`, which is given the sensors and never the truth.

    One that draws random numbers also has the attribute `seed`, a whole number: run k is given its seed + k.
    """

    name: str
    track: str

    def run(self, sequence: Sequence) -> Estimate:
        """Estimate from the sensors, read in time order."""
        ...


def seed_of(method: Method) -> int | None:
    """The seed of a method that takes one."""
    seed = getattr(method, "seed", None)
    return seed if isinstance(seed, int) and not isinstance(seed, bool) else None
