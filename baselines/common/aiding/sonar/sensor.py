"""Imaging sonar: each fan is registered on a chart of those before it, which gives the vehicle's horizontal motion.

The filter is given the displacement since the last ping, as a mean velocity; the graph, that between the pings before
two keyframes on one chart, which drifts less than the sum of the displacements between. A ping that cannot be
registered is left out, and the next one is searched for as much farther as the vehicle may have moved. While a Doppler
log gives velocities, which give the displacement several times better, pings only maintain the chart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement, RangeMeasurement, SonarImage
from oysterbench.sequence.types import SonarCalibration, Uncertainty
from oysterbench_baselines.common.aiding.dvl import Dvl
from oysterbench_baselines.common.aiding.sensor import AidingSensor, Calibration, GateSettings, stated_sigmas
from oysterbench_baselines.common.aiding.sonar.chart import Chart
from oysterbench_baselines.common.aiding.sonar.factor import (
    SONAR_KEY,
    Motion,
    Sighting,
    Step,
    step_factor,
    turned,
    wrapped,
)
from oysterbench_baselines.common.aiding.sonar.fan import Grid, View, first_echo, texture
from oysterbench_baselines.common.aiding.sonar.ground import Ground
from oysterbench_baselines.common.aiding.sonar.loops import Loops
from oysterbench_baselines.common.aiding.sonar.registration import Guess, Match, register
from oysterbench_baselines.common.aiding.sonar.settings import SonarSettings
from oysterbench_baselines.common.filter import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, VELOCITY, InvariantFilter, cross
from oysterbench_baselines.common.inertial import Segment

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import Keyframe, State

LOWEST_M = 0.1  # over the bottom: nearer, nothing of it is in the fan
GAP_S = 0.005  # of inertial measurements, beyond which the displacement since the last ping is not known


@dataclass(frozen=True)
class Heard:
    """The last ping that was registered: stamp, place (3,) on the chart with covariance (3, 3), and what it showed."""

    stamp_ns: int
    place: Array
    covariance: Array
    picture: NDArray[np.float32]
    view: View


class Sonar(AidingSensor):
    """Imaging sonar as an aiding sensor. name: of the sonar. T_imu_sonar (4, 4): its mount. reach: keyframes back to
    which a factor may go, as the window has forgotten those before. velocity_ns: stamp of the last ping that was
    believed. registered: number of pings."""

    kind = "sonar"
    measures = (SonarImage, RangeMeasurement, DvlMeasurement)
    suspect: ClassVar[slice] = VELOCITY

    def __init__(
        self,
        name: str,
        T_imu_sonar: Array,
        calibration: SonarCalibration,
        ground: Ground,
        reach: int,
        settings: SonarSettings,
        gate: GateSettings,
        uncertainty: Uncertainty | None = None,
        dvl: Dvl | None = None,
    ) -> None:
        """uncertainty: of the whole rig, as its calibration states it. dvl: the log that takes precedence, if any."""
        super().__init__(gate)
        self.name, self.T_imu_sonar, self.ground, self.reach = name, T_imu_sonar, ground, reach
        self.settings, self._dvl = settings, dvl
        self.velocity_ns: int | None = None
        self.registered = 0
        self._grid = Grid.of(calibration)
        self._lower = 0.5 * calibration.vfov_rad
        turn = stated_sigmas(uncertainty, name, ["rotation_z_rad"])[0]
        mount = float(np.hypot(np.radians(settings.mount_sigma_deg), turn))
        self._sigmas = np.array([settings.scale_sigma, mount])
        self._floor = np.diag([settings.position_floor_m**2] * 2 + [settings.heading_floor**2])
        self.loops = Loops(self._grid, settings)
        self._chart, self._charts, self._way = Chart(settings.chart), 0, 0.0
        self._last: Heard | None = None
        self._since: list[Segment] = []  # the last ping that was registered
        self._sightings: dict[int, Sighting] = {}  # by keyframe
        self._alone: set[int] = set()  # keyframes at which no log gives the velocity
        self._first: int | None = None  # keyframe of the graph; None until its first factors are asked for

    def update(self, filter: InvariantFilter, sample: SonarImage | RangeMeasurement | DvlMeasurement) -> bool:
        if not isinstance(sample, SonarImage):
            self.ground.sound(filter, sample)
            return False
        return sample.sensor == self.name and self._hear(filter, sample)

    def _hear(self, filter: InvariantFilter, ping: SonarImage) -> bool:
        """Register a ping, and correct the filter by the displacement since the last one."""
        view, settings = self._view(filter, ping), self.settings
        if view is None:
            self.refused += 1
            return False
        picture = texture(ping.pixels, self._grid, settings.fan)
        last = self._last
        since = Motion.over(self._since, filter.gyro_bias, filter.accel_bias)
        if last is not None:
            elapsed = (ping.stamp_ns - last.stamp_ns) * 1e-9
            if elapsed > settings.patience_s or abs(elapsed - since.time) > GAP_S:
                last = None
        if last is None:
            self._begin(ping.stamp_ns, picture, view)
            return False
        match = self._register(filter, last, since, picture, view)
        if match is None:
            self.refused += 1
            return False
        predicted, slope = predict(filter, since, self.T_imu_sonar)
        to_odom = turned(heading_of(filter.rotation @ since.rotation.T @ self.T_imu_sonar[:3, :3]) - last.place[2])
        covariance = match.covariance + self._floor
        step = to_odom @ (match.place - last.place)[:2]
        noise = to_odom @ (covariance + last.covariance)[:2, :2] @ to_odom.T
        noise += self._sigmas[0] ** 2 * np.outer(step, step)
        if self._counts(ping.stamp_ns) and not self.correct(filter, step - predicted[:2], slope, noise):
            return False
        self._chart.add(picture, match.place, view, self._grid, settings.fan)
        self._way += float(np.hypot(step[0], step[1]))
        self._last, self._since = Heard(ping.stamp_ns, match.place, covariance, picture, view), []
        self.velocity_ns, self.registered = ping.stamp_ns, self.registered + 1
        return True

    def _register(
        self, filter: InvariantFilter, last: Heard, since: Motion, picture: NDArray[np.float32], view: View
    ) -> Match | None:
        """Register a fan on the chart, near where the filter has it. Its heading is that of the gyroscopes: relief
        rotates the image in the same sense for as long as the vehicle turns, which would be taken for a gyro bias."""
        predicted, slope = predict(filter, since, self.T_imu_sonar)
        heading = heading_of(filter.rotation @ since.rotation.T @ self.T_imu_sonar[:3, :3])
        there = last.place + np.append(turned(last.place[2] - heading) @ predicted[:2], predicted[2])
        spread = slope @ filter.covariance @ slope.T + last.covariance[:2, :2]
        drift = float(np.sqrt(filter.covariance[GYRO_BIAS, GYRO_BIAS].trace() / 3)) * since.time
        heading_sigma = float(np.hypot(drift, self.settings.gyro_walk * np.sqrt(since.time)))
        guess = Guess(there, float(np.sqrt(np.linalg.eigvalsh(spread)[-1])), max(heading_sigma, 1e-5))
        of = self.settings
        return register(self._chart, picture, view, guess, self._grid, of.fan, of.registration)

    def _counts(self, stamp_ns: int) -> bool:
        """Whether pings count: no log has given a velocity recently."""
        velocity_ns = None if self._dvl is None else self._dvl.velocity_ns
        return velocity_ns is None or stamp_ns - velocity_ns > self.settings.silence_s * 1e9

    def _view(self, filter: InvariantFilter, ping: SonarImage) -> View | None:
        """Height and attitude of the sonar over the bottom; None where the height is not known, or too low."""
        rotation = filter.rotation @ self.T_imu_sonar[:3, :3]
        back = np.eye(3)
        back[:2, :2] = turned(-heading_of(rotation))
        bottom = self.ground.z(ping.stamp_ns)
        if bottom is None:
            depression = float(np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0))) + self._lower
            height = first_echo(ping.pixels, self._grid, self.settings.ground.near_share) * np.sin(depression)
        else:
            height = float(filter.position[2] + filter.rotation[2] @ self.T_imu_sonar[:3, 3]) - bottom
        return View(float(height), back @ rotation) if height > LOWEST_M else None

    def _begin(self, stamp_ns: int, picture: NDArray[np.float32], view: View) -> None:
        """Start a new chart, with its origin at this ping."""
        self._chart, self._charts = Chart(self.settings.chart), self._charts + 1
        self._chart.add(picture, np.zeros(3), view, self._grid, self.settings.fan)
        self._last, self._since = Heard(stamp_ns, np.zeros(3), self._floor, picture, view), []

    def counts(self) -> dict[str, int]:
        return {"sonar_loops": self.loops.count} if self.loops.places else {}

    def propagate(self, segment: Segment) -> None:
        if self._last is not None:
            self._since.append(segment)

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        """Keep the last ping that was registered, if it was a moment ago."""
        last = self._last
        if self._counts(stamp_ns):
            self._alone.add(keyframe)
        if last is None or (stamp_ns - last.stamp_ns) * 1e-9 > self.settings.max_delay_s:
            return
        since = Motion.over(self._since, filter.gyro_bias, filter.accel_bias)
        if abs((stamp_ns - last.stamp_ns) * 1e-9 - since.time) < GAP_S:
            placed = last.place, last.covariance, self._charts, self._way
            sighting = Sighting.at(*placed, since, self.T_imu_sonar)
            self._sightings[keyframe] = sighting
            if keyframe in self._alone and self.settings.loops.enabled:
                self.loops.keep(keyframe, sighting, self._chart, last.picture, last.view)

    def initialise(self, keyframe: int, state: State, filter: InvariantFilter | None) -> None:
        self._first = None

    def calibration(self) -> Calibration:
        return Calibration(SONAR_KEY, np.zeros(2), self._sigmas)

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        """Factor to the earliest keyframe that is in the window, on the same chart, and near."""
        if self._first is None:
            self._first = keyframe - 1
        second, settings = self._sightings.get(keyframe), self.settings
        if second is None or keyframe not in self._alone:
            return []
        for index in range(max(keyframe - self.reach, self._first), keyframe):
            first = self._sightings.get(index)
            if first is None or first.chart != second.chart or second.way - first.way > settings.longest_m:
                continue
            way = second.way - first.way
            step = Step.of(first, second, way * settings.drift**2, np.sqrt(way) * settings.drift_heading)
            return [step_factor(step, index, keyframe, huber=settings.huber)]
        return []

    def stretch_factors(
        self, keyframes: list[Keyframe], states: list[State], ids: NDArray[np.int64], points: Array
    ) -> list[gtsam.NonlinearFactor]:
        """Factors of the loops among the keyframes."""
        return self.loops.factors({k.index: state for k, state in zip(keyframes, states, strict=True)})


def heading_of(rotation: Array) -> float:
    """Heading of the x axis, rad."""
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def predict(filter: InvariantFilter, since: Motion, T_imu_sonar: Array) -> tuple[Array, Array]:
    """Motion (3,) of the sonar up to now: x, y (m) in odom and rotation (rad); and the derivative (2, 15 + M) of x, y
    by the filter's error, without the effect of heading, which turns displacement and image alike.

    d = v t - g t^2 / 2 - R_then lag, plus what the lever arm adds. A rotation of the state takes d + g t^2 / 2 along;
    gravity stays.
    """
    then = filter.rotation @ since.rotation.T
    lever, fall = T_imu_sonar[:3, 3], 0.5 * since.time**2 * filter.down
    way = since.time * filter.velocity - fall - then @ since.lag + (filter.rotation - then) @ lever
    turn = wrapped(heading_of(filter.rotation @ T_imu_sonar[:3, :3]) - heading_of(then @ T_imu_sonar[:3, :3]))
    slope = np.zeros((2, len(filter.covariance)))
    slope[:, ATTITUDE] = -cross(np.array([0.0, 0.0, way[2]]) + fall)[:2]
    slope[:, VELOCITY] = since.time * np.eye(3)[:2]
    slope[:, ACCEL_BIAS] = -(then @ since.by_accel)[:2]
    return np.append(way[:2], turn), slope
