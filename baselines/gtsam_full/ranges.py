"""Ranges of an altimeter and of a DVL's beams, compared with the bottom formed by the landmarks in their footprint.

Both look at ground that the camera has seen some seconds before. A range says how far away the landmarks there are: it
is the only measurement besides the DVL's velocity that gives metric scale. How well it does so depends on what it is
compared with: the first strong echo from a cone comes from what protrudes, corners are found on edges, and between
corners a rough reef may have any shape. So each echo counts the more the flatter the landmarks under it are, and the
mean difference between echoes and corners is a variable.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement, RangeMeasurement
from oysterbench.sequence.types import AltimeterCalibration
from oysterbench_baselines.common.aiding.dvl import Dvl
from oysterbench_baselines.common.aiding.sensor import AidingSensor, Calibration, GateSettings, python_factor, symbol
from oysterbench_baselines.common.filter import InvariantFilter, cross, rotation_exp
from oysterbench_baselines.gtsam_vi.states import Keyframe, State

ECHO_KEY = symbol("e")
"""By how much ranges are longer than those to the landmarks, m: of altimeters, of DVL beams; (2,)."""
ALTIMETER, BEAM = 0, 1


@dataclass(frozen=True)
class RangeSettings:
    """How ranges to the bottom count. Neither the mounts' calibrations nor the samples state any noise."""

    enabled: bool = True  # whether altimeters and the ranges of a DVL's beams are used where it gives no velocity
    sigma: float = 0.02  # m, 1 sigma of a range
    share: float = 0.01  # and of its length: speed of sound and beam patterns
    offset_sigma: float = 0.03  # m, of the mean difference between echoes and corners: an oyster protrudes by as much
    radius: float = 0.25  # m, about the point met, within which landmarks are its ground; a wide beam has its footprint
    fewest: int = 6  # landmarks: three make a plane, as many again say how rough it is
    most: int = 12  # the nearest: more cost time, and say less of the point
    width: float = 0.03  # m, rms of the landmarks across their longest spread: less is a line
    steepest: float = 0.5  # least cosine of the angle of incidence
    max_delay_s: float = 0.15  # a range older than this does not count for a keyframe
    silence_s: float = 1.0  # without a DVL's velocity, after which ranges count: it gives scale ten times better


class Ranges(AidingSensor):
    """Altimeters, and the beams of a DVL, as an aiding sensor. They give scale: the filter has no use for them.

    altimeters: their calibrations by name. echoes: by the keyframe at which they count.
    """

    kind = "ranges"
    measures = (RangeMeasurement, DvlMeasurement)

    def __init__(
        self,
        T_imu_base: Array,
        altimeters: Mapping[str, AltimeterCalibration],
        dvl: Dvl | None,
        settings: RangeSettings,
    ) -> None:
        super().__init__(GateSettings())
        self.settings = settings
        self.echoes: dict[int, list[Echo]] = {}
        self._T_imu_base, self._altimeters, self._dvl = T_imu_base, altimeters, dvl
        self._latest: dict[str, RangeMeasurement | DvlMeasurement] = {}  # by sensor

    def update(self, filter: InvariantFilter, sample: RangeMeasurement | DvlMeasurement) -> bool:
        self._latest["dvl" if isinstance(sample, DvlMeasurement) else sample.sensor] = sample
        return False

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        """Keep the ranges that were read a moment ago, as rays in the IMU frame at the keyframe, unless a DVL's
        velocity gives the scale ten times better than they do over relief."""
        settings, velocity_ns = self.settings, None if self._dvl is None else self._dvl.velocity_ns
        if velocity_ns is not None and stamp_ns - velocity_ns < settings.silence_s * 1e9:
            return
        echoes: list[Echo | None] = []
        for name, sample in self._latest.items():
            delay = (stamp_ns - sample.stamp_ns) * 1e-9
            moved = delay * filter.rate, delay * filter.rotation.T @ filter.velocity
            if delay > settings.max_delay_s:
                continue
            if isinstance(sample, RangeMeasurement):
                echoes.append(altimeter_echo(sample, self._altimeters[name], self._T_imu_base, moved, settings))
            elif self._dvl is not None:
                echoes += beam_echoes(sample, self._dvl.T_imu_dvl, moved, settings)
        self.echoes[keyframe] = [echo for echo in echoes if echo is not None]

    def calibration(self) -> Calibration:
        return Calibration(ECHO_KEY, np.zeros(2), np.full(2, self.settings.offset_sigma))

    def stretch_factors(
        self, keyframes: list[Keyframe], states: list[State], ids: NDArray[np.int64], points: Array
    ) -> list[gtsam.NonlinearFactor]:
        if len(ids) < self.settings.fewest:
            return []
        tree, factors = cKDTree(points), []
        for keyframe, state in zip(keyframes, states, strict=True):
            for echo in self.echoes.get(keyframe.index, ()):
                ground = find_ground(echo, state.matrix, tree, ids, points, self.settings)
                if ground is not None:
                    factors.append(echo_factor(echo, ground, keyframe.index))
        return factors


