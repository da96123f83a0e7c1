"""The method: the estimator of gtsam_vi, given a levelled filter and all aiding sensors of a rig."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert
from oysterbench.methods import Estimate
from oysterbench.sequence.types import CameraCalibration, Sequence
from oysterbench_baselines.common.aiding import Aiding, aiding_sensors, imaging_sonar
from oysterbench_baselines.common.aiding.dvl import Dvl
from oysterbench_baselines.common.alignment import first_moments, start_filter
from oysterbench_baselines.common.checks import check_inertial
from oysterbench_baselines.common.filter import InertialNoise
from oysterbench_baselines.gtsam_full.ranges import Ranges
from oysterbench_baselines.gtsam_full.settings import GtsamFullSettings
from oysterbench_baselines.gtsam_vi.calibration import CameraUncertainty
from oysterbench_baselines.gtsam_vi.estimator import AidedFilter, Estimator
from oysterbench_baselines.gtsam_vi.frontend import FrontEnd
from oysterbench_baselines.gtsam_vi.method import (
    Output,
    check_output,
    estimate_of,
    first_camera,
    moving_mask,
    run_estimator,
)
from oysterbench_baselines.moving import mask_weights


class GtsamFull:
    """gtsam_vi with DVL, imaging sonar, pressure, magnetometer and altimeters, each where the rig has it.

    It needs no images while it has a DVL or a sonar, but always a camera's calibration, which gives the frame rate.

    output: "online" gives each pose and covariance as known at its frame, but before the first velocity or start as
    known then; "smoothed" those after an adjustment of the whole path. camera: name of the camera; the first one by
    default. seed: of the random samples in the epipolar check. mask: as in gtsam_vi.
    """

    name = "gtsam_full"
    track = "slam"

    def __init__(
        self,
        output: Output = "smoothed",
        camera: str | None = None,
        settings: GtsamFullSettings | None = None,
        seed: int = 0,
        mask: str = "",
    ) -> None:
        check_output(self.name, output)
        self.output, self.camera, self.seed, self.mask = output, camera, seed, mask
        self.settings = settings or GtsamFullSettings()
        used = {
            "mono": self.settings.pictures,
            "imu": True,
            "dvl": self.settings.dvl,
            "sonar": self.settings.sonar,
            "pressure": self.settings.depth,
            "compass": self.settings.compass,
            "altimeter": self.settings.ranges.enabled,
        }
        sensors = [sensor for sensor, is_used in used.items() if is_used]
        self.about = {"sensors": sensors, "online": output == "online", "code": "baselines/gtsam_full"}

    @property
    def weights(self) -> dict[str, Path]:
        """Files of the trained weights that it uses: those of the mask."""
        return mask_weights(self.mask)

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base with covariances at the stamps of frames, missing ones too, and at the end; and the map."""
        check_inertial(self.name, sequence)
        if not sequence.cameras and self.camera is None:
            raise MethodError(
                f"{self.name}: sequence {sequence.name} has no camera, whose frame rate it needs even without images; "
                "run dead_reckoning"
            )
        camera = first_camera(self.name, sequence, self.camera)
        sonars = list(sequence.sonars)[:1] if self.settings.sonar else []
        sensors = [*self.settings.sensors(sequence), *sequence.altimeters, *sonars]
        sensors += [camera] if self.settings.pictures else []
        stream = sequence.stream(*(sensors or ["imu"]))
        first = first_moments(self.name, sequence.name, stream, self.settings.start)
        calibration = sequence.cameras[camera]
        stated = sequence.uncertainty if self.settings.calibration.enabled else None
        known = CameraUncertainty.of(stated, [camera], [calibration])
        moments = first.stamps_ns, first.gyro, first.accel
        estimator = aided_estimator(sequence, calibration, self.settings, moments, known)
        front_end = FrontEnd(calibration, self.settings.frontend, self.seed, moving_mask(self.mask))
        whole, start_ns = chain(first.items, stream), int(first.stamps_ns[0])
        run_estimator(estimator, sequence, [camera], whole, self.seed, start_ns, front_end=front_end)
        info = {"camera": camera, "sensors": ["imu", *sensors]}
        return estimate_of(estimator, self.output, self.settings, info)


def aided_estimator(
    sequence: Sequence,
    camera: CameraCalibration,
    settings: GtsamFullSettings,
    first: tuple[NDArray[np.int64], Array, Array],
    uncertainty: CameraUncertainty | None = None,
) -> Estimator:
    """Create an estimator with all aiding sensors of a rig that are to be used.

    first: stamps (N,), gyro and accel (N, 3) of the first moments, by which the vehicle is levelled.
    uncertainty: of the camera.
    """
    imu, settings = sequence.imu_calibration, settings.for_rig(sequence)
    noise = InertialNoise.of(imu, settings.noise.imu_inflation)
    filter, at_rest = start_filter(*first, imu, noise, settings.start)
    sensors = aiding_sensors(sequence, settings.aiding, settings.sensors(sequence))
    dvl = next((sensor for sensor in sensors if isinstance(sensor, Dvl)), None)
    if settings.ranges.enabled and (dvl is not None or sequence.altimeters):
        sensors.append(Ranges(invert(imu.T_base_imu), sequence.altimeters, dvl, settings.ranges))
    reach = settings.window.keyframes - 2  # what is about to leave the window takes no more factors
    sonar = imaging_sonar(sequence, settings.aiding, reach, dvl) if settings.sonar else None
    if sonar is not None:
        sensors.append(sonar)
    aided = AidedFilter(filter, Aiding(sensors), settings.filter_start)
    estimator = Estimator([camera], imu, settings, aided, uncertainty)
    estimator.info["started_at_rest"] = at_rest
    return estimator
