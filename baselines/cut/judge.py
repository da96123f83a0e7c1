"""A judge of label drift: how well a trained segmentation network still finds the labels after a translation.

`drift` measures whether edges have moved. It does not reveal an oyster that was painted over, or one that was painted
where there is only silt; a network that knows oysters does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.annotations import LabelledImage
from oysterbench_baselines.unet.method import DEFAULT_VIEWS
from oysterbench_baselines.unet.model import read_unet

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Verdict:
    """Pixel counts of one image, or of many together, without ignored pixels.

    labelled: labelled oyster, and rest: all others. hits and false: those of them classified as oyster before the
    translation; hits_after and false_after: after it. vanished: of the hits, no longer classified as oyster; appeared:
    of the rest, classified as oyster only after it
    """

    labelled: int
    rest: int
    hits: int
    false: int
    hits_after: int
    false_after: int
    vanished: int
    appeared: int

    @property
    def iou(self) -> float:
        """IoU of the network's mask with the labels before the translation; NaN where neither has an oyster."""
        return _share(self.hits, self.labelled + self.false)

    @property
    def iou_after(self) -> float:
        """IoU of the network's mask with the labels after the translation; NaN where neither has an oyster."""
        return _share(self.hits_after, self.labelled + self.false_after)

    @property
    def vanished_share(self) -> float:
        """Share of the oyster recognised before that no longer is. NaN where none was recognised."""
        return _share(self.vanished, self.hits)

    @property
    def appeared_share(self) -> float:
        """Share of the background correctly recognised before that is now classified as oyster; NaN without any."""
        return _share(self.appeared, self.rest - self.false)

    def holds(self, share: float) -> bool:
        """Whether the IoU after is at least this share of that before; true where there was none before."""
        return not self.iou_after < share * self.iou


class Judge:
    """A network of `oysterbench train unet` (or `unet_small`) from a file, with its views and its threshold.

    Raises MethodError where the file is not such a checkpoint.
    """

    def __init__(self, path: Path, device: torch.device | None = None) -> None:
        self._model = read_unet(path, device, DEFAULT_VIEWS)

    def sees(self, pixels: NDArray[np.uint8]) -> Mask:
        """Mask (H, W) of the pixels classified as oyster in an image (H, W, 3) RGB."""
        return np.asarray(self._model.probabilities(pixels).oyster >= 0.5)

    def verdict(self, before: LabelledImage, after: LabelledImage) -> Verdict:
        """Judge an image and its translation by the labels of the former."""
        return compare(before.oysters, before.ignore, self.sees(before.pixels), self.sees(after.pixels))


def compare(labels: Mask, ignored: Mask, before: Mask, after: Mask) -> Verdict:
    """Compare labels (H, W) with the masks predicted before and after a translation."""
    label, rest = labels & ~ignored, ~labels & ~ignored
    counts = (
        label,
        rest,
        label & before,
        rest & before,
        label & after,
        rest & after,
        label & before & ~after,
        rest & ~before & after,
    )
    return Verdict(*(int(np.count_nonzero(one)) for one in counts))


def together(verdicts: Iterable[Verdict]) -> Verdict:
    """Sum the verdicts of several images, as if they were one."""
    return Verdict(*(sum(counts) for counts in zip(*(astuple(one) for one in verdicts), strict=True)))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else np.nan
