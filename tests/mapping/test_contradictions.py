"""What gyroscope and DVL of a dive say against a path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import transform
from oysterbench.core.measurements import DvlMeasurement, ImuMeasurement
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.time_offset import shift
from oysterbench.mapping.contradictions import contradictions
from oysterbench.sequence import Sequence
from oysterbench.sequence.types import DvlCalibration
from tests.helpers.dives import dive, moved, noisy, survey
from tests.helpers.synthetic_dive import imu_calibration

RATE_HZ, PING_EVERY = 50.0, 10
CALIBRATION = replace(
    imu_calibration(), T_base_imu=transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), [0, 0, 0])
)
MOUNT = transform(np.eye(3), [0.3, 0.1, -0.1])


class Measured(Sequence):
    """What an inertial unit, turned on its mount, and a DVL measure along a path."""

    name, metadata, cameras = "measured", {}, {}
    imu_calibration = CALIBRATION

    def __init__(self, path: Trajectory, dvl: bool = True) -> None:
        self.path = path
        self.dvl_calibration = DvlCalibration(MOUNT, np.eye(3), 50.0) if dvl else None

    duration_s = 60.0

    def contents(self):
        return []

    def truth(self):
        return self.path

    def imu(self, start_ns=None, end_ns=None):
        turns = Rotation.from_quat(self.path.quaternions)
        rates = (turns[:-1].inv() * turns[1:]).as_rotvec() * RATE_HZ @ CALIBRATION.T_base_imu[:3, :3]
        generator = np.random.default_rng(1)
        for stamp, rate in zip(self.path.stamps_ns + round(0.5e9 / RATE_HZ), rates, strict=False):
            yield ImuMeasurement(int(stamp), rate + 0.002 + 0.003 * generator.standard_normal(3), np.zeros(3))

    def dvl(self, start_ns=None, end_ns=None):
        if self.path.stamps_ns[0] % 2:
            raise SequenceError("measured has no /dvl/velocity: it has some of the topics only")
        turns = Rotation.from_quat(self.path.quaternions)
        heads = self.path.positions + turns.apply(MOUNT[:3, 3])
        velocities = turns.inv().apply(np.gradient(heads, 1 / RATE_HZ, axis=0))
        generator = np.random.default_rng(2)
        for k in range(0, len(self.path), PING_EVERY):
            velocity = velocities[k] + 0.01 * generator.standard_normal(3) + (np.nan if k % 7 == 0 else 0.0)
            yield DvlMeasurement(
                int(self.path.stamps_ns[k]),
                velocity,
                np.eye(3),
                0.1,
                1.0,
                np.eye(3),
                np.ones(3),
                velocity,
                np.isfinite(velocity),
            )


WINDING = dive(1)


@pytest.mark.parametrize("truth", [WINDING, survey(30.0)])
@pytest.mark.parametrize(
    "change", ["none", "frame", "noise", "scale 1.1", "0.2 s late", "one pose in ten", "a pose in 3 s", "its middle"]
)
def test_a_path_that_agrees_is_not_complained_about(truth, change):
    path = {
        "none": truth,
        "frame": moved(truth, Rotation.from_euler("z", 2.0), (400_000.0, 4e6, 3.0)),
        "noise": noisy(truth, 0.03),
        "scale 1.1": replace(truth, positions=1.1 * truth.positions),
        "0.2 s late": shift(truth, 0.2),
        "one pose in ten": truth.select(slice(None, None, 10)),
        "a pose in 3 s": truth.select(slice(None, None, 150)),
        "its middle": truth.select(slice(400, 1100)),
    }[change]
    assert contradictions(Measured(truth), path) == []


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_wrong_scale_is_told_by_the_dvl(scale):
    truth = survey(30.0)
    scaled = replace(truth, positions=scale * truth.positions)
    (said,) = contradictions(Measured(truth), scaled)
    assert f"by the DVL, the path is {scale:g} times as long as it should be" in said
    assert contradictions(Measured(truth, dvl=False), scaled) == []


def test_a_wrong_scale_is_told_of_a_sparse_path_too():
    sparse = WINDING.select(slice(None, None, 150))
    (said,) = contradictions(Measured(WINDING), replace(sparse, positions=3 * sparse.positions))
    assert said.startswith("by the DVL, the path is 3.1 times as long as it should be")


@pytest.mark.parametrize(("late_s", "side"), [(3.0, "late"), (-1.5, "early")])
def test_a_wrong_clock_is_told_by_the_gyroscope(late_s, side):
    (said,) = contradictions(Measured(WINDING), shift(WINDING, late_s))
    assert f"timestamps are {abs(late_s):.2f} s {side}" in said


@pytest.mark.parametrize("truth", [WINDING, survey(30.0)])
def test_inverted_attitudes_are_told_by_the_gyroscope(truth):
    turned = replace(truth, quaternions=truth.quaternions * [-1, -1, -1, 1])
    (said,) = contradictions(Measured(truth), turned)
    assert "by the gyroscope, the path turns the other way" in said


def test_a_path_that_does_not_move_is_told():
    still = replace(WINDING, positions=WINDING.positions * 0, quaternions=np.tile([0, 0, 0, 1.0], (len(WINDING), 1)))
    for dvl in (True, False):
        assert contradictions(Measured(WINDING, dvl), still) == [
            "the path does not move, but by its gyroscope or DVL the vehicle did"
        ]
    # Nor is it a contradiction where the vehicle lay on the bottom.
    assert contradictions(Measured(still), WINDING) == []


@pytest.mark.parametrize("dvl", [True, False])
def test_a_path_of_positions_alone_does_not_turn_but_moves(dvl):
    level = replace(WINDING, quaternions=np.tile([0, 0, 0, 1.0], (len(WINDING), 1)))
    (said,) = contradictions(Measured(WINDING, dvl), level)
    assert said.startswith("the path does not turn, but by its gyroscope the vehicle did")


def test_a_file_without_the_topic_of_its_gyroscope_is_not_judged(monkeypatch):
    def absent(self, start_ns=None, end_ns=None):
        raise SequenceError("measured has no /imu: it has some of the topics only")

    monkeypatch.setattr(Measured, "imu", absent)
    assert contradictions(Measured(WINDING), shift(WINDING, 3.0)) == []


def test_a_file_without_some_of_the_topics_of_its_dvl_is_judged_by_the_rest():
    odd = replace(WINDING, stamps_ns=WINDING.stamps_ns + 1)
    assert contradictions(Measured(odd), replace(odd, positions=2 * odd.positions)) == []


def test_a_path_of_one_pose_says_nothing():
    assert contradictions(Measured(WINDING), WINDING.select(slice(1))) == []
