"""Trajectories that the tests of the evaluator are made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamSettings, score

EPOCH_NS = 1_700_000_000 * 10**9


def survey(duration_s: float = 20.0, rate_hz: float = 50.0, start_ns: int = EPOCH_NS) -> Trajectory:
    """A smooth loop at 3 m depth."""
    t = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    positions = np.column_stack([4 * np.cos(t / 3), 3 * np.sin(t / 3), -3 + 0.2 * np.sin(t)])
    attitude = Rotation.from_euler("zyx", np.column_stack([t / 3, 0.1 * np.sin(t), 0.1 * np.cos(t)]))
    return Trajectory(start_ns + np.round(t * 1e9).astype(np.int64), positions, attitude.as_quat())


def transect(length_m: float = 30.0, poses: int = 301, width_m: float = 0.0) -> Trajectory:
    """A straight line in x, that winds by +-width_m across it, at 10 Hz and a steady speed, level."""
    x = np.linspace(0, length_m, poses)
    phase = 2 * np.pi * np.linspace(0, 5, poses)
    positions = np.column_stack([x, width_m * np.sin(phase), width_m * np.cos(phase) - 3])
    stamps = EPOCH_NS + np.arange(poses, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (poses, 1)))


def dive(seed: int, duration_s: float = 60.0, rate_hz: float = 50.0) -> Trajectory:
    """A path with motion at many frequencies, that never repeats."""
    rng = stream(seed, b"", "dive")
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    waves = np.zeros((len(t), 6))
    for frequency in np.geomspace(0.02, 0.5, 12):
        waves += (
            rng.normal(0, 1, 6) / frequency**0.5 * np.sin(2 * np.pi * (frequency * t[:, None] + rng.uniform(0, 1, 6)))
        )
    stamps = EPOCH_NS + np.round(t * 1e9).astype(np.int64)
    return Trajectory(stamps, waves[:, :3] * [1, 1, 0.2], Rotation.from_rotvec(0.1 * waves[:, 3:]).as_quat())


def noisy(trajectory: Trajectory, sigma_m: float = 0.01, case: int = 0) -> Trajectory:
    """With independent errors of position."""
    rng = stream(3, b"", "noise", case)
    return replace(trajectory, positions=trajectory.positions + rng.normal(0, sigma_m, trajectory.positions.shape))


def moved(trajectory: Trajectory, turn: Rotation, by: tuple[float, float, float]) -> Trajectory:
    """In another world frame."""
    return replace(
        trajectory,
        positions=turn.apply(trajectory.positions) + by,
        quaternions=(turn * Rotation.from_quat(trajectory.quaternions)).as_quat(),
    )


def refusal(truth: Trajectory, estimate: Trajectory, **options: Any) -> str:
    """The one line in which the scoring refuses a pair. options: of `SlamSettings`"""
    with pytest.raises(TrajectoryError) as caught:
        score(truth, estimate, SlamSettings(**options))
    message = str(caught.value)
    assert "\n" not in message
    return message
