"""A judge of label drift: what a trained segmentation network still sees of the labels after a translation.

`drift` measures whether edges have moved. It says nothing of an oyster that was painted over, or of one that was
painted where there is only silt; a network that knows oysters does.
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
    """Pixels of one picture, or of many together; ignored ones aside.

    labelled: labelled oyster, and rest: all others. hits and false: of these, called oyster before the translation;
    hits_after and false_after: after it. vanished: of the hits, not called oyster any more; appeared: of the rest,
    called oyster only after it
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
        """Of the network with the labels, before; NaN where neither has an oyster."""
        return _share(self.hits, self.labelled + self.false)

    @property
    def iou_after(self) -> float:
        """The same after the translation."""
        return _share(self.hits_after, self.labelled + self.false_after)

    @property
    def vanished_share(self) -> float:
        """Of what it recognised as oyster before: what it does not any more. NaN where it recognised none."""
        return _share(self.vanished, self.hits)

    @property
    def appeared_share(self) -> float:
        """Of what it rightly took for none before: what it takes for oyster now."""
        return _share(self.appeared, self.rest - self.false)

    def holds(self, share: float) -> bool:
        """Whether the IoU after is at least this share of that before; so it is where there was none before."""
        return not self.iou_after < share * self.iou


class Judge:
    """A network of `oysterbench train unet` (or `unet_small`) from a file, with its views and its threshold.

    Raises MethodError where the file is no such training.
    """

    def __init__(self, path: Path, device: torch.device | None = None) -> None:
        self._model = read_unet(path, device, DEFAULT_VIEWS)

    def sees(self, pixels: NDArray[np.uint8]) -> Mask:
        """(H, W): what it calls oyster of a picture (H, W, 3) RGB."""
        return np.asarray(self._model.probabilities(pixels).oyster >= 0.5)

    def verdict(self, before: LabelledImage, after: LabelledImage) -> Verdict:
        """Of a picture and its translation."""
        return compare(before.oysters, before.ignore, self.sees(before.pixels), self.sees(after.pixels))


def compare(labels: Mask, ignored: Mask, before: Mask, after: Mask) -> Verdict:
    """Of labels (H, W) with what is called oyster before and after."""
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
    """Of all pictures as if they were one."""
    return Verdict(*(sum(counts) for counts in zip(*(astuple(one) for one in verdicts), strict=True)))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else np.nan
