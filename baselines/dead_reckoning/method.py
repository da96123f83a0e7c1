"""The method: a sequence in, an inertial path out, aided by whatever else measures motion."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, invert
from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import Estimate
from oysterbench.sequence.types import ImuMeasurement, Sequence
from oysterbench_baselines.common.aiding import Aiding, AidingSettings, aiding_sensors, sensors_of
from oysterbench_baselines.common.alignment import StartSettings, first_moments, start_filter
from oysterbench_baselines.common.checks import check_inertial
from oysterbench_baselines.common.filter import InertialNoise
from oysterbench_baselines.common.inertial import SampleBuffer

FLOOR = np.diag([1e-4**2] * 3 + [1e-5**2] * 3)
"""Added to every covariance, m^2 and rad^2: the first pose is exact by definition, and a singular matrix cannot be
inverted."""


@dataclass(frozen=True)
class DeadReckoningSettings:
    """Settings of the method.

    imu_inflation: factor on the white densities of the data sheet, to which vibration and quantisation add.
    """

    imu_inflation: float = 1.1
    start: StartSettings = field(default_factory=StartSettings)
    aiding: AidingSettings = field(default_factory=AidingSettings)


class DeadReckoning:
    """Inertial navigation, aided by DVL, pressure and magnetometer where the rig has them: an invariant filter."""

    name = "dead_reckoning"
    track = "slam"

    def __init__(self, settings: DeadReckoningSettings | None = None) -> None:
        self.settings = settings or DeadReckoningSettings()
        self.about = {
            "sensors": ["imu", "dvl", "pressure", "compass"],
            "online": True,
            "code": "baselines/dead_reckoning",
        }

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base with covariances at the stamps of the inertial samples, each from what came before it.

        odom starts at the vehicle, yaw zero, z up. Only the initial levelling uses all of the first second.
        """
        check_inertial(self.name, sequence)
        sensors = sensors_of(sequence)
        # A sensor must be named: with no name, a stream has the cameras.
        stream = sequence.stream(*(sensors or ["imu"]))
        calibration, settings = sequence.imu_calibration, self.settings
        first = first_moments(self.name, sequence.name, stream, settings.start)
        filter, at_rest = start_filter(
            first.stamps_ns,
            first.gyro,
            first.accel,
            calibration,
            InertialNoise.of(calibration, settings.imu_inflation),
            settings.start,
        )
        aiding, samples = Aiding(aiding_sensors(sequence, settings.aiding)), SampleBuffer()
        T_imu_base = invert(calibration.T_base_imu)
        stamps: list[int] = []
        poses: list[Array] = []
        covariances: list[Array] = []
        for item in chain(first.items, stream):
            if item.stamp_ns < first.stamps_ns[0]:
                continue
            if isinstance(item, ImuMeasurement):
                samples.add(item)
            segment = samples.cut(item.stamp_ns)
            filter.propagate_all(segment)
            aiding.propagate(segment)
            if isinstance(item, ImuMeasurement):
                stamps.append(item.stamp_ns)
                poses.append(filter.pose @ T_imu_base)
                covariances.append(filter.pose_covariance(poses[-1][:3, 3]) + FLOOR)
            else:
                aiding.update(filter, item)
        matrices = np.array(poses)
        positions = matrices[:, :3, 3] - matrices[0, :3, 3]
        quaternions = Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
        trajectory = Trajectory(np.array(stamps, dtype=np.int64), positions, quaternions, np.array(covariances))
        info = {"started_at_rest": at_rest, "sensors": ["imu", *sensors], "refused": aiding.refused}
        info |= aiding.found(filter)
        return Estimate(trajectory, {**info, "settings": dataclasses.asdict(settings)})
