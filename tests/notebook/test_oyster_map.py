"""Maps in a notebook are refused as those of the command are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import OptionError, TrajectoryError
from oysterbench.core.trajectory import write_tum


@pytest.fixture
def w_first(dive_file, tmp_path):
    """File of the true path with the quaternions' w first."""
    truth = oysterbench.open(dive_file).truth()
    write_tum(tmp_path / "w.tum", replace(truth, quaternions=np.roll(truth.quaternions, 1, axis=1)))
    return tmp_path / "w.tum"


def test_poses_that_are_not_upright_are_refused_from_files_and_from_memory(dive_file, w_first):
    for poses in (w_first, oysterbench.read_trajectory(w_first)):
        with pytest.raises(TrajectoryError, match=r"deg from upright .* order w x y z"):
            oysterbench.oyster_map(dive_file, poses, depth="layer")


def test_a_file_of_poses_is_read_as_said(dive_file, w_first):
    truth = oysterbench.open(dive_file).truth()
    found = oysterbench.oyster_map(dive_file, w_first, depth="layer", quaternion="wxyz")
    assert found.total.count == oysterbench.oyster_map(dive_file, truth, depth="layer").total.count
    with pytest.raises(OptionError, match="quaternion: it says how a file is read"):
        oysterbench.oyster_map(dive_file, truth, depth="layer", quaternion="wxyz")
    with pytest.raises(OptionError, match="no setting 'quaternions' of a map; did you mean quaternion"):
        oysterbench.oyster_map(dive_file, w_first, quaternions="wxyz")
