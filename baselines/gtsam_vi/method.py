"""The method: a sequence in, a trajectory out."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Literal

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array
from oysterbench.core.measurements import Image
from oysterbench.methods import Estimate
from oysterbench.sequence.types import ImuMeasurement, Sequence
from oysterbench_baselines.common.inertial import SampleBuffer, Segment, relative_rotation
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import NO_TRACKS, FrontEnd, Tracks
from oysterbench_baselines.gtsam_vi.settings import Settings
from oysterbench_baselines.gtsam_vi.stereo import StereoMatcher, pairs, second_camera


class GtsamVi:
    """Visual-inertial odometry on GTSAM: KLT tracks, preintegrated inertial factors, a fixed-lag smoother.

    output: "smoothed" gives the poses after an adjustment of the whole path, "online" those known at each frame.
    camera: name of the camera; the first one by default. stereo: use a second camera beside it as well.
    seed: of the random samples in the epipolar check.
    """

    name = "gtsam_vi"
    track = "slam"

    def __init__(
        self,
        output: Literal["smoothed", "online"] = "smoothed",
        camera: str | None = None,
        settings: Settings | None = None,
        stereo: bool = False,
        seed: int = 0,
    ) -> None:
        if output not in ("smoothed", "online"):
            raise MethodError(f"{self.name}: expected output 'smoothed' or 'online', got {output!r}")
        self.output = output
        self.camera = camera
        self.settings = settings or Settings()
        self.stereo = stereo
        self.seed = seed

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base at the camera's stamps, for some seconds where frames are missing too; and the map."""
        camera, second = self._cameras(sequence)
        front_end = FrontEnd(sequence.cameras[camera], self.settings, self.seed)
        right = None if second is None else sequence.cameras[second]
        matcher = None if right is None else StereoMatcher(sequence.cameras[camera], right, self.settings)
        estimator = Estimator(sequence.cameras[camera], sequence.imu_calibration, self.settings, right)
        R_imu_cam = estimator.model.T_imu_cam[:3, :3]
        samples = SampleBuffer()
        cameras = [camera] if second is None else [camera, second]
        patience_ns = self.settings.missing_periods / sequence.cameras[camera].rate_hz * 1e9
        since_image = list[Segment]()
        last_ns, seen_ns = 0, 0  # of the last frame, and of the last picture
        for item in pairs(sequence.stream(*cameras), camera, second, self.settings.stereo_stamp_s):
            if isinstance(item, ImuMeasurement):
                samples.add(item)
                blind_ns = item.stamp_ns - seen_ns
                if seen_ns == 0 or item.stamp_ns - last_ns < patience_ns or blind_ns > self.settings.coast_s * 1e9:
                    continue
            elif item[0].stamp_ns <= last_ns:
                continue  # its place has been taken
            stamp_ns = item.stamp_ns if isinstance(item, ImuMeasurement) else item[0].stamp_ns
            segment = samples.cut(stamp_ns)
            since_image.append(segment)
            since, last_ns = Segment.join(since_image), stamp_ns
            if isinstance(item, ImuMeasurement) or (front_end.repeats(item[0].pixels) and estimator.has_moved(since)):
                estimator.add_frame(stamp_ns, segment, NO_TRACKS.ids, NO_TRACKS.rays)  # it is missing, or stale
                continue
            image, other = item
            turn = R_imu_cam.T @ relative_rotation(since, estimator.gyro_bias) @ R_imu_cam
            tracks = front_end.track(image.pixels, turn, since.duration)
            seen_ns, since_image = stamp_ns, []
            match = None
            if matcher is not None and other is not None:
                match = partial(_match, matcher, front_end, tracks, other)
            estimator.add_frame(stamp_ns, segment, tracks.ids, tracks.rays, match)
            estimator.look(front_end.image)
            estimator.paint(image.pixels, tracks)
        estimator.finish()
        paths = estimator.paths()
        others = {name: path for name, path in paths.items() if name != self.output and len(path)}
        info = {"trajectory": self.output, "cameras": cameras, **estimator.info}
        info["settings"] = dataclasses.asdict(self.settings)
        return Estimate(paths[self.output], info, self.output, others, estimator.map())

    def _cameras(self, sequence: Sequence) -> tuple[str, str | None]:
        """Names of the camera, and of the second."""
        camera = self.camera or next(iter(sequence.cameras), "")
        if camera not in sequence.cameras:
            raise MethodError(
                f"{self.name}: sequence {sequence.name} has no camera {camera!r}; cameras: "
                f"{', '.join(sequence.cameras) or 'none'}"
            )
        if not self.stereo:
            return camera, None
        second = second_camera(sequence, camera, self.settings)
        if second is None:
            raise MethodError(
                f"{self.name}: sequence {sequence.name} has no second camera that looks where {camera!r} looks; "
                f"cameras: {', '.join(sequence.cameras)}; with one camera run gtsam_vi"
            )
        return camera, second


class GtsamViStereo(GtsamVi):
    """The same with the second camera of a stereo pair."""

    name = "gtsam_vi_stereo"

    def __init__(
        self,
        output: Literal["smoothed", "online"] = "smoothed",
        camera: str | None = None,
        settings: Settings | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(output, camera, settings, True, seed)


def _match(matcher: StereoMatcher, front_end: FrontEnd, tracks: Tracks, other: Image) -> Array:
    assert front_end.image is not None
    return matcher.match(front_end.image, front_end.equalise(other.pixels), tracks)
