"""IMU: the angular rate and specific force along the path, and the errors that a real unit adds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy

from oysterbench.core.geometry import GRAVITY, Array, transform
from oysterbench.core.measurements import ImuMeasurement
from oysterbench.core.ros import Message, decode, encode, header, make, quaternion, stamp_of, vector
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.recipe.keys import choice, number
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.faults import Fault, spans
from oysterbench.sensors.kind import XYZ, Instants, Row, SensedWorld, SensorKind, Strip, columns_of, link, quantise
from oysterbench.sensors.uncertainty import ErrorModel, Quality
from oysterbench.sensors.vibration import VibrationRecipe, vibrate

if TYPE_CHECKING:
    from oysterbench.scene.path import Motion, Path
    from oysterbench.scene.path.thrust import Throttle
    from oysterbench.sensors.magnetometer import MagnetometerRecipe

IMU = "sensor_msgs/msg/Imu"
INERTIAL_STEP = 1e-7  # rad/s and m/s^2, to which readings are rounded: four orders below the best unit's noise
FAULT_STEP_S = 0.1  # time step of the ground truth of faults
INERTIAL_NOISE = ("noise_density", "turn_on", "bias_instability", "bias_tau_s")

DEG = math.pi / 180.0
G = 9.80665  # m/s^2
ROOT_H = 60.0  # sqrt(3600 s): 1 unit/sqrt(h) = 1/60 unit/s/sqrt(Hz)
HOUR = 3600.0  # s

IMU_GRADES: Mapping[str, Mapping[str, float]] = {
    "low": {
        "gyro_noise_density": 0.75 * DEG / ROOT_H,
        "gyro_bias_instability": 10.0 * DEG / HOUR,
        "accel_noise_density": 0.05 / ROOT_H,
        "accel_bias_instability": 2.0e-4,
    },
    "mid": {
        "gyro_noise_density": 0.25 * DEG / ROOT_H,
        "gyro_bias_instability": 3.5 * DEG / HOUR,
        "accel_noise_density": 0.03 / ROOT_H,
        "accel_bias_instability": 5.0e-5,
    },
    "high": {
        "gyro_noise_density": 0.002 * DEG / ROOT_H,
        "gyro_bias_instability": 0.1 * DEG / HOUR,
        "accel_noise_density": 2.5e-5 / ROOT_H,
        "accel_bias_instability": 3.6e-6,
    },
    # ICM-20602 (TDK InvenSense, DS-000176): 4 mdps and 100 ug per root hertz, zero within 1 dps and 40 mg, taken as
    # three sigma; 16 bits over 2000 dps and 16 g. The data sheet gives no bias instability: typical for its class.
    "mems": {
        "gyro_noise_density": 4.0e-3 * DEG,
        "gyro_turn_on": 1.0 * DEG / 3,
        "gyro_bias_instability": 10.0 * DEG / HOUR,
        "gyro_range": 2000.0 * DEG,
        "gyro_step": 2000.0 * DEG / 2**15,
        "accel_noise_density": 100e-6 * G,
        "accel_turn_on": 40e-3 * G / 3,
        "accel_bias_instability": 50e-6 * G,
        "accel_range": 16.0 * G,
        "accel_step": 16.0 * G / 2**15,
    },
}
"""Grade -> noise keys of an `ImuRecipe`, in its units; low, mid and high are those of OysterSim. Bias instability is
the stationary sigma of a Gauss-Markov process."""

COMMON: Mapping[str, float | None] = {
    f"{sensor}_{key}": value
    for sensor in ("gyro", "accel")
    for key, value in (("random_walk", 0.0), ("bias_tau_s", 100.0), ("turn_on", 0.0), ("range", None), ("step", 0.0))
}
"""Values of the keys that a grade does not set: a bias that stays around its turn-on value, correlated over 100 s, and
a unit without turn-on bias, limits and steps. They, too, replace those of a rig whose grade a sequence changes."""


@dataclass(frozen=True, kw_only=True)
class ImuRecipe(SensorRecipe):
    """An IMU. `grade` sets every noise key that is not given explicitly (`IMU_GRADES`)."""

    block: ClassVar[str] = "imu"

    rate_hz: float = number(10, 4000)
    grade: str | None = choice(tuple(IMU_GRADES), None)
    """Preset of the noise keys: a low, mid or high grade, or a typical MEMS unit."""
    gyro_noise_density: float = number(0, 1)  # rad/s/sqrt(Hz): angle random walk
    gyro_random_walk: float = number(0, 1)  # rad/s^2/sqrt(Hz): unbounded random walk of the bias
    gyro_turn_on: float = number(0, 1, 0.0)  # rad/s, 1 sigma of the bias at switch-on
    gyro_bias_instability: float = number(0, 1, 0.0)  # rad/s, 1 sigma of a stationary Gauss-Markov process
    gyro_bias_tau_s: float = number(1, 1e5, 100.0)  # correlation time of that process
    gyro_scale: float = number(0, 0.5, 0.0)  # scale error, 1 sigma
    gyro_misalignment_deg: float = number(0, 10, 0.0)  # of each axis towards the other two, 1 sigma
    gyro_range: float | None = number(0.01, 1e3, None)  # rad/s; readings saturate there
    gyro_step: float = number(0, 1, 0.0)  # rad/s, resolution of the digital reading
    accel_noise_density: float = number(0, 10)  # m/s^2/sqrt(Hz): velocity random walk
    accel_random_walk: float = number(0, 10)  # m/s^3/sqrt(Hz): random walk of the bias
    accel_turn_on: float = number(0, 10, 0.0)  # m/s^2, 1 sigma of the bias at switch-on
    accel_bias_instability: float = number(0, 10, 0.0)  # m/s^2, 1 sigma of a stationary Gauss-Markov process
    accel_bias_tau_s: float = number(1, 1e5, 100.0)  # correlation time of that process
    accel_scale: float = number(0, 0.5, 0.0)  # scale error, 1 sigma
    accel_misalignment_deg: float = number(0, 10, 0.0)  # of each axis towards the other two, 1 sigma
    accel_range: float | None = number(0.1, 1e4, None)  # m/s^2; readings saturate there
    accel_step: float = number(0, 10, 0.0)  # m/s^2, resolution of the digital reading
    gyro_bias_per_k: float = number(0, 2e-3, 0.0)
    """rad/s per K, 1 sigma of an axis: 0.005 to 0.05 deg/s per K uncompensated; ICM-20602: 0.01 deg/s per K."""
    accel_bias_per_k: float = number(0, 0.05, 0.0)  # m/s^2 per K, 1 sigma of an axis; ICM-20602: 0.5 to 1 mg per K
    warming_k: float = number(0, 60, 0.0)  # temperature rise from switch-on to warm: 10 to 30 K in a closed hull
    warming_tau_s: float = number(10, 7200, 300.0)  # time constant: minutes, depending on the mass of the hull
    warmed_s: float = number(0, 86_400, 60.0)  # time for which it has been on when the sequence starts
    vibration: tuple[VibrationRecipe, ...] = ()  # vibration of the frame by thrusters
    rpy_deg: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # roll, pitch, yaw: IMU to base_link

    def check(self, where: str) -> None:
        super().check(where)
        for vibration in self.vibration:
            vibration.check(where)

    @property
    def gyro_bias_walk(self) -> float:
        """Random walk (rad/s^2/sqrt(Hz)) equivalent to the bias over less than its correlation time, with instability.

        The value for a filter that models the bias as a random walk only.
        """
        return math.hypot(self.gyro_random_walk, self.gyro_bias_instability * math.sqrt(2 / self.gyro_bias_tau_s))

    @property
    def accel_bias_walk(self) -> float:
        """Same as `gyro_bias_walk`, for the accelerometer (m/s^3/sqrt(Hz))."""
        return math.hypot(self.accel_random_walk, self.accel_bias_instability * math.sqrt(2 / self.accel_bias_tau_s))


@dataclass(frozen=True)
class ImuCalibration:
    """An IMU: continuous noise densities, bias random walks, 1-sigma turn-on biases, and stationary 1 sigma and
    correlation time of the Gauss-Markov processes of the biases (units as in `ImuRecipe`); pose.

    A random walk is that of a filter that models the bias as a walk alone: it includes the instability
    (`ImuRecipe.gyro_bias_walk`). A filter with a Gauss-Markov process beside it uses sqrt(walk^2 - 2 sigma^2 / tau).
    """

    rate_hz: float
    gyro_noise_density: float
    gyro_random_walk: float
    gyro_turn_on: float
    accel_noise_density: float
    accel_random_walk: float
    accel_turn_on: float
    gravity: float  # m/s^2
    T_base_imu: Array
    gyro_bias_instability: float = 0.0
    gyro_bias_tau_s: float = 100.0
    accel_bias_instability: float = 0.0
    accel_bias_tau_s: float = 100.0


def with_grade(unit: Any) -> Any:
    """Return an IMU's table with the keys of its grade filled in where the table does not give them."""
    grade = unit.get("grade") if isinstance(unit, Mapping) else None
    if not isinstance(grade, str) or grade not in IMU_GRADES:
        return unit
    return {**COMMON, **IMU_GRADES[grade], **unit}


