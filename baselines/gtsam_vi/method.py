"""The method: a sequence in, a trajectory out."""

from __future__ import annotations

import dataclasses
from typing import Literal

from oysterbench.errors import MethodError
from oysterbench.methods import Estimate
from oysterbench.sequence.types import ImuSample, Sequence
from oysterbench_baselines.common.inertial import SampleBuffer, relative_rotation
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import FrontEnd
from oysterbench_baselines.gtsam_vi.settings import Settings


class GtsamVi:
    """Monocular visual-inertial odometry on GTSAM: KLT tracks, preintegrated inertial factors, a fixed-lag smoother.

    output: "smoothed" gives the poses after an adjustment of the whole path, "online" those known at each frame.
    camera: name of the camera; the first one by default.
    """

    name = "gtsam_vi"
    track = "slam"

    def __init__(
        self,
        output: Literal["smoothed", "online"] = "smoothed",
        camera: str | None = None,
        settings: Settings | None = None,
    ) -> None:
        if output not in ("smoothed", "online"):
            raise MethodError(f"gtsam_vi: expected output 'smoothed' or 'online', got {output!r}")
        self.output = output
        self.camera = camera
        self.settings = settings or Settings()

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base at the camera's stamps."""
        camera = self.camera or next(iter(sequence.cameras), "")
        if camera not in sequence.cameras:
            raise MethodError(
                f"gtsam_vi: sequence {sequence.name} has no camera {camera!r}; cameras: "
                f"{', '.join(sequence.cameras) or 'none'}"
            )
        front_end = FrontEnd(sequence.cameras[camera], self.settings)
        estimator = Estimator(sequence.cameras[camera], sequence.imu_calibration, self.settings)
        R_imu_cam = estimator.model.T_imu_cam[:3, :3]
        samples = SampleBuffer()
        for item in sequence.stream(camera):
            if isinstance(item, ImuSample):
                samples.add(item)
                continue
            segment = samples.cut(item.stamp_ns)
            turn = R_imu_cam.T @ relative_rotation(segment, estimator.gyro_bias) @ R_imu_cam
            tracks = front_end.track(item.pixels, turn)
            estimator.add_frame(item.stamp_ns, segment, tracks.ids, tracks.rays)
        estimator.finish()
        trajectory = estimator.online() if self.output == "online" else estimator.smoothed()
        info = {"trajectory": self.output, "camera": camera, **estimator.info}
        return Estimate(trajectory, {**info, "settings": dataclasses.asdict(self.settings)})
