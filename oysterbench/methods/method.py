"""The interface of a method, and the estimate that a SLAM method returns."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError, TrajectoryError
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.checks import checked_poses
from oysterbench.methods.health import check_health
from oysterbench.methods.map import LandmarkMap

if TYPE_CHECKING:  # it loads every kind of sensor, which image methods do not need
    from oysterbench.sequence.types import Sequence

PATH_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]*")


@dataclass(frozen=True)
class Estimate:
    """Result of a SLAM method: poses T_odom_base at stamps of its choice; the z axis of odom points up.

    trajectory:   the path that is scored
    info:         anything the method wants to keep with the result (JSON values)
    scored:       what the scored path is called, such as "optimised"; a method with one path need not say
    alternatives: further paths of the same run by name, such as "online", in the same frames. They are written beside
                  the scored path and evaluated for information only; no ranking uses them.
    map:          keyframes and landmarks, if the method has them
    health:       (N,) uint8, one `Health` for each pose of the scored path, if the method knows

    Raises MethodError where an alternative has a name that cannot be part of a file name, no poses, a number that is
    not finite, or stamps that do not increase; or where there is not one health value for each pose.
    """

    trajectory: Trajectory
    info: Mapping[str, Any] = field(default_factory=dict)
    scored: str = ""
    alternatives: Mapping[str, Trajectory] = field(default_factory=dict)
    map: LandmarkMap | None = None
    health: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        if self.health is not None:
            check_health(self.health, len(self.trajectory))
        names = [*([self.scored] if self.scored else []), *self.alternatives]
        for name in names:
            if not PATH_NAME.fullmatch(name):
                raise MethodError(f"name of a path: expected letters, digits and _ -, got {name!r}")
            if names.count(name) > 1:
                raise MethodError(f"alternatives: expected other names than that of the scored path, got {name!r}")
        for name, path in self.alternatives.items():
            if len(path) == 0:
                raise MethodError(f"alternative {name!r}: expected poses, got none; leave it out")
            try:
                checked_poses(path, name, lambda i, name=name: f"alternative {name!r}: pose {i + 1}")  # type: ignore[misc]
            except TrajectoryError as error:
                raise MethodError(str(error)) from None


def check_estimate(found: Any, name: str, sequence: str) -> Estimate:
    """Return what the method `name` returned on a sequence, if it is an estimate. Raises MethodError."""
    if isinstance(found, Estimate) and isinstance(found.trajectory, Trajectory):
        return found
    inside = isinstance(found, Estimate)
    got = f"an Estimate of {_described(found.trajectory)}" if inside else _described(found)
    raise MethodError(
        f"method {name!r} on {sequence}: run() returned {got}, expected an Estimate of a Trajectory: return "
        "Estimate(Trajectory(stamps_ns, positions, quaternions))"
    )


def _described(value: Any) -> str:
    return "None" if value is None else f"a value of type {type(value).__name__}"


@runtime_checkable
class Method(Protocol):
    """A method: a name, a track, and `run`, which receives the sensors and never the ground truth.

    A method that draws random numbers also has the attribute `seed`, an integer: run k gets its seed + k.
    """

    name: str
    track: str

    def run(self, sequence: Sequence) -> Estimate:
        """Estimate the trajectory from the sensors, read in time order."""
        ...


def seed_of(method: Method) -> int | None:
    """Return the seed of a method, None if it takes none."""
    seed = getattr(method, "seed", None)
    return seed if isinstance(seed, int) and not isinstance(seed, bool) else None
