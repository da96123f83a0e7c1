"""Trajectories in numpy's .npz."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.text import in_one_line
from oysterbench.core.trajectory.checks import checked_poses
from oysterbench.core.trajectory.options import ReadOptions, check_rigid
from oysterbench.core.trajectory.poses import Trajectory
from oysterbench.core.trajectory.stamps import SHIFTS

STAMPS = ("stamps_ns", "t_ns", "timestamps_ns", "t", "t_s", "stamps", "stamps_s", "time", "timestamps")
POSITIONS = ("positions", "position", "p", "xyz")
QUATERNIONS = ("quaternions", "quaternion", "orientations", "q", "quat", "quats")
FRAME = "T_body_estimate"
COVARIANCES = ("covariances", "covariance", "cov")
MAX_BYTES = 2**33
"""Limit on the total size of the arrays, bytes: an archive that claims more is damaged."""


def read_npz(path: Path, data: bytes, options: ReadOptions) -> Trajectory:
    """Read `stamps_ns` (N,) int or `t` (N,) s, `positions` (N, 3), `quaternions` (N, 4), and any `covariances` (N, 6,
    6).

    `T_body_estimate` (4, 4), optional: the frame from which the body's poses were converted, as in `Trajectory`.
    """
    arrays = _arrays(path, data)
    key, stamps = _pick(arrays, STAMPS, path)
    notes: list[str] = []
    stamps_ns = _stamps(stamps, key, path, options, notes)
    positions = _floats(*_pick(arrays, POSITIONS, path), (len(stamps_ns), 3), path)
    quaternions = _floats(*_pick(arrays, QUATERNIONS, path), (len(stamps_ns), 4), path)
    if options.quaternion == "wxyz":
        quaternions = quaternions[:, [1, 2, 3, 0]]
    covariances = None
    if any(name in arrays for name in COVARIANCES):
        covariances = _floats(*_pick(arrays, COVARIANCES, path), (len(stamps_ns), 6, 6), path)
    if not len(stamps_ns):
        raise TrajectoryError(f"{path} holds no pose")
    frame = None
    if FRAME in arrays:
        frame = _floats(FRAME, arrays[FRAME], (4, 4), path)
        check_rigid(frame, f"{path}: {FRAME!r}")
    trajectory = Trajectory(stamps_ns, positions, quaternions, covariances, tuple(notes), frame)
    return checked_poses(trajectory, path.name, lambda i: f"{path}: pose {i + 1}", options)


def _arrays(path: Path, data: bytes) -> dict[str, NDArray[np.generic]]:
    known = {*STAMPS, *POSITIONS, *QUATERNIONS, *COVARIANCES, FRAME}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_BYTES:
            raise TrajectoryError(f"{path}: expected arrays of at most {MAX_BYTES >> 30} GiB, got {size >> 30} GiB")
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files if name in known}
    except TrajectoryError:
        raise
    except Exception as error:  # numpy and zipfile each raise their own on untrusted bytes
        raise TrajectoryError(f"{path} is damaged, or not an .npz of plain arrays: {in_one_line(error)}") from None


def _pick(
    arrays: dict[str, NDArray[np.generic]], names: tuple[str, ...], path: Path
) -> tuple[str, NDArray[np.generic]]:
    for name in names:
        if name in arrays:
            return name, arrays[name]
    raise TrajectoryError(
        f"{path}: expected an array {names[0]!r}, got {', '.join(sorted(arrays)) or 'none of a trajectory'}"
    )


def _floats(key: str, array: NDArray[np.generic], shape: tuple[int, ...], path: Path) -> NDArray[np.float64]:
    if array.shape != shape or array.dtype.kind not in "iuf":
        raise TrajectoryError(f"{path}: expected {key!r} as numbers {shape}, got {array.dtype} {array.shape}")
    return array.astype(np.float64)


def _stamps(
    stamps: NDArray[np.generic], key: str, path: Path, options: ReadOptions, notes: list[str]
) -> NDArray[np.int64]:
    """Stamps (N,) int64 ns; integers are converted exactly."""
    if stamps.ndim != 1 or stamps.dtype.kind not in "iuf":
        raise TrajectoryError(f"{path}: expected {key!r} as numbers (N,), got {stamps.dtype} {stamps.shape}")
    named_ns = key.endswith("_ns") or (key == "stamps" and stamps.dtype.kind in "iu")
    unit = options.time_unit or ("ns" if named_ns else "s")
    factor = 10 ** SHIFTS[unit]
    limit = 2**62 // factor
    if not np.isfinite(stamps).all() or (len(stamps) and (stamps.min() < -limit or stamps.max() > limit)):
        raise TrajectoryError(
            f"{path}: expected {key!r} in {unit}, finite and within 146 years of the epoch; correct them, or give "
            "their unit (--time-unit s, ms, us or ns)"
        )
    if stamps.dtype.kind in "iu":
        return np.asarray(stamps.astype(np.int64) * factor)
    whole = np.floor(stamps.astype(np.float64))
    stamps_ns: NDArray[np.int64] = whole.astype(np.int64) * factor + np.rint((stamps - whole) * factor).astype(np.int64)
    step_ns = float(np.spacing(np.abs(stamps).max(initial=0.0))) * factor
    if step_ns > 1.0:
        notes.append(f"{path.name}: {key!r} is {stamps.dtype}, which holds these timestamps to {step_ns:.0f} ns only")
    return stamps_ns
