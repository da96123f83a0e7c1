"""Trajectory: time-stamped poses of the body in the world, and the text formats they come in."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.errors import TrajectoryError
from oysterbench.files import write_atomically
from oysterbench.geometry import Array, interpolate_poses, poses_to_matrices

MIN_YEAR_NS_STAMP = 1e14  # a stamp above this is not seconds: as seconds it would be 3 million years


@dataclass(frozen=True)
class Trajectory:
    """Poses `T_map_body` in time.

    stamps_ns:   (N,) int64, nanoseconds
    positions:   (N, 3) float64, m, in the world frame
    quaternions: (N, 4) float64, x y z w, body to world

    Nothing is checked or sorted here: `evaluate.validate` names what is wrong with a trajectory.
    """

    stamps_ns: NDArray[np.int64]
    positions: Array
    quaternions: Array

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        if self.positions.shape != (n, 3) or self.quaternions.shape != (n, 4):
            raise TrajectoryError(
                f"expected {n} positions (N, 3) and quaternions (N, 4), "
                f"got {self.positions.shape} and {self.quaternions.shape}"
            )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def path_length(self) -> float:
        """Sum of the distances between consecutive positions, m."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @property
    def matrices(self) -> Array:
        """(N, 4, 4) transforms T_map_body."""
        return poses_to_matrices(self.positions, self.quaternions)

    def at(self, stamps_ns: NDArray[np.int64]) -> Trajectory:
        """Interpolated poses (lerp, slerp) at stamps inside the time span."""
        positions, quaternions = interpolate_poses(self.stamps_ns, self.positions, self.quaternions, stamps_ns)
        return Trajectory(np.asarray(stamps_ns, dtype=np.int64), positions, quaternions)

    def select(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Trajectory:
        """The poses at `index`."""
        return Trajectory(self.stamps_ns[index], self.positions[index], self.quaternions[index])


def seconds_to_ns(text: str) -> int:
    """Nanoseconds from seconds as text, exact where a float64 would round ("1403636580.838555648")."""
    text = text.strip()
    whole, dot, fraction = text.partition(".")
    if dot and whole.lstrip("+-").isdigit() and fraction.isdigit():
        nanoseconds = int((fraction + "000000000")[:9])
        return int(whole) * 1_000_000_000 + (-nanoseconds if whole.startswith("-") else nanoseconds)
    if text.lstrip("+-").isdigit():
        return int(text) * 1_000_000_000
    return round(float(text) * 1e9)


def ns_to_seconds(stamp_ns: int) -> str:
    """Seconds as `%d.%09d`, exact."""
    sign = "-" if stamp_ns < 0 else ""
    whole, nanoseconds = divmod(abs(int(stamp_ns)), 1_000_000_000)
    return f"{sign}{whole}.{nanoseconds:09d}"


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory file: TUM (`t x y z qx qy qz qw`) or EuRoC (`ns,x,y,z,qw,qx,qy,qz,...`).

    Comments (#), blank lines, tabs and repeated spaces are fine. A line with commas is EuRoC, as is a stamp in
    nanoseconds. Raises TrajectoryError naming file and line.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise TrajectoryError(f"{path}: no such file; expected a trajectory in TUM or EuRoC format") from None
    except IsADirectoryError:
        raise TrajectoryError(f"{path} is a folder; expected a trajectory file in TUM or EuRoC format") from None
    except PermissionError:
        raise TrajectoryError(f"{path}: permission denied") from None
    except UnicodeDecodeError:
        raise TrajectoryError(f"{path} is not text; expected a trajectory in TUM or EuRoC format") from None
    stamps: list[int] = []
    values: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        stamp, pose = _parse_line(line, f"{path}:{number}")
        stamps.append(stamp)
        values.append(pose)
    if not stamps:
        raise TrajectoryError(f"{path} holds no pose; expected lines of `t x y z qx qy qz qw`")
    table = np.array(values)
    return Trajectory(np.array(stamps, dtype=np.int64), table[:, :3].copy(), table[:, 3:].copy())


def _parse_line(line: str, where: str) -> tuple[int, list[float]]:
    """Stamp in ns and x y z qx qy qz qw of one line."""
    euroc = "," in line
    fields = [field for field in (line.split(",") if euroc else line.split())]
    if (euroc and len(fields) < 8) or (not euroc and len(fields) != 8):
        raise TrajectoryError(
            f"{where}: expected 8 numbers `t x y z qx qy qz qw`, got {len(fields)}: {line.strip()[:60]!r}"
        )
    try:
        numbers = [float(field) for field in fields[:8]]
        stamp = int(fields[0]) if euroc else seconds_to_ns(fields[0])
    except (ValueError, OverflowError):
        raise TrajectoryError(f"{where}: expected 8 numbers, got {line.strip()[:60]!r}") from None
    if not euroc and abs(numbers[0]) > MIN_YEAR_NS_STAMP:
        raise TrajectoryError(
            f"{where}: the stamp {fields[0]} looks like nanoseconds; TUM files hold seconds (divide by 1e9)"
        )
    x, y, z, a, b, c, d = numbers[1:]
    # EuRoC files alone write the quaternion as w x y z.
    return stamp, [x, y, z, b, c, d, a] if euroc else [x, y, z, a, b, c, d]


def write_tum(path: str | os.PathLike[str], trajectory: Trajectory) -> None:
    """Write `t x y z qx qy qz qw`, seconds with nine decimals, nothing half-written."""
    rows = ["# timestamp_s x_m y_m z_m qx qy qz qw"]
    for stamp, position, quaternion in zip(
        trajectory.stamps_ns, trajectory.positions, trajectory.quaternions, strict=True
    ):
        rows.append(" ".join([ns_to_seconds(stamp), *(f"{value:.12g}" for value in (*position, *quaternion))]))
    write_atomically(path, ("\n".join(rows) + "\n").encode())
