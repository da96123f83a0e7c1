"""Initialisation in motion: gyro bias, then velocity, gravity, accelerometer bias and structure in closed form.

No visual reconstruction comes first, so nothing depends on a good pair of views or a scene that is not flat:
1. The gyro bias makes the epipolar planes of many pairs of views meet in one direction each (Kneip & Lynen 2013, the
   normal epipolar constraint; He et al. 2023 for its use here).
2. With the rotations known, every camera position is linear in initial velocity, gravity and accelerometer bias, and
   every view puts two linear constraints on a landmark (Dong-Si & Mourikis 2012). Landmarks are eliminated, the
   magnitude of gravity is fixed, and constraints are weighted by the depths of the last solution.
The scale is metric from the start. A bundle adjustment with all of these free follows, in `initialisation.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.inertial import Integral, Segment, integrate
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import Observations


@dataclass(frozen=True)
class ClosedForm:
    """States of K keyframes in a world with z up, its origin at the first, x of the first pointing along +x.

    rotations (K, 3, 3) and positions (K, 3) of the IMU, velocities (K, 3) m/s, biases (3,).
    """

    rotations: Array
    positions: Array
    velocities: Array
    gyro_bias: Array
    accel_bias: Array


def closed_form_start(
    views: list[Observations],
    segments: list[Segment],
    T_imu_cams: Array,
    gravity: float,
    gyro_turn_on: float,
    accel_turn_on: float,
    ray_sigma: float,
    bias: gtsam.imuBias.ConstantBias,
) -> ClosedForm:
    """Compute initial states from K views and the K - 1 inertial segments between them.

    T_imu_cams (C, 4, 4): of one camera or two. ray_sigma: noise at depth 1. gyro_turn_on, accel_turn_on: 1 sigma of
    the biases about `bias`.
    """
    segments = [
        replace(part, gyro=part.gyro - bias.gyroscope(), accel=part.accel - bias.accelerometer()) for part in segments
    ]
    gyro_bias = estimate_gyro_bias(views, segments, T_imu_cams[0, :3, :3], gyro_turn_on, ray_sigma)
    integral = integrate(segments, gyro_bias)
    velocity, down, accel_bias = align(views, integral, T_imu_cams, gravity, accel_turn_on, ray_sigma)
    time = integral.time[:, None]
    positions = velocity * time + 0.5 * down * time**2 + integral.position - integral.position_rate @ accel_bias
    velocities = velocity + down * time + integral.velocity - integral.velocity_rate @ accel_bias
    level = level_rotation(-down)
    biases = bias.gyroscope() + gyro_bias, bias.accelerometer() + accel_bias
    return ClosedForm(level @ integral.rotation, positions @ level.T, velocities @ level.T, *biases)


def level_rotation(up: Array) -> Array:
    """R_world_frame (3, 3) that turns `up` (3,) to +z and keeps the frame's x in the plane y = 0, x > 0."""
    z = up / np.linalg.norm(up)
    forward = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
    x = forward - z * (z @ forward)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def estimate_gyro_bias(
    views: list[Observations],
    segments: list[Segment],
    R_imu_cam: Array,
    turn_on: float,
    ray_sigma: float,
    max_pairs: int = 60,
) -> Array:
    """Gyro bias (3,) rad/s for which the epipolar planes of each pair of views share a common line."""
    integral = integrate(segments, np.zeros(3))
    pairs = _pairs(views, max_pairs)
    if not pairs:
        return np.zeros(3)
    units = [_unit(homogeneous(view.rays)) @ (integral.rotation[k] @ R_imu_cam).T for k, view in enumerate(views)]
    rays_i = np.concatenate([units[i][a] for i, _, a, _ in pairs])
    rays_j = np.concatenate([units[j][b] for _, j, _, b in pairs])
    shared = np.array([len(a) for _, _, a, _ in pairs])
    view_i, view_j = (np.repeat([pair[side] for pair in pairs], shared) for side in (0, 1))
    starts, pair = np.cumsum(shared) - shared, np.repeat(np.arange(len(pairs)), shared)
    trust = np.ones(len(rays_i))

    def epipolar_planes(bias: Array) -> tuple[Array, Array]:
        """Normals (M, 3) of the planes through both rays, and per pair of views their scatter (P, 3, 3)."""
        turns = Rotation.from_rotvec(-(integral.rate @ bias)).as_matrix()
        before = (turns[view_i] @ rays_i[:, :, None])[..., 0]
        after = (turns[view_j] @ rays_j[:, :, None])[..., 0]
        normals = np.cross(before, after)
        return normals, np.add.reduceat(trust[:, None, None] * normals[:, :, None] * normals[:, None, :], starts)

    def cost(bias: Array) -> float:
        misfit = np.linalg.eigvalsh(epipolar_planes(bias)[1])[:, 0].sum()
        return float(misfit / (2 * ray_sigma**2) + bias @ bias / turn_on**2)

    bias = _minimise(cost, np.zeros(3), turn_on)
    # Repeat without the pairs of rays that slide over the scene.
    normals, scatter = epipolar_planes(bias)
    direction = np.linalg.eigh(scatter)[1][:, :, 0]
    errors = np.abs(np.einsum("mi,mi->m", normals, direction[pair]))
    limits = np.array([max(3 * float(np.median(part)), ray_sigma) for part in np.split(errors, starts[1:])])
    trust = (errors < limits[pair]).astype(float)
    return _minimise(cost, bias, turn_on)


