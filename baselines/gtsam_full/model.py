"""The visual-inertial model with what the aiding sensors share: their calibrations, as variables of the graph."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np

from oysterbench.geometry import Array
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.gtsam_full.factors import COMPASS_KEY, DVL_KEY, FIELD_UNIT
from oysterbench_baselines.gtsam_full.settings import Settings
from oysterbench_baselines.gtsam_vi.graph import Model


class AidedModel(Model):
    """earth: the Earth's field (3,) in odom as first read, FIELD_UNIT; None: no compass."""

    def __init__(self, camera: CameraCalibration, imu: ImuCalibration, settings: Settings, has_dvl: bool) -> None:
        super().__init__(camera, imu, settings)
        self.aiding = settings.aiding
        self.has_dvl = has_dvl
        self.earth: Array | None = None

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
