"""The map that a method built: its keyframes, and the points seen from them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError, TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.ply import write_ply
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.core.trajectory.checks import checked_poses

MAP, KEYFRAMES = "map.ply", "keyframes.tum"

LANDMARK = np.dtype(
    [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("observations", "<i4")]
)
"""Record of a landmark in the PLY file."""


@dataclass(frozen=True)
class LandmarkMap:
    """Keyframes and landmarks, in the odom frame of the path that is scored.

    keyframes:    poses T_odom_base
    landmarks:    (N, 3) float, m
    colours:      (N, 3) uint8 RGB, as the camera saw them
    observations: (N,) int, number of keyframes that saw each landmark

    Raises MethodError where a shape, dtype or value does not fit.
    """

    keyframes: Trajectory
    landmarks: Array
    colours: NDArray[np.uint8]
    observations: NDArray[np.int32]

    def __post_init__(self) -> None:
        n = len(self.landmarks)
        shapes = {"landmarks": (n, 3), "colours": (n, 3), "observations": (n,)}
        for key, shape in shapes.items():
            if getattr(self, key).shape != shape:
                raise MethodError(f"map: expected {key} {shape}, got {getattr(self, key).shape}")
        if self.colours.dtype != np.uint8:
            raise MethodError(f"map: expected colours as uint8, got {self.colours.dtype}")
        if self.observations.dtype.kind not in "iu":
            raise MethodError(f"map: expected observations as whole numbers, got {self.observations.dtype}")
        wrong = ~np.isfinite(self.landmarks).all(axis=1)
        if wrong.any():
            i = int(np.argmax(wrong))
            raise MethodError(f"map: expected finite landmarks, got {self.landmarks[i]} at landmark {i + 1} of {n}")
        try:
            checked_poses(self.keyframes, "key frames", lambda i: f"map: key frame {i + 1}")
        except TrajectoryError as error:
            raise MethodError(str(error)) from None

    def write(self, folder: Path) -> None:
        """Write map.ply, the landmarks in odom in m, and keyframes.tum."""
        rows = np.zeros(len(self.landmarks), dtype=LANDMARK)
        rows["x"], rows["y"], rows["z"] = np.asarray(self.landmarks, dtype=float).T
        rows["red"], rows["green"], rows["blue"] = self.colours.T
        rows["observations"] = self.observations
        write_ply(folder / MAP, rows, "landmarks in odom, m")
        write_tum(folder / KEYFRAMES, self.keyframes)
