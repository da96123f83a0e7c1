"""A trained network, ready for inference."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench_baselines.gtsam_vi.settings import FrontEndSettings
from oysterbench_baselines.gtsam_vi_learned.network import MULTIPLE, MapNetwork, MapNetworkSettings
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_finished
from oysterbench_baselines.learning.loop import channels_last

KIND = "gtsam_vi_learned"
GREY = FrontEndSettings().contrast_grey
"""Grey levels of one unit of contrast."""


@dataclass(frozen=True)
class LearnedMaps:
    """Output for one image: error_px (H, W) float32, expected error of a point there after tracking; maps (H, W, C)
    uint8, in which points can be tracked, where these were requested."""

    error_px: NDArray[np.float32]
    maps: NDArray[np.uint8] | None


class MapModel:
    """A network with its weights."""

    def __init__(self, network: MapNetwork) -> None:
        self.network = channels_last(network).eval()

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> MapModel:
        """Build from a checkpoint. Raises MethodError where it is that of another network."""
        known = dict(checkpoint.network)
        if known.pop("kind", None) != KIND:
            found = checkpoint.network.get("kind")
            raise MethodError(f"expected the checkpoint of `oysterbench train {KIND}`, got one of {found!r}")
        network = MapNetwork(MapNetworkSettings(**{**known, "channels": tuple(known["channels"])}))
        network.load_state_dict(checkpoint.weights)
        return cls(network)

    @classmethod
    def read(cls, path: Path) -> MapModel:
        """Read from a file. Raises MethodError where it is of another or an unfinished training."""
        return cls.of(read_finished(path))

    def __call__(self, even: NDArray[np.uint8], with_maps: bool = True) -> LearnedMaps:
        """Compute the maps of an image (H, W) uint8 of even contrast, of any size."""
        height, width = even.shape
        padded = np.pad(even, ((0, -height % MULTIPLE), (0, -width % MULTIPLE)), mode="edge")
        maps = None
        with torch.inference_mode():
            picture = (torch.from_numpy(padded)[None, None].float() - 128) / GREY
            picture = picture.contiguous(memory_format=torch.channels_last)
            if with_maps:
                values, log_error = self.network(picture)
                grey = (values[0, :, :height, :width] * GREY + 128).round().clamp(0, 255).to(torch.uint8)
                maps = np.ascontiguousarray(grey.permute(1, 2, 0).numpy())
            else:
                log_error = self.network.log_error(picture)
            error = torch.nn.functional.interpolate(log_error, scale_factor=4, mode="bilinear").exp()
        return LearnedMaps(error[0, 0, :height, :width].contiguous().numpy(), maps)


def described(settings: MapNetworkSettings) -> dict[str, Any]:
    """Description of the network in a checkpoint."""
    plain = asdict(settings)
    return {"kind": KIND, **{key: list(value) if isinstance(value, tuple) else value for key, value in plain.items()}}