@dataclass(frozen=True)
class Echo:
    """A range (m) with its 1 sigma, along `axis` (3,) from `origin` (3,) m in the IMU's frame at a keyframe.

    half_beam: rad, about the axis, within which the bottom that echoes may lie; kind: ALTIMETER or BEAM.
    """

    origin: Array
    axis: Array
    range: float
    sigma: float
    half_beam: float
    kind: int


@dataclass(frozen=True)
class Ground:
    """The bottom where an echo meets it: a plane through landmarks.

    ids (N,) of the landmarks; weights (N,), of sum 1, with which they make the point met; normal (3,) in odom; axis
    (3,) of the ray that meets it, in the IMU's frame; sigma: m, of the range to it, in total.
    """

    ids: NDArray[np.int64]
    weights: Array
    normal: Array
    axis: Array
    sigma: float


def altimeter_echo(
    sample: RangeMeasurement,
    mount: AltimeterCalibration,
    T_imu_base: Array,
    moved: tuple[Array, Array],
    of: RangeSettings,
) -> Echo | None:
    """Echo of an altimeter; None where there was none. moved: see `_propagated`."""
    if not np.isfinite(sample.range):
        return None
    pose = T_imu_base @ mount.T_base_sensor
    sigma = float(np.hypot(of.sigma, of.share * sample.range))
    origin, axis = _propagated(pose[:3, 3], pose[:3, 0], moved)
    return Echo(origin, axis, float(sample.range), sigma, mount.beam_rad / 2, ALTIMETER)


def beam_echoes(sample: DvlMeasurement, T_imu_dvl: Array, moved: tuple[Array, Array], of: RangeSettings) -> list[Echo]:
    """Echoes of the beams of a DVL that have a range, one each. moved: see `_propagated`."""
    echoes = []
    for direction, length, valid in zip(sample.beam_directions, sample.beam_ranges, sample.beam_valid, strict=True):
        if valid and np.isfinite(length):
            origin, axis = _propagated(T_imu_dvl[:3, 3], T_imu_dvl[:3, :3] @ direction, moved)
            sigma = float(np.hypot(of.sigma, of.share * length))
            echoes.append(Echo(origin, axis, float(length), sigma, 0.0, BEAM))
    return echoes


def _propagated(origin: Array, axis: Array, moved: tuple[Array, Array]) -> tuple[Array, Array]:
    """Transform a ray of a moment ago to the present IMU frame; moved: rotation vector (rad) and displacement (m), both
    (3,), since then, in that frame."""
    back = rotation_exp(-moved[0])
    return back @ origin - moved[1], back @ axis


