"""Scoring masks of oysters: overlap over the data set and per image, borders, classes, thresholds.

What is counted, and the values defined where there is nothing to count (see `tests/evaluate/test_segmentation.py`):

| truth | estimate | IoU, Dice of the image | adds to the sums of the data set |
|---|---|---|---|
| no oyster | no oyster | 1 | nothing |
| no oyster | some | 0 | false positives |
| oysters | none | 0 | misses |
| oysters | elsewhere | 0 | false positives and misses |
| all ignored | anything | none: the image does not count | nothing |

Over the data set: IoU and Dice are 1 if neither truth nor estimate has an oyster; precision is NaN if nothing is
predicted as oyster, recall if there is none; the rate of false positives on oyster-free images is NaN if there is no
such image; a class that is in neither has no IoU and does not enter the mean. Ignored pixels are not counted at all:
predictions there are neither right nor wrong. Borders are taken from the masks before ignored pixels are excluded, so
that an ignored region creates no border of its own.

The headline metric is IoU of the class oyster over the data set: the sum of all intersections over that of all unions,
never averaged with the background. Images are scored one by one and then discarded (`ClipScorer`), so that memory use
is that of one image.
"""

from oysterbench.evaluate.segmentation.clip import ClipResult, ClipScorer, ImageScore
from oysterbench.evaluate.segmentation.images import EstimateImage, TruthImage, check_size
from oysterbench.evaluate.segmentation.metrics import SEGMENTATION
from oysterbench.evaluate.segmentation.settings import EVALUATOR, SegmentationSettings

__all__ = [
    "EVALUATOR",
    "SEGMENTATION",
    "ClipResult",
    "ClipScorer",
    "EstimateImage",
    "ImageScore",
    "SegmentationSettings",
    "TruthImage",
    "check_size",
]
