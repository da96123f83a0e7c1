"""Estimated paths to draw beside the ground truth, aligned with it as in `oysterbench eval`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.alignment import meet
from oysterbench.evaluate.slam.inputs import open_pair
from oysterbench.evaluate.slam.settings import SlamSettings
from oysterbench.sequence.types import Sequence


@dataclass(frozen=True)
class EstimatedPath:
    """Estimated poses of base_link, aligned with the ground truth, with the notes on reading them. rmse_m: RMSE of the
    matched positions."""

    name: str
    poses: Trajectory
    rmse_m: float

    @property
    def label(self) -> str:
        """Name and error, as written beside the path."""
        error = f"{100 * self.rmse_m:.2g} cm" if self.rmse_m < 1 else f"{self.rmse_m:.3g} m"
        return f"{self.name}, ATE {error}"


def estimated_paths(sequence: Sequence, files: Iterable[Path], settings: SlamSettings) -> list[EstimatedPath]:
    """Read and align one path per file, named after the file.

    Raises SequenceError where the sequence has no ground truth to align with, and TrajectoryError where a file cannot
    be read or aligned.
    """
    paths = list(files)
    try:
        truth = sequence.truth() if paths else None
    except SequenceError as error:
        raise SequenceError(f"--estimate is shown beside the truth: {error}") from None
    found: list[EstimatedPath] = []
    for path in paths:
        assert truth is not None
        true, poses = open_pair(truth, path, settings)
        met, fit = meet(true, poses, settings)
        by = fit.similarity
        aligned = Trajectory(
            poses.stamps_ns, by.apply(poses.positions), by.rotate(poses.quaternions), notes=poses.notes
        )
        off = met.truth.positions - by.apply(met.estimate.positions)
        rmse = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        taken = {one.name for one in found} | {"truth"}
        name = next(
            name for k in range(1, len(paths) + 2) if (name := path.stem if k == 1 else f"{path.stem}-{k}") not in taken
        )
        found.append(EstimatedPath(name, aligned, rmse))
    return found