def _minimise(cost: Callable[[Array], float], start: Array, scale: float) -> Array:
    """Minimise by BFGS; the scale brings the variables close to one, as its finite differences require."""
    options = {"maxiter": 15, "eps": 1e-4}  # scipy's stubs have no `eps`
    solution = minimize(lambda x: cost(x * scale), start / scale, method="BFGS", options=options)  # type: ignore[call-overload]
    return np.asarray(solution.x * scale, dtype=float)


def _pairs(
    views: list[Observations], max_pairs: int, min_shared: int = 12
) -> list[tuple[int, int, NDArray[np.intp], NDArray[np.intp]]]:
    """Pairs of views (i, j, indices in i, indices in j), 1 to 7 views apart, thinned out evenly to `max_pairs`."""
    found = []
    for step in (1, 2, 4, 7):
        for i in range(0, len(views) - step, max(1, step // 2)):
            _, in_i, in_j = np.intersect1d(views[i].ids, views[i + step].ids, assume_unique=True, return_indices=True)
            if len(in_i) >= min_shared:
                found.append((i, i + step, in_i, in_j))
    stride = max(1, int(np.ceil(len(found) / max_pairs)))
    return found[::stride]


def align(
    views: list[Observations],
    integral: Integral,
    T_imu_cams: Array,
    gravity: float,
    accel_turn_on: float,
    ray_sigma: float,
) -> tuple[Array, Array, Array]:
    """Velocity (3,) at the first view, gravity vector (3,) and accelerometer bias (3,), in the first IMU frame.

    Minimises the sum over views of |(I - u u^T)(X - c)|^2 / (sigma d)^2, u the ray, c the camera's position, which is
    linear in the unknowns, X the landmark, eliminated, d its depth; plus the prior on the bias.
    """
    frame, track, camera, directions = _observations(views, integral, T_imu_cams[:, :3, :3])
    place, derivative = _camera_positions(integral, T_imu_cams[:, :3, 3])
    centres = place[camera, frame]
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]  # (M, 3, 3)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(track)) + 1])
    track_of = np.cumsum(np.concatenate([[0], np.diff(track) != 0]))
    # The mean specific force points up, apart from the mean acceleration, which is small compared with gravity.
    force = integral.velocity[-1]
    down = -gravity * force / np.linalg.norm(force)
    x = np.concatenate([np.zeros(3), down, np.zeros(3)])
    depth = np.ones(len(directions))
    trust = np.ones(len(directions))
    for _ in range(4):
        weight = trust / (ray_sigma * depth) ** 2
        normal, right, landmarks = _normal_equations(across, weight, centres, derivative[frame], starts, track_of)
        normal[6:, 6:] += np.eye(3) / accel_turn_on**2
        x = _solve_on_sphere(normal, right, x, gravity)
        points = landmarks(x)[track_of]
        offset = points - (derivative[frame] @ x + centres)
        depth = np.clip(np.einsum("mi,mi->m", offset, directions), 0.3, 30.0)
        error = np.linalg.norm((across @ offset[:, :, None])[..., 0], axis=1) / (ray_sigma * depth)
        # Cauchy weight by the worst view of a track: a track that slides is wrong in all its views.
        worst = np.maximum.reduceat(error, starts) / max(1.0, float(np.median(error)))
        trust = (1.0 / (1.0 + (worst / 5.0) ** 2))[track_of]
    return x[:3], x[3:6], x[6:]


def _observations(
    views: list[Observations], integral: Integral, R_imu_cams: Array
) -> tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.intp], Array]:
    """Frame (M,), id (M,), camera (M,), unit direction (M, 3) in the first IMU frame, of all views of tracks that have
    at least three, sorted by id."""
    rows = [view.rows() for view in views]
    frame = np.concatenate([np.full(len(ids), k) for k, (ids, _, _) in enumerate(rows)])
    ids, rays, camera = (np.concatenate(part) for part in zip(*rows, strict=True))
    rotations = integral.rotation[frame] @ R_imu_cams[camera]
    directions = (rotations @ _unit(homogeneous(rays))[:, :, None])[..., 0]
    _, inverse, count = np.unique(ids, return_inverse=True, return_counts=True)
    order = np.argsort(ids, kind="stable")
    order = order[count[inverse[order]] >= 3]
    return frame[order], ids[order], camera[order], directions[order]


