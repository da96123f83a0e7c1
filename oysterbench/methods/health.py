"""How a method obtained each pose: from what it saw, or by carrying on without that."""

from __future__ import annotations

import io
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError

HEALTH = "health.csv"


class Health(IntEnum):
    """How a pose was obtained."""

    COASTING = 0
    """Without vision: from IMU and aiding sensors alone, or by a guess."""
    TRACKING = 1
    """From what is seen."""
    RELOCALISED = 2
    """From what is seen after tracking was lost, tied to what was seen before."""


NAMES = tuple(health.name.lower() for health in Health)


LOST_S = 1.0
"""Time without vision from which a note says that track was lost, s: by inertia alone it is centimetres off then."""


def health_notes(info: Mapping[str, Any], stamps_ns: NDArray[np.int64], health: NDArray[np.uint8] | None) -> list[str]:
    """Note that a method never initialised, or lost track, if so: a path without vision may look like any other.

    info: of the method, whose `initialised` is 0 if it never did; stamps_ns (N,) and the `Health` (N,) of its poses
    """
    if info.get("initialised") == 0:
        return [
            "never initialised: nothing that it saw is in its path, which by inertia alone is metres off within "
            "seconds; its page in the documentation says what it needs for a start"
        ]
    seen = np.flatnonzero(np.zeros(0) if health is None else health != Health.COASTING)
    if health is None or not len(seen):
        return []
    steps_s = np.diff(stamps_ns[seen[0] :]) * 1e-9
    blind = health[seen[0] + 1 :] == Health.COASTING
    ends = np.flatnonzero(np.diff(blind, prepend=False, append=False))  # of the stretches: begin, end, begin, end, ...
    stretches_s = [float(steps_s[begin:end].sum()) for begin, end in ends.reshape(-1, 2)]
    lost_s = [stretch_s for stretch_s in stretches_s if stretch_s >= LOST_S]
    if not lost_s:
        return []
    return [
        f"lost track for {sum(lost_s):.1f} of {steps_s.sum():.1f} s, at most {max(lost_s):.1f} s at a time: there its "
        f"path is by inertia and other sensors than cameras alone, as {HEALTH} says of each pose"
    ]


def check_health(health: NDArray[np.uint8], poses: int) -> None:
    """Check that there is one `Health` for each pose. Raises MethodError where there is not."""
    if health.shape != (poses,) or health.dtype != np.uint8:
        raise MethodError(f"health: expected ({poses},) uint8, one for each pose, got {health.shape} {health.dtype}")
    if len(health) and health.max() > max(Health):
        i = int(np.argmax(health > max(Health)))
        known = ", ".join(f"{int(one)} {one.name.lower()}" for one in Health)
        raise MethodError(f"health: expected one of {known}, got {health[i]} at pose {i + 1} of {poses}")


def write_health(path: Path, stamps_ns: NDArray[np.int64], health: NDArray[np.uint8]) -> None:
    """Write a table of stamps (N,) and the `Health` (N,) of the pose at each."""
    text = io.StringIO()
    text.write("stamp_ns,health\n")
    text.writelines(
        f"{stamp},{NAMES[value]}\n" for stamp, value in zip(stamps_ns.tolist(), health.tolist(), strict=True)
    )
    write_atomically(path, text.getvalue().encode())


def read_health(path: Path) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Read the stamps (N,) and `Health` (N,) that `write_health` wrote. Raises MethodError for any other file."""
    try:
        rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
        stamps_ns = np.array([int(stamp) for stamp, _ in rows], dtype=np.int64)
        return stamps_ns, np.array([NAMES.index(name) for _, name in rows], dtype=np.uint8)
    except (OSError, ValueError) as error:
        raise MethodError(f"{path}: expected a table of stamp_ns and health ({', '.join(NAMES)}): {error}") from None
