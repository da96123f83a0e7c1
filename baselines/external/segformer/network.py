"""The network: SegFormer from the package transformers, with random initial weights."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
import transformers
from torch.nn import functional
from transformers import SegformerConfig, SegformerForSemanticSegmentation

from oysterbench.core.errors import MethodError
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_finished
from oysterbench_baselines.learning.masks import MaskModel
from oysterbench_baselines.unet.calibration import Calibration
from oysterbench_baselines.unet.model import calibration_of

OUTPUTS = ("oyster", "depth")
"""Channels of the prediction, as logits; depth: inside an oyster, see `learning.samples.depths`."""

MULTIPLE = 32
"""Number of pixels of which the width and height of the network's input must be multiples."""

SIZES: dict[str, dict[str, Any]] = {
    "b0": {"hidden_sizes": [32, 64, 160, 256], "depths": [2, 2, 2, 2], "decoder_hidden_size": 256},
    "b1": {"hidden_sizes": [64, 128, 320, 512], "depths": [2, 2, 2, 2], "decoder_hidden_size": 256},
    "b2": {"hidden_sizes": [64, 128, 320, 512], "depths": [3, 4, 6, 3], "decoder_hidden_size": 768},
}
"""Table 6 of the paper."""


@dataclass(frozen=True)
class SegFormerSettings:
    """size: a key of `SIZES`; drop_path: probability of dropping a block in training; scale: at which an image is
    processed."""

    size: str = "b0"
    drop_path: float = 0.1
    scale: float = 0.5


class SegFormer(torch.nn.Module):
    """(B, 3, h, w) standardised pixels to (B, 2, h, w) logits (`OUTPUTS`); h and w are multiples of 32."""

    def __init__(self, settings: SegFormerSettings) -> None:
        super().__init__()
        config = SegformerConfig(num_labels=len(OUTPUTS), drop_path_rate=settings.drop_path, **SIZES[settings.size])
        self.network = SegformerForSemanticSegmentation(config)

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """Predict at a quarter of the size, and enlarge that as the authors do before their loss."""
        logits = self.network(pixel_values=pixels).logits
        return functional.interpolate(logits, size=pixels.shape[-2:], mode="bilinear", align_corners=False)


def described(settings: SegFormerSettings) -> dict[str, Any]:
    """Description of the network in a checkpoint."""
    return {"kind": "segformer", "transformers": transformers.__version__, **asdict(settings)}


def read_model(path: Path, device: torch.device) -> tuple[MaskModel, Calibration]:
    """Read the network of a finished training, and its calibration. Raises MethodError where it is of another network,
    or not finished."""
    checkpoint = read_finished(path)
    return model_of(checkpoint, path, device), calibration_of(checkpoint)


def model_of(checkpoint: Checkpoint, path: Path, device: torch.device) -> MaskModel:
    """Build the network of a checkpoint. path: that messages name. Raises MethodError where it is of another one."""
    known = dict(checkpoint.network)
    if known.pop("kind", None) != "segformer":
        raise MethodError(
            f"{path}: expected the checkpoint of a segformer, got one of {checkpoint.network.get('kind')!r}"
        )
    known.pop("transformers")
    settings = SegFormerSettings(**known)
    network = SegFormer(settings)
    network.load_state_dict(checkpoint.weights)
    return MaskModel(network.to(device).eval(), settings.scale, MULTIPLE, device)
