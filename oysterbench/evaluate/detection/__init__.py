"""Scoring single oysters: average precision of boxes and masks, counts, panoptic quality.

Precision equals that of pycocotools to the last digit: its matching, image by image, and its 101-point curve, which is
only summed here (`precision`), so that clips can be resampled. Values defined where there is nothing to score (see
`tests/evaluate/test_detection.py`):

| truth | estimate | AP, recall | counts | panoptic quality |
|---|---|---|---|---|
| no oyster in the clip | none | none | error 0 | none |
| no oyster in the clip | some | none | error = their number | 0 |
| oysters | none | 0 | error = minus their number | 0 |
| oyster, ignored | on it | none: not scored | not counted | not counted |
| oyster, ignored | none | none: not scored | error 0 | none |

A crowd region (iscrowd) is a region to be ignored: an estimate that overlaps it by more than the overlap threshold (AP)
or by more than half of its own area (counts, panoptic quality) is neither right nor wrong. All oysters of an image that
are ignored are one region; in a COCO file, each crowd annotation is one. Boxes are compared with those of the connected
parts of its mask, not with one box around all of them as in pycocotools; with `bbox` only where it has no mask.

At most `max_detections` of an image count, the most confident ones. COCO's 100 would leave out oysters of a dense reef,
of which an image of seg-val shows up to 205: 150 perfect detections reach an AP of 0.663 at 100. Equal scores keep the
order given, as in pycocotools.
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
