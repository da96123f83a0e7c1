"""The methods: a sequence in, a trajectory and a map out, with one camera or with two."""

from __future__ import annotations

from oysterbench.core.errors import MethodError
from oysterbench.methods import Estimate
from oysterbench.sequence.types import Sequence
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.pipeline import Output, check_output, estimate_of, first_camera, run_estimator
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.stereo import second_camera


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
        output: Output = "smoothed",
        camera: str | None = None,
        settings: GtsamViSettings | None = None,
        stereo: bool = False,
        seed: int = 0,
    ) -> None:
        check_output(self.name, output)
        self.output, self.camera, self.stereo, self.seed = output, camera, stereo, seed
        self.settings = settings or GtsamViSettings()

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base at the camera's stamps, for some seconds where frames are missing too; and the map."""
        cameras = [first_camera(self.name, sequence, self.camera)]
        if self.stereo:
            second = second_camera(sequence, cameras[0], self.settings.stereo)
            if second is None:
                raise MethodError(
                    f"{self.name}: sequence {sequence.name} has no second camera that looks where {cameras[0]!r} "
                    f"looks; cameras: {', '.join(sequence.cameras)}; with one camera run gtsam_vi"
                )
            cameras.append(second)
        calibrations = [sequence.cameras[camera] for camera in cameras]
        estimator = Estimator(calibrations, sequence.imu_calibration, self.settings)
        run_estimator(estimator, sequence, cameras, sequence.stream(*cameras), self.seed)
        return estimate_of(estimator, self.output, self.settings, {"cameras": cameras})


class GtsamViStereo(GtsamVi):
    """The same with the second camera of a stereo pair."""

    name = "gtsam_vi_stereo"

    def __init__(
        self,
        output: Output = "smoothed",
        camera: str | None = None,
        settings: GtsamViSettings | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(output, camera, settings, True, seed)
