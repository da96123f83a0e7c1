"""Scoring single oysters: average precision of boxes and masks, counts, panoptic quality.

Precision is pycocotools' to the last digit: its matching, image by image, and its 101-point curve, over which this
package only sums (`precision`), so that clips can be resampled. What is pinned where there is nothing to score (held by
`tests/evaluate/test_detection.py`):

| truth | estimate | AP, recall | counts | panoptic quality |
|---|---|---|---|---|
| no oyster in the clip | none | none | error 0 | none |
| no oyster in the clip | some | none | error = their number | 0 |
| oysters | none | 0 | error = minus their number | 0 |
| oyster, ignored | on it | none: not asked | not counted | not counted |
| oyster, ignored | none | none: not asked | error 0 | none |

A crowd region (iscrowd) is a region to be ignored: what lies on it by more than the threshold of overlap (AP) or by
more than half of itself (counts, panoptic quality) is neither right nor wrong.

At most `max_detections` of an image count, the surest ones. COCO's 100 would leave out oysters of a dense reef, of
which an image of seg-val shows up to 205: 150 perfect detections reach an AP of 0.663 at 100. Of equal scores the order
given decides, as in pycocotools.
"""

from oysterbench.evaluate.detection.clip import DetectionClip, DetectionScorer
from oysterbench.evaluate.detection.instances import ImageInstances, Instance
from oysterbench.evaluate.detection.metrics import DETECTION
from oysterbench.evaluate.detection.settings import EVALUATOR, DetectionSettings

__all__ = [
    "DETECTION",
    "EVALUATOR",
    "DetectionClip",
    "DetectionScorer",
    "DetectionSettings",
    "ImageInstances",
    "Instance",
]
