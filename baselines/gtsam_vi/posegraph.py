"""The pose graph over places: odometry between neighbours, loops between others, by iSAM2 (Kaess et al. 2012).

Roll and pitch are measured by gravity and do not drift. So a node is the level pose of a place, with four degrees of
freedom (Qin, Li & Shen 2018, section VIII): a `Pose3` whose roll and pitch are held at zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from oysterbench.core.geometry import Array, invert
from oysterbench_baselines.gtsam_vi.places import heading_of
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings

LEVEL = 1e-4
"""1 sigma of roll and pitch of a level pose, rad."""


@dataclass(frozen=True)
class Drift:
    """Uncertainty that odometry adds in one step: variances of heading (rad^2) and position per axis (m^2)."""

    heading: float
    position: float


class PoseGraph:
    """Level poses of places in odom, in the order in which they were passed, corrected by loops."""

    def __init__(self, settings: GtsamViSettings) -> None:
        self.settings = settings
        self._params = gtsam.ISAM2Params()
        self._params.setRelinearizeThreshold(1e-3)  # m and rad: robust weights are renewed only then
        self._params.relinearizeSkip = 1
        self._params.findUnusedFactorSlots = True
        self._isam = gtsam.ISAM2(self._params)
        self.odometry: list[Array] = []  # T_odom_level as the window had them
        self.poses: list[Array] = []  # as corrected by the loops
        self._sums = np.zeros((1, 5))  # running, of heading variance times 1, x, y, x^2 + y^2; of position variance
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._passed_by = 0  # loops skipped since the last one that was added

    @property
    def correction(self) -> Array:
        """T_corrected_odom (4, 4): rotation about z and translation that take the window's poses to the graph's."""
        return self.poses[-1] @ invert(self.odometry[-1]) if self.poses else np.eye(4)

    def add(self, T_odom_level: Array, drift: Drift) -> None:
        """Add the next place; drift: of the step to it."""
        n = len(self.poses)
        factor: gtsam.NonlinearFactor
        if n == 0:
            pose, drift = T_odom_level, Drift(0.0, 0.0)
            exact = gtsam.noiseModel.Isotropic.Sigma(6, LEVEL)
            factor = gtsam.PriorFactorPose3(X(0), gtsam.Pose3(T_odom_level), exact)
        else:
            step = invert(self.odometry[-1]) @ T_odom_level
            pose = self.poses[-1] @ step
            covariance = np.diag([drift.heading] + [drift.position] * 3)
            factor = gtsam.BetweenFactorPose3(X(n - 1), X(n), gtsam.Pose3(step), _noise(step, covariance))
        self.odometry.append(T_odom_level)
        self.poses.append(pose)
        x, y = T_odom_level[:2, 3]
        # An error in heading turns all later places about this one.
        row = [drift.heading, drift.heading * x, drift.heading * y, drift.heading * (x * x + y * y), drift.position]
        self._sums = np.vstack([self._sums, self._sums[-1] + row])
        self._graph.push_back(factor)
        self._graph.push_back(_level_factor(n))
        self._values.insert(X(n), gtsam.Pose3(pose))

    def close(self, first: int, second: int, T_first_second: Array, covariance: Array) -> None:
        """Add a loop: level pose of the second place as seen from the first, and covariance (4, 4) of heading and
        position in the first's axes. Robust: a loop that all others contradict loses its weight (Cauchy).

        Time and memory grow with the graph and its loops, and neighbouring loops say the same: a large graph takes only
        one of several, the fewer the larger it is.
        """
        if self._passed_by + 1 < len(self.poses) // self.settings.loops.places_per_skip:
            self._passed_by += 1
            return
        self._passed_by = 0
        cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(self.settings.loops.cauchy)
        noise = gtsam.noiseModel.Robust.Create(cauchy, _noise(T_first_second, covariance))
        self._graph.push_back(gtsam.BetweenFactorPose3(X(first), X(second), gtsam.Pose3(T_first_second), noise))
        self._isam.update(self._graph, self._values)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for _ in range(self.settings.loops.iterations):
            self._isam.update()
        values = self._isam.calculateEstimate()
        self.poses = [values.atPose3(X(n)).matrix() for n in range(len(self.poses))]

    def rest(self) -> None:
        """Release the graph and keep the poses: no place will follow."""
        self._isam = gtsam.ISAM2(self._params)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def uncertainty(self, first: int, second: int) -> tuple[float, float]:
        """1 sigma of heading (rad) and of position along any one axis (m), of the second place as seen from the first
        by odometry alone: that loops have reduced it is ignored, which is on the safe side."""
        heading, hx, hy, square, position = self._sums[second + 1] - self._sums[first + 1]
        x, y = self.odometry[second][:2, 3]
        arm = max(0.0, square - 2 * (x * hx + y * hy) + heading * (x * x + y * y))
        return float(np.sqrt(heading)), float(np.sqrt(position + arm))


def _level_factor(n: int) -> gtsam.NonlinearFactor:
    up = gtsam.Unit3(np.array([0.0, 0.0, 1.0]))
    return gtsam.AttitudeFactorPose3(X(n), up, gtsam.noiseModel.Isotropic.Sigma(2, LEVEL), up)


def _noise(T_first_second: Array, covariance: Array) -> gtsam.noiseModel.Base:
    """Noise model in GTSAM's tangent at the second pose (rotation, then translation in its axes), from the covariance
    (4, 4) of heading and position in the axes of the first."""
    back = np.eye(4)
    heading = heading_of(T_first_second)
    c, s = np.cos(heading), np.sin(heading)
    back[1:3, 1:3] = [[c, s], [-s, c]]
    full = np.diag([LEVEL**2] * 2 + [0.0] * 4)
    full[2:, 2:] = back @ covariance @ back.T
    return gtsam.noiseModel.Gaussian.Covariance(full)
