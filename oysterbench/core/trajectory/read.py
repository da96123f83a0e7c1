"""Reading a trajectory in any format: recognised by its content, or given by the options."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory.bags import BAG_MAGIC, MCAP_MAGIC, SQLITE_MAGIC, read_bag
from oysterbench.core.trajectory.frames import METRES, T_BODY_OPTICAL, inverted, poses_of_body, scaled
from oysterbench.core.trajectory.options import EXPECTED, Format, ReadOptions
from oysterbench.core.trajectory.poses import Trajectory
from oysterbench.core.trajectory.text import is_kitti, read_text

ZIP_MAGIC = b"PK\x03\x04"
MAGIC = 16
"""Number of leading bytes that tell the formats apart."""

EUROC_TRUTH = Path("mav0", "state_groundtruth_estimate0", "data.csv")
"""File of the poses in a folder in EuRoC layout."""


def read_trajectory(path: str | os.PathLike[str], options: ReadOptions | None = None, **changes: Any) -> Trajectory:
    """Read a trajectory file in TUM, EuRoC, KITTI, CSV, .npz, MCAP or rosbag format.

    options, changes: what the content does not decide, see `ReadOptions`: `read_trajectory(path, quaternion="wxyz")`.

    Comments (# and %), blank lines, headers, tabs and repeated spaces are accepted. A header names the columns; a
    file without one is EuRoC (`ns,x,y,z,qw,qx,qy,qz,...`) where it has commas, KITTI where it has 12 columns, or else
    TUM (`s x y z qx qy qz qw`). Stamps that can only be nanoseconds are read as such, since ORB-SLAM3 writes that.
    What was decided in reading is recorded in the trajectory's `notes`. Raises TrajectoryError naming file and line,
    and the option that decides.

    Examples
    --------
    >>> from pathlib import Path
    >>> written = Path("poses.txt").write_text("10.0 0 0 0 0 0 0 1\\n10.5 3 4 0 0 0 0 1\\n")
    >>> read_trajectory("poses.txt")
    <Trajectory: 2 poses over 0.5 s and 5 m>
    >>> read_trajectory("poses.txt", unit="mm").path_length
    0.005
    """
    options = replace(options or ReadOptions(), **changes)
    path = Path(path)
    trajectory = _read(path, options)
    if options.unit is not None:
        trajectory = scaled(trajectory, METRES[options.unit])
    if options.direction == "world-to-body":
        trajectory = inverted(trajectory)
    if options.T_body_estimate is not None:
        return poses_of_body(trajectory, options.T_body_estimate)
    return poses_of_body(trajectory, T_BODY_OPTICAL) if options.frame == "optical" else trajectory


def file_format(path: Path, magic: bytes) -> Format | None:
    """Format `bag`, `mcap` or `npz`, by the first bytes of a file or the content of a folder; None for text."""
    if path.is_dir():
        if any(path.glob("*.mcap")):
            return "mcap"
        return "bag" if (path / "metadata.yaml").is_file() or any(path.glob("*.db3")) else None
    if magic.startswith(MCAP_MAGIC):
        return "mcap"
    if magic.startswith((BAG_MAGIC, SQLITE_MAGIC)):
        return "bag"
    return "npz" if magic.startswith(ZIP_MAGIC) else None


def euroc_folder(path: Path) -> Path | None:
    """Folder in EuRoC layout whose true poses are in a file, from wherever and by whichever link it is given; None for
    another file."""
    for file in (path.absolute(), Path(os.path.realpath(path))):
        if file.parts[-len(EUROC_TRUTH.parts) :] == EUROC_TRUTH.parts:
            return file.parents[len(EUROC_TRUTH.parts) - 1]
    return None


def holds_kitti(path: Path) -> bool:
    """Whether `read_trajectory` takes what is at a path for KITTI's poses by its content; not where it cannot be read,
    which reading says. What can be read only once, a pipe, is left unread and taken for another format."""
    try:
        return path.is_file() and file_format(path, _begin(path)) is None and is_kitti(path, path.read_bytes())
    except (OSError, TrajectoryError):
        return False


def _read(path: Path, options: ReadOptions) -> Trajectory:
    try:
        folder = path.is_dir()
        # A pipe can be read only once; a recording may be larger than the memory.
        once = path.exists() and not folder and not path.is_file()
        data = path.read_bytes() if once else b""
        found = file_format(path, data[:MAGIC] if once or folder else _begin(path))
        chosen = options.format or found
        if chosen in ("mcap", "bag"):
            if once:
                raise TrajectoryError(f"{path}: expected a file or folder: recordings cannot be read from a pipe")
            return read_bag(path, options)
        if options.topic is not None:
            raise TrajectoryError(f"{path}: --topic applies to an MCAP file or a bag, got neither")
        if folder:
            inside = ""
            if (path / "mav0").is_dir():
                place, there = path / EUROC_TRUTH, (path / EUROC_TRUTH).is_file()
                inside = f"; its poses are in {place}" if there else f"; it has no poses, in {place}"
            raise TrajectoryError(f"{path} is a folder; {EXPECTED}{inside}")
        data = data if once else path.read_bytes()
    except FileNotFoundError:
        raise TrajectoryError(f"{path}: no such file; {EXPECTED}") from None
    except OSError as error:
        raise TrajectoryError(f"{path}: cannot be read: {error.strerror or error}") from None
    if chosen == "npz":
        from oysterbench.core.trajectory.archive import read_npz

        return read_npz(path, data, options)
    return read_text(path, data, options)


def _begin(path: Path) -> bytes:
    with open(path, "rb") as file:
        return file.read(MAGIC)
