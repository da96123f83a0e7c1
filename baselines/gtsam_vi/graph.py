"""The factor graph: the model that its factors are built from, and the elimination order of its variables."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.common.aiding import Aiding
from oysterbench_baselines.gtsam_vi.calibration import CLOCK, LAST, CameraUncertainty
from oysterbench_baselines.gtsam_vi.cameras import CameraRig
from oysterbench_baselines.gtsam_vi.clock import clocked, moved_on
from oysterbench_baselines.gtsam_vi.preintegration import inertial_factor, preintegration_params
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, time_missing

LEAST = np.array([1e-4] * 3 + [1e-4] * 3)
"""1 sigma, rad and m, with which the start is held where it is exact by definition."""


FEWEST_SPEEDS = 20
"""Number of measured speeds from which a vehicle's usual speed is known."""
LEAST_SPEED = 0.05
"""Usual speed, m/s, of a vehicle that has hardly moved so far."""


@dataclass(frozen=True)
class StartPrior:
    """What is known of the state at which a graph starts: covariances of its pose (6, 6) and velocity (3, 3), in odom's
    axes; bias: known from before a loss, to `known_bias` of the turn-on bias."""

    pose: Array
    velocity: Array
    bias: gtsam.imuBias.ConstantBias | None = None


NOTHING_BUT_THE_GAUGE = StartPrior(np.diag([0.0] * 3 + [0.5**2] * 2 + [0.0]), np.eye(3) * 2.0**2)
"""Position and heading are what the start says, and nothing is known of the rest."""