def find_ground(
    echo: Echo, T_odom_imu: Array, tree: cKDTree, ids: NDArray[np.int64], points: Array, of: RangeSettings
) -> Ground | None:
    """Find the plane that an echo meets, through landmarks (M,) at points (M, 3), which are in `tree`; None where there
    are too few around it, or where they are in a line, steep, or all to one side."""
    rotation, origin = T_odom_imu[:3, :3], T_odom_imu[:3, :3] @ echo.origin + T_odom_imu[:3, 3]
    reach = max(echo.range * np.tan(echo.half_beam), of.radius)
    # First where a level bottom would be met; then, for a wide beam, where the actual bottom is.
    ray = _nearest(rotation @ echo.axis, np.array([0.0, 0.0, -1.0]), echo.half_beam)
    met = origin + echo.range * ray
    for _ in range(2 if echo.half_beam else 1):
        distances, nearest = tree.query(met, k=of.most, distance_upper_bound=reach)
        near = np.sort(np.atleast_1d(nearest)[np.isfinite(distances)])
        if len(near) < of.fewest:
            return None
        centre = points[near].mean(axis=0)
        _, spread, axes = np.linalg.svd(points[near] - centre, full_matrices=False)
        spread = spread / np.sqrt(len(near))
        normal = axes[2] * -np.sign(axes[2] @ rotation @ echo.axis)
        ray = _nearest(rotation @ echo.axis, -normal, echo.half_beam)
        along = normal @ ray
        if spread[1] < of.width or along > -of.steepest:
            return None
        met = origin + normal @ (centre - origin) / along * ray
    flat, at = (points[near] - centre) @ axes[:2].T, axes[:2] @ (met - centre)
    if np.any(np.abs(at) > 2 * spread[:2]):
        return None
    weights = 1.0 / len(near) + flat @ np.linalg.solve(flat.T @ flat, at)
    # The ground between the landmarks deviates from the plane as much as they do.
    return Ground(ids[near], weights, normal, rotation.T @ ray, float(np.hypot(echo.sigma, spread[2] / -along)))


def _nearest(axis: Array, wanted: Array, limit: float) -> Array:
    """The unit vector that is nearest to `wanted` within an angle (rad) of `axis`, both (3,) unit vectors."""
    turn = np.cross(axis, wanted)
    sine = float(np.linalg.norm(turn))
    angle = float(np.arctan2(sine, axis @ wanted))
    if angle <= limit:
        return wanted
    return rotation_exp(turn / max(sine, 1e-12) * limit) @ axis


def echo_error(
    echo: Echo, ground: Ground, pose: gtsam.Pose3, landmarks: Array, offsets: Array
) -> tuple[float, tuple[Array, Array, Array]]:
    """Predicted less measured range, m, and its derivatives by pose (6,), landmarks (N, 3) and offsets (2,).

    With o the sensor, d the ray and q the point that the weights make of the landmarks, all in odom, n the normal:
    n . (q - o) / n . d + offset - range. Weights and normal are held: their changes are of second order in the
    distance of the landmarks from the plane.
    """
    rotation = pose.rotation().matrix()
    normal = ground.normal @ rotation  # in the IMU's frame
    along = float(normal @ ground.axis)
    gap = ground.normal @ (ground.weights @ landmarks - pose.translation()) - normal @ echo.origin
    length = float(gap) / along
    by_turn = (normal @ cross(echo.origin) + length * normal @ cross(ground.axis)) / along
    by_offsets = np.zeros(2)
    by_offsets[echo.kind] = 1.0
    slopes = np.concatenate([by_turn, -normal / along]), np.outer(ground.weights, ground.normal / along), by_offsets
    return length + float(offsets[echo.kind]) - echo.range, slopes


def echo_factor(echo: Echo, ground: Ground, keyframe: int) -> gtsam.NonlinearFactor:
    """Factor on a keyframe's pose, the landmarks under it, and the offsets; with Cauchy loss, as reefs have holes."""
    keys = [symbol("x", keyframe), *(symbol("l", int(i)) for i in ground.ids), ECHO_KEY]

    def evaluate(pose: gtsam.Pose3, *others: Array) -> tuple[Array, list[Array]]:
        residual, (by_pose, by_landmarks, by_offsets) = echo_error(
            echo, ground, pose, np.array(others[:-1]), others[-1]
        )
        return np.array([residual]), [slope[None] for slope in (by_pose, *by_landmarks, by_offsets)]

    return python_factor(keys, ground.sigma, 1, evaluate, cauchy=1.0)
