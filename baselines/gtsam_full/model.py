"""The visual-inertial model with what the aiding sensors share: their calibrations, as variables of the graph."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from oysterbench.geometry import Array
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.gtsam_full.factors import COMPASS_KEY, DVL_KEY, FIELD_UNIT
from oysterbench_baselines.gtsam_full.settings import Settings
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.states import State

LEAST = np.array([1e-4] * 3 + [1e-4] * 3)
"""rad and m, 1 sigma: what the start is held with where it is exact by definition."""


class AidedModel(Model):
    """earth: the Earth's field (3,) in odom as first read, FIELD_UNIT; None: no compass. start: pose covariance (6, 6)
    and velocity covariance (3, 3) of the first key frame in odom's axes; None: nothing known but the gauge."""

    def __init__(self, camera: CameraCalibration, imu: ImuCalibration, settings: Settings, has_dvl: bool) -> None:
        super().__init__(camera, imu, settings)
        self.aiding = settings.aiding
        self.has_dvl = has_dvl
        self.earth: Array | None = None
        self.start: tuple[Array, Array] | None = None

    def shared(self) -> Mapping[int, Array]:
        values = {}
        if self.has_dvl:
            values[DVL_KEY] = np.zeros(4)
        if self.earth is not None:
            values[COMPASS_KEY] = np.concatenate([self.earth, np.zeros(3), np.eye(3).ravel()])
        return values

    def shared_priors(self) -> list[gtsam.NonlinearFactor]:
        aiding = self.aiding
        twist = np.radians(aiding.dvl_misalignment_sigma_deg)
        iron = [aiding.field_sigma / FIELD_UNIT] * 3 + [aiding.hard_iron_sigma / FIELD_UNIT] * 3
        sigmas = {
            DVL_KEY: [aiding.dvl_scale_sigma, twist, twist, twist],
            COMPASS_KEY: iron + [aiding.soft_iron_sigma] * 9,
        }
        return [
            gtsam.PriorFactorVector(key, mean, gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas[key])))
            for key, mean in self.shared().items()
        ]

    def start_priors(self, keyframe: int, state: State) -> list[gtsam.NonlinearFactor]:
        if self.start is None:
            return super().start_priors(keyframe, state)
        of_pose, of_velocity = self.start
        rotation = state.nav.attitude().matrix()
        # GTSAM states rotation before translation, both in the axes of the pose itself.
        turn = np.zeros((6, 6))
        turn[:3, 3:] = turn[3:, :3] = rotation.T
        pose = turn @ of_pose @ turn.T + np.diag(LEAST**2)
        turn_on = np.array([self.accel_turn_on] * 3 + [self.gyro_turn_on] * 3)
        return [
            gtsam.PriorFactorPose3(X(keyframe), state.nav.pose(), gtsam.noiseModel.Gaussian.Covariance(pose)),
            gtsam.PriorFactorVector(
                V(keyframe), state.nav.velocity(), gtsam.noiseModel.Gaussian.Covariance(of_velocity)
            ),
            gtsam.PriorFactorConstantBias(
                B(keyframe), gtsam.imuBias.ConstantBias(), gtsam.noiseModel.Diagonal.Sigmas(turn_on)
            ),
        ]
