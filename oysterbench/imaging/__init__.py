"""The tracks segmentation and detection, run: methods over the clips of a split, or answers read from files."""

from oysterbench.imaging.answering import answers_of, instances_of
from oysterbench.imaging.detection import evaluate_detection, score_detection_files
from oysterbench.imaging.segmentation import evaluate_segmentation, score_segmentation_files

__all__ = [
    "answers_of",
    "evaluate_detection",
    "evaluate_segmentation",
    "instances_of",
    "score_detection_files",
    "score_segmentation_files",
]
