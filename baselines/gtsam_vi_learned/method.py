"""The method: gtsam_vi with the learned front end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.methods import Estimate
from oysterbench.sequence.types import CameraCalibration, Sequence
from oysterbench_baselines.gtsam_vi.frontend import FrontEnd
from oysterbench_baselines.gtsam_vi.method import GtsamVi, Output
from oysterbench_baselines.gtsam_vi_learned.settings import GtsamViLearnedSettings
from oysterbench_baselines.learning.trained import on_torch, trained, used_path

if TYPE_CHECKING:
    from oysterbench_baselines.gtsam_vi_learned.model import MapModel


class GtsamViLearned(GtsamVi):
    """Visual-inertial odometry on GTSAM, its corners chosen by how well a network expects them to be tracked.

    output, camera, seed: as in gtsam_vi. checkpoint: path of the trained network; by default the one that
    `OYSTERBENCH_GTSAM_VI_LEARNED` names, or that `oysterbench train gtsam_vi_learned` or `oysterbench download
    gtsam_vi_learned` left. threads: number of CPU threads.
    """

    name = "gtsam_vi_learned"
    settings: GtsamViLearnedSettings

    def __init__(
        self,
        output: Output = "smoothed",
        camera: str | None = None,
        settings: GtsamViLearnedSettings | None = None,
        seed: int = 0,
        checkpoint: str = "",
        threads: int = 1,
    ) -> None:
        super().__init__(output, camera, settings or GtsamViLearnedSettings(), False, seed)
        self.checkpoint, self.threads = checkpoint, threads
        self.about = {**self.about, "code": "baselines/gtsam_vi_learned"}

    @property
    def weights(self) -> dict[str, Path]:
        """Files of the trained weights that it uses."""
        return {"gtsam_vi_learned": used_path("gtsam_vi_learned", self.checkpoint)}

    def run(self, sequence: Sequence) -> Estimate:
        """Run as gtsam_vi does. Raises MethodError, with what to type, where there are no trained weights."""
        self._path()
        return super().run(sequence)

    def front_end(self, calibration: CameraCalibration) -> FrontEnd:
        path = self._path()
        with on_torch(self.name):
            from oysterbench_baselines.gtsam_vi_learned.frontend import LearnedFrontEnd
        return LearnedFrontEnd(calibration, self.settings, load_model(path, self.threads), self.seed)

    def _path(self) -> Path:
        return trained("gtsam_vi_learned", self.checkpoint)


def load_model(path: Path, threads: int = 1) -> MapModel:
    """Load the trained network at a path."""
    import torch

    from oysterbench_baselines.gtsam_vi_learned.model import MapModel

    torch.set_num_threads(threads)
    return MapModel.read(path)