def _camera_positions(integral: Integral, levers: Array) -> tuple[Array, Array]:
    """Positions c = derivative @ (v, g, b_a) + centre of cameras at lever arms (C, 3) in every view: centre (C, K, 3),
    derivative (K, 3, 9)."""
    k = len(integral.time)
    derivative = np.zeros((k, 3, 9))
    derivative[:, :, 0:3] = np.eye(3) * integral.time[:, None, None]
    derivative[:, :, 3:6] = np.eye(3) * 0.5 * integral.time[:, None, None] ** 2
    derivative[:, :, 6:9] = -integral.position_rate
    return np.array([integral.position + integral.rotation @ lever for lever in levers]), derivative


def _normal_equations(
    across: Array,
    weight: Array,
    centres: Array,
    derivative: Array,
    starts: NDArray[np.intp],
    track_of: NDArray[np.intp],
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Normal equations (9, 9), (9,) with the landmarks eliminated, and the landmarks as a function of x."""
    weighted = across * weight[:, None, None]
    information = np.add.reduceat(weighted, starts)  # (L, 3, 3)
    information += np.eye(3) * 1e-6 * np.trace(information, axis1=1, axis2=2)[:, None, None]
    cross = np.add.reduceat(weighted @ derivative, starts)  # (L, 3, 9)
    constant = np.add.reduceat((weighted @ centres[:, :, None])[..., 0], starts)  # (L, 3)
    inverse = np.linalg.inv(information)
    point_rate, point = inverse @ cross, (inverse @ constant[:, :, None])[..., 0]
    # Residual of a view: across (X - c), X = point + point_rate x, c = centres + derivative x.
    slope = point_rate[track_of] - derivative
    offset = point[track_of] - centres
    normal = np.einsum("mia,mij,mjb->ab", slope, weighted, slope, optimize=True)
    right = -np.einsum("mia,mij,mj->a", slope, weighted, offset, optimize=True)
    return normal, right, lambda x: point + point_rate @ x


def _solve_on_sphere(normal: Array, right: Array, x: Array, gravity: float) -> Array:
    """Minimum of x^T N x - 2 r^T x with |x[3:6]| = gravity: Gauss-Newton on the tangent plane of the sphere."""
    x = x.copy()
    for _ in range(10):
        down = x[3:6] / gravity
        tangent = np.linalg.svd(down[None, :])[2][1:].T  # (3, 2)
        basis = np.zeros((9, 8))
        basis[:3, :3] = np.eye(3)
        basis[3:6, 3:5] = tangent
        basis[6:, 5:] = np.eye(3)
        step = basis @ np.linalg.solve(basis.T @ normal @ basis, basis.T @ (right - normal @ x))
        x += step
        x[3:6] *= gravity / np.linalg.norm(x[3:6])
        if np.linalg.norm(step) < 1e-8:
            break
    return x


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), dtype=float)
