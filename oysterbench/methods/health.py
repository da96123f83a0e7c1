"""How a method obtained each pose: from what it saw, or by carrying on without that."""

from __future__ import annotations

import io
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.core.files import write_atomically

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
