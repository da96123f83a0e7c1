"""Height of the bottom, as sounded by an altimeter, the beams of a DVL, or the start of the fan's own echo."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement, RangeMeasurement
from oysterbench.sequence.types import AltimeterCalibration
from oysterbench_baselines.common.aiding.sonar.settings import GroundSettings
from oysterbench_baselines.common.filter import InvariantFilter


class Ground:
    """The plane onto which a fan is projected: z in odom, the mean of the latest soundings.

    altimeters: T_imu_sensor (4, 4) and calibration, by name. T_imu_dvl (4, 4): None where there is no log.
    """

    def __init__(
        self,
        altimeters: Mapping[str, tuple[Array, AltimeterCalibration]],
        T_imu_dvl: Array | None,
        settings: GroundSettings,
    ) -> None:
        self.settings = settings
        self._altimeters, self._T_imu_dvl = altimeters, T_imu_dvl
        self._soundings = deque[tuple[int, float]]()  # ns, z in odom

    def sound(self, filter: InvariantFilter, sample: RangeMeasurement | DvlMeasurement) -> None:
        """Add a reading, given the filter at its stamp. The beams of a log together weigh as much as an altimeter."""
        found: list[float] = []
        if isinstance(sample, RangeMeasurement):
            mount, calibration = self._altimeters[sample.sensor]
            if calibration.min_range_m <= sample.range <= calibration.max_range_m:
                # The first echo of a wide cone comes from straight below, within it.
                axis = filter.rotation @ mount[:3, 0]
                down = min(-axis[2], 1.0)
                tilt = max(float(np.arccos(down)) - 0.5 * calibration.beam_rad, 0.0)
                found.append(self._place(filter, mount) - sample.range * float(np.cos(tilt)))
        elif self._T_imu_dvl is not None:
            rotation = filter.rotation @ self._T_imu_dvl[:3, :3]
            valid = np.asarray(sample.beam_valid, dtype=bool) & np.isfinite(sample.beam_ranges)
            falls = (sample.beam_directions[valid] @ rotation.T)[:, 2] * sample.beam_ranges[valid]
            if len(falls):
                found.append(self._place(filter, self._T_imu_dvl) + float(np.mean(falls)))
        for z in found:
            self._soundings.append((sample.stamp_ns, z))

    @staticmethod
    def _place(filter: InvariantFilter, mount: Array) -> float:
        return float(filter.position[2] + filter.rotation[2] @ mount[:3, 3])

    def z(self, stamp_ns: int) -> float | None:
        """z (m) of the plane that echoes come from, at a stamp; None where nothing has sounded it recently."""
        while self._soundings and stamp_ns - self._soundings[0][0] > self.settings.memory_s * 1e9:
            self._soundings.popleft()
        if not self._soundings:
            return None
        return float(np.mean([z for _, z in self._soundings])) + self.settings.standing_m
