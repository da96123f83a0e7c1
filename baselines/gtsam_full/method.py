"""The method: a sequence in, a trajectory with covariances out."""

from __future__ import annotations

import dataclasses
from itertools import chain
from typing import Literal

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.methods import Estimate
from oysterbench.sequence.types import Sequence
from oysterbench_baselines.common.inertial import SampleBuffer, Segment, relative_rotation
from oysterbench_baselines.gtsam_full.estimator import AidedEstimator
from oysterbench_baselines.gtsam_full.settings import Settings
from oysterbench_baselines.gtsam_vi.frontend import NO_TRACKS, FrontEnd
from oysterbench_baselines.gtsam_vi.method import GtsamVi


class GtsamFull(GtsamVi):
    """gtsam_vi with DVL, pressure, magnetometer and altimeters, each where the rig has it.

    It needs no pictures while it has a DVL.

    output: "online" gives each pose and covariance as known at its frame, "smoothed" those after an adjustment of the
    whole path. camera: name of the camera; the first one by default. seed: of the random samples in the epipolar check.
    """

    name = "gtsam_full"
    track = "slam"

    def __init__(
        self,
        output: Literal["smoothed", "online"] = "smoothed",
        camera: str | None = None,
        settings: Settings | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(output, camera, seed=seed)
        self.settings: Settings = settings or Settings()

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base with covariances at the stamps of frames, missing ones too, and at the end; and the map."""
        camera, _ = self._cameras(sequence)
        sensors = [*self.settings.sensors(sequence), *sequence.altimeters]
        stream = sequence.stream(*sensors, camera)
        head = []
        for item in stream:
            head.append(item)
            if item.stamp_ns - head[0].stamp_ns > self.settings.start.level_s * 1e9:
                break
        inertial = [item for item in head if isinstance(item, ImuMeasurement)]
        if len(inertial) < 2:
            raise MethodError(f"gtsam_full: expected inertial samples in sequence {sequence.name}, got {len(inertial)}")
        first = (
            np.array([sample.stamp_ns for sample in inertial], dtype=np.int64),
            np.array([sample.gyro for sample in inertial]),
            np.array([sample.accel for sample in inertial]),
        )
        estimator = AidedEstimator(sequence, sequence.cameras[camera], self.settings, first)
        front_end = FrontEnd(sequence.cameras[camera], estimator.settings, self.seed)
        R_imu_cam = estimator.model.T_imu_cam[:3, :3]
        patience_ns = self.settings.missing_periods / sequence.cameras[camera].rate_hz * 1e9
        samples = SampleBuffer()
        since_frame, since_image = list[Segment](), list[Segment]()
        last_ns = latest_ns = int(first[0][0])  # of the last frame, and of the last inertial sample
        for item in chain(head, stream):
            if isinstance(item, ImuMeasurement):
                samples.add(item)
                latest_ns = item.stamp_ns
                if latest_ns - last_ns < patience_ns:
                    continue
            segment = samples.cut(item.stamp_ns)
            estimator.add_segment(segment)
            since_frame.append(segment)
            since_image.append(segment)
            tracks = None
            if isinstance(item, Image):
                since = Segment.join(since_image)
                if not (front_end.repeats(item.pixels) and estimator.has_moved(since)):
                    R_before_now = relative_rotation(since, estimator.gyro_bias)
                    tracks = front_end.track(item.pixels, R_imu_cam.T @ R_before_now @ R_imu_cam, since.duration)
                    since_image = []
            elif not isinstance(item, ImuMeasurement):
                estimator.add_sample(item)
                continue
            if estimator.frames and item.stamp_ns <= last_ns:
                continue  # its place has been taken
            seen = NO_TRACKS if tracks is None else tracks  # a frame may be missing, or stale
            estimator.add_frame(item.stamp_ns, Segment.join(since_frame), seen.ids, seen.rays)
            if isinstance(item, Image) and tracks is not None:
                estimator.look(front_end.image)
                estimator.paint(item.pixels, tracks)
            last_ns, since_frame = item.stamp_ns, []
        if latest_ns > last_ns:  # to the very end
            segment = samples.cut(latest_ns)
            estimator.add_segment(segment)
            estimator.add_frame(latest_ns, Segment.join([*since_frame, segment]), NO_TRACKS.ids, NO_TRACKS.rays)
        estimator.finish()
        paths = estimator.paths()
        others = {name: path for name, path in paths.items() if name != self.output and len(path)}
        info = {"trajectory": self.output, "camera": camera, "sensors": ["imu", *sensors, camera], **estimator.info}
        info["settings"] = dataclasses.asdict(self.settings)
        return Estimate(paths[self.output], info, self.output, others, estimator.map())