def imu_pose(recipe: ImuRecipe | MagnetometerRecipe) -> Array:
    """T_base_imu (4, 4), or the pose of a magnetometer."""
    turn = scipy.spatial.transform.Rotation.from_euler("xyz", recipe.rpy_deg, degrees=True)
    return transform(turn.as_matrix(), recipe.position_m)


@dataclass(frozen=True, kw_only=True)
class Triad:
    """Error parameters of three axes, gyroscopes or accelerometers, as in `ImuRecipe`; u is rad/s or m/s^2."""

    noise_density: float  # u/sqrt(Hz)
    random_walk: float = 0.0  # u/s/sqrt(Hz)
    turn_on: float = 0.0  # u, 1 sigma
    bias_instability: float = 0.0  # u, stationary sigma
    bias_tau_s: float = 100.0
    scale: float = 0.0  # 1 sigma
    misalignment_deg: float = 0.0  # 1 sigma
    range: float | None = None  # u
    step: float = 0.0  # u
    bias_per_k: float = 0.0  # u/K, 1 sigma

    @classmethod
    def of(cls, recipe: ImuRecipe, which: str) -> Triad:
        """Take the triad `which`, "gyro" or "accel", from a recipe."""
        return cls(**{key.name: getattr(recipe, f"{which}_{key.name}") for key in fields(cls)})


