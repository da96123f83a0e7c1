"""Options that decide how a file of poses is read, where its content does not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, is_rigid

Format = Literal["tum", "euroc", "kitti", "csv", "npz", "mcap", "bag"]
TimeUnit = Literal["s", "ms", "us", "ns"]
Order = Literal["xyzw", "wxyz"]
LengthUnit = Literal["m", "mm"]
Frame = Literal["body", "optical"]
Direction = Literal["body-to-world", "world-to-body"]
Duplicates = Literal["first", "last", "mean", "refuse"]

EXPECTED = "expected a trajectory: TUM, EuRoC, KITTI, CSV, .npz, MCAP or a ROS bag"
"""What is said where a file is none."""


@dataclass(frozen=True)
class ReadOptions:
    """How to read a trajectory file; None: as its content indicates.

    format:          of the file
    topic:           of an MCAP file or a bag; `/tf:map.base_link` chooses one transform
    times:           (N,) int64 ns, stamps of the lines of a KITTI file
    time_unit:       of the stamps
    quaternion:      order of the four numbers in the file
    unit:            of the positions
    direction:       what a pose maps: points of the body into the world, or the reverse (COLMAP's files)
    frame:           whose poses they are: the body's, or those of a camera's optical frame at the body's origin
    T_body_estimate: (4, 4), takes points of the frame whose poses they are into the body
    duplicates:      which of several poses at one stamp counts; None: the first if they differ by less than
                     neighbours do, otherwise they are refused
    sort:            sort poses by their stamps instead of refusing them
    """

    format: Format | None = None
    topic: str | None = None
    times: NDArray[np.int64] | None = None
    time_unit: TimeUnit | None = None
    quaternion: Order | None = None
    unit: LengthUnit | None = None
    direction: Direction | None = None
    frame: Frame | None = None
    T_body_estimate: Array | None = None
    duplicates: Duplicates | None = None
    sort: bool = False

    def __post_init__(self) -> None:
        choices: dict[str, Any] = {
            "format": Format,
            "time_unit": TimeUnit,
            "quaternion": Order,
            "unit": LengthUnit,
            "direction": Direction,
            "frame": Frame,
            "duplicates": Duplicates,
        }
        for key, values in choices.items():
            value = getattr(self, key)
            if value is not None and value not in get_args(values):
                raise TrajectoryError(f"{key}: expected one of {', '.join(get_args(values))}, got {value!r}")
        if self.T_body_estimate is not None:
            if self.frame is not None:
                raise TrajectoryError("frame and T_body_estimate both set the frame of the poses: expected only one")
            check_rigid(self.T_body_estimate, "T_body_estimate")


def check_rigid(matrix: Array, name: str) -> None:
    """Refuse a matrix that is not a rigid transform (4, 4). Raises TrajectoryError, which starts with `name`."""
    if not is_rigid(matrix):
        raise TrajectoryError(f"{name}: expected a rigid transform (4, 4), got {np.array2string(np.asarray(matrix))}")
