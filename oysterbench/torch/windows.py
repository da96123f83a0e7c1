"""Windows of consecutive frames, with the IMU samples and the motion between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset

from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.core.geometry import Array, invert
from oysterbench.core.trajectory import too_wide
from oysterbench.sequence import Sequence
from oysterbench.sequence.places import CACHE_BYTES, Chunks, IndexedFile
from oysterbench.sequence.types import imu_arrays
from oysterbench.torch.sources import Shots, Source, Transform, cameras_of, names_of, opened, place_of, sequence_files


class WindowDataset(Dataset[Any]):
    """Windows of consecutive frames with the motion between them, for learned visual-inertial odometry.

    Parameters
    ----------
    source : str, path, oysterbench.Split, or several of these
        A split or its name, rendered or downloaded if it is not here; sequence files (.mcap); folders of them.
    length : int
        Number of frames T in a window, at least two.
    stride : int
        Number of frames from the start of one window to the start of the next.
    camera : str or list of str, optional
        Cameras whose frames are used; the first of each sequence by default.
    poses : bool
        Whether items contain true poses. Without them, sequences with withheld ground truth can be read, too.
    max_gap_s : float, optional
        Windows in which two consecutive frames are further apart, as after lost frames, are left out.
    transform : callable, optional
        Maps each item to what is returned instead. It must be picklable where workers are spawned.
    cache_mb : float
        Size of the cache of unpacked file chunks in each process.

    Notes
    -----
    Inertial samples are those between the stamps of frames; poses are of the times when the images were taken. A frame
    that repeats an image has the pose of that image: `taken_ns` tells such frames, which methods see as they are.

    An item is a dict. K is the greatest number of IMU samples between two frames anywhere in the data set, so that all
    items have the same shape and the default collate function can batch them:

    ============== ======================== ============================================================
    key            tensor                   what
    ============== ======================== ============================================================
    image          (T, 3, H, W) uint8       RGB
    stamp_ns       (T,) int64               of the frames, ns
    imu            (T - 1, K, 6) float32    angular rate x y z, rad/s, and specific force x y z, m/s^2, both
                                            in the IMU's frame, of the samples after frame t up to frame
                                            t + 1, the latter included; 0 after the last one
    imu_stamp_ns   (T - 1, K) int64         of the samples, ns; 0 after the last one
    imu_count      (T - 1,) int64           samples before the padding
    taken_ns       (T,) int64               true times at which the images were taken, ns: earlier than the stamp where
                                            a frame repeats an image, or the camera's stamps are late
    pose           (T, 4, 4) float64        true T_map_body at taken_ns, m; the same for an image that is repeated
    relative_pose  (T - 1, 4, 4) float32    true motion in the body frame: maps points from the body frame at
                                            frame t + 1 to the body frame at frame t, m
    intrinsics     (3, 3) float32           matrix of the camera, px
    T_body_camera  (4, 4) float32           maps points from the optical frame to the body frame, m
    T_body_imu     (4, 4) float32           maps points from the IMU's frame to the body frame, m
    name, sequence, camera  str             name: SEQUENCE/CAMERA/STAMP of the first frame
    ============== ======================== ============================================================

    The body frame has x forward, y left, z up; the optical frame z forward, x right, y down. Calibrations are those
    that methods are given.

    Raises
    ------
    oysterbench.core.errors.SequenceError
        A file is absent, damaged, has no such camera, or has no ground truth although `poses` requires it.

    Examples
    --------
    From a file, or from a split by its name, as in `WindowDataset("slam-train", length=5)`:

    >>> import oysterbench
    >>> windows = oysterbench.torch.WindowDataset("mini-01.mcap", length=5, stride=2)
    >>> windows
    <WindowDataset: 8 windows of 5 frames of 1 sequences, with poses>
    >>> windows[0]["relative_pose"].shape
    torch.Size([4, 4, 4])
    """

    def __init__(
        self,
        source: Source,
        length: int,
        stride: int = 1,
        camera: str | Iterable[str] | None = None,
        poses: bool = True,
        max_gap_s: float | None = None,
        transform: Transform | None = None,
        cache_mb: float = CACHE_BYTES / 1e6,
    ) -> None:
        for name, value, least in (("length", length, 2), ("stride", stride, 1)):
            if not isinstance(value, Integral) or value < least:
                raise OptionError(f"{name}: expected a number of frames from {least} on, got {value!r}")
        length, stride = int(length), int(stride)
        self.length, self.stride, self.poses, self.transform = length, stride, poses, transform
        asked = None if camera is None else names_of(camera, "camera")
        chunks = Chunks(round(1e6 * cache_mb))
        self._parts = [part for path in sequence_files(source) for part in _parts_of(path, asked, poses, chunks)]
        self._begins = [part.begins(length, stride, max_gap_s) for part in self._parts]
        self._ends = np.cumsum([len(begins) for begins in self._begins], dtype=np.intp)
        if not len(self):
            raise SequenceError(
                f"{source}: no window of {length} frames; expected longer sequences, or shorter windows"
            )
        self.imu_samples = max(part.most_samples for part in self._parts)

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, number: int) -> Any:
        part, k = place_of(number, self._ends)
        begin = int(self._begins[part][k])
        item = self._parts[part].item(begin, begin + self.length, self.imu_samples)
        return item if self.transform is None else self.transform(item)

    def __repr__(self) -> str:
        sequences = {part.shots.file.path for part in self._parts}
        what = f"{len(self)} windows of {self.length} frames of {len(sequences)} sequences"
        return f"<WindowDataset: {what}, with {'poses' if self.poses else 'no poses'}>"


@dataclass(frozen=True)
class _Part:
    """The F frames of one camera.

    imu, imu_stamps_ns: all IMU samples (N, 6) and their stamps (N,); edges (F,): number of samples up to each frame,
    one at its stamp included; taken_ns (F,): when the images were taken; poses (F, 4, 4): T_map_body then, NaN outside
    the ground truth; None without poses.
    """

    shots: Shots
    imu: NDArray[np.float32]
    imu_stamps_ns: NDArray[np.int64]
    edges: NDArray[np.intp]
    taken_ns: NDArray[np.int64]
    poses: Array | None
    T_body_imu: Array

    @property
    def most_samples(self) -> int:
        """Greatest number of samples between two consecutive frames."""
        return int(np.diff(self.edges).max(initial=1))

    def begins(self, length: int, stride: int, max_gap_s: float | None) -> NDArray[np.intp]:
        """Numbers of the first frames of the windows."""
        count = len(self.shots.stamps_ns)
        known = np.ones(count, dtype=bool) if self.poses is None else np.isfinite(self.poses[:, 0, 0])
        gaps_ns = np.diff(self.shots.stamps_ns)
        near = np.ones(len(gaps_ns), dtype=bool) if max_gap_s is None else ~too_wide(gaps_ns, max_gap_s)
        starts = range(0, count - length + 1, stride)
        whole = [k for k in starts if known[k : k + length].all() and near[k : k + length - 1].all()]
        return np.array(whole, dtype=np.intp)

    def item(self, begin: int, end: int, samples: int) -> dict[str, Any]:
        """Item of the frames [begin, end), with room for a number of IMU samples between consecutive frames."""
        shots = self.shots
        frames = range(begin, end)
        imu = np.zeros((len(frames) - 1, samples, 6), dtype=np.float32)
        stamps = np.zeros((len(frames) - 1, samples), dtype=np.int64)
        counts = np.diff(self.edges[begin:end])
        for row, (low, count) in enumerate(zip(self.edges[begin:end], counts, strict=False)):
            imu[row, :count] = self.imu[low : low + count]
            stamps[row, :count] = self.imu_stamps_ns[low : low + count]
        item = {
            "image": torch.stack([shots.image(k) for k in frames]),
            "stamp_ns": torch.from_numpy(shots.stamps_ns[begin:end].copy()),
            "imu": torch.from_numpy(imu),
            "imu_stamp_ns": torch.from_numpy(stamps),
            "imu_count": torch.from_numpy(counts.astype(np.int64)),
            "intrinsics": _small(shots.calibration.matrix),
            "T_body_camera": _small(shots.calibration.T_base_cam),
            "T_body_imu": _small(self.T_body_imu),
            "name": shots.name(begin),
            "sequence": shots.sequence,
            "camera": shots.camera,
        }
        if self.poses is not None:
            poses = self.poses[begin:end]
            item["taken_ns"] = torch.from_numpy(self.taken_ns[begin:end].copy())
            item["pose"] = torch.from_numpy(poses.copy())
            item["relative_pose"] = _small(invert(poses[:-1]) @ poses[1:])
        return item


def _small(matrix: Array) -> torch.Tensor:
    return torch.from_numpy(matrix.astype(np.float32))


def _parts_of(path: Path, asked: list[str] | None, poses: bool, chunks: Chunks) -> list[_Part]:
    sequence = opened(path)
    names = asked or list(sequence.cameras)[:1]
    if not names:
        raise SequenceError(f"{path}: expected a camera, found none")
    imu_stamps, gyro, accel = imu_arrays(sequence.imu())
    imu = np.concatenate([gyro, accel], axis=1).astype(np.float32)
    parts = []
    for camera in cameras_of(sequence, path, names):
        file = IndexedFile(path, [f"/{camera}/image"], chunks)
        if f"/{camera}/image" not in file.topics:
            raise SequenceError(f"{path}: no image of {camera}: it was left out of the file")
        stamps = file.topics[f"/{camera}/image"].stamps_ns
        calibration = sequence.cameras[camera]
        shots = Shots(file, sequence.name, camera, calibration, np.arange(len(stamps)), stamps)
        edges = np.searchsorted(imu_stamps, stamps, side="right")
        taken, known = _poses(sequence, path, camera, stamps) if poses else (stamps, None)
        parts.append(_Part(shots, imu, imu_stamps, edges, taken, known, sequence.imu_calibration.T_base_imu))
    return parts


def _poses(
    sequence: Sequence, path: Path, camera: str, stamps_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array]:
    """When the images of the frames with these stamps were taken (F,), ns, and T_map_body (F, 4, 4) then; NaN outside
    the ground truth.

    Raises SequenceError where the sequence has no ground truth.
    """
    try:
        truth = sequence.truth()
    except SequenceError:
        raise SequenceError(
            f"{path}: it has no ground-truth poses (withheld, or never recorded); poses=False leaves them out"
        ) from None
    true = sequence.truly_calibrated().cameras[camera]
    taken = np.array([true.taken_ns(int(stamp)) for stamp in stamps_ns], dtype=np.int64)
    inside = (taken >= truth.stamps_ns[0]) & (taken <= truth.stamps_ns[-1])
    found = np.full((len(stamps_ns), 4, 4), np.nan)
    found[inside] = truth.at(taken[inside]).matrices
    return taken, found