def ideal_imu(motion: Motion, T_base_imu: Array) -> tuple[Array, Array]:
    """Angular rate (N, 3) rad/s and specific force (N, 3) m/s^2, in the IMU frame, of an IMU without errors.

    The IMU sits at a lever arm r from the body's origin and senses
    f = R^T (a - g) + w' x r + w x (w x r) (Savage 1998, sec. 2), rotated into its own axes.
    """
    lever = T_base_imu[:3, 3]
    gravity = np.array([0.0, 0.0, -GRAVITY])
    force = np.einsum("nji,nj->ni", motion.rotation, motion.acceleration - gravity)
    force = force + np.cross(motion.rate_dot, lever) + np.cross(motion.rate, np.cross(motion.rate, lever))
    return motion.rate @ T_base_imu[:3, :3], force @ T_base_imu[:3, :3]


def measure(
    path: Path, recipe: ImuRecipe, times_s: Array, streams: Streams, throttle: Throttle | None = None
) -> tuple[Array, Array]:
    """Readings at times (N,) = k / rate_hz s: gyro (N, 3) rad/s and accel (N, 3) m/s^2, in the IMU frame.

    Vibration adds to the motion along the path; then come the errors of the axes, each from its own random stream.
    throttle: of the thrusters, whose vibration follows it.
    """
    gyro, accel = ideal_imu(path.at(times_s), imu_pose(recipe))
    branch = streams.at("imu")
    return read_out(gyro, recipe, "gyro", branch, throttle), read_out(accel, recipe, "accel", branch, throttle)


