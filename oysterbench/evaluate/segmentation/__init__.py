"""Scoring masks of oysters: overlap over the data set and per image, borders, classes, thresholds.

What is counted, and what is pinned where there is nothing to count (held by `tests/evaluate/test_segmentation.py`):

| truth | estimate | IoU, Dice of the image | adds to the sums of the data set |
|---|---|---|---|
| no oyster | no oyster | 1 | nothing |
| no oyster | some | 0 | false positives |
| oysters | none | 0 | misses |
| oysters | elsewhere | 0 | false positives and misses |
| all ignored | anything | none: the image has no vote | nothing |

Over the data set: IoU and Dice are 1 where neither truth nor estimate has an oyster; precision is NaN where nothing is
called oyster, recall where there is none; the rate of false positives on oyster-free images is NaN where there is no
such image; a class that is in neither has no IoU and no part in the mean. Ignored pixels are in no count: what is said
of them is neither right nor wrong. Borders are those of the masks as they stand, taken before ignored pixels are left
out, so that an ignored region makes no border of its own.

The headline is IoU of the class oyster over the data set: all intersections by all unions, never averaged with the
background. Images are scored one by one and then forgotten (`ClipScorer`), so memory is that of one image.
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
