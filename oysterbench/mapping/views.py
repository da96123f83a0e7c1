"""Views: downscaled and undistorted pinhole images with their camera poses along a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import SequenceError, TrajectoryError
from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import Image
from oysterbench.core.trajectory import Trajectory, too_wide
from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.sequence.export.parts import undistorting_maps
from oysterbench.sequence.types import CameraCalibration, Sequence

Watch = Callable[[int], None]
"""Called with the stamp, ns, of each measurement that was processed."""


REPEATS_NS = 500_000_000
"""Period before a frame in which the frame that it repeats is searched for, ns."""
GRAVITY_SAMPLES = 2000
MOST_TILT_DEG = 15.0
"""Maximum median angle between gravity as measured by the IMU and the vertical of a trajectory: surge and the best
estimators stay below 2 deg, and a map with more tilt would be useless."""


def unwatched(stamp_ns: int) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class View:
    """A pinhole image: colours (H, W, 3) uint8 RGB, camera matrix (3, 3), T_world_cam (4, 4).

    shown: (H, W), where the camera shows something, as a lens may fill only part of the pinhole image; None for all
    """

    stamp_ns: int
    colours: NDArray[np.uint8]
    matrix: Array
    T_world_cam: Array
    shown: NDArray[np.bool_] | None = None

    @cached_property
    def grey(self) -> NDArray[np.float32]:
        """Grey levels (H, W) float32."""
        return cv2.cvtColor(self.colours, cv2.COLOR_RGB2GRAY).astype(np.float32)


class Pinhole:
    """Converts images of a camera to those of a pinhole camera, at most `width_px` columns wide."""

    def __init__(self, name: str, camera: CameraCalibration, width_px: int) -> None:
        if camera.port_m is not None:
            raise SequenceError(
                f"{name} looks through a flat port, so its rays do not meet in one point: expected a camera calibrated "
                "in water"
            )
        self.T_base_cam = camera.T_base_cam
        self._maps = undistorting_maps(camera, camera.matrix)
        scale = min(1.0, width_px / camera.width)
        self._size = (round(camera.width * scale), round(camera.height * scale))
        sx, sy = self._size[0] / camera.width, self._size[1] / camera.height
        # Pixel centres have integer coordinates: the left edge of the image stays at -0.5.
        self.matrix = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1.0]]) @ camera.matrix
        self._shown: NDArray[np.bool_] | None = None
        if self._maps is not None:
            whole = np.full((camera.height, camera.width), 255, dtype=np.uint8)
            self._shown = self._resized(cv2.remap(whole, *self._maps, cv2.INTER_LINEAR)) == 255

    def view(self, image: Image, T_world_base: Array) -> View:
        """Return the view of an image, at a pose T_world_base (4, 4)."""
        pixels = image.pixels
        if self._maps is not None:
            pixels = cv2.remap(pixels, *self._maps, cv2.INTER_LINEAR)
        return View(image.stamp_ns, self._resized(pixels), self.matrix, T_world_base @ self.T_base_cam, self._shown)

    def _resized(self, pixels: Any) -> Any:
        if self._size == pixels.shape[1::-1]:
            return pixels
        return cv2.resize(pixels, self._size, interpolation=cv2.INTER_AREA)


class PoseInterpolator:
    """Interpolates poses of base_link (4, 4), in the world frame of a trajectory, at any stamp that it covers."""

    def __init__(self, trajectory: Trajectory, max_gap_s: float) -> None:
        self.trajectory, self._max_gap_s = trajectory, max_gap_s

    def at(self, stamp_ns: int) -> Array | None:
        """Interpolate T_world_base; None outside the trajectory and in its gaps."""
        stamps = self.trajectory.stamps_ns
        after = int(np.searchsorted(stamps, stamp_ns))
        if after < len(stamps) and stamps[after] == stamp_ns:
            return np.asarray(self.trajectory.select(slice(after, after + 1)).matrices[0])
        if after in (0, len(stamps)) or too_wide(stamps[after] - stamps[after - 1], self._max_gap_s):
            return None
        return np.asarray(self.trajectory.select(slice(after - 1, after + 1)).at(np.array([stamp_ns])).matrices[0])

    def is_gap(self, stamp_ns: int) -> bool:
        """Whether a stamp without a pose lies between two poses that are too far apart, rather than before or after all
        of them."""
        stamps = self.trajectory.stamps_ns
        return bool(len(stamps) and stamps[0] < stamp_ns < stamps[-1])

    def taking(self, camera: CameraCalibration, stamp_ns: int) -> Array | None:
        """T_world_base at the time when a camera took the frame of a stamp; None as in `at`."""
        return self.at(camera.taken_ns(stamp_ns))

    def of_rows(self, camera: CameraCalibration, stamp_ns: int) -> Array | None:
        """T_world_cam at the time when each row of a frame was taken: (H, 4, 4) for a rolling shutter, else (1, 4, 4).

        None if the middle row has no pose, as in `at`. Rows beyond an end of the trajectory, or in a gap, have the pose
        at that end.
        """
        middle = self.taking(camera, stamp_ns)
        if middle is None or camera.readout_s == 0:
            return None if middle is None else (middle @ camera.T_base_cam)[None]
        stamps = self.trajectory.stamps_ns
        gaps, time = np.flatnonzero(too_wide(np.diff(stamps), self._max_gap_s)), camera.taken_ns(stamp_ns)
        first = max((stamps[gap + 1] for gap in gaps if stamps[gap] < time), default=stamps[0])
        last = min((stamps[gap] for gap in gaps if stamps[gap] >= time), default=stamps[-1])
        taken = np.clip(camera.rows_taken_ns(stamp_ns), first, last)
        around = slice(int(np.searchsorted(stamps, taken[0], "right")) - 1, int(np.searchsorted(stamps, taken[-1])) + 1)
        return np.asarray(self.trajectory.select(around).at(taken).matrices @ camera.T_base_cam)


def begin_ns(sequence: Sequence) -> int:
    """First stamp, of the IMU or, in a file without its topic, of the first sensor whose topics are there, cameras
    first. Raises SequenceError where there is none."""
    if sequence.has_imu:
        return next(iter(sequence.imu())).stamp_ns
    here = {topic for topic, _, count in sequence.contents() if count}
    for name, kind in sequence.sensors().items():
        if name in here or here.issuperset(kind.read_topics(name)):  # a folder of EuRoC, or topics of a file
            for measured in sequence.measurements(name):
                return int(measured.stamp_ns)
    raise SequenceError(f"{sequence.name} has all topics of no sensor: expected those of one or more for a map")


def check_time(sequence: Sequence, trajectory: Trajectory) -> None:
    """Refuse a trajectory that does not overlap with the sequence in time. Raises TrajectoryError."""
    first = begin_ns(sequence)
    last = first + round(sequence.duration_s * 1e9)
    if len(trajectory) == 0 or trajectory.stamps_ns[-1] < first or trajectory.stamps_ns[0] > last:
        got = "none" if len(trajectory) == 0 else (
            f"one from {trajectory.stamps_ns[0] * 1e-9:.3f} to {trajectory.stamps_ns[-1] * 1e-9:.3f} s"
        )  # fmt: skip
        raise TrajectoryError(
            f"expected a trajectory of {sequence.name}, from {first * 1e-9:.3f} to {last * 1e-9:.3f} s, got {got}: "
            "they do not overlap in time"
        )


def check_upright(sequence: Sequence, trajectory: Trajectory) -> None:
    """Refuse poses by which gravity, as measured by the IMU, does not point down: what is seen from them would not lie
    on the bottom. Without an IMU, none are. Raises TrajectoryError, with what the poses look like."""
    stamps, felt = [], []
    for sample in sequence.imu() if sequence.has_imu else ():
        if trajectory.stamps_ns[0] <= sample.stamp_ns <= trajectory.stamps_ns[-1]:
            stamps.append(sample.stamp_ns)
            felt.append(sample.accel)
    if not stamps:
        return
    step = -(-len(stamps) // GRAVITY_SAMPLES)
    up = np.array(felt[::step]) @ sequence.imu_calibration.T_base_imu[:3, :3].T
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    turns = Rotation.from_quat(trajectory.at(np.array(stamps[::step])).quaternions)

    def tilt_deg(attitudes: Rotation) -> float:
        return float(np.degrees(np.median(np.arccos(np.clip(attitudes.apply(up)[:, 2], -1.0, 1.0)))))

    tilt = tilt_deg(turns)
    if tilt < MOST_TILT_DEG:
        return
    reordered = Rotation.from_quat(np.roll(turns.as_quat(), -1, axis=1))
    looks = {"quaternions in the order w x y z: give --quaternion wxyz": reordered}
    for name, camera in sequence.cameras.items():
        of_base = turns * Rotation.from_matrix(camera.T_base_cam[:3, :3]).inv()
        place = [*camera.T_base_cam[:3, 3], *Rotation.from_matrix(camera.T_base_cam[:3, :3]).as_quat()]
        looks[f"poses of {name}: give --T-body-estimate={','.join(f'{n:.6g}' for n in place)}"] = of_base
    best = min(looks, key=lambda look: tilt_deg(looks[look]))
    seem = f"; they look like {best}" if tilt_deg(looks[best]) < MOST_TILT_DEG else ""
    raise TrajectoryError(
        f"by these poses the vehicle of {sequence.name} would be {tilt:.0f} deg from upright by its own inertial unit: "
        f"expected poses of base_link in a world whose z points up{seem}"
    )


def partner(sequence: Sequence, camera: str, settings: CloudSettings) -> str | None:
    """Name of a camera that sees much the same as `camera`, from beside it, at the same rate; None without one."""
    T_cam_base = invert(sequence.cameras[camera].T_base_cam)
    for name, other in sequence.cameras.items():
        T = T_cam_base @ other.T_base_cam
        angle = np.degrees(np.arccos(np.clip(T[2, 2], -1.0, 1.0)))
        same_rate = other.rate_hz == sequence.cameras[camera].rate_hz
        apart = 0.01 < float(np.linalg.norm(T[:3, 3])) < settings.max_base_m
        if name != camera and same_rate and apart and angle < settings.max_axes_deg:
            return name
    return None


def shown_at(sequence: Sequence, camera: str, stamp_ns: int) -> tuple[Image, int] | None:
    """The frame of a camera at a stamp, and the stamp at which its image first appeared: a video link that loses a
    frame repeats the last one. None if there is no frame."""
    earlier = list(sequence.images(camera, stamp_ns - REPEATS_NS, stamp_ns + 1))
    if not earlier or earlier[-1].stamp_ns != stamp_ns:
        return None
    image, first_ns = earlier[-1], stamp_ns
    for before in reversed(earlier[:-1]):
        if not np.array_equal(before.pixels, image.pixels):
            break
        first_ns = before.stamp_ns
    return image, first_ns


def without_repeats(images: Iterator[Image]) -> Iterator[Image]:
    """Yield the frames that do not repeat the image of the frame before."""
    before: Image | None = None
    for image in images:
        if before is None or not np.array_equal(before.pixels, image.pixels):
            yield image
        before = image


def frames(
    sequence: Sequence, camera: str, other: str | None, settings: CloudSettings
) -> Iterator[tuple[Image, Image | None]]:
    """Yield new frames of a camera, each with that of the other camera at its stamp; incomplete pairs are skipped."""
    own = without_repeats(sequence.images(camera))
    if other is None:
        yield from ((image, None) for image in own)
        return
    tolerance = settings.pair_tolerance_s * 1e9
    partners = without_repeats(sequence.images(other))
    second = next(partners, None)
    for image in own:
        while second is not None and second.stamp_ns < image.stamp_ns - tolerance:
            second = next(partners, None)
        if second is not None and second.stamp_ns <= image.stamp_ns + tolerance:
            yield image, second