def read_out(truth: Array, recipe: ImuRecipe, which: str, streams: Streams, throttle: Throttle | None = None) -> Array:
    """Readings of the "gyro" or "accel" triad, given the true values (N, 3), in the same unit."""
    n, triad = len(truth), Triad.of(recipe, which)
    for index, vibration in enumerate(recipe.vibration):
        if vibration.on == which:
            truth = truth + vibrate(n, recipe.rate_hz, vibration, streams.at("vibration", index), throttle)
    if triad.scale or triad.misalignment_deg:
        truth = truth @ sensitivity(triad, streams.at(which)).T
    found = truth + errors(n, 1.0 / recipe.rate_hz, triad, streams.at(which))
    if triad.bias_per_k and recipe.warming_k:
        per_k = triad.bias_per_k * streams.at(which).generator("per_k").standard_normal(3)
        found = found + warmed(recipe, np.arange(n) / recipe.rate_hz)[:, None] * per_k
    return digitise(found, triad)


def warmed(recipe: ImuRecipe, times_s: Array) -> Array:
    """Temperature rise (N,) K since the start of the sequence, at which the turn-on bias holds.

    That of a body with a single heat capacity under constant heating: T = T_end (1 - exp(-t / tau)) since switch-on.
    """
    left = recipe.warming_k * math.exp(-recipe.warmed_s / recipe.warming_tau_s)
    return np.asarray(-left * np.expm1(-times_s / recipe.warming_tau_s))


def sensitivity(triad: Triad, streams: Streams) -> Array:
    """Matrix (3, 3) from true values to readings: scale errors on the diagonal, misalignment of the axes off it."""
    matrix: Array = np.radians(triad.misalignment_deg) * streams.generator("misalignment").standard_normal((3, 3))
    np.fill_diagonal(matrix, 1.0 + triad.scale * streams.generator("scale").standard_normal(3))
    return matrix


def errors(n: int, dt: float, triad: Triad, streams: Streams) -> Array:
    """Bias plus noise (n, 3) of samples dt apart: turn-on bias, bias random walk and instability, and white noise.

    White noise of the continuous density has sigma = density / sqrt(dt) per sample (IEEE 952-1997, annex C).
    """
    total = np.tile(triad.turn_on * streams.generator("turn_on").standard_normal(3), (n, 1))
    if triad.random_walk:
        total += random_walk(n, dt, triad.random_walk, streams.generator("walk"))
    if triad.bias_instability:
        total += gauss_markov(n, dt, triad.bias_instability, triad.bias_tau_s, streams.generator("instability"))
    if triad.noise_density:
        total += triad.noise_density / np.sqrt(dt) * streams.generator("white").standard_normal((n, 3))
    return total


def random_walk(n: int, dt: float, density: float, rng: np.random.Generator) -> Array:
    """Random walks (n, 3) from zero, with steps of standard deviation density * sqrt(dt) (IEEE 952-1997, annex C)."""
    steps = density * np.sqrt(dt) * rng.standard_normal((n, 3))
    steps[0] = 0.0
    return np.cumsum(steps, axis=0)


def gauss_markov(n: int, dt: float, sigma: float, tau_s: float, rng: np.random.Generator) -> Array:
    """First-order Gauss-Markov processes (n, 3) with standard deviation sigma from the first sample on.

    b_k = phi b_(k-1) + sigma sqrt(1 - phi^2) w_k with phi = exp(-dt / tau): the exponentially correlated noise of
    IEEE 952-1997, annex C, exact at any dt.
    """
    from scipy.signal import lfilter

    drive = sigma * rng.standard_normal((n, 3))
    drive[1:] *= np.sqrt(-np.expm1(-2 * dt / tau_s))
    return np.asarray(lfilter([1.0], [1.0, -np.exp(-dt / tau_s)], drive, axis=0))


def digitise(values: Array, triad: Triad) -> Array:
    """Readings (N, 3) as they leave the IMU: saturated at its range, and rounded to its steps."""
    if triad.range is not None:
        values = np.clip(values, -triad.range, triad.range)
    return np.rint(values / triad.step) * triad.step if triad.step else values


def shaking(world: SensedWorld, recipe: ImuRecipe) -> Throttle | None:
    """Throttle of the thrusters, or None where no vibration of the IMU follows it."""
    if all(vibration.kind != "thrusters" for vibration in recipe.vibration):
        return None
    from oysterbench.scene.path.thrust import throttle

    return world.instrument(recipe, lambda: throttle(world.path, world.recipe, world.streams))


def _row(message: Any) -> Row:
    return columns_of("gyro_", message.angular_velocity) | columns_of("accel_", message.linear_acceleration)


