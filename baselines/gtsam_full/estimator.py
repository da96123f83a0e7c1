"""The estimator: a filter that always runs, and the window of gtsam_vi, which corrects it at every key frame.

The filter (IMU, DVL, depth, compass) predicts every frame and needs no picture. From the window comes its state, with
its covariance, anew at each key frame; the window in turn starts from the filter, and starts again from it after a
failure. So there is a pose and a covariance for every frame, with or without anything to see.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import DvlMeasurement, MagneticMeasurement, PressureMeasurement, RangeMeasurement
from oysterbench.sequence.types import CameraCalibration, Sequence
from oysterbench_baselines.common.aiding import Aiding
from oysterbench_baselines.common.filter import (
    VELOCITY,
    InertialNoise,
)
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.common.start import start_filter
from oysterbench_baselines.gtsam_full.echoes import Echo, altimeter_echo, beam_echoes
from oysterbench_baselines.gtsam_full.factors import (
    COMPASS_KEY,
    DEPTH_KEY,
    DVL_KEY,
    FIELD_UNIT,
    depth_factor,
    field_factor,
    sum_velocities,
    velocity_factor,
)
from oysterbench_baselines.gtsam_full.model import AidedModel
from oysterbench_baselines.gtsam_full.settings import Settings
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.graph import adjust
from oysterbench_baselines.gtsam_vi.initialisation import View
from oysterbench_baselines.gtsam_vi.states import State, read_state
from oysterbench_baselines.gtsam_vi.window import Window

FLOOR = np.diag([1e-4**2] * 3 + [1e-5**2] * 3)
"""m^2 and rad^2 on every covariance: the first pose is exact by definition."""


class AidedEstimator(Estimator):
    """Takes frames of tracks, inertial measurements and the aiding sensors' samples, in time order."""

    settings: Settings
    _window: Window | None
    _first: int

    def __init__(
        self,
        sequence: Sequence,
        camera: CameraCalibration,
        settings: Settings,
        first: tuple[NDArray[np.int64], Array, Array],
    ) -> None:
        """first: stamps (N,), gyro and accel (N, 3) of the first moments, by which the vehicle is levelled."""
        settings = settings.for_rig(sequence)
        super().__init__(camera, sequence.imu_calibration, settings)
        noise = InertialNoise.of(self.imu, settings.imu_inflation)
        self.filter, self.info["started_at_rest"] = start_filter(*first, self.imu, noise, settings.start)
        self.aiding = Aiding(sequence, settings.aiding)
        has_dvl = "dvl" in settings.sensors(sequence)
        self.model: AidedModel = AidedModel(camera, self.imu, settings, has_dvl, has_dvl or bool(sequence.altimeters))
        self._altimeters = sequence.altimeters
        self._ranges: dict[str, RangeMeasurement | DvlMeasurement] = {}  # the latest, by sensor
        self._velocity_ns: int | None = None  # when the DVL last gave a velocity that was believed
        self._parts: list[tuple[Segment, DvlMeasurement | None]] = []  # since the last key frame
        self._intervals: dict[
            int, list[tuple[Segment, DvlMeasurement | None]]
        ] = {}  # by the key frame that they lead to
        self._heights: dict[int, tuple[float, float]] = {}  # of the pressure sensor at a key frame, and 1 sigma, m
        self._fields: dict[int, tuple[Array, float]] = {}  # magnetic field at a key frame, and 1 sigma, FIELD_UNIT
        self._pressure: PressureMeasurement | None = None
        self._field: MagneticMeasurement | None = None
        self._first_field: tuple[Array, int] | None = None

    # Samples.

    def add_segment(self, segment: Segment) -> None:
        """Inertial measurements up to the next sample or frame."""
        for dt, gyro, accel in zip(segment.dt, segment.gyro, segment.accel, strict=True):
            self.filter.propagate(dt, gyro, accel)
        if self.keyframes:
            self._parts.append((segment, None))

    def add_sample(self, sample: DvlMeasurement | PressureMeasurement | MagneticMeasurement | RangeMeasurement) -> None:
        """A sample at the end of the last segment."""
        if isinstance(sample, RangeMeasurement):
            self._ranges[sample.sensor] = sample
            return
        if isinstance(sample, DvlMeasurement):
            self._ranges["dvl"] = sample
        if not self.aiding.add(self.filter, sample):
            return  # what the filter refuses as a lie is none in the window either
        if isinstance(sample, DvlMeasurement):
            self._velocity_ns = sample.stamp_ns
            if self._parts:
                self._parts[-1] = (self._parts[-1][0], sample)
        elif isinstance(sample, PressureMeasurement):
            self._pressure = sample
        elif isinstance(sample, MagneticMeasurement):
            self._field = sample

    def add_frame(self, stamp_ns: int, segment: Segment, ids: NDArray[np.int64], rays: Array) -> None:
        if not self.keyframes and self.model.has_dvl:
            self._hold_start()
        super().add_frame(stamp_ns, segment, ids, rays)
        pose = self.filter.pose
        if self._sails or self._window is not None:
            self.frames[-1].online = pose
        place = (pose @ invert(self.imu.T_base_imu))[:3, 3]
        self.frames[-1].covariance = self.filter.pose_covariance(place) + FLOOR

    @property
    def _sails(self) -> bool:
        """Whether the filter has ever been told a velocity: without one it is dead reckoning by the inertial unit."""
        return self.aiding.rows("dvl") is not None

    @property
    def gyro_bias(self) -> Array:
        return self.filter.gyro_bias

    def _carry(self, segment: Segment) -> None:
        """It has been carried on, sample by sample."""

    # Key frames.

    def _add_keyframe(self, stamp_ns: int, view: View, predicted: State | None) -> None:
        k = len(self.keyframes)
        self._intervals[k], self._parts = self._parts, []
        self._note_height(k, stamp_ns)
        self._note_field(k, stamp_ns)
        self._note_echoes(k, stamp_ns)
        super()._add_keyframe(stamp_ns, view, predicted)
        if self._window is not None:
            self._intervals.clear()  # all of them are in factors now

    def _note_height(self, k: int, stamp_ns: int) -> None:
        """The depth reading, moved to the key frame at the filter's vertical speed."""
        if self._pressure is None:
            return
        delay = (stamp_ns - self._pressure.stamp_ns) * 1e-9
        height = self.aiding.height(self._pressure) + delay * self.filter.velocity[2]
        variance = self.aiding.height_variance(self._pressure, Segment.join(self._since).duration)
        if delay <= self.settings.keyframe_max_s:
            self._heights[k] = float(height), float(np.sqrt(variance + (0.02 * delay) ** 2))

    def _note_field(self, k: int, stamp_ns: int) -> None:
        """The magnetic field, if it was read a moment ago; less certain as the vehicle turns."""
        sample, settings = self._field, self.settings
        if sample is None or (stamp_ns - sample.stamp_ns) * 1e-9 > settings.compass_delay_s:
            return
        if self._fields and k < next(reversed(self._fields)) + settings.compass_keyframes:
            return
        field = sample.field / FIELD_UNIT
        turned = np.linalg.norm(self.filter.rate) * (stamp_ns - sample.stamp_ns) * 1e-9
        own = (sample.variance + settings.aiding.magnetic_sigma**2) / FIELD_UNIT**2
        self._fields[k] = field, float(np.sqrt(own + (turned * np.linalg.norm(field)) ** 2))
        if self._first_field is None:
            self._first_field = field, k

    def _note_echoes(self, k: int, stamp_ns: int) -> None:
        """The ranges that were read a moment ago, as rays in the IMU's frame of the key frame.

        They are for the scale, and a DVL's velocity knows it ten times better than they do over relief.
        """
        f, of = self.filter, self.settings.echo
        if not self.model.has_ranges:
            return
        if self._velocity_ns is not None and stamp_ns - self._velocity_ns < of.silence_s * 1e9:
            return
        T_imu_base = invert(self.imu.T_base_imu)
        echoes: list[Echo | None] = []
        for name, sample in self._ranges.items():
            delay = (stamp_ns - sample.stamp_ns) * 1e-9
            moved = delay * f.rate, delay * f.rotation.T @ f.velocity
            if delay > of.delay_s:
                continue
            if isinstance(sample, DvlMeasurement):
                echoes += beam_echoes(sample, self.aiding.T_imu_dvl, moved, of)
            else:
                echoes.append(altimeter_echo(sample, self._altimeters[name], T_imu_base, moved, of))
        self.model.echoes[k] = [echo for echo in echoes if echo is not None]

    def _aiding_of(self, k: int, before: State) -> list[gtsam.NonlinearFactor]:
        """Factors of the interval that leads to key frame k, and of k itself; `before`: the state one earlier."""
        settings, aiding, factors = self.settings, self.aiding, []
        gravity = self.imu.gravity
        if self.model.has_dvl:
            floor = settings.aiding.dvl_noise_floor
            velocity = sum_velocities(self._intervals[k], before, gravity, aiding.T_imu_dvl, floor)
            if velocity is not None:
                factors.append(velocity_factor(velocity, k - 1, gravity, settings.aiding_huber))
        if k in self._heights and self.model.height_offset is not None:
            factors.append(depth_factor(k, self._heights[k][0], aiding.T_imu_pressure[:3, 3], self._heights[k][1]))
        if k in self._fields and self.model.earth is not None:
            field, sigma = self._fields[k]
            rotation = aiding.T_imu_compass[:3, :3].T
            factors.append(field_factor(k, field, sigma, rotation, settings.aiding_huber))
        return factors

    # Start.

    def _try_to_start(self, max_scale_sigma: float) -> None:
        """With a DVL the filter knows the motion, and the window takes it from there; without, as gtsam_vi does."""
        if not self._sails:
            if self.model.height_offset is None and self._heights:
                self.model.height_offset = next(iter(self._heights.values()))[0]  # odom is about where it starts
            if self.model.earth is None and self._first_field is not None:
                self.model.earth = self._earth_seen(self._filter_state(), self.keyframes[-1].index)
            for keyframe in self.keyframes[self._first + 1 :]:
                if not keyframe.aiding:
                    keyframe.aiding = self._aiding_of(keyframe.index, self._filter_state())
            super()._try_to_start(max_scale_sigma)
            return
        self.model.height_offset = self.aiding.height_offset(self.filter)
        settings = self.settings
        stretch = self.keyframes[self._first :]
        elapsed = (stretch[-1].stamp_ns - stretch[0].stamp_ns) * 1e-9
        tilt = np.sqrt(np.diag(self.filter.covariance)[:2].max())
        if len(stretch) < settings.start_keyframes or elapsed < settings.start_s:
            return
        if tilt > np.radians(settings.start_tilt_deg):
            return
        states = self._states_back(stretch)
        if self._first_field is not None:
            self.model.earth = self._earth_seen(states[-1], stretch[-1].index)
        for keyframe, before in zip(stretch[1:], states[:-1], strict=True):
            keyframe.aiding = self._aiding_of(keyframe.index, before)
        try:
            bundle = adjust(self.model, stretch, states, (3 * settings.max_slide_px, settings.max_landmark_error_px))
            window = Window(self.model, stretch, bundle)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            return
        self._window = window
        self.info.setdefault("init_s", (stretch[-1].stamp_ns - self.keyframes[0].stamp_ns) * 1e-9)
        for keyframe in stretch[1:] if self._first else stretch:
            keyframe.state = read_state(bundle.values, keyframe.index)
        self._good = (self.keyframes[-1].index, self.keyframes[-1].state)
        self._fill_back(stretch[0].index)

    def _earth_seen(self, state: State, k: int) -> Array:
        """Earth's field (3,) in odom, FIELD_UNIT, if `state` is that of key frame k. It is free: this is only where the
        solver begins."""
        assert self._first_field is not None
        field, _ = self._fields.get(k, (self._first_field[0], 0.0))
        to_compass = self.aiding.T_imu_compass[:3, :3].T @ state.nav.attitude().matrix().T
        return to_compass.T @ field

    def _states_back(self, stretch: list) -> list[State]:
        """States of the key frames: the filter's at the last, and back from there along the inertial measurements."""
        states = [self._filter_state()]
        for keyframe in reversed(stretch[1:]):
            states.append(self._back(states[-1], keyframe.segment))
        return states[::-1]

    # The window's estimate, as the filter's state.

    def _calibrations(self) -> dict[int, tuple[slice, Array]]:
        rows: dict[int, tuple[slice, Array]] = {}
        for key, name, unit in (
            (DVL_KEY, "dvl", np.ones(4)),
            (DEPTH_KEY, "pressure", np.ones(1)),
            (COMPASS_KEY, "magnetometer", np.r_[[FIELD_UNIT] * 6, np.ones(9)]),
        ):
            at = self.aiding.rows(name)
            if key in self.model.shared() and at is not None:
                rows[key] = at, unit
        return rows

    # Failures.

    def _restart(self) -> None:
        """The window is given up; the filter goes on, and the next window starts from it."""
        if not self._sails:
            super()._restart()
            return
        self.info["restarts"] = int(self.info.get("restarts", 0)) + 1
        self._distrust()
        self._window, self._bad_keyframes = None, 0
        self._first = self.keyframes[-1].index
        for keyframe in self.keyframes:
            if keyframe.state is None or not np.isfinite(keyframe.state.matrix).all():
                keyframe.state = self._filter_state()
        self.keyframes[-1].state = self._filter_state()
        self._hold_start()

    def _hold_start(self) -> None:
        """A window that starts now knows the first state as well as the filter does."""
        f = self.filter
        self.model.starts[self._first] = (
            f.pose_covariance(f.position),
            f.covariance[VELOCITY, VELOCITY] + np.eye(3) * 1e-6,
        )

    # Results.

    def finish(self) -> None:
        if not self._sails:
            super().finish()
            return
        self.info["keyframes"] = len(self.keyframes)
        self.info["initialised"] = int(self._window is not None)
        if self.loops is not None:
            self.info["places"], self.info["loops"] = len(self.loops.places), len(self.loops.loops)
        self.info.update({f"refused_{kind}": n for kind, n in self.aiding.refused.items()})
