"""A trained network, ready to predict."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_finished
from oysterbench_baselines.learning.efficientnet import EfficientNetLite, for_prediction, pretrained
from oysterbench_baselines.learning.loop import channels_last
from oysterbench_baselines.learning.masks import MaskModel, enlarged, probability
from oysterbench_baselines.learning.novelty import Array, Novelty
from oysterbench_baselines.learning.samples import Floats, shrink, standardised, statistics, working_scale
from oysterbench_baselines.unet.calibration import Calibration
from oysterbench_baselines.unet.instances import Division
from oysterbench_baselines.unet.network import CONTRAST, PretrainedUNetwork, UNetworkSettings, build_network, kind_of
from oysterbench_baselines.unet.views import FINER, VIEWS, Look, View, closer_views, fitting_zoom, shows_the_same

ALIKE_SIDE = 320
"""Length of an image's longer side, px, at which its features for novelty are computed."""
EMBEDDED = 3
"""Number of the encoder's deepest levels whose means over the image are its features for novelty."""


class Probabilities(NamedTuple):
    """Maps of probabilities (H, W): oyster, calibrated; depth inside an oyster; live, that the oyster is alive, None
    where the network cannot tell. division: parameters by which instances are separated in them."""

    oyster: Floats
    depth: Floats
    live: Floats | None
    division: Division


@dataclass
class UNetModel(MaskModel):
    """A network of `unet` with its measurements. views: how many of `VIEWS` are averaged; novelty: None for networks
    without a pretrained encoder."""

    views: int = 1
    calibration: Calibration = field(default_factory=Calibration)
    novelty: Novelty | None = None

    def look(self, pixels: NDArray[np.uint8]) -> Look:
        """Predict logits of an image (H, W, 3) uint8 RGB, averaged over views. With more than one view, a network with
        a pretrained encoder looks from farther away where oysters are large at first glance, and more closely where
        they are small; the closer views alone are averaged if they show the same ones."""
        glance = self._seen(pixels, VIEWS[0])
        zoom = fitting_zoom(glance) if self.views > 1 and isinstance(self.network, PretrainedUNetwork) else 1.0
        if zoom < 1.0:
            farther = [view._replace(zoom=zoom * view.zoom) for view in VIEWS[: self.views]]
            return Look(self._mean([self._seen(pixels, view) for view in farther]), zoom)
        views = closer_views(zoom) if zoom > 1.0 else VIEWS
        seen = [glance, *(self._seen(pixels, view) for view in views[1 : self.views])]
        if zoom > 1.0:
            closer = self._mean(seen[1::2])
            if shows_the_same(closer, glance):
                return Look(closer, FINER * zoom)
        return Look(self._mean(seen))

    @staticmethod
    def _mean(seen: list[Floats]) -> Floats:
        return np.asarray(np.mean(seen, axis=0), np.float32)

    def _seen(self, pixels: NDArray[np.uint8], view: View) -> Floats:
        """Logits (K, H, W) of one view, transformed back to the original image."""
        seen = np.ascontiguousarray(np.rot90(pixels[:, ::-1] if view.mirrored else pixels, view.turns))
        found = np.rot90(enlarged(self.small_logits(seen, view.zoom), *seen.shape[:2]), -view.turns, axes=(1, 2))
        return found[..., ::-1] if view.mirrored else found

    def probabilities(self, pixels: NDArray[np.uint8]) -> Probabilities:
        """Predict calibrated probabilities for an image (H, W, 3) uint8 RGB."""
        (oyster, depth, *live), zoom = self.look(pixels)
        tells = bool(live) and self.calibration.tells
        return Probabilities(
            probability(self.calibration.applied(oyster)),
            probability(depth),
            probability(live[0] - np.float32(self.calibration.live_cut)) if tells else None,
            self.calibration.division.zoomed(zoom),
        )

    def alike(self, pixels: NDArray[np.uint8]) -> Array:
        """Features (C,) of an image for novelty: means over the deepest levels (`EMBEDDED`) of the encoder as it was
        before the training, in which the network's own encoder forgot all that oysters are not."""
        small = shrink(pixels, working_scale(pixels.shape, self.scale, ALIKE_SIDE))
        batch = self.batch(standardised(small, *statistics(small)))
        with torch.inference_mode():
            levels = self._untrained.features(CONTRAST * batch)[-EMBEDDED:]
        return torch.cat([level.mean(dim=(2, 3)) for level in levels], dim=1)[0].double().cpu().numpy()

    @cached_property
    def _untrained(self) -> EfficientNetLite:
        assert isinstance(self.network, PretrainedUNetwork)
        encoder: EfficientNetLite = for_prediction(channels_last(pretrained(self.network.encoder.name).to(self.device)))
        return encoder

    def novelty_of(self, pixels: NDArray[np.uint8]) -> float | None:
        """How unlike an image is to those of the training: one in a hundred images of a clip left out exceeds 1. None
        where the novelty was not measured."""
        return None if self.novelty is None else float(self.novelty.of(self.alike(pixels)[None])[0])


def unet_model(checkpoint: Checkpoint, device: torch.device | None = None, views: int = 1) -> UNetModel:
    """Build the model from a checkpoint. Raises MethodError where that is of another network."""
    if checkpoint.network.get("kind") != "unet":
        raise MethodError(f"expected the checkpoint of a unet, got one of {checkpoint.network.get('kind')!r}")
    settings = UNetworkSettings(**{key: value for key, value in checkpoint.network.items() if key != "kind"})
    network = build_network(settings)
    network.load_state_dict(checkpoint.weights)
    device = device or torch.device("cpu")
    return UNetModel(
        for_prediction(channels_last(network.to(device))),
        settings.scale,
        settings.multiple,
        device,
        settings.side,
        settings.outputs,
        views,
        calibration_of(checkpoint),
        Novelty.read(checkpoint.measured["novelty"]) if "novelty" in checkpoint.measured else None,
    )


def calibration_of(checkpoint: Checkpoint) -> Calibration:
    """Calibration that a checkpoint holds; the default one where none was measured."""
    return Calibration(**checkpoint.measured.get("calibration", {}))


def read_unet(path: Path, device: torch.device | None = None, views: int = 1, kind: str = "") -> UNetModel:
    """Read the model from a checkpoint file. kind: training that it must be of (`network.kind_of`); empty for any.
    Raises MethodError where it is of another or an unfinished one."""
    checkpoint = read_finished(path)
    model = unet_model(checkpoint, device, views)
    if kind:
        check_kind(checkpoint, kind, path)
    return model


def check_kind(checkpoint: Checkpoint, kind: str, path: Path | None) -> None:
    """Raise MethodError unless a checkpoint is of this kind of training (`network.kind_of`)."""
    found = kind_of(checkpoint.network) if checkpoint.network.get("kind") == "unet" else checkpoint.network.get("kind")
    if kind != found:
        raise MethodError(
            f"{path}: expected weights of `oysterbench train {kind}`, got some of `oysterbench train {found}`"
        )


def described(settings: UNetworkSettings) -> dict[str, Any]:
    """Description of the network in a checkpoint."""
    return {"kind": "unet", **asdict(settings)}