class Imu(SensorKind[ImuRecipe, ImuCalibration, ImuMeasurement]):
    """Sensor kind: IMU."""

    recipe = ImuRecipe
    calibration = ImuCalibration
    title = "inertial unit"
    reader = "imu"
    rank = 0
    pose = "T_base_imu"
    required = True
    leaves: ClassVar = {"": IMU}
    tables: ClassVar = {"": _row}

    def fill_in(self, table: Any) -> Any:
        return with_grade(table)

    def calibrate(self, recipe: ImuRecipe, site: SiteRecipe) -> dict[str, Any]:
        noise = [f"{which}_{key}" for which in ("gyro", "accel") for key in INERTIAL_NOISE]
        return {
            "rate_hz": recipe.rate_hz,
            **{key: getattr(recipe, key) for key in noise},
            "gyro_random_walk": recipe.gyro_bias_walk,
            "accel_random_walk": recipe.accel_bias_walk,
            "gravity": GRAVITY,
            "T_base_imu": imu_pose(recipe).tolist(),
        }

    def error_model(self, recipe: ImuRecipe, entry: Mapping[str, Any], quality: Quality) -> ErrorModel:
        """Empty model: the other sensors are calibrated relative to the IMU."""
        return ErrorModel.of({})

    def measure(self, world: SensedWorld, recipe: ImuRecipe, at: Instants) -> Iterator[ImuMeasurement]:
        readings = measure(world.path, recipe, at.times_s, world.streams, shaking(world, recipe))
        gyro, accel = (quantise(values, INERTIAL_STEP) for values in readings)
        return (ImuMeasurement(int(at.stamps_ns[k]), gyro[k], accel[k]) for k in at.wanted)

    def faults(self, world: SensedWorld, recipe: ImuRecipe) -> list[Fault]:
        """Warming of the IMU, and spans in which the thrusters are above half throttle."""
        end, found = world.recipe.duration_s, []
        if recipe.warming_k and (recipe.gyro_bias_per_k or recipe.accel_bias_per_k):
            found.append(Fault(0.0, end, "warming_k", float(warmed(recipe, np.array([end]))[0])))
        throttle = shaking(world, recipe)
        if throttle is not None:
            times = np.arange(0.0, end, FAULT_STEP_S)
            shares = throttle.at(times)
            found += spans(times, shares > 0.5, "vibration_throttle", shares)
        return found

    def encode(self, recipe: ImuRecipe, measurement: ImuMeasurement) -> list[Message]:
        """Message with rates and forces and the variances of a sample; orientation is marked as absent (REP 145)."""
        absent = np.zeros(9)
        absent[0] = -1.0
        densities = (recipe.gyro_noise_density, recipe.accel_noise_density)
        gyro_variance, accel_variance = (density**2 * recipe.rate_hz for density in densities)
        message = make(
            IMU,
            header=header(measurement.stamp_ns, link("imu")),
            orientation=quaternion(np.array([0.0, 0.0, 0.0, 1.0])),
            orientation_covariance=absent,
            angular_velocity=vector(measurement.gyro),
            angular_velocity_covariance=np.diag([gyro_variance] * 3).ravel(),
            linear_acceleration=vector(measurement.accel),
            linear_acceleration_covariance=np.diag([accel_variance] * 3).ravel(),
        )
        return [Message("/imu", measurement.stamp_ns, encode(message))]

    def decode(self, name: str, calibration: ImuCalibration, *data: bytes) -> ImuMeasurement:
        message = decode(data[0], IMU)
        rate, force = message.angular_velocity, message.linear_acceleration
        gyro, accel = np.array([rate.x, rate.y, rate.z]), np.array([force.x, force.y, force.z])
        if not np.isfinite([gyro, accel]).all():
            raise ValueError(f"{name}: expected finite angular rates and specific forces")
        return ImuMeasurement(stamp_of(message.header), gyro, accel)

    def strips(self, name: str) -> list[Strip]:
        return [
            Strip("/imu", "angular rate, deg/s", tuple(f"gyro_{axis}" for axis in XYZ), 180 / np.pi),
            Strip("/imu", "specific force, m/s²", tuple(f"accel_{axis}" for axis in XYZ)),
        ]


KIND = Imu()
