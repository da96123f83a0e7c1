"""What several tests of the command line stand on."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.trajectory import Trajectory, write_tum


@pytest.fixture
def trajectories(tmp_path):
    """A truth and an estimate that is 0.1 m off in alternating directions, as TUM files."""
    stamps = 1_000_000_000_000 + np.arange(200) * 50_000_000
    angle = np.linspace(0, 4, 200)
    positions = np.column_stack([np.cos(angle), np.sin(angle), 0.3 * angle])
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    off = positions + np.where(np.arange(200) % 2, 0.1, -0.1)[:, None] * [0, 0, 1]
    write_tum(tmp_path / "truth.tum", Trajectory(stamps, positions, quaternions))
    write_tum(tmp_path / "mine.tum", Trajectory(stamps, off, quaternions))
    return tmp_path / "truth.tum", tmp_path / "mine.tum"
