"""Windows of consecutive frames, with the inertial samples and the motion between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset

from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.core.geometry import Array, invert
from oysterbench.sequence import Sequence
from oysterbench.sequence.places import CACHE_BYTES, Chunks, IndexedFile
from oysterbench.sequence.types import imu_arrays
from oysterbench.torch.sources import Shots, Source, Transform, cameras_of, opened, place_of, sequence_files


class WindowDataset(Dataset[Any]):
    """Windows of consecutive frames with what moved between them: for visual-inertial odometry that is learned.

    Parameters
    ----------
    source : str, path, oysterbench.Split, or several of these
        A split or its name, which is rendered or downloaded where it is not here; sequence files (.mcap); folders of
        them.
    length : int
        Frames T in a window, two at least.
    stride : int
        Frames from the begin of a window to that of the next.
    camera : str or list of str, optional
        Whose frames; the first of each sequence by default.
    poses : bool
        Whether true poses come along. Without them, sequences that keep their truth back can be read, too.
    max_gap_s : float, optional
        Windows in which two frames are further apart, as where frames were lost, are left out.
    transform : callable, optional
        Given an item, returns what is to be given instead. It must be picklable where workers are spawned.
    cache_mb : float
        Unpacked chunks of files that each process keeps.

    Notes
    -----
    An item is a dict. K is the most inertial samples that lie between two frames anywhere in the data set, so that all
    items have one shape and the default collate function makes batches of them:

    ============== ======================== ============================================================
    key            tensor                   what
    ============== ======================== ============================================================
    image          (T, 3, H, W) uint8       RGB
    stamp_ns       (T,) int64               of the frames, ns
    imu            (T - 1, K, 6) float32    angular rate x y z, rad/s, and specific force x y z, m/s^2, both
                                            in the IMU's frame, of the samples after frame t up to frame
                                            t + 1, the latter included; 0 behind the last one
    imu_stamp_ns   (T - 1, K) int64         of the samples, ns; 0 behind the last one
    imu_count      (T - 1,) int64           samples before the padding
    pose           (T, 4, 4) float64        true T_map_body when each frame was taken, m
    relative_pose  (T - 1, 4, 4) float32    true motion in the body's frame: takes points of the body at
                                            frame t + 1 into the body at frame t, m
    intrinsics     (3, 3) float32           matrix of the camera, px
    T_body_camera  (4, 4) float32           takes points of the optical frame into the body, m
    T_body_imu     (4, 4) float32           takes points of the IMU's frame into the body, m
    name, sequence, camera  str             name: SEQUENCE/CAMERA/STAMP of the first frame
    ============== ======================== ============================================================

    Frames x forward, y left, z up in the body; z forward, x right, y down in the optical frame. Calibrations are those
    that methods are given.

    Raises
    ------
    oysterbench.core.errors.SequenceError
        A file is absent, damaged, has no such camera, or no truth although `poses` asks for it.

    Examples
    --------
    Of a file, or of a split by its name, as `WindowDataset("slam-train", length=5)`:

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
            if not isinstance(value, int) or value < least:
                raise OptionError(f"{name}: expected a number of frames from {least} on, got {value!r}")
        self.length, self.stride, self.poses, self.transform = length, stride, poses, transform
        asked = [camera] if isinstance(camera, str) else None if camera is None else list(camera)
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
    """The frames of one camera, F of them.

    imu, imu_stamps_ns: all inertial samples (N, 6) and their stamps (N,); edges (F,): number of samples up to each
    frame, that at its stamp included; poses (F, 4, 4): T_map_body, NaN where the truth does not reach; None without
    """

    shots: Shots
    imu: NDArray[np.float32]
    imu_stamps_ns: NDArray[np.int64]
    edges: NDArray[np.intp]
    poses: Array | None
    T_body_imu: Array

    @property
    def most_samples(self) -> int:
        """Between two frames."""
        return int(np.diff(self.edges).max(initial=1))

    def begins(self, length: int, stride: int, max_gap_s: float | None) -> NDArray[np.intp]:
        """Numbers of the first frames of windows."""
        count = len(self.shots.stamps_ns)
        known = np.ones(count, dtype=bool) if self.poses is None else np.isfinite(self.poses[:, 0, 0])
        most_ns = np.iinfo(np.int64).max if max_gap_s is None else round(1e9 * max_gap_s)
        near = np.asarray(np.diff(self.shots.stamps_ns) <= most_ns)
        starts = range(0, count - length + 1, stride)
        whole = [k for k in starts if known[k : k + length].all() and near[k : k + length - 1].all()]
        return np.array(whole, dtype=np.intp)

    def item(self, begin: int, end: int, samples: int) -> dict[str, Any]:
        """Of the frames from `begin` on, before `end`, with room for so many inertial samples between two."""
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
        known = _poses(sequence, path, camera, stamps) if poses else None
        parts.append(_Part(shots, imu, imu_stamps, edges, known, sequence.imu_calibration.T_base_imu))
    return parts


def _poses(sequence: Sequence, path: Path, camera: str, stamps_ns: NDArray[np.int64]) -> Array:
    """(F, 4, 4) true T_map_body when frames of these stamps were taken; NaN where the truth does not reach."""
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
    return found
