"""What methods answered about images, read from files: masks, probability maps, arrays, COCO annotations."""

from oysterbench.answers.coco import CocoFile, read_coco
from oysterbench.answers.masks import FORMS, MaskFiles, open_answers
from oysterbench.answers.truth import Clip, open_truth, sequence_clip

__all__ = ["FORMS", "Clip", "CocoFile", "MaskFiles", "open_answers", "open_truth", "read_coco", "sequence_clip"]
