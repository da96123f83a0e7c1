"""The network: SegFormer as the package transformers has it, its weights drawn at random."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
import transformers
from torch.nn import functional
from transformers import SegformerConfig, SegformerForSemanticSegmentation

from oysterbench.core.errors import MethodError
from oysterbench_baselines.learning.checkpoint import read_finished
from oysterbench_baselines.learning.masks import MaskModel

OUTPUTS = ("oyster", "depth")
"""What the channels of the prediction are logits of; depth: into an oyster, see `learning.samples.depths`."""

MULTIPLE = 32
"""Of pixels, that width and height of what the network is given must be: its coarsest level has one in so many."""

SIZES: dict[str, dict[str, Any]] = {
    "b0": {"hidden_sizes": [32, 64, 160, 256], "depths": [2, 2, 2, 2], "decoder_hidden_size": 256},
    "b1": {"hidden_sizes": [64, 128, 320, 512], "depths": [2, 2, 2, 2], "decoder_hidden_size": 256},
    "b2": {"hidden_sizes": [64, 128, 320, 512], "depths": [3, 4, 6, 3], "decoder_hidden_size": 768},
}
"""Table 6 of the paper."""


@dataclass(frozen=True)
class SegFormerSettings:
    """size: of `SIZES`; drop_path: chance of leaving a block out in training; scale: of an image, at which it is looked
    at."""

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
        """What it says at a quarter of the size, enlarged as the authors do before their loss."""
        logits = self.network(pixel_values=pixels).logits
        return functional.interpolate(logits, size=pixels.shape[-2:], mode="bilinear", align_corners=False)


def described(settings: SegFormerSettings) -> dict[str, Any]:
    """What a checkpoint says of the network."""
    return {"kind": "segformer", "transformers": transformers.__version__, **asdict(settings)}


def read_model(path: Path, device: torch.device) -> MaskModel:
    """From a finished training. Raises MethodError where it is of another network, or not finished."""
    checkpoint = read_finished(path)
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
