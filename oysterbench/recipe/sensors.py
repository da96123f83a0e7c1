"""What a vehicle measures with besides its cameras: inertial unit, sonars, DVL, pressure, magnetometer."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from oysterbench.recipe.grades import IMU_GRADES
from oysterbench.recipe.keys import choice, number

VIBRATION_KINDS = ("white", "sine", "psd")
VIBRATION_TARGETS = ("accel", "gyro")


@dataclass(frozen=True, kw_only=True)
class SensorRecipe:
    """What every sensor has: a rate, a place on the vehicle, a clock, and losses."""

    rate_hz: float = number(0.01, 4000)
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # in base_link
    clock_offset_ms: float = number(-1000, 1000, 0.0)  # of its stamps: positive when they are late
    dropout: float = number(0, 0.99, 0.0)  # share of its messages that are lost
    dropout_burst: float = number(1, 1000, 1.0)  # messages lost in a row, on average


@dataclass(frozen=True, kw_only=True)
class VibrationRecipe:
    """What thrusters and pumps add to a reading, through the whole sequence without restarts."""

    on: str = choice(VIBRATION_TARGETS)
    kind: str = choice(VIBRATION_KINDS)
    level: tuple[float, float, float] = number(0, 1000, (0.0, 0.0, 0.0))
    """Per axis, m/s^2 or rad/s: standard deviation of a sample (white), or amplitude (sine)."""
    frequency_hz: float = number(0, 2000, 1.0)  # of a sine; above half the unit's rate it aliases, as does a psd
    psd: tuple[tuple[float, float, float, float], ...] = number(0, 1e6, ())
    """Rows of frequency (Hz, increasing) and one-sided power spectral density per axis, (m/s^2)^2/Hz or (rad/s)^2/Hz;
    linear between the rows, nothing outside them."""


@dataclass(frozen=True, kw_only=True)
class ImuRecipe(SensorRecipe):
    """An inertial unit. `grade` gives every key of noise that is not given itself (`IMU_GRADES`)."""

    rate_hz: float = number(10, 4000)
    grade: str | None = choice(tuple(IMU_GRADES), None)
    gyro_noise_density: float = number(0, 1)  # rad/s/sqrt(Hz), angle random walk
    gyro_random_walk: float = number(0, 1)  # rad/s^2/sqrt(Hz), of the bias, without end
    gyro_turn_on: float = number(0, 1, 0.0)  # rad/s, 1 sigma
    gyro_bias_instability: float = number(0, 1, 0.0)  # rad/s, stationary 1 sigma of a Gauss-Markov process
    gyro_bias_tau_s: float = number(1, 1e5, 100.0)  # its correlation time
    gyro_scale: float = number(0, 0.5, 0.0)  # error of scale, 1 sigma
    gyro_misalignment_deg: float = number(0, 10, 0.0)  # of each axis towards the others, 1 sigma
    gyro_range: float | None = number(0.01, 1e3, None)  # rad/s; readings stop there
    gyro_step: float = number(0, 1, 0.0)  # rad/s, of the digital reading
    accel_noise_density: float = number(0, 10)  # m/s^2/sqrt(Hz), velocity random walk
    accel_random_walk: float = number(0, 10)  # m/s^3/sqrt(Hz), of the bias
    accel_turn_on: float = number(0, 10, 0.0)  # m/s^2, 1 sigma
    accel_bias_instability: float = number(0, 10, 0.0)  # m/s^2, stationary 1 sigma of a Gauss-Markov process
    accel_bias_tau_s: float = number(1, 1e5, 100.0)
    accel_scale: float = number(0, 0.5, 0.0)
    accel_misalignment_deg: float = number(0, 10, 0.0)
    accel_range: float | None = number(0.1, 1e4, None)  # m/s^2
    accel_step: float = number(0, 10, 0.0)  # m/s^2
    vibration: tuple[VibrationRecipe, ...] = ()
    rpy_deg: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # imu to base_link

    @property
    def gyro_bias_walk(self) -> float:
        """Random walk (rad/s^2/sqrt(Hz)) that the bias is over less than its correlation time, instability included.

        What a filter should take that knows a bias as a walk only.
        """
        return math.hypot(self.gyro_random_walk, self.gyro_bias_instability * math.sqrt(2 / self.gyro_bias_tau_s))

    @property
    def accel_bias_walk(self) -> float:
        """The same (m/s^3/sqrt(Hz)) of the accelerometer."""
        return math.hypot(self.accel_random_walk, self.accel_bias_instability * math.sqrt(2 / self.accel_bias_tau_s))


@dataclass(frozen=True, kw_only=True)
class AcousticRecipe(SensorRecipe):
    """What sonars have in common. Pitch is positive below the horizon."""

    name: str
    pitch_deg: float = number(-90, 90, 0.0)
    yaw_deg: float = number(-180, 180, 0.0)
    assumed_sound_speed_m_s: float | None = number(1300, 1700, None)  # that ranges are made with; None: the true one


@dataclass(frozen=True, kw_only=True)
class SonarRecipe(AcousticRecipe):
    """An imaging (multibeam, forward-looking) sonar: a fan of beams, each an echo strength per range bin."""

    frequency_khz: float = number(50, 3000, 750.0)
    hfov_deg: float = number(5, 180, 130.0)
    vfov_deg: float = number(1, 90, 20.0)
    beams: int = number(8, 1024, 256)
    beam_deg: float = number(0.1, 20, 1.0)  # width of a beam across, at half power
    bins: int = number(16, 4096, 500)
    min_range_m: float = number(0.05, 20, 0.1)
    max_range_m: float = number(0.5, 200, 10.0)
    bandwidth_khz: float = number(1, 1000, 200.0)  # resolves c / 2B in range
    looks: float = number(0.5, 100, 1.0)  # of the speckle: intensity is Gamma with this shape; 1 is fully developed
    noise_db: float = number(-200, 0, -105.0)  # noise over the echo of a perfect scatterer filling a beam at 1 m
    tvg: bool = field(default=True)  # time-varying gain: undoes spreading and absorption
    multipath: float = number(0, 1, 0.0)  # amplitude kept by sound that takes one more bounce off bottom or surface
    cloud: bool = field(default=False)  # also a point cloud with class and instance of each return


@dataclass(frozen=True, kw_only=True)
class ScannerRecipe(AcousticRecipe):
    """A mechanically scanned sonar: one narrow beam, turned a step at each ping about the z axis of its mount."""

    frequency_khz: float = number(50, 3000, 750.0)
    beam_deg: float = number(0.1, 20, 2.0)  # across, at half power
    vfov_deg: float = number(1, 90, 25.0)
    step_deg: float = number(0.1, 30, 0.9)
    sector_deg: float = number(1, 360, 360.0)  # scanned to and fro where less than 360
    bins: int = number(16, 4096, 1200)
    min_range_m: float = number(0.05, 20, 0.75)
    max_range_m: float = number(0.5, 200, 10.0)
    bandwidth_khz: float = number(1, 1000, 50.0)
    looks: float = number(0.5, 100, 1.0)
    noise_db: float = number(-200, 0, -105.0)
    tvg: bool = field(default=True)


@dataclass(frozen=True, kw_only=True)
class AltimeterRecipe(AcousticRecipe):
    """A single-beam echo sounder: the range of the first strong echo in its cone."""

    pitch_deg: float = number(-90, 90, 90.0)
    frequency_khz: float = number(10, 3000, 115.0)
    beam_deg: float = number(1, 60, 28.0)
    min_range_m: float = number(0.05, 20, 0.3)
    max_range_m: float = number(0.5, 300, 100.0)
    noise_m: float = number(0, 1, 0.005)  # 1 sigma
    noise_share: float = number(0, 0.2, 0.002)  # of the range, 1 sigma
    step_m: float = number(0, 1, 0.001)


@dataclass(frozen=True, kw_only=True)
class DvlRecipe(SensorRecipe):
    """A Doppler velocity log: four beams in Janus form, looking down."""

    rate_hz: float = number(0.1, 50, 8.0)
    yaw_deg: float = number(-180, 180, 0.0)  # of the mount; beams lie at 45, 135, 225 and 315 deg from its x axis
    janus_deg: float = number(5, 45, 22.5)  # beams off the vertical
    min_range_m: float = number(0.01, 5, 0.05)
    max_range_m: float = number(1, 300, 50.0)
    beam_noise_m_s: float = number(0, 1, 0.004)  # 1 sigma of a beam's velocity
    scale_error: float = number(0, 0.1, 0.001)  # 1 sigma of a constant share of the velocity
    range_noise_share: float = number(0, 0.1, 0.001)  # of a beam's range, 1 sigma
    misalignment_deg: float = number(0, 10, 0.0)  # of the mount against its calibration, 1 sigma
    assumed_sound_speed_m_s: float | None = number(1300, 1700, None)


@dataclass(frozen=True, kw_only=True)
class PressureRecipe(SensorRecipe):
    """A pressure sensor. What tide and waves do is of the site (`SiteRecipe`)."""

    rate_hz: float = number(0.1, 1000, 20.0)
    offset_m: float = number(0, 5, 0.02)  # of depth, 1 sigma, constant
    noise_m: float = number(0, 1, 0.002)  # of depth, 1 sigma
    step_pa: float = number(0, 1e5, 20.0)  # of the digital reading
    max_depth_m: float = number(1, 11_000, 300.0)  # readings stop there


@dataclass(frozen=True, kw_only=True)
class MagnetometerRecipe(SensorRecipe):
    """Three fluxgates or the like, in the Earth's field (`SiteRecipe`) and the vehicle's own."""

    rate_hz: float = number(0.1, 1000, 50.0)
    noise_ut: float = number(0, 10, 0.3)  # uT, 1 sigma of a sample
    hard_iron_ut: tuple[float, float, float] = number(-1000, 1000, (0.0, 0.0, 0.0))  # in the sensor's frame
    soft_iron: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]] = number(
        -10, 10, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    )  # takes the Earth's field to the one at the sensor, both in its frame
    step_ut: float = number(0, 10, 0.0)
    rpy_deg: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # magnetometer to base_link
