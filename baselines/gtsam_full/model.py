"""The visual-inertial model with what the aiding sensors share: their calibrations, as variables of the graph."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.gtsam_full.echoes import ECHO_KEY, Echo, echo_factor, find_ground
from oysterbench_baselines.gtsam_full.factors import COMPASS_KEY, DEPTH_KEY, DVL_KEY, FIELD_UNIT
from oysterbench_baselines.gtsam_full.settings import Settings
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.states import Keyframe, State


class AidedModel(Model):
    """earth: the Earth's field (3,) in odom as first read, FIELD_UNIT; None: no compass. height_offset: of the pressure
    sensor over z of odom as first read, m; None: no such sensor. echoes: by key frame."""

    def __init__(
        self,
        camera: CameraCalibration,
        imu: ImuCalibration,
        settings: Settings,
        has_dvl: bool,
        has_ranges: bool = False,
    ) -> None:
        super().__init__(camera, imu, settings)
        self.aiding = settings.aiding
        self.has_dvl = has_dvl
        self.has_ranges = has_ranges and settings.ranges
        self.echo = settings.echo
        self.echoes: dict[int, list[Echo]] = {}
        self.earth: Array | None = None
        self.height_offset: float | None = None

    def shared(self) -> Mapping[int, Array]:
        values = {}
        if self.has_dvl:
            values[DVL_KEY] = np.zeros(4)
        if self.earth is not None:
            values[COMPASS_KEY] = np.concatenate([self.earth, np.zeros(3), np.eye(3).ravel()])
        if self.height_offset is not None:
            values[DEPTH_KEY] = np.array([self.height_offset])
        if self.has_ranges:
            values[ECHO_KEY] = np.zeros(2)
        return values

    def shared_priors(self) -> list[gtsam.NonlinearFactor]:
        aiding = self.aiding
        twist = np.radians(aiding.dvl_misalignment_sigma_deg)
        iron = [aiding.field_sigma / FIELD_UNIT] * 3 + [aiding.hard_iron_sigma / FIELD_UNIT] * 3
        sigmas = {
            DVL_KEY: [aiding.dvl_scale_sigma, twist, twist, twist],
            COMPASS_KEY: iron + [aiding.soft_iron_sigma] * 9,
            DEPTH_KEY: [aiding.height_sigma],
            ECHO_KEY: [self.echo.offset_sigma] * 2,
        }
        return [
            gtsam.PriorFactorVector(key, mean, gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas[key])))
            for key, mean in self.shared().items()
        ]

    def ground(
        self, keyframes: list[Keyframe], states: list[State], ids: NDArray[np.int64], points: Array
    ) -> list[gtsam.NonlinearFactor]:
        if not self.has_ranges or len(ids) < self.echo.fewest:
            return []
        tree, factors = cKDTree(points), []
        for keyframe, state in zip(keyframes, states, strict=True):
            for echo in self.echoes.get(keyframe.index, ()):
                ground = find_ground(echo, state.matrix, tree, ids, points, self.echo)
                if ground is not None:
                    factors.append(echo_factor(echo, ground, keyframe.index))
        return factors
