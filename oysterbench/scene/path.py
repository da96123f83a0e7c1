"""Motion of the vehicle: paths that are smooth enough to be differentiated by hand into what an IMU feels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from oysterbench.errors import RecipeError
from oysterbench.geometry import Array
from oysterbench.recipe import LOOP_RIPPLE, PathRecipe, SequenceRecipe
from oysterbench.streams import Streams
from oysterbench.trajectory import Trajectory

KNOT_S = 0.1
"""Spacing of the spline's knots: 20 times shorter than the shortest period of the motion below."""

SWAY_PERIODS_S = (2.2, 3.4, 5.3)
"""Periods of a station-keeping ROV's motion; the shorter ones carry most of the acceleration."""

TERRAIN_SMOOTHING_S = 1.0
"""An ROV follows the bottom through its altimeter and its own inertia, not stone by stone."""

Height = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Motion:
    """State of the body at N times. World frame `map`, body frame `base_link`.

    position (N, 3) m, velocity (N, 3) m/s, acceleration (N, 3) m/s^2: of the body's origin, in the world frame.
    rotation (N, 3, 3): body to world. rate (N, 3) rad/s, rate_dot (N, 3) rad/s^2: of the body against the world,
    in the body frame.
    """

    position: Array
    velocity: Array
    acceleration: Array
    rotation: Array
    rate: Array
    rate_dot: Array


@dataclass(frozen=True)
class Path:
    """Quintic splines of x, y, z (m) and yaw, pitch, roll (rad; intrinsic z y x) over time (s): four times
    continuously differentiable, so that accelerations and rates are exact derivatives and not differences."""

    position: BSpline
    attitude: BSpline
    duration_s: float

    def at(self, times_s: Array) -> Motion:
        """Motion at times (N,) in s from the start."""
        velocity, acceleration = self.position.derivative(1), self.position.derivative(2)
        angles = self.attitude(times_s)
        rates = self.attitude.derivative(1)(times_s)
        accelerations = self.attitude.derivative(2)(times_s)
        rate, rate_dot = body_rates(angles, rates, accelerations)
        return Motion(
            position=self.position(times_s),
            velocity=velocity(times_s),
            acceleration=acceleration(times_s),
            rotation=Rotation.from_euler("ZYX", angles).as_matrix(),
            rate=rate,
            rate_dot=rate_dot,
        )

    def trajectory(self, times_s: Array, stamps_ns: np.ndarray) -> Trajectory:
        """Poses at times (N,) s, stamped with stamps_ns (N,)."""
        quaternions = Rotation.from_euler("ZYX", self.attitude(times_s)).as_quat(canonical=True)
        return Trajectory(np.asarray(stamps_ns, dtype=np.int64), self.position(times_s), quaternions)


def body_rates(angles: Array, rates: Array, accelerations: Array) -> tuple[Array, Array]:
    """Body rate and its derivative, both (N, 3) in the body frame, from yaw, pitch, roll (N, 3) and derivatives.

    The kinematics of z-y-x Euler angles (Fossen 2011, eq. 2.28), and their time derivative.
    """
    _, pitch, roll = angles.T
    yaw_1, pitch_1, roll_1 = rates.T
    yaw_2, pitch_2, roll_2 = accelerations.T
    sin_p, cos_p, sin_r, cos_r = np.sin(pitch), np.cos(pitch), np.sin(roll), np.cos(roll)
    rate = np.column_stack(
        [
            roll_1 - yaw_1 * sin_p,
            pitch_1 * cos_r + yaw_1 * cos_p * sin_r,
            -pitch_1 * sin_r + yaw_1 * cos_p * cos_r,
        ]
    )
    rate_dot = np.column_stack(
        [
            roll_2 - yaw_2 * sin_p - yaw_1 * pitch_1 * cos_p,
            pitch_2 * cos_r
            - pitch_1 * roll_1 * sin_r
            + yaw_2 * cos_p * sin_r
            - yaw_1 * pitch_1 * sin_p * sin_r
            + yaw_1 * roll_1 * cos_p * cos_r,
            -pitch_2 * sin_r
            - pitch_1 * roll_1 * cos_r
            + yaw_2 * cos_p * cos_r
            - yaw_1 * pitch_1 * sin_p * cos_r
            - yaw_1 * roll_1 * cos_p * sin_r,
        ]
    )
    return rate, rate_dot