class Model:
    """Calibrations, noise models and the factors built from them. aiding: the sensors besides cameras and IMU.

    uncertainty: of the cameras, which are then calibrated online.
    start_prior: by the keyframe at which a graph starts; where there is none, nothing is known but the gauge.
    """

    def __init__(
        self,
        cameras: list[CameraCalibration],
        imu: ImuCalibration,
        settings: GtsamViSettings,
        aiding: Aiding | None = None,
        uncertainty: CameraUncertainty | None = None,
    ) -> None:
        self.settings = settings
        self.imu = imu
        self.rig = CameraRig(cameras, imu, uncertainty)
        self.aiding = aiding or Aiding()
        self.params = preintegration_params(imu, settings.noise)
        self.blind_params = preintegration_params(imu, settings.noise, settings.noise.warming_s)
        self.start_prior: dict[int, StartPrior] = {}
        self._speeds, self._squares = 0, 0.0  # number of measured speeds, and the sum of their squares
        # A file may state that the IMU has no turn-on bias; a little is assumed, for what its model leaves out.
        self.gyro_turn_on = max(imu.gyro_turn_on, 1e-4)
        self.accel_turn_on = max(imu.accel_turn_on, 1e-3)

    def inertial(
        self, previous: Keyframe, keyframe: Keyframe, bias: gtsam.imuBias.ConstantBias
    ) -> gtsam.NonlinearFactor:
        """Inertial factor between the states of two keyframes, preintegrated at a bias. Over a time without sight, only
        what is assumed of the drift of the biases counts."""
        params = self.blind_params if keyframe.blind else self.params
        factor = inertial_factor(keyframe.index - 1, keyframe.index, keyframe.segment, bias, params)
        if not self.rig.clock_is_free:
            return factor
        after = keyframe.rates
        assert after is not None
        return clocked(factor, CLOCK, (previous.rates or after, after), self.imu.gravity)

    def at_stamp(self, keyframe: Keyframe, state: State) -> State:
        """Propagate a keyframe's state from when its image was taken to its stamp."""
        rates = keyframe.rates
        return state if rates is None else moved_on(state, self.rig.clock_s, rates, self.imu.gravity)

    def when_taken(self, keyframe: Keyframe, state: State) -> State:
        """Propagate a keyframe's state from its stamp back to when its image was taken."""
        rates = keyframe.rates
        return state if rates is None else moved_on(state, -self.rig.clock_s, rates, self.imu.gravity)

    def motion(
        self,
        previous: Keyframe,
        keyframe: Keyframe,
        before: State,
        state: State,
        bias: gtsam.imuBias.ConstantBias,
    ) -> list[gtsam.NonlinearFactor]:
        """All factors that tie a keyframe to the one before it, given the states of both: loosely where the estimator
        went astray or inertial measurements are missing. While it is lost, they still say how the vehicle moves."""
        k, settings = keyframe.index, self.settings
        if not (keyframe.segment.has_gap or keyframe.astray):
            drag = [self.drag(keyframe)] if keyframe.blind else []
            return [self.inertial(previous, keyframe, bias), *drag, *keyframe.aiding]
        time = max(keyframe.segment.duration, settings.keyframes.min_s)
        turn = np.hypot(self.gyro_turn_on * time, settings.recovery.unknown_rate * time_missing([keyframe.segment]))
        moved = np.repeat([turn, settings.recovery.unknown_speed * time], 3)
        turn_on = np.array([self.accel_turn_on] * 3 + [self.gyro_turn_on] * 3)
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        return [
            gtsam.BetweenFactorPose3(X(k - 1), X(k), before.nav.pose().between(state.nav.pose()), diagonal(moved)),
            gtsam.PriorFactorVector(V(k), state.nav.velocity(), gtsam.noiseModel.Isotropic.Sigma(3, 2.0)),
            gtsam.BetweenFactorConstantBias(B(k - 1), B(k), gtsam.imuBias.ConstantBias(), diagonal(turn_on)),
        ]

    def zero_velocity(self, keyframe: int) -> gtsam.NonlinearFactor:
        """Zero-velocity update of a keyframe."""
        return gtsam.PriorFactorVector(
            V(keyframe), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, self.settings.zero_velocity.sigma)
        )

    def bias_sigmas(self, bias: gtsam.imuBias.ConstantBias) -> float:
        """Largest component of a bias, in sigmas of the turn-on biases."""
        gyro = np.abs(bias.gyroscope()).max() / self.gyro_turn_on
        return float(max(gyro, np.abs(bias.accelerometer()).max() / self.accel_turn_on))

    def note_speed(self, speed: float) -> None:
        """Note a measured speed of the moving vehicle, m/s."""
        self._speeds, self._squares = self._speeds + 1, self._squares + speed**2

    @property
    def usual_speed(self) -> float:
        """Root mean square of the speeds measured under way so far, m/s; `unknown_speed` before there are enough."""
        if self._speeds < FEWEST_SPEEDS:
            return self.settings.recovery.unknown_speed
        return max(float(np.sqrt(self._squares / self._speeds)), LEAST_SPEED)

    def drag(self, keyframe: Keyframe) -> gtsam.NonlinearFactor:
        """Velocity prior of a keyframe that sees next to nothing: no vehicle goes much faster then than it did before,
        whatever the IMU says. Those within `memory_s` together weigh as much as one measurement of zero speed, with the
        usual speed as its sigma."""
        limits, time = self.settings.recovery, max(keyframe.segment.duration, self.settings.keyframes.min_s)
        sigma = limits.blind_speed * self.usual_speed * float(np.sqrt(max(limits.memory_s / time, 1.0)))
        return gtsam.PriorFactorVector(V(keyframe.index), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, sigma))

    def calibration_priors(self) -> list[gtsam.NonlinearFactor]:
        """Prior factors of the calibrations of cameras and aiding sensors."""
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        aiding = [gtsam.PriorFactorVector(c.key, c.value, diagonal(c.sigmas)) for c in self.aiding.calibrations()]
        return [*self.rig.prior(self.settings.noise), *aiding]

    def calibration_keys(self) -> list[int]:
        """Keys of all calibrations that are variables."""
        return [*self.rig.keys(), *(calibration.key for calibration in self.aiding.calibrations())]

    def start_priors(self, keyframe: int, state: State) -> list[gtsam.NonlinearFactor]:
        """Prior factors of the state at which a graph starts; by default, of its position and heading as the gauge."""
        rotation = state.nav.attitude().matrix()
        known = self.start_prior.get(keyframe, NOTHING_BUT_THE_GAUGE)
        # GTSAM puts rotation before translation, both in the axes of the pose itself.
        turn = np.zeros((6, 6))
        turn[:3, 3:] = turn[3:, :3] = rotation.T
        pose = turn @ known.pose @ turn.T + np.diag(LEAST**2)
        turn_on = np.array([self.accel_turn_on] * 3 + [self.gyro_turn_on] * 3)
        share = 1.0 if known.bias is None else self.settings.recovery.known_bias
        return [
            gtsam.PriorFactorPose3(X(keyframe), state.nav.pose(), gtsam.noiseModel.Gaussian.Covariance(pose)),
            gtsam.PriorFactorVector(
                V(keyframe), state.nav.velocity(), gtsam.noiseModel.Gaussian.Covariance(known.velocity)
            ),
            gtsam.PriorFactorConstantBias(
                B(keyframe),
                known.bias or gtsam.imuBias.ConstantBias(),
                gtsam.noiseModel.Diagonal.Sigmas(share * turn_on),
            ),
        ]


def nested_dissection(
    graph: gtsam.NonlinearFactorGraph | gtsam.GaussianFactorGraph, left: Collection[int] = ()
) -> gtsam.Ordering:
    """Elimination order by METIS (Karypis & Kumar 1998), which cuts a path of many passes across all of them.

    left: variables that are not to be eliminated. It takes a third of the memory that COLAMD's order does. METIS writes
    beyond its arrays where a variable shares no factor with any other (a calibration that nothing measures), so such
    variables are withheld from it and come last. So do the cameras, which all landmarks share.
    """
    linked, known = gtsam.SymbolicFactorGraph(), set[int]()
    for n in range(graph.size()):
        keys = {key for key in graph.at(n).keys() if key >> 56 not in LAST}.difference(left)  # noqa: SIM118
        if len(keys) > 1:
            linked.push_back(gtsam.SymbolicFactor.FromKeys(sorted(keys)))
            known |= keys
    ordering = gtsam.Ordering.MetisSymbolicFactorGraph(linked) if known else gtsam.Ordering()
    for key in graph.keyVector():
        if key not in known and key not in left:
            ordering.push_back(key)
    return ordering
