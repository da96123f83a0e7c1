"""Errors along each axis, against errors that were put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.report.components import attitude_errors_deg, position_errors
from tests.report.test_report import loop


def test_errors_are_those_that_were_put_in_along_each_axis():
    truth = loop()
    turns = Rotation.from_euler("z", np.linspace(0, 300, len(truth))[:, None], degrees=True)
    truth = replace(truth, quaternions=turns.as_quat())
    tilt = Rotation.from_rotvec([2.0, -1.0, 0.5], degrees=True)  # in the body, whichever way it looks
    off = truth.positions + np.array([0.3, -0.2, 0.1])
    estimate = replace(truth, positions=off, quaternions=(turns * tilt).as_quat())
    result = score(truth, estimate, SlamSettings(align="none"))
    assert position_errors(result) == pytest.approx(np.tile([0.3, -0.2, 0.1], (len(truth), 1)))
    assert attitude_errors_deg(result) == pytest.approx(np.tile([2.0, -1.0, 0.5], (len(truth), 1)), abs=1e-9)
    assert np.linalg.norm(attitude_errors_deg(result), axis=1) == pytest.approx(result.rotation_error_deg)
    assert np.linalg.norm(position_errors(result), axis=1) == pytest.approx(result.error_m)