def build_path(recipe: SequenceRecipe, ground_height: Height, obstacle_height: Height, streams: Streams) -> Path:
    """The path of a sequence over its reef.

    ground_height, obstacle_height: z (m) in `map` of the bare bottom, and of the top of what lies on it, at x, y.

    Raises RecipeError where the path would come closer to an obstacle than `path.clearance_m`, or break the surface.
    """
    times = np.arange(0.0, recipe.duration_s + 1.0, KNOT_S)  # past the end, so that the end is like the rest
    plan = recipe.path
    x, y, heading = loop(plan, times, streams.generator("path", "loop"))
    altitude_z = gaussian_filter1d(ground_height(x, y), TERRAIN_SMOOTHING_S / KNOT_S, mode="nearest") + plan.altitude_m
    wobble = sway(times, plan, streams)
    position = np.column_stack([x, y, altitude_z]) + plan.sway_m * wobble[:, :3]
    attitude = np.radians(plan.tilt_deg) * wobble[:, 3:]
    attitude[:, 0] += heading
    path = Path(
        make_interp_spline(times, position, k=5), make_interp_spline(times, attitude, k=5), float(recipe.duration_s)
    )
    _check_clearance(path, recipe, obstacle_height)
    return path


def loop(plan: PathRecipe, times: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """x, y (m) and heading (rad, unwrapped) along a closed loop around the origin, run from rest at `speed_m_s`."""
    start, bend = rng.uniform(0.0, 2 * np.pi, 2)
    turn = rng.choice([-1.0, 1.0])
    angle = np.linspace(0.0, 2 * np.pi, 4001)
    # An ellipse-like and a three-lobed term: curvature changes along the way, so that no part is a plain circle.
    radius = plan.radius_m * (1 + LOOP_RIPPLE * (0.6 * np.sin(2 * angle + bend) + 0.4 * np.sin(3 * angle)))
    curve = np.column_stack([radius * np.cos(start + turn * angle), radius * np.sin(start + turn * angle)])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    closed = make_interp_spline(length, curve, k=5, bc_type="periodic")
    # Smootherstep of speed (Perlin 2002), integrated: velocity, acceleration and jerk start from zero.
    ramp = np.clip(times / plan.ramp_s, 0.0, 1.0)
    way = plan.speed_m_s * (
        plan.ramp_s * (ramp**6 - 3 * ramp**5 + 2.5 * ramp**4) + np.maximum(times - plan.ramp_s, 0.0)
    )
    position = closed(way)
    tangent = closed.derivative(1)(way)
    return position[:, 0], position[:, 1], np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))


def sway(times: Array, plan: PathRecipe, streams: Streams) -> Array:
    """(N, 6) sums of sines with random phases, of unit amplitude, that grow from rest with the ramp."""
    grown = np.clip(times / plan.ramp_s, 0.0, 1.0)
    envelope = grown**3 * (10 + grown * (6 * grown - 15))
    motion = np.zeros((len(times), 6))
    for axis in range(6):
        rng = streams.generator("path", "sway", axis)
        weights = rng.dirichlet(np.full(len(SWAY_PERIODS_S), 4.0))
        for weight, period in zip(weights, SWAY_PERIODS_S, strict=True):
            period = period * rng.uniform(0.85, 1.15)
            phase = rng.uniform(0, 2 * np.pi)
            motion[:, axis] += weight * np.sin(2 * np.pi * times / period + phase)
    return motion * envelope[:, None]


def _check_clearance(path: Path, recipe: SequenceRecipe, obstacle_height: Height) -> None:
    position = path.position(np.arange(0.0, recipe.duration_s, KNOT_S / 2))
    clearance = position[:, 2] - obstacle_height(position[:, 0], position[:, 1])
    worst = int(np.argmin(clearance))
    if clearance[worst] < recipe.path.clearance_m:
        raise RecipeError(
            f"sequence {recipe.name}: key 'path.altitude_m': at x = {position[worst, 0]:.1f}, y = "
            f"{position[worst, 1]:.1f} m the path comes to {clearance[worst]:.2f} m above the reef; expected at least "
            f"path.clearance_m = {recipe.path.clearance_m:g}; raise the altitude or lower reef.relief_rms_m"
        )
    if position[:, 2].max() >= 0.0:
        raise RecipeError(
            f"sequence {recipe.name}: key 'path.altitude_m': the path breaks the surface; expected z below 0, got "
            f"{position[:, 2].max():.2f} m; lower the altitude or raise reef.depth_m"
        )
